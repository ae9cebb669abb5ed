"""Where a second navigator begins: the aircraft flew on, and was braked."""

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from vwnav.onboard.succession import start_after

TOLD_S = 100.0
PLACE = np.array([40.0, -30.0, -50.0])


@given(
    speed_m_s=st.floats(0.0, 10.0),
    course_rad=st.floats(-3.1, 3.1),
    flies_on_s=st.floats(0.05, 1.0),
    brake_m_s2=st.floats(3.0, 8.0),
    since_s=st.floats(0.0, 4.0),
)
@example(speed_m_s=7.8, course_rad=-0.8, flies_on_s=1.0, brake_m_s2=5.0, since_s=1.9)
@example(speed_m_s=10.0, course_rad=0.0, flies_on_s=1.0, brake_m_s2=3.0, since_s=4.0)
def test_an_aircraft_that_is_braked_is_within_two_sigmas_of_it(
    speed_m_s, course_rad, flies_on_s, brake_m_s2, since_s
):
    braking_s = min(max(since_s - flies_on_s, 0.0), speed_m_s / brake_m_s2)
    way_m = speed_m_s * (min(since_s, flies_on_s) + braking_s) - 0.5 * brake_m_s2 * braking_s**2
    along = np.array([np.cos(course_rad), np.sin(course_rad)])
    start = start_after(PLACE, speed_m_s * along, TOLD_S, TOLD_S + since_s)
    there_m = PLACE[:2] + way_m * along
    assert np.hypot(*(start.position_ned_m[:2] - there_m)) < 2.0 * start.sigma_m
    assert start.position_ned_m[2] == PLACE[2]
