"""A model other than the default, named or of `--config`: each command takes it as `fly` does."""

import json
import socket

import pytest

SETTINGS = """[features]
model = "nano_int8"

[localizer]
max_keypoints = 500
max_view_area_px = 78336.0
"""


@pytest.fixture(scope="module")
def nano(vwnav, place, tmp_path_factory):
    """A pack of that model's features, and the settings that name the model."""
    folder = tmp_path_factory.mktemp("nano")
    pack, settings = folder / "nano.mbtiles", folder / "board.toml"
    settings.write_text(SETTINGS)
    done = vwnav(
        "map", "build", place.pack, "-o", pack, "--features", "learned,sift", "--model", "nano_int8"
    )
    assert done.code == 0, done.err
    return pack, settings


@pytest.fixture
def checks(vwnav):
    def run(*words):
        done = vwnav("doctor", *words, "--json")
        return done.code, {each["name"]: each for each in json.loads(done.out)["checks"]}

    return run


def test_calibrate_mount_looks_with_the_model_of_the_settings(vwnav, nano, place, tmp_path):
    pack, settings = nano
    (tmp_path / "t.csv").write_text("t_s,roll_deg,pitch_deg,yaw_deg\n0,0,0,20\n0.4,0,0,20\n")
    asked = [
        "calibrate", "mount", place.video, "--telemetry", tmp_path / "t.csv", "--map", pack,
        "--camera", place.camera, "-o", tmp_path / "mounted.toml",
    ]  # fmt: skip
    for words in (("--config", settings), ("--model", "nano_int8"), ("--features", "sift")):
        assert "25 are needed" in vwnav(*asked, *words).complaint
    refused = vwnav(*asked)
    assert refused.code == 1
    assert "give --model nano" in refused.complaint


def test_doctor_judges_pack_and_time_of_the_model_that_would_fly(checks, nano, place):
    pack, settings = nano
    code, found = checks("--map", pack)
    assert (code, found["map"]["verdict"]) == (3, "FAIL")
    assert "give --model nano" in found["map"]["detail"]
    for words in (("--config", settings), ("--model", "nano_int8")):
        _, found = checks("--map", pack, *words)
        assert found["map"]["verdict"] == "PASS"
        assert "vwnav-learned-nano" in found["learned features"]["detail"]
    _, found = checks("--map", place.pack, "--config", settings)
    assert found["map"]["verdict"] == "FAIL"
    assert "323x242, 500 keypoints" in found["learned features"]["detail"]


def test_doctor_times_what_flies_where_that_is_sift(checks, nano, tmp_path):
    _, found = checks("--map", nano[0], "--features", "sift")
    assert found["map"]["verdict"] == "PASS"
    assert "learned features" not in found
    assert " ms for " in found["sift features"]["detail"]
    _, found = checks("--map", nano[0], "--model", tmp_path / "none.onnx")
    assert found["map"]["verdict"] == "PASS"  # SIFT flies
    assert found["learned features"]["verdict"] == "WARN"
    assert "flying on SIFT" in found["learned features"]["detail"]


def test_fly_tells_of_a_pack_of_another_model_before_it_waits_for_the_link(vwnav, place, tmp_path):
    (tmp_path / "route.txt").write_text("1,20,0,50\n")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    refused = vwnav(
        "fly", "--map", place.pack, "--route", tmp_path / "route.txt", "--home", "60.4,22.5",
        "--camera", place.camera, "--video", place.video, "--model", "nano",
        "--connection", f"udpin://127.0.0.1:{port}", "-o", tmp_path / "run",
    )  # fmt: skip
    assert refused.code == 1
    assert "give --model default" in refused.complaint
    assert not (tmp_path / "run").exists()
