"""Camera calibration files: our own JSON and TOML, OpenCV's YAML, ROS camera_info YAML.

Our own keys, the same in JSON and TOML (`docs/conventions.md` has an example):
`width_px height_px model fx_px fy_px cx_px cy_px distortion mount_rpy_deg lever_arm_m readout_s
time_offset_s sensor_mode calibrated`; those from `distortion` on may be left out. The mount turns
the camera away from looking straight down with its upper edge to the nose. `sensor_mode` holds the
fields of `SensorMode` that are known; `calibrated` says how all of it was found.
"""

import difflib
import json
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomli_w

from vwnav.errors import CalibrationError
from vwnav.files.whole import write_whole
from vwnav.geometry.camera import MAX_OFF_NADIR_RAD, R_BODY_CAMERA_DOWN, Camera, CameraModel
from vwnav.geometry.rotations import euler_from_rotation, rotation_from_euler
from vwnav.geometry.sensor_mode import SensorMode
from vwnav.types import Array

_NESTING, _MOST_NESTING = ("[", "{", "- ", ":"), 5000  # of YAML; OpenCV writes some dozens
_MAX_BYTES = 1_000_000
_LEAST_FOCAL_RATIO, _LEAST_OFFSET_SIGMA_S = 0.001, 0.01  # what the next flight leaves of measured
_FOCAL_RATIOS = (0.05, 50.0)  # of the longer side: from 170 degrees to one, and some more
_MOST_ASPECT = 2.0  # of a pixel's sides: of pictures that were squeezed, 4:3 to 16:9 say
_MIDDLE = 0.25, 0.75  # shares of a side: farther off is the calibration of another size
_NUMBERS = ("fx_px", "fy_px", "cx_px", "cy_px")
_REQUIRED = ("width_px", "height_px", "model", *_NUMBERS)
_OPTIONAL = ("distortion", "mount_rpy_deg", "lever_arm_m", "readout_s", "time_offset_s",
    "sensor_mode", "calibrated")  # fmt: skip
_MODELS: dict[str, CameraModel] = {
    "": "pinhole",
    "pinhole": "pinhole",
    "plumb_bob": "pinhole",
    "radtan": "pinhole",
    "rational_polynomial": "pinhole",
    "fisheye": "fisheye",
    "equidistant": "fisheye",
}
_MODEL_KEYS = ("distortion_model", "camera_model")


def load_camera(path: Path | str) -> Camera:
    """The camera of a calibration file.

    Raises:
        CalibrationError: the file is missing, damaged, or describes no camera.
    """
    path = Path(path)
    try:
        camera = _camera(path, _read(path))
        _check_plausible(camera)
    except CalibrationError:
        raise
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError, cv2.error) as error:
        raise CalibrationError(
            f"{path}: not a usable camera calibration ({_one_line(error)}); "
            "expected JSON, TOML, or YAML of OpenCV or ROS camera_info"
        ) from error
    return camera


def load_findings(path: Path | str) -> dict[str, Any]:
    """What `calibrated` of our own kind of file says: sigmas and errors by name; {} without it.

    Raises:
        CalibrationError: the file cannot be read.
    """
    path = Path(path)
    suffix, text = path.suffix.lower(), _read(path)
    if suffix not in (".json", ".toml"):
        return {}
    try:
        values = json.loads(text) if suffix == ".json" else tomllib.loads(text)
    except ValueError as error:
        raise CalibrationError(f"{path}: damaged ({_one_line(error)})") from error
    return dict(values.get("calibrated", {}))


def save_camera(
    camera: Camera, path: Path | str, calibrated: Mapping[str, Any] | None = None
) -> None:
    """Write our own JSON or TOML, by the file's suffix, whole or not at all.

    Args:
        camera: to be written.
        path: of the file.
        calibrated: how it was found, by name; None leaves that out.

    Raises:
        CalibrationError: the suffix is another one, or the file cannot be written.
    """
    path = Path(path)
    values = _to_dict(camera) | ({"calibrated": dict(calibrated)} if calibrated else {})
    match path.suffix.lower():
        case ".json":
            text = json.dumps(values, indent=2) + "\n"
        case ".toml":
            text = tomli_w.dumps(values)
        case suffix:
            raise CalibrationError(f"{path}: cannot write {suffix!r}; use .json or .toml")
    try:
        write_whole(path, text)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot write ({error.strerror})") from error


def _read(path: Path) -> str:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise CalibrationError(f"{path}: larger than 1 MB, not a camera calibration")
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not text"
        raise CalibrationError(f"{path}: cannot read ({why})") from error


def _camera(path: Path, text: str) -> Camera:
    match path.suffix.lower():
        case ".json":
            return _from_dict(json.loads(text))
        case ".toml":
            return _from_dict(tomllib.loads(text))
        case ".yaml" | ".yml":
            return _from_yaml(text)
        case suffix:
            raise CalibrationError(
                f"{path}: unknown kind of calibration {suffix!r}; use .json, .toml, .yaml or .yml"
            )


def _from_dict(values: Any) -> Camera:
    if not isinstance(values, dict):
        raise ValueError("expected named values at the top")
    missing = [key for key in _REQUIRED if key not in values]
    if not isinstance(values.get("calibrated", {}), dict):
        raise ValueError("calibrated is no table")
    known = (*_REQUIRED, *_OPTIONAL)
    unknown = [key for key in values if key not in known]
    if missing:
        raise ValueError(f"missing {', '.join(missing)}")
    if unknown:
        near = difflib.get_close_matches(unknown[0], known, n=1)
        hint = f", did you mean {near[0]}?" if near else ""
        raise ValueError(f"unknown key {', '.join(unknown)}{hint}")
    fx_px, fy_px, cx_px, cy_px = (_number(values[key], key) for key in _NUMBERS)
    roll, pitch, yaw = (math.radians(a) for a in _numbers(values, "mount_rpy_deg", (0.0,) * 3))
    return Camera(
        width_px=_pixels(values["width_px"], "width_px"),
        height_px=_pixels(values["height_px"], "height_px"),
        K=np.array([[fx_px, 0.0, cx_px], [0.0, fy_px, cy_px], [0.0, 0.0, 1.0]]),
        distortion=tuple(_numbers(values, "distortion", ())),
        model=values["model"],
        R_body_camera=rotation_from_euler(roll, pitch, yaw) @ R_BODY_CAMERA_DOWN,
        t_body_camera_m=np.array(_numbers(values, "lever_arm_m", (0.0,) * 3)),
        readout_s=_number(values["readout_s"], "readout_s") if "readout_s" in values else None,
        time_offset_s=_number(values.get("time_offset_s", 0.0), "time_offset_s"),
        sensor_mode=SensorMode.of(values["sensor_mode"]) if "sensor_mode" in values else None,
        **_sigmas(values.get("calibrated", {}), fx_px),
    )


def _sigmas(calibrated: dict[str, Any], fx_px: float) -> dict[str, float]:
    """Of mount (of roll and pitch the larger), dates and focal length, where they were told."""
    sigmas = {}
    if "sigma_mount_rpy_deg" in calibrated:
        roll, pitch, _ = _numbers(calibrated, "sigma_mount_rpy_deg", (0.0,) * 3)
        sigmas["sigma_mount_rad"] = math.radians(max(roll, pitch))
    if (key := "sigma_time_offset_s") in calibrated:
        sigma_s = _number(calibrated[key], key)
        sigmas[key] = max(sigma_s, _LEAST_OFFSET_SIGMA_S) if sigma_s >= 0.0 else sigma_s
    focal = _focal_sigma_ratio(calibrated, fx_px)
    return sigmas if focal is None else sigmas | {"sigma_focal_ratio": focal}


def _focal_sigma_ratio(calibrated: dict[str, Any], fx_px: float) -> float | None:
    """One sigma of the focal length, relative; None where it was not told."""
    keys = [key for key in ("sigma_fx_px", "sigma_focal_ratio") if key in calibrated]
    told = {key: _number(calibrated[key], key) for key in keys}
    for key, sigma in told.items():
        if sigma < 0.0:
            raise ValueError(f"{key} is {sigma:g}, expected 0 or more")
    if not told or fx_px <= 0.0:  # which is no camera
        return None
    in_px = told.get("sigma_fx_px", math.inf)
    return max(min(in_px / fx_px, told.get("sigma_focal_ratio", math.inf)), _LEAST_FOCAL_RATIO)


def _to_dict(camera: Camera) -> dict[str, Any]:
    mount_rpy_rad = euler_from_rotation(camera.R_body_camera @ R_BODY_CAMERA_DOWN.T)
    readout = {} if camera.readout_s is None else {"readout_s": camera.readout_s}
    mode = {} if camera.sensor_mode is None else {"sensor_mode": camera.sensor_mode.told()}
    return {
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "model": camera.model,
        "fx_px": float(camera.K[0, 0]),
        "fy_px": float(camera.K[1, 1]),
        "cx_px": float(camera.K[0, 2]),
        "cy_px": float(camera.K[1, 2]),
        "distortion": list(camera.distortion),
        "mount_rpy_deg": [math.degrees(angle) for angle in mount_rpy_rad],
        "lever_arm_m": camera.t_body_camera_m.tolist(),
        **readout,
        "time_offset_s": camera.time_offset_s,
        **mode,
    }


def _from_yaml(text: str) -> Camera:
    # ROS writes no version line, without which OpenCV does not read the file.
    body = text if text.lstrip().startswith("%YAML") else f"%YAML:1.0\n---\n{text}"
    if sum(map(text.count, _NESTING)) > _MOST_NESTING:  # so deep OpenCV ends us without a word
        raise ValueError("far more in it than a calibration has")
    try:
        storage = cv2.FileStorage(body, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    except SystemError as error:  # its binding's own, without a word about the file
        raise ValueError("not YAML") from error
    try:
        K = _matrix(storage, "camera_matrix").reshape(3, 3)
        coefficients = _matrix(storage, "distortion_coefficients")
        width_px, height_px = (storage.getNode(f"image_{side}") for side in ("width", "height"))
        model = _yaml_model(storage)
        if width_px.empty() or height_px.empty():
            raise ValueError("missing image_width or image_height")
        return Camera(
            width_px=_pixels(width_px.real(), "image_width"),
            height_px=_pixels(height_px.real(), "image_height"),
            K=K,
            distortion=_known_coefficients(coefficients, model),
            model=model,
        )
    finally:
        storage.release()


def _yaml_model(storage: cv2.FileStorage) -> CameraModel:
    """The lens by all keys that programs name it with."""
    if not storage.getNode("xi").empty():
        raise ValueError("xi is of an omnidirectional lens, expected pinhole or fisheye")
    told = {key: _model_named(storage.getNode(key), key) for key in _MODEL_KEYS}
    if told["camera_model"] == "pinhole" and told["distortion_model"] is not None:
        del told["camera_model"]  # Kalibr's word for the projection, whatever the distortion
    told["fisheye_model"] = _model_numbered(storage.getNode("fisheye_model"))
    known = {key: model for key, model in told.items() if model is not None}
    if len(set(known.values())) > 1:
        raise ValueError(f"{' and '.join(known)} contradict each other")
    return next(iter(known.values()), "pinhole")


def _model_named(node: cv2.FileNode, key: str) -> CameraModel | None:
    if node.empty():
        return None
    if not node.isString() or node.string().lower() not in _MODELS:
        raise ValueError(f"unknown {key} {node.string() or node.real()!r}")
    return _MODELS[node.string().lower()]


def _model_numbered(node: cv2.FileNode) -> CameraModel | None:
    """By `fisheye_model`, 0 or 1, of OpenCV's own calibration program."""
    if node.empty():
        return None
    if node.real() not in (0.0, 1.0):
        raise ValueError(f"fisheye_model is {node.real():g}, expected 0 or 1")
    return "fisheye" if node.real() else "pinhole"


def _known_coefficients(coefficients: Array, model: CameraModel) -> tuple[float, ...]:
    """The coefficients without trailing zeros beyond those of the model, which others use."""
    known, keep = ("k1 k2 k3 k4", 4) if model == "fisheye" else ("k1 k2 p1 p2 k3", 5)
    if np.any(coefficients[keep:]):
        raise ValueError(f"distortion beyond {known} of a {model} lens")
    return tuple(float(k) for k in coefficients[:keep])


def _matrix(storage: cv2.FileStorage, key: str) -> Array:
    """The numbers of a matrix, row by row, as OpenCV and ROS both write them."""
    data = storage.getNode(key).getNode("data") if not storage.getNode(key).empty() else None
    if data is None or not data.isSeq():
        raise ValueError(f"missing {key} with its data")
    return np.array([data.at(i).real() for i in range(data.size())])


def _number(value: Any, key: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{key} is {value!r}, expected a finite number")
    return float(value)


def _numbers(values: dict[str, Any], key: str, default: tuple[float, ...]) -> list[float]:
    found = values.get(key, default)
    if not isinstance(found, list | tuple) or (default and len(found) != len(default)):
        raise ValueError(f"{key} is {found!r}, expected a list of {len(default) or 'some'} numbers")
    return [_number(value, key) for value in found]


def _pixels(value: Any, key: str) -> int:
    if _number(value, key) != int(value) or not 1 <= value <= 100_000:
        raise ValueError(f"{key} is {value!r}, expected a whole number of pixels")
    return int(value)


def _check_plausible(camera: Camera) -> None:
    _check_focal_lengths(camera)
    _check_mount(camera)
    shares = camera.K[0, 2] / camera.width_px, camera.K[1, 2] / camera.height_px
    if min(shares) < 0.0 or max(shares) >= 1.0:
        where = "outside the picture of"
    elif min(shares) < _MIDDLE[0] or max(shares) > _MIDDLE[1]:
        where = "far from the middle of one (is it of pictures of another size?) of"
    else:
        return
    raise ValueError(
        f"the principal point {camera.K[0, 2]:g}, {camera.K[1, 2]:g} lies {where} "
        f"{camera.width_px} x {camera.height_px} px"
    )


def _check_mount(camera: Camera) -> None:
    aside_rad = math.acos(np.clip(camera.R_body_camera[2, 2], -1.0, 1.0))
    if aside_rad > MAX_OFF_NADIR_RAD:
        raise ValueError(
            f"mount_rpy_deg turns the camera {math.degrees(aside_rad):.0f} degrees away from "
            "straight down, 60 at most; 0, 0, 180 is one that looks down, its top to the tail"
        )


def _check_focal_lengths(camera: Camera) -> None:
    fx_px, fy_px = camera.K[0, 0], camera.K[1, 1]
    longer_px = max(camera.width_px, camera.height_px)
    ratios = (fx_px / longer_px, fy_px / longer_px)
    if not (_FOCAL_RATIOS[0] <= min(ratios) and max(ratios) <= _FOCAL_RATIOS[1]):
        raise ValueError(
            f"focal lengths of {fx_px:g} and {fy_px:g} px in a picture of {longer_px} px, which no "
            "lens has: are they in pixels of this picture?"
        )
    if max(ratios) > _MOST_ASPECT * min(ratios):
        raise ValueError(f"fx_px of {fx_px:g} and fy_px of {fy_px:g}: no pixel is so long")


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
