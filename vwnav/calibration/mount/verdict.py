"""Which numbers a flight has told, and which not, and why."""

import math
from dataclasses import dataclass, replace

import numpy as np

from vwnav.calibration.mount.solve import MountFit
from vwnav.errors import CalibrationError
from vwnav.geometry.camera import R_BODY_CAMERA_DOWN, Camera
from vwnav.geometry.rotations import euler_from_rotation, rotation_from_euler

MOST_TILT_RAD, MOST_YAW_RAD = math.radians(0.5), math.radians(1.0)
MOST_OFFSET_S, MOST_READOUT_S = 0.005, 0.005
MOST_FOCAL = {True: 0.003, False: 0.01}  # by whether heights were told
LEAST_BANK_RAD = math.radians(20.0)


@dataclass(frozen=True, slots=True)
class ToldNumber:
    """One number: its value and sigma in words, and why it is refused (empty: it is taken)."""

    name: str
    value: str
    refused: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class MountVerdict:
    """The camera as a flight has told it; what was refused is as it was before."""

    camera: Camera
    told: tuple[ToldNumber, ...]
    findings: dict[str, object]


def judge(
    flown: Camera, fit: MountFit, focal: bool, heights: bool, most_bank_rad: float
) -> MountVerdict:
    """Take what is known well enough.

    Args:
        flown: the camera as it was believed to be.
        fit: what the flight tells.
        focal: whether the focal length was asked.
        heights: whether a rangefinder or a height above ground was told.
        most_bank_rad: the largest tilt of the aircraft in an image.

    Raises:
        CalibrationError: not even the mount is told.
    """
    roll_pitch_rad = float(max(fit.sigmas_rad[:2]))
    if not roll_pitch_rad <= MOST_TILT_RAD:
        raise CalibrationError(
            f"this flight tells the mount to {math.degrees(roll_pitch_rad):.1f} degrees only: "
            "fly longer, over ground with more to see, in legs of several headings"
        )
    told = [_mount(fit), _yaw(fit), _offset(fit), _readout(fit)]
    if focal:
        told.append(_focal(flown, fit, heights, most_bank_rad))
    why = (
        "nothing that is read here tells a place of the aircraft but the camera itself; it would "
        "take the GPS of a flight with turns in hover, which is not read: measure it with a ruler"
    )
    told.append(ToldNumber("lever arm", "", why))
    refused = {each.name for each in told if each.refused}
    return MountVerdict(_camera(flown, fit, refused, focal), tuple(told), _findings(fit, refused))


def _mount(fit: MountFit) -> ToldNumber:
    roll, pitch, _ = np.degrees(_angles(fit.R_body_camera))
    sigmas = np.degrees(fit.sigmas_rad)
    value = f"{roll:.2f} +- {sigmas[0]:.2f}, {pitch:.2f} +- {sigmas[1]:.2f} degrees"
    return ToldNumber("mount: roll, pitch", value)


def _yaw(fit: MountFit) -> ToldNumber:
    yaw, sigma = math.degrees(_angles(fit.R_body_camera)[2]), math.degrees(fit.sigmas_rad[2])
    why = "" if fit.sigmas_rad[2] <= MOST_YAW_RAD else (
        "without banking the mount's turn and the compass's error look alike"
    )  # fmt: skip
    return ToldNumber("mount: yaw", f"{yaw:.2f} +- {sigma:.2f} degrees", why)


def _offset(fit: MountFit) -> ToldNumber:
    why = "" if fit.sigma_offset_s <= MOST_OFFSET_S else "the aircraft hardly turned"
    value = f"{1e3 * fit.offset_s:.1f} +- {1e3 * fit.sigma_offset_s:.1f} ms"
    return ToldNumber("time offset, this flight's", value, why)


def _readout(fit: MountFit) -> ToldNumber:
    why = "" if fit.sigma_readout_s <= MOST_READOUT_S else "the picture hardly moved"
    value = f"{1e3 * fit.readout_s:.1f} +- {1e3 * fit.sigma_readout_s:.1f} ms"
    return ToldNumber("read-out", value, why)


def _focal(flown: Camera, fit: MountFit, heights: bool, most_bank_rad: float) -> ToldNumber:
    value = (
        f"{fit.focal_ratio * flown.K[0, 0]:.2f} px, {100.0 * (fit.focal_ratio - 1.0):+.2f} "
        f"+- {100.0 * fit.sigma_focal_ratio:.2f} %"
    )
    why = ""
    if flown.model == "fisheye":
        why = "a fisheye's comes from the board alone"
    elif not heights and most_bank_rad < LEAST_BANK_RAD:
        why = (
            "no rangefinder or GPS height, and no turn with over 20 degrees of bank "
            f"({math.degrees(most_bank_rad):.0f} were flown)"
        )
    elif fit.sigma_focal_ratio > MOST_FOCAL[heights]:
        why = f"known to {100.0 * fit.sigma_focal_ratio:.1f} % only: a longer flight"
    return ToldNumber("focal length", value, why)


def _camera(flown: Camera, fit: MountFit, refused: set[str], focal: bool) -> Camera:
    roll, pitch, yaw = _angles(fit.R_body_camera)
    if "mount: yaw" in refused:
        yaw = _angles(flown.R_body_camera)[2]
    found = replace(flown, R_body_camera=rotation_from_euler(roll, pitch, yaw) @ R_BODY_CAMERA_DOWN)
    if "time offset, this flight's" not in refused:
        found = replace(found, time_offset_s=flown.time_offset_s + fit.offset_s)
    if "read-out" not in refused:
        found = replace(found, readout_s=fit.readout_s)
    if focal and "focal length" not in refused:
        found = _rescaled(found, fit.focal_ratio)
    return found


def _rescaled(camera: Camera, ratio: float) -> Camera:
    """Another focal length; distortion bends the same pixels as before."""
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= ratio
    powers = (2, 4, 1, 1, 6)  # of the radius, in k1 k2 p1 p2 k3
    bent = tuple(k * ratio**power for k, power in zip(camera.distortion, powers, strict=False))
    return replace(camera, K=K, distortion=bent)


def _findings(fit: MountFit, refused: set[str]) -> dict[str, object]:
    found: dict[str, object] = {
        "mount_pictures": fit.images,
        "sigma_mount_rpy_deg": [round(math.degrees(s), 4) for s in fit.sigmas_rad],
    }
    if "time offset, this flight's" not in refused:
        found["sigma_time_offset_s"] = round(fit.sigma_offset_s, 6)
    if "read-out" not in refused:
        found["sigma_readout_s"] = round(fit.sigma_readout_s, 6)
    if fit.sigma_focal_ratio > 0.0 and "focal length" not in refused:
        found["sigma_focal_ratio"] = round(fit.sigma_focal_ratio, 6)
    return found


def _angles(R_body_camera: np.ndarray) -> tuple[float, float, float]:
    return euler_from_rotation(R_body_camera @ R_BODY_CAMERA_DOWN.T)
