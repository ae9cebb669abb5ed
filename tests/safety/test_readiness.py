"""The list of what must be right before the motors start."""

from dataclasses import replace

import numpy as np
import pytest
from vehicles import FLYING

from vwnav.safety.camera_watch import CameraSight
from vwnav.safety.readiness import Equipment, check_flight, missing
from vwnav.safety.safety_config import SafetyConfig
from vwnav.types import Attitude, Estimate
from vwnav.vehicle import Finding, FlightMode, Navigation

STANDING = replace(FLYING, armed=False, in_air=False, mode=FlightMode.HOLD)
READY = Equipment(findings=(), link_refusal=None, sight=CameraSight(9.9))
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


def test_the_autopilots_own_reason_is_said():
    vehicle = replace(STANDING, armable=False, complaints=("Low", "PreArm: VisOdom: not healthy"))
    assert trouble(vehicle=vehicle).endswith("arm: Low; PreArm: VisOdom: not healthy")


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"connected": False}, "not heard"),
        ({"battery_ratio": None}, "does not say how full"),
        ({"battery_ratio": 0.3}, "charge it"),
        ({"armable": False}, "readiness to arm"),
        ({"local_position_ok": False}, "local position"),
        ({"in_air": True}, "in the air"),
        ({"attitude": Attitude(9.3, ESTIMATE.quat_wxyz)}, "0.7 s late"),
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
        ({"sight": CameraSight(None)}, "no picture has come"),
        ({"sight": CameraSight(7.0)}, "no picture for 3.0 s"),
        ({"sight": CameraSight(9.9, "the camera repeats its pictures")}, "repeats"),
    ],
)
def test_what_the_equipment_lacks_is_said(changes, word):
    assert word in trouble(equipment=replace(READY, **changes))


def test_a_parameter_that_only_warns_keeps_nobody_on_the_ground():
    assert trouble(equipment=replace(READY, findings=(replace(NO_VISION, severity="warn"),))) == ""


def test_a_px4_that_does_not_tell_who_chose_its_mode_keeps_nobody_on_the_ground():
    vehicle = replace(STANDING, tells_intent=False)
    (check,) = [each for each in check_flight(vehicle, GOOD, READY, SafetyConfig(), 10.0)
                if each.name == "autopilot"]  # fmt: skip
    assert check.verdict == "WARN"
    assert "COM_OBL_RC_ACT" in check.detail
    assert trouble(vehicle=vehicle) == ""


def test_without_an_estimate_the_guards_own_words_are_passed_on():
    assert "velocity is lost" in trouble(navigation=Navigation(None, "its velocity is lost"))


def shown(vehicle=STANDING, navigation=GOOD, equipment=READY) -> list[tuple[str, str, str]]:
    checks = check_flight(vehicle, navigation, equipment, SafetyConfig(), 10.0)
    return [(check.name, check.verdict, check.detail) for check in checks]


def test_what_is_well_is_shown_too_in_its_order():
    assert shown() == [
        ("link", "PASS", "heard"),
        ("parameters", "PASS", "as a flight on vision wants them"),
        ("battery", "PASS", "90 %"),
        ("camera", "PASS", "pictures come"),
        ("estimate", "PASS", "there is one to fly on"),
        ("autopilot", "PASS", "ready to arm, with a position"),
    ]


def test_all_that_is_wrong_is_shown_at_once():
    vehicle = replace(STANDING, connected=False, battery_ratio=0.2, armable=False)
    warns = replace(NO_VISION, parameter="NAV_DLL_ACT", present=None, severity="warn")
    equipment = replace(READY, findings=(NO_VISION, warns), sight=CameraSight(8.9))
    assert shown(vehicle, Navigation(None), equipment) == [
        ("link", "FAIL", "the autopilot is not heard"),
        ("EKF2_EV_CTRL", "FAIL", "is 0, should be 1: vision is not fused"),
        ("NAV_DLL_ACT", "WARN", "is missing, should be 1: vision is not fused"),
        ("battery", "FAIL", "20 %, 35 % is wanted: charge it"),
        ("camera", "FAIL", "no picture for 1.1 s: check its cable"),
        ("estimate", "FAIL", "neither attitude nor height has come from the autopilot"),
        ("autopilot", "FAIL", "it reports no readiness to arm: a ground station may show why"),
    ]


@pytest.mark.parametrize(
    ("changes", "name"),
    [({"battery_ratio": None}, "battery"), ({"in_air": True}, "autopilot"),
     ({"local_position_ok": False}, "autopilot")],
)  # fmt: skip
def test_what_the_vehicle_lacks_has_its_name(changes, name):
    assert trouble(vehicle=replace(STANDING, **changes)).startswith(f"{name}: ")


@pytest.mark.parametrize(
    ("changes", "name"),
    [({"findings": None}, "parameters"), ({"link_refusal": "57600 baud"}, "link"),
     ({"sight": CameraSight(None)}, "camera"), ({"sight": CameraSight(9.9, "repeats")}, "camera")],
)  # fmt: skip
def test_what_the_equipment_lacks_has_its_name(changes, name):
    assert trouble(equipment=replace(READY, **changes)).startswith(f"{name}: ")


def test_exactly_enough_is_enough():
    assert trouble(vehicle=replace(STANDING, battery_ratio=0.35)) == ""
    assert trouble(equipment=replace(READY, sight=CameraSight(9.0))) == ""
    assert trouble(vehicle=replace(STANDING, attitude=Attitude(9.7, ESTIMATE.quat_wxyz))) == ""
    assert trouble(vehicle=replace(STANDING, armable=False, connected=False)).count("; ") == 1


@pytest.mark.parametrize(
    ("sight", "words"),
    [
        (CameraSight(9.9, shade="black"), "black all over: is the lens covered"),
        (CameraSight(9.9, shade="white"), "white all over"),
        (CameraSight(9.9, rate_hz=5.04), "come 5.0 times a second, 10 a second are wanted"),
    ],
)
def test_an_odd_picture_warns_and_keeps_nobody_on_the_ground(sight, words):
    name, verdict, detail = shown(equipment=replace(READY, sight=sight))[3]
    assert (name, verdict) == ("camera", "WARN")
    assert words in detail
    assert trouble(equipment=replace(READY, sight=sight)) == ""


def test_a_rate_that_is_enough_or_not_known_yet_is_no_matter():
    for rate_hz in (8.0, 30.0, None):
        assert (
            shown(equipment=replace(READY, sight=CameraSight(9.9, rate_hz=rate_hz)))[3][1] == "PASS"
        )
