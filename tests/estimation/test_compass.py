"""A compass that looks the other way, and a match that is turned: one of them is wrong."""

import math

import numpy as np
import pytest

from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import Exposed, NedFix
from vwnav.estimation.states import States
from vwnav.types import Attitude, Height, OdometryMotion

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def hovering(turned_deg, seconds=4.0):
    """Level at 50 m; each half second a fix, 3 m beside, turned by what `turned_deg(n)` says."""
    ekf = Ekf(EkfConfig())
    ekf.handle(Attitude(0.0, LEVEL))
    place = np.array([0.0, 0.0, -50.0])
    ekf.initialise(Start(t_s=0.0, position_ned_m=place, sigma_m=5.0, agl_m=50.0))
    accepted = []
    for n in range(1, round(50 * seconds)):
        t_s = round(0.02 * n, 6)
        ekf.handle(Attitude(t_s, LEVEL))
        if n % 5 == 0:
            ekf.handle(Height(t_s, 50.0))
        if n % 25 == 0:
            fix = NedFix(
                t_s=t_s, position_ne_m=np.array([3.0, 0.0]), covariance_ne_m2=np.eye(2),
                yaw_rad=math.radians(turned_deg(n // 25)), sigma_yaw_rad=0.02, agl_m=50.0,
                sigma_agl_m=1.0,
            )  # fmt: skip
            accepted.append(ekf.handle(fix).accepted)
    return ekf, accepted


@pytest.mark.parametrize("turned_deg", [60.0, 180.0])
def test_fixes_that_are_turned_are_believed_when_several_are_and_then_wholly(turned_deg):
    """The first was believed but for its heading; the route was flown to the other side."""
    ekf, accepted = hovering(lambda n: turned_deg)
    assert accepted[:3] == [False] * 3
    assert accepted[-1]
    off_deg = math.degrees(ekf.state.x[States.HEADING_BIAS]) + turned_deg
    assert (off_deg + 180.0) % 360.0 == pytest.approx(180.0, abs=3.0)


def test_fixes_of_slow_searches_are_believed_likewise():
    """Each is of an image that is older than the history: it meets the clone of its pose."""
    config = EkfConfig()
    ekf, accepted = Ekf(config), []
    ekf.handle(Attitude(0.0, LEVEL))
    place = np.array([0.0, 0.0, -50.0])
    ekf.initialise(Start(t_s=0.0, position_ned_m=place, sigma_m=5.0, agl_m=50.0))
    every, exposed_s = round(50.0 * (config.history_s + 1.0)), math.nan
    for n in range(1, 6 * every):
        t_s = round(0.02 * n, 6)
        ekf.handle(Attitude(t_s, LEVEL))
        ekf.handle(Height(t_s, 50.0))
        if n % every == 0:
            if n > every:
                fix = NedFix(
                    t_s=exposed_s, position_ne_m=np.array([3.0, 0.0]), covariance_ne_m2=np.eye(2),
                    yaw_rad=math.pi, sigma_yaw_rad=0.02, agl_m=50.0, sigma_agl_m=1.0,
                )  # fmt: skip
                accepted.append(ekf.handle(fix).accepted)
            exposed_s = t_s
            ekf.handle(Exposed(t_s))
    assert accepted == [False, False, False, True]
    assert abs(ekf.state.x[States.HEADING_BIAS]) == pytest.approx(math.pi, abs=0.1)


def test_a_match_that_is_turned_alone_moves_nothing():
    ekf, accepted = hovering(lambda n: 180.0 if n == 5 else 0.0)
    assert accepted == [n != 5 for n in range(1, len(accepted) + 1)]
    assert ekf.state.x[States.HEADING_BIAS] == pytest.approx(0.0, abs=0.02)


def test_a_compass_that_errs_as_they_do_is_learned_at_once():
    ekf, accepted = hovering(lambda n: 20.0)
    assert all(accepted)
    assert ekf.state.x[States.HEADING_BIAS] == pytest.approx(math.radians(-20.0), abs=0.03)


def drifting(bias_deg: float) -> tuple[Ekf, list[tuple[float, float]]]:
    """Level, northwards at 4 m/s, told in the autopilot's north; then fixes, two a second.

    Also time and how far it is off in the velocity, in its own sigmas, since the fixes began.
    """
    bias_rad = math.radians(bias_deg)
    yaw = np.array([math.cos(bias_rad / 2.0), 0.0, 0.0, math.sin(bias_rad / 2.0)])
    told = 4.0 * np.array([math.cos(bias_rad), math.sin(bias_rad), 0.0])
    ekf, off = Ekf(EkfConfig()), []
    ekf.handle(Attitude(0.0, yaw))
    start = Start(
        t_s=0.0, position_ned_m=np.array([0.0, 0.0, -50.0]), sigma_m=60.0, agl_m=50.0,
        sigma_velocity_m_s=5.0,
    )  # fmt: skip
    ekf.initialise(start)
    for n in range(1, 600):
        t_s = round(0.02 * n, 6)
        ekf.handle(Attitude(t_s, yaw))
        if n % 5 == 0:
            ekf.handle(Height(t_s, 50.0))
            way = OdometryMotion(
                round(t_s - 0.1, 6), t_s, 0.1 * told, 0.05**2 * np.eye(3), 0.0, 0.003, 50.0, 99
            )
            ekf.handle(way)
        if n % 25 == 0 and n > 250:
            fix = NedFix(
                t_s=t_s, position_ne_m=np.array([4.0 * t_s, 0.0]), covariance_ne_m2=np.eye(2),
                yaw_rad=0.0, sigma_yaw_rad=0.02, agl_m=50.0, sigma_agl_m=1.0,
            )  # fmt: skip
            ekf.handle(fix)
            found = ekf.estimate(t_s)
            error = found.velocity_ned_m_s[:2] - [4.0, 0.0]
            off.append((t_s, math.sqrt(error @ np.linalg.solve(found.covariance[3:5, 3:5], error))))
    return ekf, off


@pytest.mark.parametrize("bias_deg", [60.0, 180.0, -120.0])
def test_with_a_heading_that_was_off_from_the_start_velocity_and_wind_turn(bias_deg):
    """Left as they were, a head wind for a tail wind, the attitude seemed to lean by 2 degrees."""
    ekf, off = drifting(bias_deg)
    assert off[2][1] > 5.0  # sigmas: three are not believed
    assert all(sigmas < 1.0 for _, sigmas in off[3:])  # was 6 to 22 with the fourth
    assert np.degrees(np.linalg.norm(ekf.state.x[States.TILT])) < 0.5
