"""Builds a map pack from georeferenced rasters."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from vwnav import __version__
from vwnav.errors import MapError
from vwnav.geometry.geodesy import (
    MAX_ZOOM,
    TILE_PX,
    Tile,
    Window,
    ground_resolution_m_per_px,
    lat_lon_from_mercator_px,
    zoom_for_resolution,
)
from vwnav.maps.build.keypoints import block_of, extract_block
from vwnav.maps.build.raster import Bounds, RasterSource
from vwnav.maps.build.warp import BLOCK_PX, PlacedRaster, bounds_window, compose
from vwnav.maps.build.writer import PackWriter
from vwnav.maps.heights import HeightGrid
from vwnav.maps.image import MapImage, window_slices
from vwnav.maps.schema import ASSUMED_SIGMA_M, SCHEMA_VERSION, GeoreferenceBasis
from vwnav.types import FeatureExtractor

LEVELS_BY_DEFAULT = 3
_COARSER_AT_MOST = 1.2  # the finest level loses at most so much of the source's resolution
_MAX_TILES = 2_000_000

Progress = Callable[[str, int, int], None]  # what is being done, how much is done, of how much


@dataclass(frozen=True, slots=True, kw_only=True)
class BuildOptions:
    """What a pack is told beside its sources.

    Attributes:
        levels: zoom levels; by default the sources' own resolution and the two coarser ones.
        name: shown to people; by default that of the first source.
        attribution: whom the imagery's terms want named.
        georeference_sigma_m: one sigma of the imagery's position, per horizontal axis; None:
            not known, and 1 m is assumed.
        georeference_basis: how it is known; None in a pack that does not say.
        created_utc: when, as ISO 8601, for provenance.
        heights: of the terrain.
        origins: names of what the imagery comes from, for provenance; by default the sources'.
    """

    levels: Sequence[int] | None = None
    name: str | None = None
    attribution: str = ""
    georeference_sigma_m: float | None = None
    georeference_basis: GeoreferenceBasis | None = "given"
    created_utc: str = ""
    heights: HeightGrid | None = None
    origins: Sequence[str] | None = None


@dataclass(slots=True)
class _Counter:
    """Counts steps of work for the progress callback."""

    report: Progress
    what: str
    total: int
    done: int = field(default=0)

    def step(self) -> None:
        self.done += 1
        self.report(self.what, self.done, self.total)


def build_pack(
    sources: Sequence[RasterSource],
    output: Path,
    extractors: Sequence[FeatureExtractor],
    options: BuildOptions | None = None,
    progress: Progress | None = None,
) -> None:
    """Build a pack; on any error or interrupt an existing one stays as it was.

    Args:
        sources: where they overlap, the first one that has data wins.
        output: an `.mbtiles` file, replaced when the new one is whole.
        extractors: one for each feature set.
        options: names, levels and the like.
        progress: called with (what, done, total).

    Raises:
        MapError: a source cannot be read or has no data, or the output cannot be written.
    """
    options = options or BuildOptions()
    report = progress or (lambda what, done, total: None)
    if not sources:
        raise MapError("no map sources; name a GeoTIFF, a folder of pictures or a map.csv")
    rasters = [PlacedRaster.of(source) for source in sources]
    bounds = _union([raster.bounds for raster in rasters])
    levels = _levels(rasters, bounds, options.levels)
    with PackWriter(output) as writer:
        writer.begin()
        for zoom in levels:
            _write_level(writer, rasters, zoom, zoom + 1 in levels, report)
        tiles = {zoom: writer.tiles(zoom) for zoom in levels}
        if not all(tiles.values()):
            raise MapError(f"{sources[0].name}: holds no imagery")
        for extractor in extractors:
            _write_features(writer, extractor, tiles, report)
        if options.heights is not None:
            writer.put_heights(options.heights)
        writer.finish(
            _mbtiles_metadata(sources, options, bounds, levels),
            _own_metadata(sources, options, levels),
        )


def sources_bounds(sources: Sequence[RasterSource]) -> Bounds:
    """South, west, north, east of all sources together, degrees.

    Raises:
        MapError: one of them has no place, or they lie on both sides of the 180th meridian.
    """
    return _union([PlacedRaster.of(source).bounds for source in sources])


def default_levels(m_per_px: float, lat_deg: float) -> tuple[int, ...]:
    """Zoom levels, finest first, for imagery of a resolution: its own and two coarser ones."""
    zoom = zoom_for_resolution(lat_deg, m_per_px)
    if ground_resolution_m_per_px(lat_deg, zoom) > _COARSER_AT_MOST * m_per_px:
        zoom += 1
    return tuple(range(min(zoom, MAX_ZOOM), max(zoom - LEVELS_BY_DEFAULT, -1), -1))


def _levels(
    rasters: Sequence[PlacedRaster], bounds: Bounds, wanted: Sequence[int] | None
) -> tuple[int, ...]:
    levels = tuple(sorted(set(wanted or ()), reverse=True))
    if not levels:
        finest_m = min(raster.m_per_px for raster in rasters)
        levels = default_levels(finest_m, (bounds[0] + bounds[2]) / 2.0)
    if levels[0] > MAX_ZOOM or levels[-1] < 0:
        raise MapError(f"levels are zooms from 0 to {MAX_ZOOM}, got {levels}")
    h, w = bounds_window(bounds, levels[0]).shape
    if h * w / TILE_PX**2 > _MAX_TILES:
        raise MapError(
            f"level {levels[0]} would need {h * w // TILE_PX**2} tiles; "
            "are the coordinates right? Else choose coarser ones with --levels"
        )
    return levels


def _write_level(
    writer: PackWriter,
    rasters: Sequence[PlacedRaster],
    zoom: int,
    from_finer: bool,
    report: Progress,
) -> None:
    """Render a level from the sources, or from the next finer one where that is in the pack."""
    blocks = _blocks([raster.window(zoom) for raster in rasters])
    counter = _Counter(report, f"level {zoom}", len(blocks))
    for block in blocks:
        image = _finer(writer, zoom, block) if from_finer else compose(rasters, zoom, block)
        for tile in block.tiles(zoom) if image is not None else ():
            part = window_slices(tile.window, block.x0, block.y0)
            writer.put_tile(tile, MapImage(image.bgr[part], image.mask[part]))
        counter.step()


def _blocks(windows: Sequence[Window]) -> list[Window]:
    """Blocks of whole tiles that together hold the windows; none holds nothing."""
    edges = np.array(windows)
    x0, y0 = edges[:, :2].min(axis=0) // TILE_PX * TILE_PX
    x1, y1 = -(-edges[:, 2:].max(axis=0) // TILE_PX) * TILE_PX
    blocks = Window(int(x0), int(y0), int(x1), int(y1)).parts(BLOCK_PX)
    return [
        block for block in blocks if any(0 not in window.clipped(block).shape for window in windows)
    ]


def _finer(writer: PackWriter, zoom: int, block: Window) -> MapImage:
    twice = Window(*(2 * edge for edge in block))
    return writer.colour_image(zoom + 1, twice).halved()


def _write_features(
    writer: PackWriter,
    extractor: FeatureExtractor,
    tiles: dict[int, list[Tile]],
    report: Progress,
) -> None:
    writer.add_feature_set(extractor)
    blocks = [block for level in tiles.values() for block in sorted({*map(block_of, level)})]
    present = {tile for level in tiles.values() for tile in level}
    counter = _Counter(report, f"{extractor.name} features", len(blocks))
    for block in blocks:
        found = extract_block(partial(writer.colour_image, block.zoom), block, extractor)
        for tile, features in found.items():
            if tile in present:
                writer.put_features(extractor.name, tile, features)
        counter.step()


def _union(bounds: Sequence[Bounds]) -> Bounds:
    south, west, north, east = np.array(bounds).T
    union = float(south.min()), float(west.min()), float(north.max()), float(east.max())
    if union[3] - union[1] > 180.0:
        raise MapError("the sources lie on both sides of the 180th meridian; make two packs")
    return union


def _mbtiles_metadata(
    sources: Sequence[RasterSource],
    options: BuildOptions,
    bounds: Bounds,
    levels: tuple[int, ...],
) -> dict[str, str]:
    """MBTiles 1.3: longitude first, bounds are left, bottom, right, top.

    They are widened to whole pixels of the finest level: GDAL takes them for the edges of pixels.
    """
    window = bounds_window(bounds, levels[0])
    north, west = lat_lon_from_mercator_px(float(window.x0), float(window.y0), levels[0])
    south, east = lat_lon_from_mercator_px(float(window.x1), float(window.y1), levels[0])
    return {
        "name": options.name or Path(sources[0].name).stem,
        "format": "png",
        "bounds": f"{west:.10f},{south:.10f},{east:.10f},{north:.10f}",
        "center": f"{(west + east) / 2:.8f},{(south + north) / 2:.8f},{levels[0]}",
        "minzoom": str(levels[-1]),
        "maxzoom": str(levels[0]),
        "attribution": options.attribution,
        "description": "map pack of vwnav: imagery, and features to find a drone's pictures in it",
        "type": "baselayer",
        "version": "1",
    }


def _own_metadata(
    sources: Sequence[RasterSource], options: BuildOptions, levels: tuple[int, ...]
) -> dict[str, str]:
    sigma_m, basis = options.georeference_sigma_m, options.georeference_basis
    if sigma_m is None:
        sigma_m, basis = ASSUMED_SIGMA_M, "assumed"
    own = {
        "schema_version": str(SCHEMA_VERSION),
        "levels": json.dumps(levels),
        "georeference_sigma_m": repr(float(sigma_m)),
        "sources": json.dumps(options.origins or [source.name for source in sources]),
        "created_utc": options.created_utc,
        "vwnav_version": __version__,
    }
    return own if basis is None else own | {"georeference_basis": basis}
