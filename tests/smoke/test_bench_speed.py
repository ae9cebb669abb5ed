"""`vwnav bench speed` on one model, quickly, and `replay` and `fly` on the settings it writes."""

import json
from contextlib import ExitStack

import pytest
from smoke_place import read_run

from vwnav.config import load_config
from vwnav.onboard.options import FlyOptions
from vwnav.onboard.plan import plan_flight

QUICK = (
    "--features", "nano_int8", "--threads", "1", "--repeats", "2", "--seconds", "5",
    "--target-hz", "0.5",
)  # fmt: skip


@pytest.fixture(scope="module")
def measured(vwnav, tmp_path_factory):
    """What it said as JSON, and the settings."""
    settings = tmp_path_factory.mktemp("speed") / "board.toml"
    return vwnav("bench", "speed", *QUICK, "--json", "-o", settings), settings


def test_every_resolution_and_budget_is_timed_and_one_is_chosen(measured):
    done, _ = measured
    assert done.code == 0, done.err
    report = json.loads(done.out)
    rows = report["settings"]
    assert len(rows) == 6
    assert {row["features"] for row in rows} == {"nano_int8"}
    assert all(0.0 < row["time"]["p50_ms"] <= row["time"]["p99_ms"] for row in rows)
    assert all(row["time"]["placed"] == 1.0 for row in rows)
    assert all(row["accuracy"]["inliers"] > 10.0 for row in rows)
    chosen = report["chosen"]
    assert chosen["accuracy"]["inliers"] == max(row["accuracy"]["inliers"] for row in rows)
    assert chosen["latency"]["fixes"] >= 2
    assert 0.0 < chosen["latency"]["p50_ms"] <= chosen["latency"]["p99_ms"]
    assert {check["name"] for check in report["after"]} == {"voltage", "throttling", "temperature"}
    assert report["thesis_hz"]["sift"] == "17"


def test_the_projection_is_of_published_rates(measured):
    report = json.loads(measured[0].out)
    first = report["projection"][0]
    assert (first["model"], first["size"], first["is_int8"]) == ("nano_int8", "640x480", True)
    assert first["gmac"] == pytest.approx(0.478, abs=0.001)
    assert first["ms"]["Pi 4"] == pytest.approx(2.0 * first["gmac"] / 30.0 * 1e3, rel=1e-3)
    assert first["ms"]["Pi 5"] == pytest.approx(2.0 * first["gmac"] / 100.0 * 1e3, rel=1e-3)


def test_what_is_written_is_what_was_chosen(measured):
    done, settings = measured
    chosen = json.loads(done.out)["chosen"]
    config = load_config(settings)
    assert (config.features.model, config.features.threads) == ("nano_int8", 1)
    assert config.localizer.max_keypoints == chosen["keypoints"]
    assert config.pipeline.fix_interval_s == chosen["config"]["pipeline"]["fix_interval_s"]
    assert "--model nano_int8" in settings.read_text()
    assert list(settings.parent.iterdir()) == [settings]


def test_a_flight_takes_them(vwnav, measured, place, tmp_path):
    (tmp_path / "route.txt").write_text("1,20,0,50\n")
    bare = tmp_path / "bare.mbtiles"
    assert vwnav("map", "build", place.pack, "-o", bare, "--features", "sift").code == 0
    names = FlyOptions.__dataclass_fields__
    asked = dict.fromkeys(names) | {
        "sim": False, "map_source": str(bare), "route": tmp_path / "route.txt",
        "route_frame": "local", "config_path": measured[1], "home": "60.4,22.5",
    }  # fmt: skip
    with ExitStack() as stack:
        plan = plan_flight(FlyOptions(**asked), stack)
        assert plan.config.features.model == "nano_int8"
        named = plan_flight(FlyOptions(**asked | {"features": "sift"}), stack)
        assert named.config.features.name == "sift"


def test_replay_looks_with_the_model_of_the_settings(vwnav, measured, place, tmp_path):
    asked = ["replay", place.video, "--map", place.pack, "--camera", place.camera, "-o"]
    refused = vwnav(*asked, tmp_path / "nano", "--config", measured[1])
    assert refused.code == 1
    assert "--model nano" in refused.complaint
    other = tmp_path / "int8.toml"
    other.write_text(measured[1].read_text().replace("nano_int8", "default_int8"))
    done = vwnav(*asked, tmp_path / "int8", "--config", other)
    assert done.code == 0, done.err
    assert load_config(tmp_path / "int8" / "config.toml").features.model == "default_int8"
    assert read_run(tmp_path / "int8")["features"] == "learned"


@pytest.mark.parametrize(
    ("asked", "complaint"),
    [
        (["--features", "nanno"], "nano_int8"),
        (["--threads", "99"], "cores"),
        (["-o", "{folder}/none/board.toml"], "folder that exists"),
        (["-o", "{folder}"], "give a file"),
    ],
)
def test_what_cannot_be_measured_is_one_line_before_anything_runs(
    vwnav, tmp_path, asked, complaint
):
    done = vwnav("bench", "speed", *(word.format(folder=tmp_path) for word in asked))
    assert done.code == 1
    assert complaint in done.complaint
    assert done.out == ""
    assert not list(tmp_path.iterdir())


def test_damaged_weights_are_one_line(vwnav, tmp_path):
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"no graph")
    done = vwnav("bench", "speed", "--features", broken, "--json", "-o", tmp_path / "board.toml")
    assert done.code == 1
    assert "broken.onnx is damaged" in done.complaint
    assert not (tmp_path / "board.toml").exists()
