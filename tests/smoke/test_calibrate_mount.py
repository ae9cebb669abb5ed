"""`vwnav calibrate mount` by the real command, over rendered flights; what it refuses."""

from contextlib import closing

import cv2
import numpy as np
import pytest

from vwnav.bench.mount.recorded import Mounted, record
from vwnav.geometry.calibration import load_camera, load_findings, save_camera
from vwnav.geometry.rotations import vector_from_rotation
from vwnav.recording.input_log import About, InputLog
from vwnav.recording.recorder import Recorder
from vwnav.sim.named_sites import parse_site
from vwnav.sim.renderer import default_camera
from vwnav.types import Attitude


@pytest.fixture
def mount(vwnav, place, tmp_path):
    def run(source, *extra, camera=None):
        out = tmp_path / "mounted.toml"
        done = vwnav(
            "calibrate", "mount", source, "--map", place.pack, "--camera", camera or place.camera,
            "-o", out, *extra, blocked=False, timeout_s=1800.0,
        )  # fmt: skip
        return done, out

    return run


@pytest.mark.long
def test_a_wrongly_mounted_late_and_rolling_camera_is_found_out(mount, place, tmp_path):
    truth = Mounted()
    R_body_camera = record(tmp_path / "flight.mcap", truth, parse_site("sim:default"))
    done, out = mount(tmp_path / "flight.mcap")
    assert done.code == 0, done.err
    assert "lever arm: not told by this flight" in done.err
    camera, found = load_camera(out), load_findings(out)
    turned_deg = np.degrees(vector_from_rotation(R_body_camera @ camera.R_body_camera.T))
    assert np.all(np.abs(turned_deg) < 3.0 * np.array(found["sigma_mount_rpy_deg"]))
    assert np.all(np.abs(turned_deg[:2]) < 0.2)
    for error_s, name in (
        (camera.time_offset_s - truth.offset_s, "sigma_time_offset_s"),
        (camera.readout_s - truth.readout_s, "sigma_readout_s"),
    ):
        assert abs(error_s) < min(3.0 * found[name], 0.002), name


def test_what_tells_nothing_is_refused_in_one_line(mount, place, tmp_path):
    done, out = mount(place.video)
    assert done.code == 1
    assert "give the flight's attitudes with --telemetry" in done.complaint
    done, _ = mount(place.video, "--telemetry", tmp_path / "none.csv")
    assert "no telemetry file" in done.complaint
    heights = tmp_path / "heights.csv"
    heights.write_text("t_s,height_m\n0,10\n1,11\n")
    done, _ = mount(place.video, "--telemetry", heights)
    assert "tells no attitude" in done.complaint
    assert not out.exists()


def test_broken_files_and_a_missing_folder_are_told_in_one_line(vwnav, mount, place, tmp_path):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(bytes(range(256)))
    done, out = mount(broken)
    assert done.code == 1
    assert "not an MCAP file, or it is damaged" in done.complaint
    blind = tmp_path / "blind.mcap"
    with closing(Recorder(blind, {}, image_rate_hz=1.0)) as recorder:
        log = InputLog(recorder, About("learned", "", "nadir", place.frame, None))
        for t_s in (0.0, 0.1, 0.2):
            log.input(Attitude(t_s, np.array([1.0, 0.0, 0.0, 0.0])))
    done, _ = mount(blind)
    assert done.code == 1
    assert "blind.mcap holds no picture" in done.complaint
    assert not out.exists()
    done = vwnav(
        "calibrate", "mount", broken, "--map", place.pack, "--camera", place.camera,
        "-o", tmp_path / "none" / "mounted.toml", blocked=False,
    )  # fmt: skip
    assert done.code == 1
    assert "no folder" in done.complaint


@pytest.mark.long
def test_a_flight_over_another_place_is_refused(mount, place, tmp_path):
    folder = tmp_path / "pictures"
    folder.mkdir()
    noise = np.random.default_rng(3)
    for number in range(30):
        small = noise.integers(0, 255, (60, 80), np.uint8)
        big = cv2.resize(small, (640, 480), interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(folder / f"{number}.png"), big)
    rows = [f"{t},0,0,20,60" for t in range(31)]
    (tmp_path / "t.csv").write_text("\n".join(["t_s,roll_deg,pitch_deg,yaw_deg,agl_m", *rows]))
    done, out = mount(folder, "--telemetry", tmp_path / "t.csv", "--features", "sift")
    assert done.code == 1
    assert "hardly any picture is found on the map" in done.complaint
    assert not out.exists()


def test_too_few_images_with_an_attitude_are_refused(mount, place, tmp_path):
    (tmp_path / "t.csv").write_text("t_s,roll_deg,pitch_deg,yaw_deg\n0,0,0,20\n0.4,0,0,20\n")
    done, _ = mount(place.video, "--telemetry", tmp_path / "t.csv")
    assert done.code == 1
    assert "of 40 pictures have an attitude; 25 are needed" in done.complaint


def test_vwnav_camera_tells_and_draws_what_it_sees(vwnav, place, tmp_path):
    done = vwnav(
        "camera", place.video, "--camera", place.camera, "--height-m", "60", "--features", "sift",
        "-o", tmp_path / "seen.png",
    )  # fmt: skip
    assert done.code == 0, done.err
    px_per_m = default_camera().K[0, 0] / 60.0
    assert f"{px_per_m:.1f} px a metre" in done.out
    assert "10.0 pictures a second" in done.out
    drawn = cv2.imread(str(tmp_path / "seen.png")).astype(int)
    green = (drawn[..., 1] - drawn[..., 0] > 60) & (drawn[..., 1] - drawn[..., 2] > 60)
    assert green.sum() > 2000  # its keypoints, on an image in grey


def test_vwnav_camera_complains_in_one_line(vwnav, place, tmp_path):
    assert "no pictures at" in vwnav("camera", tmp_path / "none").complaint
    save_camera(default_camera().scaled(320, 240), tmp_path / "other.toml")
    done = vwnav("camera", place.video, "--camera", tmp_path / "other.toml", "--seconds", "0.1")
    assert "calibrate at that size" in done.complaint
    done = vwnav("camera", place.video, "--seconds", "0.1", "-o", tmp_path / "seen.pdf")
    assert "give a .jpg or .png" in done.complaint
