import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.guidance.visual_waypoints import VisualWaypointConfig, VisualWaypoints

PLACES = np.array([[100.0, 0.0], [200.0, 50.0]])
CONFIG = VisualWaypointConfig(radius_m=10.0, min_matches=5)


def around(place: np.ndarray, count: int, distance_m: float) -> np.ndarray:
    angles = np.linspace(0.0, 6.0, count)
    return place + distance_m * np.column_stack([np.cos(angles), np.sin(angles)])


@pytest.mark.parametrize(
    ("count", "distance_m", "reached"),
    [(5, 9.9, (0,)), (4, 1.0, ()), (50, 10.1, ()), (0, 0.0, ())],
)
def test_reached_when_enough_features_inside_the_radius_are_matched(
    count: int, distance_m: float, reached: tuple[int, ...]
) -> None:
    waypoints = VisualWaypoints(PLACES, CONFIG)
    assert waypoints.step(around(PLACES[0], count, distance_m)) == reached


def test_waypoints_are_reached_in_order_only() -> None:
    waypoints = VisualWaypoints(PLACES, CONFIG)
    assert waypoints.step(around(PLACES[1], 20, 3.0)) == ()
    assert waypoints.step(around(PLACES[0], 20, 3.0)) == (0,)
    assert waypoints.step(around(PLACES[0], 20, 3.0)) == ()
    assert waypoints.step(around(PLACES[1], 20, 3.0)) == (1,)
    assert waypoints.done
    assert waypoints.step(around(PLACES[1], 20, 3.0)) == ()


def test_one_image_may_reach_several() -> None:
    waypoints = VisualWaypoints(PLACES, VisualWaypointConfig(radius_m=500.0, min_matches=1))
    assert waypoints.step(PLACES[:1]) == (0, 1)


@given(st.lists(st.tuples(st.floats(-500, 500), st.floats(-500, 500)), max_size=30))
def test_the_index_never_goes_back(matches: list[tuple[float, float]]) -> None:
    waypoints = VisualWaypoints(PLACES, VisualWaypointConfig(radius_m=200.0, min_matches=2))
    before = waypoints.next_index
    waypoints.step(np.array(matches))
    assert before <= waypoints.next_index <= 2


def test_senseless_waypoints_and_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="waypoints"):
        VisualWaypoints(np.array([[np.nan, 0.0]]), CONFIG)
    with pytest.raises(ValueError, match="radius"):
        VisualWaypointConfig(radius_m=0.0)
    with pytest.raises(ValueError, match="radius"):
        VisualWaypointConfig(min_matches=0)
