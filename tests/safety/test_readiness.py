"""The list of what must be right before the motors start."""

from dataclasses import replace

import numpy as np
import pytest
from vehicles import FLYING

from vwnav.safety.readiness import Equipment, check_flight, missing
from vwnav.safety.safety_config import SafetyConfig
from vwnav.types import Estimate, Finding, FlightMode, Navigation

STANDING = replace(FLYING, armed=False, in_air=False, mode=FlightMode.HOLD)
READY = Equipment(findings=(), link_refusal=None, picture_s=9.9, picture_trouble="")
ESTIMATE = Estimate(
    t_s=10.0, position_ned_m=np.zeros(3), velocity_ned_m_s=np.zeros(3), covariance=np.eye(6),
    quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]), sigma_yaw_rad=0.1, agl_m=0.1, sigma_agl_m=0.1,
    t_last_fix_s=None, reset_counter=0,
)  # fmt: skip
GOOD = Navigation(ESTIMATE)
NO_VISION = Finding(
    parameter="EKF2_EV_CTRL", present=0.0, wanted="1", why="vision is not fused", severity="fail"
)


def trouble(vehicle=STANDING, navigation=GOOD, equipment=READY) -> str:
    return missing(check_flight(vehicle, navigation, equipment, SafetyConfig(), 10.0))


def test_nothing_is_missing_when_all_is_well():
    assert trouble() == ""


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"connected": False}, "not heard"),
        ({"battery_ratio": None}, "does not say how full"),
        ({"battery_ratio": 0.3}, "charge it"),
        ({"armable": False}, "readiness to arm"),
        ({"local_position_ok": False}, "local position"),
        ({"in_air": True}, "in the air"),
    ],
)
def test_what_the_vehicle_lacks_is_said(changes, word):
    assert word in trouble(vehicle=replace(STANDING, **changes))


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"findings": None}, "not read yet"),
        ({"findings": (NO_VISION,)}, "EKF2_EV_CTRL: is 0, should be 1"),
        ({"link_refusal": "57600 baud is too little"}, "57600 baud"),
        ({"picture_s": None}, "no picture has come"),
        ({"picture_s": 7.0}, "no picture for 3.0 s"),
        ({"picture_trouble": "the camera repeats its pictures"}, "repeats"),
    ],
)
def test_what_the_equipment_lacks_is_said(changes, word):
    assert word in trouble(equipment=replace(READY, **changes))


def test_a_parameter_that_only_warns_keeps_nobody_on_the_ground():
    assert trouble(equipment=replace(READY, findings=(replace(NO_VISION, severity="warn"),))) == ""


def test_without_an_estimate_the_guards_own_words_are_passed_on():
    assert "velocity is lost" in trouble(navigation=Navigation(None, "its velocity is lost"))
