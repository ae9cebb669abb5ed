import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.errors import CalibrationError
from vwnav.geometry.calibration import load_camera, load_findings, save_camera
from vwnav.geometry.camera import R_BODY_CAMERA_DOWN, Camera, check_fits
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.geometry.sensor_mode import SensorMode

K = np.array([[500.25, 0.0, 321.5], [0.0, 501.5, 238.25], [0.0, 0.0, 1.0]])
_LEANS = st.tuples(st.floats(-0.75, 0.75), st.floats(-0.75, 0.75))  # together up to 58 degrees
OURS = {
    "width_px": 640,
    "height_px": 480,
    "model": "pinhole",
    "fx_px": 500.0,
    "fy_px": 500.0,
    "cx_px": 319.5,
    "cy_px": 239.5,
}
ROS = """image_width: 640
image_height: 480
camera_name: belly
camera_matrix:
  rows: 3
  cols: 3
  data: [500.25, 0., 321.5, 0., 501.5, 238.25, 0., 0., 1.]
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: {count}
  data: {data}
"""


def opencv_yaml(path: Path, distortion: list[float]) -> Path:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", np.array([distortion]).T)
    storage.release()
    return path


def refused(path: Path) -> str:
    with pytest.raises(CalibrationError) as caught:
        load_camera(path)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 500
    return message


def mounted(roll: float, pitch: float, yaw: float, fisheye: bool) -> Camera:
    return Camera(
        width_px=640,
        height_px=480,
        K=K,
        distortion=(-0.1, 0.01, 1e-4, -1e-4),
        model="fisheye" if fisheye else "pinhole",
        R_body_camera=rotation_from_euler(roll, pitch, yaw) @ R_BODY_CAMERA_DOWN,
        t_body_camera_m=np.array([0.1, 0.0, 0.05]),
    )


@pytest.mark.parametrize("suffix", [".json", ".toml"])
@given(leans=_LEANS, yaw=st.floats(-3.1, 3.1), fisheye=st.booleans())
def test_our_files_give_the_same_camera_back(
    tmp_path_factory: pytest.TempPathFactory,
    suffix: str,
    leans: tuple[float, float],
    yaw: float,
    fisheye: bool,
) -> None:
    path = tmp_path_factory.mktemp("calibration") / f"camera{suffix}"
    camera = mounted(*leans, yaw, fisheye)
    save_camera(camera, path)
    again = load_camera(path)
    assert (again.model, again.distortion) == (camera.model, camera.distortion)
    np.testing.assert_array_equal(again.K, camera.K)
    np.testing.assert_allclose(again.R_body_camera, camera.R_body_camera, atol=1e-7)
    np.testing.assert_array_equal(again.t_body_camera_m, camera.t_body_camera_m)


def test_a_lever_arm_in_millimetres_is_refused(tmp_path: Path) -> None:
    save_camera(mounted(0.0, 0.0, 0.3, False), tmp_path / "c.toml")
    text = (tmp_path / "c.toml").read_text().replace("0.05,", "50.0,").replace("0.1,", "100.0,")
    (tmp_path / "c.toml").write_text(text)
    assert "is it in metres?" in refused(tmp_path / "c.toml")


@pytest.mark.parametrize("suffix", [".json", ".toml"])
def test_a_file_that_an_editor_has_put_a_mark_before_is_read(tmp_path: Path, suffix: str) -> None:
    save_camera(mounted(0.0, 0.0, 0.3, False), tmp_path / f"c{suffix}")
    text = (tmp_path / f"c{suffix}").read_text()
    (tmp_path / f"c{suffix}").write_text(text, encoding="utf-8-sig")
    assert load_camera(tmp_path / f"c{suffix}").width_px == 640


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("c.json", "[" * 100_000),
        ("c.toml", "a = " + "[" * 100_000),
        ("c.yaml", "a: " + "[" * 100_000),  # and these three end OpenCV
        ("c.yaml", "a:\n  " + "- " * 100_000),
        ("c.yaml", "a:" + " b:" * 100_000),
    ],
)
def test_a_file_without_end_to_its_nesting_is_refused(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    assert "not a usable camera calibration" in refused(tmp_path / name)


def test_what_is_no_yaml_is_said_to_be_none(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text("a: [\n")
    assert "(not YAML)" in refused(tmp_path / "c.yaml")


def test_opencv_yaml_is_read(tmp_path: Path) -> None:
    camera = load_camera(opencv_yaml(tmp_path / "c.yml", [-0.2, 0.05, 1e-3, 2e-3, 0.01]))
    np.testing.assert_allclose(camera.K, K)
    assert camera.distortion == pytest.approx((-0.2, 0.05, 1e-3, 2e-3, 0.01))
    assert (camera.width_px, camera.height_px, camera.model) == (640, 480, "pinhole")


def with_lines(path: Path, *lines: str) -> Path:
    """An OpenCV YAML with more keys at its top."""
    head, rest = path.read_text().split("---\n", 1)
    path.write_text(head + "---\n" + "".join(f"{line}\n" for line in lines) + rest)
    return path


@pytest.mark.parametrize(("number", "model"), [(0, "pinhole"), (1, "fisheye")])
def test_the_fisheye_of_opencvs_own_calibration_program_is_one(
    tmp_path: Path, number: int, model: str
) -> None:
    """As samples/cpp/tutorial_code/calib3d/camera_calibration writes it."""
    path = opencv_yaml(tmp_path / "c.yml", [-0.02, 0.005, -0.003, 0.001])
    lines = ("nr_of_frames: 25", "square_size: 50.", "flags: 10", f"fisheye_model: {number}")
    camera = load_camera(with_lines(path, *lines))
    assert camera.model == model
    assert camera.distortion == pytest.approx((-0.02, 0.005, -0.003, 0.001))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("xi: 1.2", "xi"),
        ("camera_model: omni", "omni"),
        ("fisheye_model: 2", "fisheye_model"),
        ("fisheye_model: 1\ndistortion_model: plumb_bob", "contradict"),
        ("camera_model: fisheye\ndistortion_model: radtan", "contradict"),
        ("distortion_model: 3", "distortion_model"),
    ],
)
def test_what_makes_it_another_lens_is_refused(tmp_path: Path, line: str, message: str) -> None:
    path = opencv_yaml(tmp_path / "c.yml", [-0.02, 0.005, -0.003, 0.001])
    assert message in refused(with_lines(path, line))


@pytest.mark.parametrize(
    ("line", "model"),
    [
        ("camera_model: pinhole", "pinhole"),
        ("camera_model: Equidistant", "fisheye"),
        ("camera_model: pinhole\ndistortion_model: equidistant", "fisheye"),  # Kalibr's words
    ],
)
def test_a_model_by_another_key_is_read(tmp_path: Path, line: str, model: str) -> None:
    path = opencv_yaml(tmp_path / "c.yml", [-0.02, 0.005, -0.003, 0.001])
    assert load_camera(with_lines(path, line)).model == model


def test_opencv_yaml_with_unused_higher_coefficients_is_read(tmp_path: Path) -> None:
    camera = load_camera(opencv_yaml(tmp_path / "c.yaml", [-0.2, 0.05, 0, 0, 0.01, 0, 0, 0]))
    assert len(camera.distortion) == 5


def test_higher_distortion_coefficients_are_refused(tmp_path: Path) -> None:
    path = opencv_yaml(tmp_path / "c.yaml", [-0.2, 0.05, 0, 0, 0.01, 0.3, 0, 0])
    assert "k1 k2 p1 p2 k3" in refused(path)


@pytest.mark.parametrize(
    ("ros_model", "data", "model"),
    [
        ("plumb_bob", [-0.2, 0.05, 0.001, 0.002, 0.0], "pinhole"),
        ("equidistant", [0.1, 0.01, 0.0, 0.0], "fisheye"),
    ],
)
def test_ros_camera_info_is_read(
    tmp_path: Path, ros_model: str, data: list[float], model: str
) -> None:
    path = tmp_path / "ost.yaml"
    path.write_text(ROS.format(model=ros_model, count=len(data), data=data))
    camera = load_camera(path)
    assert camera.model == model
    assert camera.distortion == pytest.approx(data)
    np.testing.assert_allclose(camera.K, K)


def test_unknown_ros_model_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "ost.yaml"
    path.write_text(ROS.format(model="division", count=4, data=[0.0] * 4))
    assert "division" in refused(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fx_px": -500.0}, "positive focal"),
        ({"fx_px": float("nan")}, "finite"),
        ({"fx_px": True}, "finite number"),
        ({"fx_px": "500"}, "finite number"),
        ({"distortion": [0.1, float("inf"), 0, 0]}, "finite"),
        ({"distortion": 3}, "list"),
        ({"width_px": 640.5}, "whole number"),
        ({"width_px": 10**30}, "whole number"),
        ({"cx_px": 5000.0}, "outside the picture"),
        ({"model": "magic"}, "pinhole or fisheye"),
        ({"model": ["pinhole"]}, "not a usable"),
        ({"mount_rpy_deg": [0, 0]}, "3 numbers"),
        ({"mount_rpy_deg": [180, 0, 0]}, "180 degrees away from straight down"),
        ({"mount_rpy_deg": [0, 61, 0]}, "61 degrees away from straight down"),
        ({"calibrated": {"sigma_mount_rpy_deg": [0.1]}}, "3 numbers"),
        ({"calibrated": {"sigma_mount_rpy_deg": [0.0, 0.0, 0.1]}}, "sigma of the mount"),
        ({"calibrated": {"sigma_fx_px": "small"}}, "finite number"),
        ({"calibrated": {"sigma_time_offset_s": 3.0}}, "expected a time offset"),
        ({"calibrated": {"sigma_time_offset_s": -0.1}}, "expected a time offset"),
        ({"calibrated": {"sigma_time_offset_s": "small"}}, "finite number"),
        ({"calibrated": {"sigma_focal_ratio": 3.0}}, "sigma of the focal length"),
        ({"calibrated": {"sigma_fx_px": -1.0}}, "sigma_fx_px is -1, expected 0 or more"),
        ({"calibrated": {"sigma_fx_px": 1.0}, "fx_px": 0}, "positive focal"),
        ({"fx_px": 4.4, "fy_px": 4.4}, "are they in pixels"),
        ({"fx_px": 1e9, "fy_px": 1e9}, "are they in pixels"),
        ({"fx_px": 150.0}, "no pixel is so long"),
        ({"width_px": 1920, "height_px": 1440}, "is it of pictures of another size?"),
        ({"focal": 3}, "unknown key focal"),
        ({"readout": 0.02}, "unknown key readout, did you mean readout_s?"),
        ({"sensor_mode": "binned"}, "sensor_mode is no table"),
        ({"sensor_mode": {"size": [1, 1]}}, "unknown key size of sensor_mode"),
        ({"sensor_mode": {"read_px": [1640]}}, "read_px of sensor_mode"),
        ({"sensor_mode": {"read_px": [1640, 0]}}, "read_px of sensor_mode"),
        ({"sensor_mode": {"seen_px": [0, 0, 3280.5, 2464]}}, "seen_px of sensor_mode"),
        ({"sensor_mode": {"seen_px": [-1, 0, 3280, 2464]}}, "seen_px of sensor_mode"),
        ({"sensor_mode": {"bits": True}}, "bits of sensor_mode"),
        ({"sensor_mode": {"sensor": 219}}, "sensor of sensor_mode"),
    ],
)
def test_senseless_values_are_refused_in_one_line(
    tmp_path: Path, change: dict[str, object], message: str
) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(OURS | change))
    assert message in refused(path)


@pytest.mark.parametrize("suffix", [".json", ".toml"])
@pytest.mark.parametrize(
    "mode",
    [
        None,
        SensorMode(sensor="imx219", read_px=(1640, 1232), bits=10, seen_px=(0, 0, 3280, 2464)),
        SensorMode(pixels="MJPG"),
    ],
)
def test_the_mode_of_the_sensor_is_kept_with_its_findings(
    tmp_path: Path, suffix: str, mode: SensorMode | None
) -> None:
    path = tmp_path / f"camera{suffix}"
    save_camera(replace(mounted(0.0, 0.0, 0.3, False), sensor_mode=mode), path, {"views": 20})
    assert load_camera(path).sensor_mode == mode
    assert load_findings(path) == {"views": 20}


def test_how_sure_the_mount_is_comes_from_its_calibration(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(OURS))
    assert load_camera(path).sigma_mount_rad == pytest.approx(math.radians(2.0))
    save_camera(load_camera(path), path, {"sigma_mount_rpy_deg": [0.1, 0.3, 2.0]})
    assert load_camera(path).sigma_mount_rad == pytest.approx(math.radians(0.3))


@pytest.mark.parametrize(("told_s", "sigma_s"), [(None, 0.08), (0.03, 0.03), (0.001, 0.01)])
def test_how_sure_its_dates_are_comes_from_its_calibration_and_the_next_flight(
    tmp_path: Path, told_s: float | None, sigma_s: float
) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(OURS))
    found = {} if told_s is None else {"sigma_time_offset_s": told_s}
    save_camera(load_camera(path), path, found)
    assert load_camera(path).sigma_time_offset_s == pytest.approx(sigma_s)


@pytest.mark.parametrize(
    ("found", "sigma"),
    [
        ({}, 0.015),  # as data sheets go
        ({"sigma_fx_px": 0.01 * OURS["fx_px"]}, 0.01),
        ({"sigma_fx_px": 0.01 * OURS["fx_px"], "sigma_focal_ratio": 0.004}, 0.004),
        ({"sigma_fx_px": 1e-9}, 0.001),  # it warms, and is focused
    ],
)
def test_how_sure_the_focal_length_is_comes_from_its_calibrations(
    tmp_path: Path, found: dict[str, float], sigma: float
) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(OURS))
    save_camera(load_camera(path), path, found)
    assert load_camera(path).sigma_focal_ratio == pytest.approx(sigma)


def test_missing_value_is_named(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({k: v for k, v in OURS.items() if k != "cy_px"}))
    assert "cy_px" in refused(path)


@pytest.mark.parametrize("suffix", [".json", ".toml", ".yaml"])
@pytest.mark.parametrize(
    "content", [b"", b"{", b"[1, 2]", b"\xff\xfe\x00", b"camera_matrix: [", b"a" * 999]
)
def test_damaged_files_are_refused_in_one_line(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"camera{suffix}"
    path.write_bytes(content)
    refused(path)


@given(cut=st.integers(0, 400))
def test_a_file_cut_anywhere_is_refused(tmp_path_factory: pytest.TempPathFactory, cut: int) -> None:
    folder = tmp_path_factory.mktemp("cut")
    text = opencv_yaml(folder / "whole.yaml", [-0.2, 0.05, 0.0, 0.0, 0.01]).read_text()
    path = folder / "cut.yaml"
    path.write_text(text[: min(cut, text.rindex("data"))])
    refused(path)


def test_missing_file_wrong_kind_and_huge_file_are_refused(tmp_path: Path) -> None:
    assert "cannot read" in refused(tmp_path / "none.json")
    (tmp_path / "camera.txt").write_text("")
    assert ".toml" in refused(tmp_path / "camera.txt")
    (tmp_path / "camera.json").write_text(" " * 2_000_000)
    assert "1 MB" in refused(tmp_path / "camera.json")


def test_calibration_for_other_images_is_refused() -> None:
    camera = Camera.from_hfov(640, 480, 60.0)
    check_fits(camera, 640, 480)
    with pytest.raises(CalibrationError, match="640 x 480 px but they are 1280 x 720"):
        check_fits(camera, 1280, 720)


def test_only_our_own_kinds_are_written(tmp_path: Path) -> None:
    camera = Camera.from_hfov(640, 480, 60.0)
    with pytest.raises(CalibrationError, match=r"use \.json or \.toml"):
        save_camera(camera, tmp_path / "camera.yaml")
    with pytest.raises(CalibrationError, match="cannot write"):
        save_camera(camera, tmp_path / "nowhere" / "camera.json")
