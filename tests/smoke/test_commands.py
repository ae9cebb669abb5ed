"""The real commands on good input, with the workstation's libraries out of reach."""

import csv
import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from smoke_place import FRAMES, read_run

from vwnav.config import load_config
from vwnav.geometry.calibration import load_camera, save_camera
from vwnav.geometry.geodesy import horizontal_distance_m
from vwnav.maps.pack import MapPack
from vwnav.recording.run_folder import COLUMNS


def read_rows(folder):
    with (folder / "trajectory.csv").open() as file:
        return list(csv.DictReader(file))


def errors_m(rows, place):
    return [
        horizontal_distance_m(float(r["lat_deg"]), float(r["lon_deg"]), *truth)
        for r, truth in zip(rows, place.truth_lat_lon_deg, strict=True)
        if r["lat_deg"]
    ]


@pytest.fixture(scope="module")
def replayed(vwnav, place, tmp_path_factory):
    folder = tmp_path_factory.mktemp("replay") / "run"
    done = vwnav("replay", place.video, "--map", place.pack, "--camera", place.camera, "-o", folder)
    return done, folder


def test_replay_without_telemetry_finds_the_place_and_follows_it(replayed, place):
    done, folder = replayed
    assert done.code == 0, done.err
    rows = read_rows(folder)
    assert len(rows) == FRAMES
    errors = errors_m(rows, place)
    assert len(errors) >= FRAMES - 12
    assert np.median(errors) < 1.5


def test_a_recording_that_stalls_is_not_believed_to_stand(vwnav, place, tmp_path):
    """Its last picture had been fixed again and again, 13 m behind, at a sigma of half a metre."""
    shown, images, out = cv2.VideoCapture(str(place.video)), tmp_path / "images", tmp_path / "run"
    images.mkdir()
    pictures = [shown.read()[1] for _ in range(FRAMES)]
    for number, picture in enumerate(pictures):
        stalled = 12 < number < 30
        cv2.imwrite(str(images / f"{number}.png"), pictures[12] if stalled else picture)
    done = vwnav("replay", images, "--map", place.pack, "--camera", place.camera, "-o", out)
    assert done.code == 0, done.err
    rows = read_rows(out)
    off_m = np.array(errors_m(rows, place))
    told = [row for row in rows if row["lat_deg"]]
    sigmas_m = [math.hypot(float(row["sigma_n_m"]), float(row["sigma_e_m"])) for row in told]
    assert np.max(off_m / sigmas_m) < 4.0
    assert np.all(off_m[-6:] < 2.0)


def test_replay_leaves_a_run_folder_that_explains_itself(replayed, place):
    _, folder = replayed
    run = read_run(folder)
    assert run["point"] == "center"
    assert set(run["origin"]) == {"lat_deg", "lon_deg", "alt_amsl_m"}
    assert list(read_rows(folder)[0]) == COLUMNS
    assert read_rows(folder)[0]["t_s"] == "0.0000"
    assert cv2.imread(str(folder / "track.png")) is not None
    stated_m = load_config(folder / "config.toml").ekf.map_stated_sigma_m
    with MapPack.open(place.pack) as pack:  # half of the variance that was given
        assert stated_m == pytest.approx(pack.georeference_sigma_m / np.sqrt(2.0))


def test_the_same_recording_gives_the_same_trajectory(vwnav, place, replayed, tmp_path):
    vwnav(
        "replay", place.video, "--map", place.pack, "--camera", place.camera, "-o", tmp_path / "b"
    )
    first, second = ((f / "trajectory.csv").read_bytes() for f in (replayed[1], tmp_path / "b"))
    assert first == second


def test_a_replay_replays_from_its_own_recording_without_images(vwnav, place, replayed, tmp_path):
    recording = replayed[1] / "flight.mcap"
    done = vwnav("replay", recording, "--map", place.pack, "-o", tmp_path / "b", blocked=False)
    assert done.code == 0, done.err
    assert "byte for byte" in done.err
    first, second = ((f / "trajectory.csv").read_bytes() for f in (replayed[1], tmp_path / "b"))
    assert first == second
    assert read_run(tmp_path / "b")["fixes"] == read_run(replayed[1])["fixes"]


@pytest.mark.parametrize("features", ["learned", "sift"])
def test_replay_with_telemetry_gives_the_nadir(vwnav, place, tmp_path, features):
    done = vwnav(
        "replay", place.video, "--map", place.pack, "--camera", place.camera,
        "--telemetry", place.telemetry, "--features", features, "-o", tmp_path / "r",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert read_run(tmp_path / "r")["point"] == "nadir"
    assert np.median(errors_m(read_rows(tmp_path / "r"), place)) < 1.5


def test_localize_prints_one_json_object_with_the_agreed_fields(vwnav, place):
    lat, lon = place.truth_lat_lon_deg[0]
    done = vwnav(
        "localize", place.image, "--map", place.pack, "--camera", place.camera, "--json",
        "--lat", lat + 0.0002, "--lon", lon, "--sigma-m", 40, "--agl-m", 66, "--yaw-deg", 30,
    )  # fmt: skip
    assert done.code == 0, done.err
    (found,) = (json.loads(line) for line in done.out.splitlines())
    assert found["status"] == "fix"
    assert horizontal_distance_m(found["lat_deg"], found["lon_deg"], lat, lon) < 3.0
    assert set(found) >= {"reason", "sigma_m", "yaw_deg", "agl_m", "inliers", "features", "point"}
    assert set(found["time_ms"]) == {"rectify", "extract", "match", "verify", "total"}


def test_a_rejected_image_is_a_result(vwnav, place, tmp_path):
    cv2.imwrite(str(tmp_path / "black.png"), np.zeros((480, 640), np.uint8))
    done = vwnav(
        "localize", tmp_path / "black.png", "--map", place.pack, "--hfov-deg", 70, "--json"
    )
    found = json.loads(done.out)
    assert done.code == 0
    assert found["status"] == "rejected"
    assert found["reason"]
    assert found["lat_deg"] is None


def test_doctor_and_map_info_speak_json(vwnav, place):
    checks = json.loads(vwnav("doctor", "--map", place.pack, "--json").out)["checks"]
    assert {"PASS", "WARN"} >= {check["verdict"] for check in checks}
    info = json.loads(vwnav("map", "info", place.pack, "--json").out)
    assert {each["name"] for each in info["features"]} == {"learned", "sift"}


def test_doctor_says_whether_anybody_measured_lens_mount_and_read_out(vwnav, place, tmp_path):
    def detail_of(camera):
        checks = json.loads(vwnav("doctor", "--camera", camera, "--json").out)["checks"]
        return next(check["detail"] for check in checks if check["name"] == "calibration")

    bare = tmp_path / "bare.json"
    save_camera(load_camera(place.camera), bare)
    assert "2.0 degrees, 1.7 m" in detail_of(bare)
    assert "vwnav calibrate mount" in detail_of(bare)
    assert "focal length to 1.5 %" in detail_of(bare)
    assert "vwnav calibrate camera" in detail_of(bare)
    assert "read-out not known" in detail_of(bare)
    assert "dates of pictures to 80 ms: nobody measured them" in detail_of(bare)
    found = {"sigma_mount_rpy_deg": [0.1, 0.3, 2.0], "sigma_fx_px": 1.0}
    found["sigma_time_offset_s"] = 0.002
    save_camera(replace(load_camera(bare), readout_s=0.0), tmp_path / "mounted.json", found)
    measured = detail_of(tmp_path / "mounted.json")
    assert "0.3 degrees, 0.3 m" in measured
    assert "dates of pictures to 10 ms" in measured
    assert "calibrate" not in measured


def test_doctor_blames_the_file_that_is_wrong(vwnav, place, tmp_path):
    (tmp_path / "bad.plan").write_text('{"fileType": "Plan"}')
    (tmp_path / "bad.mbtiles").write_bytes(b"no pack")

    def verdicts(pack):
        run = vwnav("doctor", "--map", pack, "--route", tmp_path / "bad.plan", "--json")
        assert run.code == 3
        return {check["name"]: check["verdict"] for check in json.loads(run.out)["checks"]}

    assert (verdicts(place.pack)["map"], verdicts(place.pack)["route"]) == ("PASS", "FAIL")
    broken = verdicts(tmp_path / "bad.mbtiles")
    assert (broken["map"], broken["route"]) == ("FAIL", "FAIL")
    item = {"type": "SimpleItem", "command": 16, "frame": 0, "params": [0, 0, 0, 0, 60.4, 22.5, 90]}
    mission = {"items": [item]}  # above a sea that nobody knows the ground at home by
    (tmp_path / "bad.plan").write_text(json.dumps({"fileType": "Plan", "mission": mission}))
    assert verdicts(place.pack)["route"] == "FAIL"


def test_version_and_help_work_everywhere(vwnav):
    assert vwnav("--version").out.startswith("vwnav ")
    for command in ("fly", "replay", "localize", "map", "doctor"):
        assert vwnav(command, "--help").code == 0
