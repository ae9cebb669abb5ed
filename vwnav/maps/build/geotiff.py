"""Any georeferenced raster that GDAL reads (workstation only: needs rasterio)."""

import logging
import math
import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
import rasterio.errors
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.enums import ColorInterp, MaskFlags
from rasterio.windows import Window as RasterioWindow

from vwnav.errors import MapError
from vwnav.geometry.geodesy import Window
from vwnav.maps.build.collar import Collar, find_collar
from vwnav.maps.build.coordinates import (
    WGS84,
    height_unit_m,
    transformed,
    warn_of_unknown_datum,
    whole_turns_deg,
    wkt,
)
from vwnav.maps.build.raster import Bounds, Georeference
from vwnav.maps.heights import MAX_SIDE, HeightGrid
from vwnav.maps.image import MapImage, Mask
from vwnav.types import Array

_LOG = logging.getLogger(__name__)
_CACHE_MB = 256  # GDAL would take a twentieth of the memory
_STRETCH_PERCENT = (1.0, 99.0)
_STRETCH_SAMPLE_PX = 1024
_HEIGHT_STEP_M = 10.0
_HEIGHTS_READ_PX = 2 * MAX_SIDE  # a side at most; OpenCV samples no more than 32766
_LOWEST_M, _HIGHEST_M = -500.0, 9000.0  # the shore of the Dead Sea, Mount Everest, and some more


class RasterFile:
    """A GeoTIFF, or an image with a world file: any CRS, palette, 1, 3 or 4 bands, any depth."""

    def __init__(self, path: Path, crs: str | None = None) -> None:
        """Open a raster.

        Args:
            path: of the raster.
            crs: used where the file names none, such as "EPSG:32643".

        Raises:
            MapError: it cannot be read, or nothing says where it lies.
        """
        if not path.is_file():
            raise MapError(f"{path}: no such file")
        _check_name(path)
        try:
            with warnings.catch_warnings():
                # Said below, in one line with what to do about it.
                warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
                self._dataset = rasterio.open(path)
        except rasterio.errors.RasterioIOError as error:
            raise MapError(f"{path}: not a raster that can be read ({_line(error)})") from error
        self._path = path
        self._crs = self._dataset.crs or _crs_beside(path) or _named_crs(crs)
        self._check_georeference()
        self._wkt = wkt(self._crs)
        warn_of_unknown_datum(path, self._wkt)
        self._turns_deg = whole_turns_deg(self._crs, self._dataset)
        self._bands = _colour_bands(self._dataset)
        self._palette = _palette(self._dataset)
        self._stretch = self._stretch_limits()
        self._collar = self._undeclared_collar()

    @property
    def name(self) -> str:
        """The file's name."""
        return self._path.name

    @property
    def size_wh(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self._dataset.width, self._dataset.height

    @property
    def georeference(self) -> Georeference:
        """Where its pixels lie."""
        return Georeference(self._pixel_from_lat_lon, self._lat_lon_from_pixel)

    def window(self, window: Window) -> MapImage:
        """Read a part of the raster as BGR with its mask.

        Raises:
            MapError: the file is damaged there.
        """
        image = self._read(window)
        if self._collar is None:
            return image
        return MapImage(image.bgr, image.mask & ~self._collar.at(image.bgr, window))

    def _pixel_from_lat_lon(self, lat_deg: Array, lon_deg: Array) -> tuple[Array, Array]:
        x, y = transformed(self._path, WGS84, self._wkt, lon_deg.ravel(), lat_deg.ravel())
        u, v = ~self._dataset.transform @ (x + self._turns_deg, y)
        return u.reshape(lat_deg.shape), v.reshape(lat_deg.shape)

    def _lat_lon_from_pixel(self, u: Array, v: Array) -> tuple[Array, Array]:
        x, y = self._dataset.transform @ (u.ravel(), v.ravel())
        lon, lat = transformed(self._path, self._wkt, WGS84, x - self._turns_deg, y)
        return lat.reshape(u.shape), lon.reshape(u.shape)

    def _read(self, window: Window) -> MapImage:
        h, w = window.shape
        place = RasterioWindow(window.x0, window.y0, w, h)
        try:
            with rasterio.Env(GDAL_CACHEMAX=_CACHE_MB):
                values = self._dataset.read(self._bands, window=place)
                mask = self._dataset.dataset_mask(window=place) > 0
        except rasterio.errors.RasterioError as error:
            raise MapError(f"{self._path}: damaged or cut off ({_line(error)})") from error
        return self._coloured(values, mask)

    def _coloured(self, values: NDArray[Any], mask: Mask) -> MapImage:
        if self._palette is not None:
            rgba = self._palette[np.clip(values[0], 0, len(self._palette) - 1)]
            return MapImage(np.ascontiguousarray(rgba[..., 2::-1]), mask & (rgba[..., 3] > 0))
        if self._stretch is not None:
            low, high = (limit[:, None, None] for limit in self._stretch)
            mask = mask & np.isfinite(values).all(axis=0)
            inside = np.clip(np.nan_to_num(values), low, high)
            values = np.round((inside - low) / (high - low) * 255.0)
        rgb = np.moveaxis(values.astype(np.uint8), 0, -1)
        if rgb.shape[2] == 1:
            rgb = np.repeat(rgb, 3, axis=2)
        return MapImage(np.ascontiguousarray(rgb[..., ::-1]), mask)

    def _check_georeference(self) -> None:
        if self._dataset.transform.is_identity or self._dataset.transform.is_degenerate:
            raise MapError(
                f"{self._path}: not georeferenced; give it a world file, list its corners in a "
                "map.csv, or warp it with gdalwarp"
            )
        if self._crs is None:
            raise MapError(f"{self._path}: names no coordinate system; say it with --crs EPSG:...")

    def _stretch_limits(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """(low, high) of each band from a thinned reading, for rasters deeper than 8 bits."""
        if self._dataset.dtypes[0] == "uint8":
            return None
        step = max(1, max(self.size_wh) // _STRETCH_SAMPLE_PX)
        shape = (max(1, self._dataset.height // step), max(1, self._dataset.width // step))
        try:
            sample = self._dataset.read(self._bands, out_shape=(len(self._bands), *shape))
            mask = self._dataset.dataset_mask(out_shape=shape) > 0
        except rasterio.errors.RasterioError as error:
            raise MapError(f"{self._path}: damaged or cut off ({_line(error)})") from error
        values = sample[:, mask & np.isfinite(sample).all(axis=0)]
        if not values.size:
            raise MapError(f"{self._path}: holds no data")
        low, high = np.percentile(values, _STRETCH_PERCENT, axis=1)
        return low, np.where(high > low, high, np.nextafter(low, np.inf))

    def _undeclared_collar(self) -> Collar | None:
        """Black or white borders of a raster that declares no missing data at all."""
        declared = any(flags != [MaskFlags.all_valid] for flags in self._dataset.mask_flag_enums)
        if declared or (self._palette is not None and (self._palette[:, 3] == 0).any()):
            return None
        return find_collar(self._read, self.size_wh)


def read_heights(path: Path, bounds: Bounds) -> HeightGrid:
    """Terrain heights under (south, west, north, east) from an elevation raster.

    What the raster declares missing is a hole, and so is what no ground on earth is as high as.

    Raises:
        MapError: it cannot be read or does not cover the map at all.
    """
    south, west, north, east = bounds
    rows, columns = (
        int(np.clip(span * 111_000.0 / _HEIGHT_STEP_M, 2, MAX_SIDE))
        for span in (north - south, (east - west) * np.cos(np.radians(north)))
    )
    lat, lon = np.meshgrid(
        np.linspace(north, south, rows), np.linspace(west, east, columns), indexing="ij"
    )
    _check_name(path)
    try:
        with rasterio.open(path) as dataset:
            heights = _heights_at(path, dataset, lat, lon)
    except rasterio.errors.RasterioError as error:
        raise MapError(
            f"{path}: not an elevation raster that can be read ({_line(error)})"
        ) from error
    if not np.isfinite(heights).any():
        raise MapError(f"{path}: has no heights under the map")
    return HeightGrid(bounds, heights)


def _heights_at(path: Path, dataset: Any, lat: Array, lon: Array) -> NDArray[np.float32]:
    if dataset.crs is None:
        raise MapError(f"{path}: names no coordinate system")
    given = wkt(dataset.crs)
    warn_of_unknown_datum(path, given)
    x, y = transformed(path, WGS84, given, lon.ravel(), lat.ravel())
    x = x + whole_turns_deg(dataset.crs, dataset)
    u, v = (value.reshape(lat.shape) for value in ~dataset.transform @ (x, y))
    (x0, x1, w), (y0, y1, h) = _read_span(u, dataset.width), _read_span(v, dataset.height)
    if w <= 0 or h <= 0:
        return np.full(lat.shape, np.nan, np.float32)
    # The nearest of many, not their mean, which would take voids that nothing declares for terrain.
    place = RasterioWindow(x0, y0, x1 - x0, y1 - y0)
    band = dataset.read(1, window=place, out_shape=(h, w), masked=True)
    values = _metres(path, dataset, band.astype(np.float64).filled(np.nan))
    u, v = (u - x0) * (w / (x1 - x0)), (v - y0) * (h / (y1 - y0))
    at = (u - 0.5).astype(np.float32), (v - 0.5).astype(np.float32)
    heights = cv2.remap(
        values, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(np.nan,) * 4
    )
    return np.asarray(heights, np.float32)


def _read_span(at: Array, side: int) -> tuple[int, int, int]:
    """Along an axis of so many pixels: the first under `at`, the end, how many of them are read."""
    margin = 2 * max(1, math.ceil(np.ptp(at) / _HEIGHTS_READ_PX))
    first, end = max(int(at.min()) - margin, 0), min(int(at.max()) + margin + 1, side)
    return first, end, min(end - first, _HEIGHTS_READ_PX)


def _metres(path: Path, dataset: Any, values: Array) -> NDArray[np.float32]:
    """What the values of the first band say, NaN where nothing or what no ground is as high as."""
    heights = (values * dataset.scales[0] + dataset.offsets[0]) * height_unit_m(path, dataset)
    absurd = (heights < _LOWEST_M) | (heights > _HIGHEST_M)
    if absurd.any():
        _LOG.warning(
            "%s: %d of %d heights are not between %.0f and %.0f m: taken for holes",
            path, np.count_nonzero(absurd), absurd.size, _LOWEST_M, _HIGHEST_M,
        )  # fmt: skip
    return np.where(absurd, np.nan, heights).astype(np.float32)


def _colour_bands(dataset: Any) -> list[int]:
    """Numbers of the red, green and blue band, or of the one gray band."""
    labels = list(dataset.colorinterp)
    rgb = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
    if all(label in labels for label in rgb):
        return [labels.index(label) + 1 for label in rgb]
    opaque = [i + 1 for i, label in enumerate(labels) if label != ColorInterp.alpha]
    return opaque[:3] if len(opaque) >= 3 else opaque[:1]


def _palette(dataset: Any) -> NDArray[np.uint8] | None:
    """(n, 4) RGBA of a palette raster's indices."""
    if dataset.colorinterp[0] != ColorInterp.palette:
        return None
    table = dataset.colormap(1)
    palette = np.zeros((max(table) + 1, 4), np.uint8)
    for index, rgba in table.items():
        palette[index] = rgba
    return palette


def _crs_beside(path: Path) -> CRS | None:
    """The coordinate system of a .prj file beside an image, as ESRI's software writes it."""
    for beside in (path.with_suffix(".prj"), path.with_suffix(".PRJ")):
        if beside.is_file():
            text = beside.read_text(encoding="utf-8", errors="replace")
            try:
                return CRS.from_wkt(text, morph_from_esri_dialect=True)
            except rasterio.errors.CRSError as error:
                raise MapError(f"{beside}: not a coordinate system ({_line(error)})") from error
    return None


def _named_crs(crs: str | None) -> CRS | None:
    if crs is None:
        return None
    try:
        return CRS.from_user_input(crs)
    except rasterio.errors.CRSError as error:
        raise MapError(f"--crs {crs}: not a coordinate system; say EPSG:32643 or such") from error


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _check_name(path: Path) -> None:
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise MapError(f"{path}: rasterio opens no name that is not UTF-8; rename it") from error
