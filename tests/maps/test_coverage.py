import numpy as np
import pytest
from map_samples import ORIGIN_PX, ZOOM

from vwnav.geometry.geodesy import lat_lon_from_mercator_px
from vwnav.maps.coverage import check_route
from vwnav.maps.pack import MapPack


def places(*uv: tuple[float, float]) -> np.ndarray:
    """Places at pixels of the small map, which is about 270 m by 230 m."""
    return np.array(
        [lat_lon_from_mercator_px(ORIGIN_PX[0] + u, ORIGIN_PX[1] + v, ZOOM) for u, v in uv]
    )


def test_a_route_inside_the_map_is_covered(sift_pack: MapPack):
    coverage = check_route(sift_pack, places((200, 200), (500, 200), (500, 400)), 30.0)
    assert coverage.ok
    assert coverage.length_m == pytest.approx(500 * sift_pack.levels[0].m_per_px, rel=0.01)
    assert "covers all" in coverage.summary()


def test_the_stretch_beyond_the_edge_is_named(sift_pack: MapPack):
    m_per_px = sift_pack.levels[0].m_per_px
    coverage = check_route(sift_pack, places((500, 300), (1000, 300), (400, 300)), 0.0)
    (stretch,) = coverage.uncovered
    assert stretch.start_m == pytest.approx(200 * m_per_px, abs=12)
    assert stretch.end_m == pytest.approx(800 * m_per_px, abs=12)
    assert coverage.uncovered_m == pytest.approx(600 * m_per_px, abs=24)
    assert "does not cover" in coverage.summary()


def test_the_margin_counts(sift_pack: MapPack):
    along_the_edge = places((100, 580), (600, 580))
    assert check_route(sift_pack, along_the_edge, 2.0).ok
    assert not check_route(sift_pack, along_the_edge, 20.0).ok


def test_two_excursions_are_two_stretches(sift_pack: MapPack):
    coverage = check_route(sift_pack, places((-99, 300), (350, 300), (900, 300)), 0.0)
    assert len(coverage.uncovered) == 2
    assert coverage.uncovered[0].start_m == 0.0
    assert coverage.uncovered[1].end_m == pytest.approx(coverage.length_m)


def test_a_single_place_is_a_route(sift_pack: MapPack):
    assert check_route(sift_pack, places((300, 300)), 20.0).ok
    assert not check_route(sift_pack, places((-300, 300)), 20.0).ok


@pytest.mark.parametrize("route", [np.zeros((0, 2)), np.zeros(2), np.full((2, 2), np.nan)])
def test_what_is_no_route_is_refused(sift_pack: MapPack, route: np.ndarray):
    with pytest.raises(ValueError, match="expected"):
        check_route(sift_pack, route)
