"""The way back along the way that was flown."""

import time
from itertools import pairwise
from types import SimpleNamespace

import numpy as np

from vwnav.mission.home import FlownWay

HOME_NE_M = np.zeros(2)


def at(north_m: float, east_m: float = 0.0, height_m: float = 50.0) -> SimpleNamespace:
    return SimpleNamespace(position_ned_m=np.array([north_m, east_m, -height_m]))


def test_a_loop_is_left_out_on_the_way_back():
    way, corners = FlownWay(), [(0, 0), (100, 0), (100, 100), (200, 100), (200, 0), (100, 0)]
    for (n0, e0), (n1, e1) in pairwise(corners):
        for share in np.linspace(0.0, 1.0, 51):
            way.note(at(n0 + share * (n1 - n0), e0 + share * (e1 - e0)))
    back = way.back_ned_m(at(100.0), HOME_NE_M)
    assert len(back) <= 5
    assert np.all(np.abs(back[:, 1]) < 1.0)
    assert back[-1].tolist() == [0.0, 0.0, -50.0]


def test_the_way_back_is_as_high_as_it_was_flown_or_as_it_is_now():
    way = FlownWay()
    for i in range(11):
        way.note(at(30.0 * i, height_m=50.0 if i < 6 else 4.0))
    low = way.back_ned_m(at(310.0, height_m=4.0), HOME_NE_M)
    assert set(low[low[:, 0] > 151.0, 2]) == {-4.0}
    assert set(low[low[:, 0] < 151.0, 2]) == {-50.0}
    risen = way.back_ned_m(at(310.0, height_m=34.0), HOME_NE_M)
    assert set(risen[risen[:, 0] > 151.0, 2]) == {-34.0}
    assert risen[-1].tolist() == [0.0, 0.0, -50.0]


def test_the_way_back_from_100_km_is_found_while_the_mission_ticks():
    way = FlownWay()
    for i in range(5_000):
        way.note(at(20.1 * i))
    began_s = time.process_time()
    back = way.back_ned_m(at(20.1 * 5_000), HOME_NE_M)
    assert time.process_time() - began_s < 2.0
    assert len(back) == 5_000
    assert np.all(np.diff(back[:, 0]) < 0.0)
