"""Bad input: one clear line, the right exit code, nothing half-written."""

import shutil
import sqlite3

import cv2
import numpy as np
import pytest
from smoke_place import read_run

from vwnav.geometry.calibration import save_camera
from vwnav.geometry.camera import Camera

NO_LINK = "udpin://127.0.0.1:19733"


@pytest.fixture
def replay(vwnav, place, tmp_path):
    def run(*extra, pack=place.pack, video=place.video, camera=place.camera):
        out = tmp_path / "out"
        done = vwnav("replay", video, "--map", pack, "--camera", camera, "-o", out, *extra)
        return done, out

    return run


def test_a_missing_pack(replay, tmp_path):
    done, out = replay(pack=tmp_path / "none.mbtiles")
    assert done.code == 1
    assert "none.mbtiles" in done.complaint
    assert not out.exists()


def test_a_pack_that_is_cut_off(replay, place, tmp_path):
    broken = tmp_path / "cut.mbtiles"
    broken.write_bytes(place.pack.read_bytes()[: place.pack.stat().st_size // 3])
    done, out = replay(pack=broken)
    assert done.code == 1
    assert "cut.mbtiles" in done.complaint
    assert not out.exists()


def test_a_pack_of_another_model_names_the_command_that_repairs_it(replay, place, tmp_path):
    other = tmp_path / "other.mbtiles"
    shutil.copy(place.pack, other)
    with sqlite3.connect(other) as database:
        names = "SELECT name FROM sqlite_master WHERE type='table'"
        for table in [row[0] for row in database.execute(names)]:
            columns = [r[1] for r in database.execute(f"PRAGMA table_info({table})")]
            if "feature_set_id" in columns and "name" in columns:
                database.execute(
                    f"UPDATE {table} SET feature_set_id = 'vwnav-learned-other-00000000' "
                    "WHERE name = 'learned'"
                )
    done, out = replay(pack=other)
    assert done.code == 1
    assert "vwnav map build" in done.complaint
    assert not out.exists()


def test_a_video_that_ends_in_the_middle_of_a_frame(replay, place, tmp_path):
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(place.video.read_bytes()[:-4000])
    done, _ = replay(video=cut)
    assert done.code == 1
    assert "cut.mp4" in done.complaint


def test_a_recording_that_is_none(vwnav, place, tmp_path):
    (tmp_path / "flight.mcap").write_bytes(b"no recording, but long enough to look at")
    done = vwnav("replay", tmp_path / "flight.mcap", "--map", place.pack, "-o", tmp_path / "out")
    assert done.code == 1
    assert "not an MCAP file" in done.complaint
    assert not (tmp_path / "out").exists()


def test_a_calibration_for_another_image_size(replay, tmp_path):
    save_camera(Camera.from_hfov(1920, 1080, 80.0), tmp_path / "camera.json")
    done, out = replay(camera=tmp_path / "camera.json")
    assert done.code == 1
    assert "1920" in done.complaint
    assert "640" in done.complaint
    assert not out.exists()


def test_no_autopilot_on_the_link(vwnav, place, tmp_path):
    done = vwnav(
        "fly", "--map", place.pack, "--route", _route(tmp_path, "1,20,0,50\n"), "--home",
        "60.4,22.5", "--camera", place.camera, "--video", place.video, "--connection", NO_LINK,
        "-o", tmp_path / "out",
    )  # fmt: skip
    assert done.code == 1
    assert f"waiting for the autopilot on {NO_LINK}" in done.err
    assert f"no autopilot on {NO_LINK} within 20 s" in done.complaint
    assert not (tmp_path / "out" / "trajectory.csv").exists()


@pytest.mark.long
def test_a_service_that_finds_no_autopilot_may_be_tried_again_and_leaves_nothing(
    vwnav, place, tmp_path, monkeypatch
):
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    done = vwnav(
        "fly", "--map", place.pack, "--route", _route(tmp_path, "1,20,0,50\n"), "--home",
        "60.4,22.5", "--camera", place.camera, "--video", place.video, "--connection", NO_LINK,
        "--arm", cwd=tmp_path,
    )  # fmt: skip
    assert done.code == 1
    assert "never arms by itself" in done.err
    assert list((tmp_path / "runs").iterdir()) == []


def test_a_service_that_breaks_again_and_again_leaves_one_folder(
    vwnav, place, tmp_path, monkeypatch
):
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    (tmp_path / "picamera2.py").write_text(
        "class Picamera2:\n    camera_properties = None\n"
        "    def __getattr__(self, _): return lambda *_, **__: None\n"
    )
    for _ in range(2):
        done = vwnav(
            "fly", "--map", place.pack, "--route", _route(tmp_path, "1,20,0,50\n"), "--home",
            "60.4,22.5", "--camera", place.camera, "--video", "picamera2", "--connection", NO_LINK,
            cwd=tmp_path,
        )  # fmt: skip
        assert done.code == 1
        assert "AttributeError" in done.err
    (left,) = (tmp_path / "runs").iterdir()
    assert f"runs/{left.name} keeps why" in done.err
    assert "AttributeError" in (left / "traceback.txt").read_text()


def test_a_route_with_a_nan(vwnav, tmp_path):
    done = vwnav(
        "fly", "--sim", "--route", _route(tmp_path, "1,nan,0,50\n"), "-o", tmp_path / "out"
    )
    assert done.code == 1
    assert "route.txt" in done.complaint
    assert not (tmp_path / "out").exists()


def test_a_map_that_does_not_cover_the_route_is_not_safe_to_fly(vwnav, place, tmp_path):
    done = vwnav(
        "fly", "--sim", "--map", place.pack, "--route", _route(tmp_path, "1,900,0,50\n"), "-o",
        tmp_path / "out",
    )  # fmt: skip
    assert done.code == 3
    assert "does not cover" in done.complaint
    assert not (tmp_path / "out").exists()


def test_a_broken_model_is_said_and_sift_flies_instead(replay, tmp_path):
    (tmp_path / "broken.onnx").write_bytes(b"not a model")
    done, out = replay("--model", tmp_path / "broken.onnx")
    assert done.code == 0, done.err
    assert "SIFT" in done.err
    assert read_run(out)["fixes"] > 0


def test_a_place_that_is_not_on_the_map_is_no_success(replay, tmp_path):
    noise = np.random.default_rng(0)
    writer = cv2.VideoWriter(
        str(tmp_path / "noise.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 10.0, (640, 480)
    )
    for _ in range(4):
        writer.write(noise.integers(0, 255, (480, 640, 3), dtype=np.uint8))
    writer.release()
    done, _ = replay(video=tmp_path / "noise.mp4")
    assert done.code == 1
    assert "none of 4 pictures was located" in done.complaint


def test_an_output_folder_that_holds_a_run_is_not_written_over(replay, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "trajectory.csv").write_text("precious")
    done, out = replay()
    assert done.code == 1
    assert (out / "trajectory.csv").read_text() == "precious"


@pytest.mark.parametrize("arguments", [("fly",), ("replay",), ("localize",), ("map", "build")])
def test_a_command_without_its_arguments_is_a_usage_error(vwnav, arguments):
    assert vwnav(*arguments).code == 2


def test_time_that_waits_is_for_the_embedded_simulation_alone(vwnav, place, tmp_path):
    done = vwnav(
        "fly", "--realtime", "--map", place.pack, "--route", _route(tmp_path, "1,20,0,50\n"),
        "--video", place.video, "--connection", NO_LINK,
    )  # fmt: skip
    assert done.code == 2
    assert "--sim" in done.err


def _route(folder, text):
    path = folder / "route.txt"
    path.write_text(text)
    return path
