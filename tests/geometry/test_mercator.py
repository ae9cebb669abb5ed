import functools

import pyproj
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.geometry import geodesy
from vwnav.geometry.geodesy import LocalFrame

latitudes = st.floats(-85.0, 85.0)
longitudes = st.floats(-180.0, 180.0)
zooms = st.integers(0, 23)
HALF_WORLD_M = 20037508.342789244


@functools.cache
def web_mercator() -> pyproj.Transformer:
    return pyproj.Transformer.from_crs("EPSG:4326", "EPSG:3857", always_xy=True)


@given(latitudes, longitudes, zooms)
def test_pixels_agree_with_pyproj(lat: float, lon: float, zoom: int) -> None:
    x_m, y_m = web_mercator().transform(lon, lat)
    px_per_m = 256 * 2**zoom / (2 * HALF_WORLD_M)
    expected = ((x_m + HALF_WORLD_M) * px_per_m, (HALF_WORLD_M - y_m) * px_per_m)
    assert geodesy.mercator_px(lat, lon, zoom) == pytest.approx(expected, abs=1e-5)


@given(latitudes, longitudes, zooms)
def test_latitude_and_longitude_come_back(lat: float, lon: float, zoom: int) -> None:
    x, y = geodesy.mercator_px(lat, lon, zoom)
    again = geodesy.lat_lon_from_mercator_px(x, y, zoom)
    assert again == pytest.approx((lat, lon), abs=1e-9)


@given(st.floats(-80.0, 80.0), longitudes, st.integers(15, 20))
def test_scale_is_that_of_short_steps_on_the_ellipsoid(lat: float, lon: float, zoom: int) -> None:
    frame = LocalFrame(lat, lon, 0.0)
    lats, lons, _ = frame.to_geodetic([[0, -5, 0], [0, 5, 0], [-5, 0, 0], [5, 0, 0]])
    x, y = geodesy.mercator_px(lats, lons, zoom)
    per_m = ((x[1] - x[0]) % (256 * 2**zoom) / 10.0, (y[2] - y[3]) / 10.0)
    assert geodesy.mercator_px_per_m(lat, zoom) == pytest.approx(per_m, rel=1e-5)


def test_east_and_north_differ_by_two_thirds_of_a_percent_at_the_equator() -> None:
    east, north = geodesy.mercator_px_per_m(0.0, 19)
    assert north / east == pytest.approx(1.00674, abs=1e-5)


@given(latitudes, zooms)
def test_zoom_of_a_resolution_is_the_level_it_came_from(lat: float, zoom: int) -> None:
    resolution = geodesy.ground_resolution_m_per_px(lat, zoom)
    assert geodesy.zoom_for_resolution(lat, resolution) == zoom
    assert geodesy.zoom_for_resolution(lat, resolution * 1.3) == zoom


def test_known_tile_numbers() -> None:
    # https://wiki.openstreetmap.org/wiki/Slippy_map_tilenames, Java example, zoom 10.
    x, y = geodesy.mercator_px(47.968056, 7.909167, 10)
    assert (int(x // 256), int(y // 256)) == (534, 356)


def test_corners_of_the_world_and_its_middle() -> None:
    assert geodesy.mercator_px(90.0, -180.0, 0) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert geodesy.mercator_px(0.0, 0.0, 3) == pytest.approx((1024.0, 1024.0))


@pytest.mark.parametrize("resolution", [0.0, -1.0, float("nan")])
def test_impossible_resolution_is_refused(resolution: float) -> None:
    with pytest.raises(ValueError, match="positive resolution"):
        geodesy.zoom_for_resolution(0.0, resolution)
