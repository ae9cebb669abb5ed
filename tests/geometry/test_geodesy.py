import functools

import numpy as np
import pyproj
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.geometry.geodesy import (
    LocalFrame,
    ecef_from_geodetic,
    horizontal_distance_m,
    places_along,
)

latitudes = st.floats(-90.0, 90.0)
longitudes = st.floats(-180.0, 180.0)
heights = st.floats(-500.0, 20_000.0)
offsets = st.floats(-20_000.0, 20_000.0)


@functools.cache
def ecef() -> pyproj.Transformer:
    return pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)


@given(latitudes, longitudes, heights)
def test_earth_centred_coordinates_agree_with_pyproj(lat: float, lon: float, alt: float) -> None:
    theirs = ecef().transform(lon, lat, alt)
    np.testing.assert_allclose(ecef_from_geodetic(lat, lon, alt), theirs, atol=1e-7, rtol=0)


@given(latitudes, longitudes, heights)
def test_geodetic_coordinates_come_back(lat: float, lon: float, alt: float) -> None:
    point = ecef_from_geodetic(lat, lon, alt)
    again = ecef_from_geodetic(*LocalFrame(lat, lon, alt).to_geodetic(np.zeros(3)))
    np.testing.assert_allclose(again, point, atol=1e-8, rtol=0)


@given(latitudes, longitudes, heights, offsets, offsets, st.floats(-1000.0, 1000.0))
def test_local_frame_agrees_with_the_topocentric_conversion_of_pyproj(
    lat: float, lon: float, alt: float, north: float, east: float, down: float
) -> None:
    point = LocalFrame(lat, lon, alt).to_geodetic([north, east, down])
    topocentric = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lat_0={lat!r} +lon_0={lon!r} +h_0={alt!r}"
    )
    east_1, north_1, up_1 = topocentric.transform(point[1], point[0], point[2])
    np.testing.assert_allclose([north_1, east_1, -up_1], [north, east, down], atol=1e-6, rtol=0)


@given(latitudes, longitudes, heights, offsets, offsets)
def test_local_frame_round_trip(
    lat: float, lon: float, alt: float, north: float, east: float
) -> None:
    frame = LocalFrame(lat, lon, alt)
    ned = np.array([north, east, -100.0])
    np.testing.assert_allclose(frame.to_ned(*frame.to_geodetic(ned)), ned, atol=1e-6, rtol=0)


def test_local_frame_takes_many_points_at_once() -> None:
    frame = LocalFrame(41.1, 29.0, 100.0)
    points = np.random.default_rng(1).uniform(-1000.0, 1000.0, (4, 5, 3))
    lat_deg, lon_deg, alt_m = frame.to_geodetic(points)
    assert lat_deg.shape == (4, 5)
    np.testing.assert_allclose(frame.to_ned(lat_deg, lon_deg, alt_m), points, atol=1e-7)


def test_axes_of_the_local_frame_are_north_east_down() -> None:
    ned = LocalFrame(41.1, 29.0, 100.0).to_ned(
        [41.101, 41.1, 41.1], [29.0, 29.001, 29.0], [100, 100, 90]
    )
    assert ned[0, 0] > 100.0
    assert ned[1, 1] > 80.0
    assert ned[2] == pytest.approx([0.0, 0.0, 10.0], abs=1e-9)


@given(st.floats(-85.0, 85.0), longitudes, st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_horizontal_distance_agrees_with_the_geodesic(
    lat: float, lon: float, d_lat: float, d_lon: float
) -> None:
    _, _, theirs = pyproj.Geod(ellps="WGS84").inv(lon, lat, lon + d_lon, lat + d_lat)
    ours = horizontal_distance_m(lat, lon, lat + d_lat, lon + d_lon)
    assert ours == pytest.approx(theirs, rel=1e-5, abs=1e-6)


def test_horizontal_distance_crosses_the_antimeridian_the_short_way() -> None:
    assert horizontal_distance_m(0.0, 179.9999, 0.0, -179.9999) == pytest.approx(22.26, abs=0.01)


@pytest.mark.parametrize("origin", [(91.0, 0.0, 0.0), (0.0, float("nan"), 0.0)])
def test_impossible_origin_is_refused(origin: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="origin"):
        LocalFrame(*origin)


@pytest.mark.parametrize("stops", [[[0.0, 0.0], [46.84, -91.99]], [[46.84, -91.99]]])
def test_a_way_across_the_globe_is_no_million_of_places(stops: list[list[float]]) -> None:
    places = list(places_along(np.array(stops), 10.0))
    assert len(places) <= 50_002
    np.testing.assert_allclose(places[-1][2], stops[-1])


def test_a_ways_places_lie_as_near_as_asked() -> None:
    along_m = [each for each, _, _ in places_along(np.array([[46.0, 8.0], [46.1, 8.1]]), 10.0)]
    assert np.diff(along_m).max() <= 10.0
