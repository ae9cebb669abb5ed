"""The autopilot's parameters that decide whether a flight on vision works, and what they must be.

Each with its reason; all were flown or measured on PX4 1.16 and 1.18 and ArduCopter 4.7.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from vwnav.mavlink.modes import AutopilotKind
from vwnav.vehicle import Finding, Severity

TAKEOFF_HEIGHT = "MIS_TAKEOFF_ALT"


@dataclass(frozen=True, slots=True)
class _ParameterRule:
    """`names`: the first that exists counts; firmware versions rename parameters."""

    names: tuple[str, ...]
    good: Callable[[float], bool]
    wanted: str
    why: str
    severity: Severity


def _bit(number: int) -> Callable[[float], bool]:
    return lambda value: bool(int(value) >> number & 1)


def _equals(*values: int) -> Callable[[float], bool]:
    return lambda value: int(value) in values


_PX4 = (
    _ParameterRule(("EKF2_EV_CTRL",), _bit(0), "bit 0 (horizontal position) set: 5",
          "vision is not fused at all", "fail"),
    _ParameterRule(("EKF2_EV_CTRL",), lambda value: int(value) & 0b101 != 1,
          "bit 2 (velocity) set: 5",
          "after a cut of the link it may come down with the wind: vwnav knows the velocity before "
          "the place", "warn"),
    _ParameterRule(("EKF2_EV_CTRL",), lambda value: not int(value) & 0b1010, "no other bits: 5",
          "height and yaw sent by vwnav come from PX4's own sensors", "warn"),
    _ParameterRule(("EKF2_HGT_REF",), _equals(0, 2), "0 (barometer)",
          "a height from GPS or vision would follow what is jammed, or vwnav itself", "warn"),
    _ParameterRule(("SYS_HAS_GPS",), _equals(0), "0, then reboot",
          "without a receiver the arming checks wait for a fix", "warn"),
    _ParameterRule(("EKF2_GPS_CTRL",), _equals(0), "0, then reboot",
          "a jammed or spoofed GPS would be fused beside vision", "warn"),
    _ParameterRule(("EKF2_EV_DELAY",), lambda value: value <= 200.0, "0 to 200 ms",
          "a longer one is not covered by EKF2_DELAY_MAX", "warn"),
    _ParameterRule(("COM_OF_LOSS_T",), lambda value: value <= 1.5, "1 s or less",
          "the aircraft flies on blind for so long when the computer dies", "warn"),
    _ParameterRule(("COM_OBL_RC_ACT",), _equals(4, 5), "4 (Land) or 5 (Hold)",
          "what happens when the computer dies; 0 (Position) needs a pilot with sticks", "warn"),
    _ParameterRule(("COM_LOW_BAT_ACT",), _equals(2, 3), "3 (return, then land)",
          "a low battery only warns", "warn"),
    _ParameterRule(("NAV_DLL_ACT",), lambda value: value > 0, "2 (return) or 1 (hold)",
          "losing the ground station does nothing", "warn"),
    _ParameterRule(("COM_RC_OVERRIDE",), _bit(1), "bit 1 set: 3 (PX4 to 1.17)",
          "the pilot's sticks cannot end Offboard", "warn"),
    _ParameterRule(("MAN_OVERRIDE_SPD",), lambda value: value > 0, "above 0 (PX4 from 1.18)",
          "the pilot's sticks cannot end Offboard", "warn"),
)  # fmt: skip
_ARDUPILOT = (
    _ParameterRule(("VISO_TYPE",), _equals(1), "1 (MAVLink), then reboot",
          "position messages are thrown away", "fail"),
    _ParameterRule(("EK3_SRC1_POSXY",), _equals(6), "6 (ExternalNav)",
          "vision is not fused at all", "fail"),
    _ParameterRule(("EK3_SRC1_VELXY",), _equals(6), "6 (ExternalNav)",
          "with position alone one jump corrupts the velocity: 15 to 60 m off", "fail"),
    _ParameterRule(("EK3_SRC1_VELZ",), _equals(0), "0 (none)",
          "vertical velocity from GPS is not there", "warn"),
    _ParameterRule(("EK3_SRC1_POSZ",), _equals(1), "1 (barometer)",
          "the height sent by vwnav comes from this barometer", "warn"),
    _ParameterRule(("EK3_SRC1_YAW",), _equals(1, 8), "1 (compass)",
          "the yaw sent by vwnav comes from the autopilot: it must not be fused", "fail"),
    _ParameterRule(("GPS1_TYPE", "GPS_TYPE"), _equals(0), "0 (none), then reboot",
          "a jammed or spoofed GPS may be taken for good", "warn"),
    _ParameterRule(("VISO_DELAY_MS",), lambda value: value <= 100.0, "10 ms",
          "estimates are stamped when they are sent", "warn"),
    _ParameterRule(("BATT_FS_LOW_ACT",), lambda value: value > 0, "2 (return) or 1 (land)",
          "a low battery only warns", "warn"),
    _ParameterRule(("FS_GCS_ENABLE",), lambda value: value > 0, "1 (return) or 5 (land)",
          "losing the ground station does nothing", "warn"),
    _ParameterRule(("FS_EKF_ACTION",), _equals(1, 3), "1 (land)",
          "what happens when vision stops and the position is lost", "warn"),
)  # fmt: skip
_OPTIONAL = frozenset({"COM_RC_OVERRIDE", "MAN_OVERRIDE_SPD", "SYS_HAS_GPS", "EKF2_GPS_CTRL"})


def parameter_names(kind: AutopilotKind) -> tuple[str, ...]:
    """Every parameter that is looked at, the one that is borrowed for a take-off too."""
    names = [name for rule in _rules(kind) for name in rule.names]
    borrowed = [TAKEOFF_HEIGHT] if kind is AutopilotKind.PX4 else []
    return tuple(dict.fromkeys(names + borrowed))


def check_parameters(kind: AutopilotKind, values: Mapping[str, float]) -> list[Finding]:
    """What is not as it should be, worst first.

    Args:
        kind: firmware family.
        values: parameters that exist, by name.
    """
    findings = [_check(rule, values) for rule in _rules(kind)]
    found = [finding for finding in findings if finding is not None]
    return sorted(found, key=lambda finding: finding.severity != "fail")


def _rules(kind: AutopilotKind) -> tuple[_ParameterRule, ...]:
    return _PX4 if kind is AutopilotKind.PX4 else _ARDUPILOT


def _check(rule: _ParameterRule, values: Mapping[str, float]) -> Finding | None:
    name = next((name for name in rule.names if name in values), None)
    if name is None and set(rule.names) <= _OPTIONAL:
        return None  # not a parameter of this version
    if name is not None and rule.good(values[name]):
        return None
    return Finding(
        parameter=name or rule.names[0],
        present=None if name is None else values[name],
        wanted=rule.wanted,
        why=rule.why,
        severity=rule.severity,
    )
