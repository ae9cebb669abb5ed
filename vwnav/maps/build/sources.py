"""Finds out what a map source on the command line is, and opens it."""

import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from vwnav.errors import MapError
from vwnav.files.folder import PICTURES, files_in
from vwnav.geometry.geodesy import Window, mercator_px
from vwnav.machine.extras import how_to_install
from vwnav.maps.build.builder import BuildOptions
from vwnav.maps.build.image_files import corner_images, is_corner_table
from vwnav.maps.build.raster import Georeference, RasterSource, level_georeference
from vwnav.maps.image import MapImage
from vwnav.maps.pack import MapPack
from vwnav.maps.schema import is_pack

if TYPE_CHECKING:
    from vwnav.maps.build.geotiff import RasterFile

_RASTERS = (".tif", ".tiff", ".vrt")
_IMAGES = tuple(suffix for suffix in PICTURES if suffix not in _RASTERS)


class PackSource:
    """A pack's own imagery at its finest level: its features can be remade without its sources."""

    def __init__(self, path: Path) -> None:
        """Open a pack.

        Raises:
            MapError: it cannot be opened.
        """
        self.pack = MapPack.open(path)
        self._zoom = self.pack.levels[0].zoom
        # A pack's bounds are whole pixels of this level, but for the rounding of their digits.
        south, west, north, east = self.pack.bounds
        x0, y0 = mercator_px(north, west, self._zoom)
        x1, y1 = mercator_px(south, east, self._zoom)
        self._window = Window(round(x0), round(y0), round(x1), round(y1))

    @property
    def name(self) -> str:
        """The file's name."""
        return self.pack.path.name

    @property
    def size_wh(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        h, w = self._window.shape
        return w, h

    @property
    def georeference(self) -> Georeference:
        """Where its pixels lie."""
        return level_georeference(self._zoom, self._window.x0, self._window.y0)

    def window(self, window: Window) -> MapImage:
        """A part of the imagery."""
        x0, y0 = self._window.x0, self._window.y0
        moved = Window(window.x0 + x0, window.y0 + y0, window.x1 + x0, window.y1 + y0)
        return self.pack.colour_image(self._zoom, moved)


def open_sources(paths: Sequence[Path], crs: str | None = None) -> list[RasterSource]:
    """Open GeoTIFFs, images with a world file, tables of corners, packs, and folders of these.

    Args:
        paths: as the user named them.
        crs: coordinate system of rasters that name none.

    Raises:
        MapError: one cannot be read, or a needed library is not installed.
    """
    files: list[Path] = []
    for path in paths:
        if not path.exists():
            raise MapError(f"{path}: no such file or folder")
        files += _in_folder(path) if path.is_dir() else [path]
    tables = [path for path in files if path.suffix.lower() == ".csv"]
    loose = [path for path in files if path.suffix.lower() in _IMAGES and not _world_file(path)]
    sources: list[RasterSource] = []
    for table in tables:
        sources += corner_images(table, loose)
    listed = {source.name for source in sources}
    for path in files:
        if path in tables or (path in loose and path.name in listed):
            continue
        sources.append(PackSource(path) if _is_pack(path) else _raster_file(path, crs))
    return sources


def default_options(paths: Sequence[Path], sources: Sequence[RasterSource]) -> BuildOptions:
    """Options for sources that were named as `paths`: what a pack that is rebuilt says of itself.

    Without one, the name is that of the first path.
    """
    packs = [source.pack for source in sources if isinstance(source, PackSource)]
    if not packs:
        return BuildOptions(name=paths[0].resolve().stem)
    pack, alone = packs[0], len(sources) == 1
    assumed = pack.georeference_basis == "assumed"
    return BuildOptions(
        levels=tuple(level.zoom for level in pack.levels) if alone else None,
        name=pack.name,
        attribution=pack.attribution,
        georeference_sigma_m=None if assumed else pack.georeference_sigma_m,
        georeference_basis=pack.georeference_basis,
        heights=pack.heights,
        origins=pack.sources if alone else None,
    )


def _in_folder(folder: Path) -> list[Path]:
    """A folder's tables of corners; without one, its georeferenced rasters."""
    tables = [path for path in files_in(folder, (".csv",)) if is_corner_table(path)]
    if tables:
        return tables
    images = files_in(folder, (*_IMAGES, *_RASTERS))
    rasters = [path for path in images if path.suffix.lower() in _RASTERS or _world_file(path)]
    if not rasters:
        raise MapError(
            f"{folder}: holds no GeoTIFF, no picture with a world file, and no table of corners "
            "(map.csv)"
        )
    return rasters


def _world_file(path: Path) -> Path | None:
    """The world file beside an image: .wld, .jgw, .jpgw and the like."""
    suffix = path.suffix.lower()
    if suffix not in (*_IMAGES, *_RASTERS):
        return None
    short = f".{suffix[1]}{suffix[-1]}w"
    for candidate in (short, f"{suffix}w", ".wld"):
        for spelt in (candidate, candidate.upper()):
            if path.with_suffix(spelt).is_file():
                return path.with_suffix(spelt)
    return None


def _is_pack(path: Path) -> bool:
    """Whether a file is a pack of ours; other MBTiles are rasters like any other."""
    try:
        return is_pack(path)
    except sqlite3.Error:
        return True  # damaged: opening it as a pack says so


def _raster_file(path: Path, crs: str | None) -> "RasterFile":
    try:
        from vwnav.maps.build.geotiff import RasterFile
    except ImportError as error:
        raise MapError(
            f"{path}: reading it needs rasterio; install it: {how_to_install('maps')} ({error})"
        ) from error
    return RasterFile(path, crs)
