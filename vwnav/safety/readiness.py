"""The one list of what must be right before the motors start: `doctor` and `fly` both show it."""

from collections.abc import Iterable
from dataclasses import dataclass

from vwnav.safety.camera_watch import CameraSight
from vwnav.safety.check import Check
from vwnav.safety.safety_config import SafetyConfig
from vwnav.vehicle import Finding, Navigation, VehicleState

_IMAGE_AGE_S = 1.0
_UNTOLD_INTENT = (
    "this PX4 does not tell which mode was asked for (before 1.15): after a cut of the link the "
    "mode of its failsafe counts as the pilot's choice, so set COM_OBL_RC_ACT to 4 (Land)"
)
_IMAGES_HZ, _ENOUGH_HZ = 10.0, 8.0  # what is wanted, and what may pass for it
_ATTITUDE_AGE_S = 0.4  # flown: 0.3 s late for 10 s; at 0.5 odometry is lost again and again


@dataclass(frozen=True, slots=True)
class Equipment:
    """What the list needs to know besides telemetry and estimate.

    Attributes:
        findings: parameters that are not as vision wants them; None while they are being read.
        link_refusal: why the link cannot carry a flight; None when it can.
        sight: what the camera's images are like.
    """

    findings: tuple[Finding, ...] | None
    link_refusal: str | None
    sight: CameraSight


def check_flight(
    vehicle: VehicleState,
    navigation: Navigation,
    equipment: Equipment,
    config: SafetyConfig,
    t_s: float,
) -> tuple[Check, ...]:
    """Everything that is looked at before arming, in the order in which it is shown."""
    return (
        _link(vehicle, equipment, t_s),
        *check_parameters(equipment.findings),
        check_battery(vehicle, config),
        check_camera(equipment.sight, t_s),
        _estimate(navigation),
        _autopilot(vehicle),
    )


def missing(checks: Iterable[Check]) -> str:
    """What keeps the aircraft on the ground, in one line; empty when nothing does."""
    return "; ".join(f"{check.name}: {check.detail}" for check in checks if check.verdict == "FAIL")


def check_battery(vehicle: VehicleState, config: SafetyConfig) -> Check:
    """A battery that nobody knows is none to fly on."""
    ratio = vehicle.battery_ratio
    if ratio is None:
        detail = "the autopilot does not say how full it is: calibrate its power module"
        return Check("battery", "FAIL", detail)
    enough = ratio >= config.battery_takeoff_ratio
    needed = "" if enough else f", {100 * config.battery_takeoff_ratio:.0f} % is wanted: charge it"
    return Check("battery", "PASS" if enough else "FAIL", f"{100 * ratio:.0f} %{needed}")


def check_camera(sight: CameraSight, t_s: float) -> Check:
    """Images come and fit; odd ones keep nobody on the ground: below one that stands it is dark."""
    if sight.trouble:
        return Check("camera", "FAIL", sight.trouble)
    if sight.image_s is None:
        return Check("camera", "FAIL", "no picture has come: check its cable")
    age_s = t_s - sight.image_s
    if age_s > _IMAGE_AGE_S:
        return Check("camera", "FAIL", f"no picture for {age_s:.1f} s: check its cable")
    odd = "; ".join(filter(None, (_shade(sight), _rate(sight))))
    return Check("camera", "WARN" if odd else "PASS", odd or "pictures come")


def _shade(sight: CameraSight) -> str:
    if not sight.shade:
        return ""
    return f"pictures are {sight.shade} all over: is the lens covered, or its exposure fixed?"


def _rate(sight: CameraSight) -> str:
    if sight.rate_hz is None or sight.rate_hz >= _ENOUGH_HZ:
        return ""
    wanted = f"{_IMAGES_HZ:g} a second are wanted"
    return f"pictures come {sight.rate_hz:.1f} times a second, {wanted}: odometry needs overlap"


def check_parameters(findings: tuple[Finding, ...] | None) -> tuple[Check, ...]:
    """A line for every parameter that is wrong."""
    if findings is None:
        return (Check("parameters", "FAIL", "not read yet"),)
    if not findings:
        return (Check("parameters", "PASS", "as a flight on vision wants them"),)
    return tuple(
        Check(
            finding.parameter,
            "FAIL" if finding.severity == "fail" else "WARN",
            f"{_present(finding)}, should be {finding.wanted}: {finding.why}",
        )
        for finding in findings
    )


def _present(finding: Finding) -> str:
    return "is missing" if finding.present is None else f"is {finding.present:g}"


def _link(vehicle: VehicleState, equipment: Equipment, t_s: float) -> Check:
    if not vehicle.connected:
        return Check("link", "FAIL", "the autopilot is not heard")
    if equipment.link_refusal is not None:
        return Check("link", "FAIL", equipment.link_refusal)
    attitude = vehicle.attitude
    age_s = 0.0 if attitude is None else t_s - attitude.t_s
    if age_s > _ATTITUDE_AGE_S:
        late = f"the autopilot's attitude comes {age_s:.1f} s late, {_ATTITUDE_AGE_S:g} at most"
        return Check("link", "FAIL", f"{late}: is the link or this computer overloaded?")
    return Check("link", "PASS", "heard")


def _estimate(navigation: Navigation) -> Check:
    if navigation.estimate is not None:
        return Check("estimate", "PASS", "there is one to fly on")
    detail = navigation.lost or "neither attitude nor height has come from the autopilot"
    return Check("estimate", "FAIL", detail)


def _autopilot(vehicle: VehicleState) -> Check:
    if vehicle.in_air:
        return Check("autopilot", "FAIL", "it reports to be in the air")
    if not vehicle.armable:
        why = "; ".join(vehicle.complaints[-2:]) or "a ground station may show why"
        return Check("autopilot", "FAIL", f"it reports no readiness to arm: {why}")
    if not vehicle.local_position_ok:
        return Check("autopilot", "FAIL", "it reports no local position: is it set up for vision?")
    if not vehicle.tells_intent:
        return Check("autopilot", "WARN", _UNTOLD_INTENT)
    return Check("autopilot", "PASS", "ready to arm, with a position")
