"""Where is an aircraft looked for, and what is believed, before any fix was?"""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vwnav.estimation.beginning.first_fix import (
    DOUBTED_AFTER,
    PRIOR_SIGMAS,
    TRUSTED_AFTER,
    FirstFix,
)
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import NedFix
from vwnav.estimation.inputs import decode, encode
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler, wrap_pi
from vwnav.types import Attitude, Estimate, Height, MapFix, Prior

FRAME = LocalFrame(41.1, 29.0, 0.0)
NOBODY_KNOWS_M = 2000.0


def found_at(t_s: float, ned_m: np.ndarray, yaw_rad: float) -> MapFix:
    lat_deg, lon_deg, _ = FRAME.to_geodetic(np.array([*ned_m[:2], 0.0]))
    return MapFix(
        t_s=t_s,
        lat_deg=float(lat_deg),
        lon_deg=float(lon_deg),
        covariance_ne_m2=np.eye(2),
        yaw_rad=yaw_rad,
        sigma_yaw_rad=0.02,
        agl_m=-float(ned_m[2]),
        sigma_agl_m=1.0,
        point="nadir",
        features="learned",
    )


def believed(t_s: float, ned_m: np.ndarray, yaw_rad: float, sigma_m_s: float) -> Estimate:
    covariance = np.diag([NOBODY_KNOWS_M**2] * 2 + [1.0] + [sigma_m_s**2] * 3)
    return Estimate(
        t_s=t_s,
        position_ned_m=ned_m,
        velocity_ned_m_s=np.zeros(3),
        covariance=covariance,
        quat_wxyz=quat_from_rotation(rotation_from_euler(0.0, 0.0, yaw_rad)),
        sigma_yaw_rad=0.2,
        agl_m=-float(ned_m[2]),
        sigma_agl_m=1.0,
        t_last_fix_s=None,
        reset_counter=0,
    )


@given(
    search_s=st.floats(0.5, 60.0),
    speed_m_s=st.floats(0.0, 10.0),
    course_rad=st.floats(-math.pi, math.pi),
    climb_m_s=st.floats(-0.4, 3.0),
    turn_rad=st.floats(-3.0, 3.0),
    compass_off_rad=st.floats(-0.3, 0.3),
    sigma_m_s=st.floats(0.05, 3.0),
)
def test_what_was_found_is_looked_for_where_the_aircraft_has_come_since(
    search_s, speed_m_s, course_rad, climb_m_s, turn_rad, compass_off_rad, sigma_m_s
):
    """However long the search took; the filter's place is 900 m off, its heading a compass's."""
    way_m = speed_m_s * search_s
    course = np.array([math.cos(course_rad), math.sin(course_rad)])
    then_m = np.array([30.0, -20.0, -30.0])
    now_m = np.add(then_m, [*(way_m * course), -climb_m_s * search_s])
    off_rad = course_rad + compass_off_rad
    told_m = [way_m * math.cos(off_rad), way_m * math.sin(off_rad), -climb_m_s * search_s]
    start_m = np.array([900.0, 0.0, -30.0])
    first = FirstFix()
    assert not first.confirmed(
        found_at(5.0, then_m, 0.4), believed(5.0, start_m, 0.4 + compass_off_rad, sigma_m_s)
    )
    now = believed(5.0 + search_s, start_m + told_m, 0.4 + compass_off_rad + turn_rad, sigma_m_s)
    prior = first.prior(Prior(agl_m=now.agl_m), now.t_s, now)
    looked_m = FRAME.to_ned(prior.lat_deg, prior.lon_deg, 0.0)
    assert np.hypot(*(looked_m - now_m)[:2]) < PRIOR_SIGMAS * prior.sigma_m
    assert prior.sigma_m < 6.0 + sigma_m_s * search_s + 0.25 * way_m
    assert abs(prior.agl_m + now_m[2]) < prior.sigma_agl_ratio * prior.agl_m
    assert abs(wrap_pi(prior.yaw_rad - 0.4 - turn_rad)) < 2.0 * prior.sigma_yaw_rad


def test_where_nobody_tells_the_way_it_is_looked_for_as_far_as_an_aircraft_comes():
    first, place_m = FirstFix(), np.array([0.0, 0.0, -50.0])
    first.confirmed(found_at(5.0, place_m, 0.0), None)
    prior = first.prior(Prior(), 9.0, None)
    assert prior.sigma_m > 4.0 * 30.0 / PRIOR_SIGMAS


def test_a_few_fixes_that_agree_are_believed_over_a_persons_word():
    """A click on a map, 42 m off: they were refused until the flight was given up."""
    ekf = Ekf(EkfConfig())
    place = np.array([0.0, 0.0, -50.0])
    ekf.initialise(Start(t_s=0.0, position_ned_m=place, sigma_m=5.0, agl_m=50.0, by_person=True))
    accepted = []
    for number in range(1, 200):
        t_s = 0.02 * number
        ekf.handle(Attitude(t_s, quat_from_rotation(np.eye(3))))
        ekf.handle(Height(t_s, 50.0))
        if number % 20 == 0:
            told = NedFix(
                t_s=t_s, position_ne_m=np.array([30.0, -30.0]), covariance_ne_m2=0.3 * np.eye(2)
            )
            accepted.append(ekf.handle(told).accepted)
    assert accepted[:3] == [False] * 3
    assert all(accepted[3:])
    now = ekf.estimate(t_s)
    off_m = float(np.hypot(*(now.position_ned_m[:2] - [30.0, -30.0])))
    assert off_m < 1.0
    assert now.reset_counter == 1


def test_what_a_person_has_told_is_replayed_as_that():
    start = Start(t_s=0.0, position_ned_m=np.zeros(3), by_person=True)
    assert decode(encode(start)).by_person
    of_before = {name: value for name, value in encode(start).items() if name != "by_person"}
    assert not decode(of_before).by_person


def begun(fixes: int) -> FirstFix:
    """A beginning that has had so many fixes since."""
    first = FirstFix()
    first.began()
    for _ in range(fixes):
        first.fused()
    return first


def test_a_place_is_doubted_where_the_video_broke_off_and_nothing_more_is_found():
    """Where a recording was paused it went on 253 m away, at a sigma of some metres, to its end."""
    first = begun(TRUSTED_AFTER)
    for _ in range(10):
        first.missed()
    assert not first.doubted
    first.broke()
    for _ in range(DOUBTED_AFTER):
        first.missed()
    assert first.doubted


def test_images_that_show_nothing_are_not_held_against_a_place():
    """A black stretch: none can be followed, and none is found."""
    first = begun(TRUSTED_AFTER)
    for _ in range(30):
        first.broke()
        first.missed()
    assert not first.doubted
    for _ in range(TRUSTED_AFTER):
        first.fused()
    assert not first.young


def test_a_beginning_that_was_never_trusted_is_doubted_as_soon_broken_or_not():
    first = begun(TRUSTED_AFTER - 1)
    for _ in range(DOUBTED_AFTER):
        first.broke()
        first.missed()
    assert first.doubted
