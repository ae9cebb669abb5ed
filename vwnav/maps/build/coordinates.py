"""What a raster's coordinate system says: where its places lie, and what its heights count in."""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pyproj.exceptions

from vwnav.errors import MapError
from vwnav.types import Array

WGS84 = "EPSG:4326"
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
