"""What a raster's coordinate system says: where its places lie, and what its heights count in."""

import logging
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pyproj.exceptions

from vwnav.errors import MapError
from vwnav.types import Array

_LOG = logging.getLogger(__name__)
WGS84 = "EPSG:4326"
_SEMI_MAJOR_M, _INVERSE_FLATTENING = 6_378_137.0, 298.257223  # of WGS 84, GRS 80 and CGCS2000
_US_SURVEY_FOOT_M = 1200.0 / 3937.0
# As GDAL, PROJ and makers of DEMs spell them, in small letters
_UNITS_M = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("cm", "centimetre", "centimetres", "centimeter", "centimeters"), 0.01),
    **dict.fromkeys(("dm", "decimetre", "decimetres", "decimeter", "decimeters"), 0.1),
    **dict.fromkeys(("ft", "foot", "feet", "international foot"), 0.3048),
    **dict.fromkeys(("ftus", "us-ft", "us_ft", "us ft", "sft", "foot_us"), _US_SURVEY_FOOT_M),
    **dict.fromkeys(("us survey foot", "us survey feet"), _US_SURVEY_FOOT_M),
}


def transformed(path: Path, given: str, wanted: str, x: Array, y: Array) -> tuple[Array, Array]:
    """Places (n,), (n,) of one coordinate system in another; longitude goes before latitude.

    Args:
        path: the raster's, for the message.
        given: coordinate system of the places, as `wkt` gives it, or `WGS84`.
        wanted: the one that they are wanted in.
        x: eastings in the units of `given`.
        y: northings.

    Raises:
        MapError: there is no way from one to the other, as of a site's own metres.
    """
    try:
        moved_x, moved_y = _between(given, wanted).transform(x, y, errcheck=True)
    except pyproj.exceptions.ProjError as error:
        raise MapError(
            f"{path}: its coordinate system does not tell latitude and longitude here; warp it "
            f"with gdalwarp ({' '.join(str(error).split())[:100]})"
        ) from error
    return np.asarray(moved_x), np.asarray(moved_y)


def wkt(crs: Any) -> str:
    """A rasterio coordinate system as text that loses nothing of it."""
    return str(crs.to_wkt(version="WKT2_2019"))


def whole_turns_deg(crs: Any, dataset: Any) -> float:
    """What longitudes of a raster count beyond 180 degrees: 360 where they go from 0 to 360.

    Args:
        crs: its coordinate system, of rasterio.
        dataset: the raster, of rasterio.
    """
    if not crs.is_geographic:
        return 0.0
    middle_deg, _ = dataset.transform @ (dataset.width / 2.0, dataset.height / 2.0)
    return 360.0 * round(float(middle_deg) / 360.0)


def warn_of_unknown_datum(path: Path, given: str) -> None:
    """Say so where nobody knows how a raster's datum lies to WGS 84: PROJ then takes it for equal.

    Args:
        path: the raster's, for the message.
        given: its coordinate system, as `wkt` gives it.
    """
    if not _is_datum_known(given):
        _LOG.warning(
            "%s: no datum shift to WGS 84 is known of its coordinate system (%s), it may lie 100 m "
            "off and more: hold the map against another, or give a shift (gdalwarp -s_srs with "
            "+towgs84)",
            path, pyproj.CRS.from_user_input(given).name[:60],
        )  # fmt: skip


def height_unit_m(path: Path, dataset: Any) -> float:
    """Metres that a unit of an elevation raster's first band is.

    The band's own word goes before its vertical coordinate system's; without either it is metres.

    Raises:
        MapError: it counts in what is no length that is known, depths, or above the ellipsoid.
    """
    crs = pyproj.CRS.from_wkt(wkt(dataset.crs))
    vertical = crs.axis_info[2:]
    if any(axis.direction != "up" for axis in vertical):
        raise MapError(f"{path}: holds depths, not heights")
    if vertical and not crs.is_vertical:  # a third axis without a vertical system of its own
        raise MapError(
            f"{path}: its heights are above the ellipsoid, not above sea level; subtract the geoid "
            "(gdalwarp -t_srs EPSG:4326+5773), or correct its coordinate system if it says so "
            "wrongly (gdal_edit.py -a_srs)"
        )
    unit = dataset.units[0]
    if unit and unit.lower() not in _UNITS_M:
        raise MapError(f"{path}: its heights are in {unit[:40]!r}; make them metres (gdal_calc)")
    if unit:
        return _UNITS_M[unit.lower()]
    return float(vertical[0].unit_conversion_factor) if vertical else 1.0


@lru_cache(maxsize=64)
def _between(given: str, wanted: str) -> pyproj.Transformer:
    here, there = (pyproj.CRS.from_user_input(each).to_2d() for each in (given, wanted))
    return pyproj.Transformer.from_crs(here, there, always_xy=True)


@lru_cache(maxsize=64)
def _is_datum_known(given: str) -> bool:
    crs = pyproj.CRS.from_user_input(given).to_2d()
    body = crs.ellipsoid
    if body is None:  # a site's own metres: there is no way at all, and `transformed` says so
        return True
    # Datums of satellites have these figures, and lie within a metre of WGS 84.
    is_of_satellites = (
        abs(body.semi_major_metre - _SEMI_MAJOR_M) < 1e-3
        and abs(body.inverse_flattening - _INVERSE_FLATTENING) < 1e-5
    )
    try:
        pyproj.Transformer.from_crs(crs, WGS84, always_xy=True, allow_ballpark=False)
    except pyproj.exceptions.ProjError:
        return is_of_satellites
    return True
