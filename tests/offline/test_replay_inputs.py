"""A flight replays from its own recording to the last bit; what cannot be replayed says why."""

import csv
import json
import math
import shutil
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner
from vehicles import FLYING

from vwnav.__main__ import app
from vwnav.assemble import Assembled, about_run, ground_of
from vwnav.clock import WallClock
from vwnav.config import Config
from vwnav.errors import MapError, SourceError
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.ekf import Ekf
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler
from vwnav.maps.build.builder import BuildOptions, build_pack
from vwnav.maps.build.raster import array_source, local_georeference
from vwnav.maps.heights import HeightGrid
from vwnav.maps.pack import MapPack
from vwnav.mission.mission import FlightEnd, Phase
from vwnav.offline.replay_inputs import Player
from vwnav.offline.report import ReplayRecord
from vwnav.onboard.record import FlightRecord
from vwnav.pipeline import Pipeline
from vwnav.recording.input_log import About, ImageSeen, InputLog, read_input_log
from vwnav.recording.reader import read_recording
from vwnav.recording.recorder import Recorder, plain
from vwnav.runtime import FlightRuntime
from vwnav.safety.camera_watch import CameraWatch
from vwnav.safety.estimate_guard import EstimateGuard
from vwnav.seams import FeatureChoice, GuardedWatcher
from vwnav.types import (
    Attitude,
    Frame,
    Height,
    ImuSample,
    MapFix,
    OdometryMotion,
    Range,
    Rejected,
    RejectReason,
)
from vwnav.vehicle import VelocitySetpoint

HOME = LocalFrame(60.4, 22.5, 30.0)
FIRST_RELEASE = Path(__file__).with_name("first_release.mcap")
FLIGHT_TICKS = 60  # 3 s at least, and ...
FLIGHT_LOOKS = 15  # ... as long as so many images take to be matched, on a busy machine
MOST_TICKS = 6000  # some minutes more: images whose steps all raise are never matched
SPEED_M_S = 5.0


class Link:
    """An aircraft 50 m up that flies north and sways."""

    def state(self):
        now_s = time.monotonic()
        sway = rotation_from_euler(0.05 * np.sin(3.0 * now_s), 0.02, 0.1)
        attitude = Attitude(now_s, quat_from_rotation(sway))
        # Not armed: the guard lets everything pass as the filter has it.
        return replace(FLYING, t_s=now_s, armed=False, attitude=attitude, height_t_s=now_s)

    def step(self, t_s):
        pass

    def take_orders(self):
        return (), ()

    def take_measurements(self):
        """Attitude, height, range, and three IMU samples in each 20 ms, which feel the swaying."""
        state = self.state()
        now_s = state.t_s
        imu = (
            ImuSample(t_s, np.array([0.1 * np.sin(9.0 * t_s), 0.0, -9.8]), np.full(3, 0.01), 0.006)
            for t_s in (now_s - 0.012, now_s - 0.006, now_s)
        )
        return (state.attitude, *imu, Height(now_s, 50.0), Range(now_s, 50.0))

    def send_estimate(self, estimate):
        pass


@dataclass
class Mission:
    localizer: "Localizer"
    ticks: int = FLIGHT_TICKS
    end: FlightEnd | None = None
    phase: Phase = Phase.ROUTE
    setpoint: VelocitySetpoint | None = None

    def tick(self, t_s, navigation):
        self.ticks -= 1
        self.setpoint = VelocitySetpoint(SPEED_M_S, 0.0, 0.0, 0.01 * self.ticks)
        looked = self.localizer.tries >= FLIGHT_LOOKS
        if self.ticks <= 0 and (looked or self.ticks < -MOST_TICKS):
            self.end = FlightEnd(None)


@dataclass
class Localizer:
    """Late fixes, each fourth of them a rejection, and each third one found by correlation."""

    began_s: float
    tries: int = 0

    def localize(self, frame, prior, seed):
        time.sleep(0.08)
        self.tries += 1
        if self.tries % 4 == 0:
            return Rejected(frame.t_s, RejectReason.FEW_INLIERS, "3 of 9", "learned")
        north_m = SPEED_M_S * (frame.t_s - self.began_s) + 0.3 * np.sin(self.tries)
        lat_deg, lon_deg, _ = HOME.to_geodetic(np.array([north_m, 1.0, -50.0]))
        fix = MapFix(
            frame.t_s, float(lat_deg), float(lon_deg), 0.3 * np.eye(2), 0.1, 0.02, 50.2, 1.0,
            "nadir", "learned",
        )  # fmt: skip
        if self.tries % 3 == 0:
            nothing = dict.fromkeys(("yaw_rad", "sigma_yaw_rad", "agl_m", "sigma_agl_m"))
            return replace(fix, **nothing, placed_by="correlation")
        return fix


@dataclass
class Odometry:
    last_s: float | None = None
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))
    readout_s: tuple[float, float] = (0.0, 0.015)

    def step(self, frame, R_ned_body, agl_m):
        before_s, self.last_s = self.last_s, frame.t_s
        if before_s is None:
            return Rejected(frame.t_s, RejectReason.FEW_KEYPOINTS)
        way = np.array([SPEED_M_S * (frame.t_s - before_s), 0.0, 0.0]) + 0.03 * self.rng.normal()
        return OdometryMotion(before_s, frame.t_s, way, 0.003 * np.eye(3), 0.0, 0.01, agl_m, 80)


class Images:
    def __init__(self):
        self.count = 0

    def next_frame(self):
        time.sleep(0.03)
        self.count += 1
        noise = np.random.default_rng(self.count).integers(0, 255, (48, 64), dtype=np.uint8)
        return Frame(time.monotonic(), noise, self.count)


def make_pack(path: Path, hill_m: float) -> Path:
    """200 m of nothing around home, with a slope in its terrain heights."""
    slope = np.linspace(0.0, hill_m, 20, dtype=np.float32).reshape(20, 1).repeat(20, 1)
    heights = HeightGrid((60.39, 22.48, 60.41, 22.52), 30.0 + slope)
    image = np.random.default_rng(0).integers(20, 200, (400, 400, 3), dtype=np.uint8)
    source = array_source(image, local_georeference(HOME, (100.0, -100.0), 0.5), name="place")
    build_pack([source], path, [], BuildOptions(heights=heights))
    return path


@pytest.fixture(scope="module")
def pack_file(tmp_path_factory):
    return make_pack(tmp_path_factory.mktemp("pack") / "place.mbtiles", 9.0)


@pytest.fixture(scope="module")
def flown(pack_file, tmp_path_factory) -> Path:
    """The folder of a flight of three seconds or more, with all its threads."""
    folder = tmp_path_factory.mktemp("flight")
    config = Config()
    with MapPack.open(pack_file) as pack, ThreadPoolExecutor(1) as executor:
        ekf = Ekf(config.ekf, ground_of(pack, HOME))
        began_s = time.monotonic()
        localizer = Localizer(began_s)
        choice = FeatureChoice(localizer, None, config.pipeline, print)
        pipeline = Pipeline(choice, Odometry(), ekf, HOME, 0.02, config.pipeline, executor)
        assembled = Assembled(pipeline, ekf, pack, SimpleNamespace(feature_set_id="fake"))
        about = about_run(assembled, "learned", "nadir")
        record = FlightRecord(folder, about, pack, config, None, WallClock())
        ekf.record(record.input_log.input)
        above_m = np.array([0.0, 0.0, -50.0])
        ekf.initialise(
            Start(t_s=began_s, position_ned_m=above_m, agl_m=50.0, sigma_velocity_m_s=9.0)
        )
        mission = Mission(localizer)
        record.follow(mission, pipeline)
        runtime = FlightRuntime(
            pipeline, mission, Link(), EstimateGuard(), SimpleNamespace(report=None),
            CameraWatch(64, 48), GuardedWatcher(record), deque(),
        )  # fmt: skip
        runtime.run(Images(), WallClock())
        assert localizer.tries >= FLIGHT_LOOKS
        record.close(SimpleNamespace(sim=False), pipeline, pack.name)
    return folder


def interrupt(*_args) -> None:
    raise KeyboardInterrupt


def replay(recording: Path, pack: Path, out: Path):
    return CliRunner().invoke(app, ["replay", str(recording), "--map", str(pack), "-o", str(out)])


def rows(path: Path) -> list[str]:
    return path.read_text().splitlines()


def test_a_flight_replays_to_the_identical_trajectory(flown, pack_file, tmp_path):
    done = replay(flown / "flight.mcap", pack_file, tmp_path / "out")
    assert done.exit_code == 0, done.output
    first, again = (folder / "trajectory.csv" for folder in (flown, tmp_path / "out"))
    assert first.read_bytes() == again.read_bytes()
    assert len(rows(first)) > 10
    assert any(",fix," in row for row in rows(first))
    assert all(row.rsplit(",", 1)[1] for row in rows(first)[10:])  # commanded yaw
    assert "identical to" in done.stderr
    assert "byte for byte" in done.stderr
    run, flight = (json.loads((f / "run.json").read_text()) for f in (tmp_path / "out", flown))
    assert run["identical"] is True
    assert all(run[key] == flight[key] for key in ("frames", "attempts", "fixes", "origin"))
    assert (tmp_path / "out" / "track.png").stat().st_size > 1000


def test_a_recording_of_the_first_release_replays(pack_file, tmp_path):
    """Five seconds, written by 0.1.0's recorder beside its filter, with images of 64 x 48 px.

    The place is the present filter's: since slopes teach no tilt it ends 0.20 m from where it did,
    and 0.68 m since an aircraft flies for as long as its IMU's clock says: here by 6 ms a sample,
    three of them in the 20 ms that the dates are apart. By 0.07 m since a camera's turn is a state,
    0.34 m since the first heading by a fix is believed by half until another says the same, and
    0.21 m since a tilt error of the autopilot's stays in NED while the aircraft turns.
    """
    done = replay(FIRST_RELEASE, pack_file, tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "recorded by vwnav 0.1.0" in done.stderr
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert (run["frames"], run["attempts"], run["fixes"]) == (74, 22, 5)
    with (tmp_path / "out" / "trajectory.csv").open() as file:
        *_, last = csv.DictReader(file)
    end_ned_m = [float(last[name]) for name in ("north_m", "east_m", "down_m")]
    assert math.dist(end_ned_m, (25.053, 1.005, -50.018)) < 0.05


def test_not_only_the_rounded_rows_but_every_bit_of_the_estimates_comes_back(flown, pack_file):
    with MapPack.open(pack_file) as pack:
        ekf = Ekf(Config().ekf, ground_of(pack, HOME))
        told = [
            seen for seen in read_input_log(flown / "flight.mcap") if type(seen) is not ImageSeen
        ]
        again = [plain(estimate) for estimate in map(ekf.take, told) if estimate is not None]
    in_flight = [
        record.content for record in read_recording(flown / "flight.mcap", frozenset({"/estimate"}))
    ]
    assert len(in_flight) > 5
    assert all(estimate in again for estimate in in_flight)


def test_the_ground_of_the_map_entered_the_filter(flown, pack_file, tmp_path, monkeypatch):
    """Or the check of the map would be idle: without it the trajectory is another."""
    monkeypatch.setattr("vwnav.offline.replay_inputs.ground_of", lambda *_: None)
    done = replay(flown / "flight.mcap", pack_file, tmp_path / "out")
    assert done.exit_code == 0
    assert "NOT identical" in done.stderr


def test_a_trajectory_that_differs_is_said_with_its_first_time(flown, pack_file, tmp_path):
    shutil.copy(flown / "flight.mcap", tmp_path)
    lines = rows(flown / "trajectory.csv")
    lines[7] = lines[7].replace(",", ",1", 1)
    (tmp_path / "trajectory.csv").write_bytes("".join(f"{line}\r\n" for line in lines).encode())
    done = replay(tmp_path / "flight.mcap", pack_file, tmp_path / "out")
    assert done.exit_code == 0
    t_s = lines[7].split(",")[0]
    flown_csv = tmp_path / "trajectory.csv"
    assert f"NOT identical to {flown_csv}: differs from t_s {t_s} on" in done.stderr


def test_a_flight_that_crashed_replays_as_far_as_its_recording_goes(flown, pack_file, tmp_path):
    whole = (flown / "flight.mcap").read_bytes()
    (tmp_path / "flight.mcap").write_bytes(whole[: int(0.6 * len(whole))])
    shutil.copy(flown / "trajectory.csv", tmp_path / "trajectory.csv.part")
    done = replay(tmp_path / "flight.mcap", pack_file, tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "breaks off" in done.stderr
    assert "as far as the recording goes" in done.stderr
    again = rows(tmp_path / "out" / "trajectory.csv")
    assert 5 < len(again) < len(rows(flown / "trajectory.csv"))


def test_the_folder_of_a_crashed_flight_is_not_written_over(flown, pack_file, tmp_path):
    shutil.copy(flown / "flight.mcap", tmp_path)
    (tmp_path / "trajectory.csv.part").write_text("precious")
    done = replay(tmp_path / "flight.mcap", pack_file, tmp_path)
    assert "already holds a run" in str(done.exception)
    assert (tmp_path / "trajectory.csv.part").read_text() == "precious"


def test_a_folder_that_cannot_be_had_is_refused_before_the_work(
    flown, pack_file, tmp_path, monkeypatch
):
    (tmp_path / "trajectory.csv").write_text("precious")
    monkeypatch.setattr(Player, "play", interrupt)
    done = replay(flown / "flight.mcap", pack_file, tmp_path)
    assert "already holds a run" in str(done.exception)
    done = replay(flown / "flight.mcap", pack_file, pack_file / "out")
    assert f"{pack_file} is no folder that may be written" in str(done.exception)


def test_an_interrupted_replay_leaves_nothing_and_can_be_asked_for_again(
    flown, pack_file, tmp_path, monkeypatch
):
    out = tmp_path / "out"
    out.mkdir()
    (out / "config.toml").write_text("somebody's")
    with monkeypatch.context() as during:
        during.setattr(ReplayRecord, "add", interrupt)
        assert replay(flown / "flight.mcap", pack_file, out).exit_code != 0
    assert [each.name for each in out.iterdir()] == ["config.toml"]
    done = replay(flown / "flight.mcap", pack_file, out)
    assert done.exit_code == 0, done.output


def test_another_map_is_refused(flown, tmp_path):
    other = make_pack(tmp_path / "other.mbtiles", 9.5)
    done = replay(flown / "flight.mcap", other, tmp_path / "out")
    assert isinstance(done.exception, MapError)
    assert "other.mbtiles is another map" in str(done.exception)
    assert not (tmp_path / "out").exists()


def about() -> About:
    return About("learned", "fake", "nadir", HOME, None)


def record_nothing(path: Path, config: dict, input_log: bool) -> Path:
    recorder = Recorder(path, config)
    if input_log:
        InputLog(recorder, about())
    recorder.close()
    return path


SETTINGS = Config().model_dump(mode="json")


@pytest.mark.parametrize(
    ("config", "input_log", "why"),
    [
        (SETTINGS, False, "holds no filter inputs"),
        (SETTINGS, True, "broke off before the first picture"),
        ({"ekf": SETTINGS["ekf"] | {"swing_m": 1.0}}, True, r"other settings \(swing_m\)"),
        ({"ekf": SETTINGS["ekf"] | {"history_s": "long"}}, True, "settings of the filter"),
        ({}, True, "no settings of the filter"),
    ],
)
def test_what_cannot_be_replayed_says_why(pack_file, tmp_path, config, input_log, why):
    path = record_nothing(tmp_path / "flight.mcap", config, input_log)
    done = replay(path, pack_file, tmp_path / "out")
    with pytest.raises(SourceError, match=why):
        raise done.exception
    assert not (tmp_path / "out").exists()


def test_a_recording_older_than_a_setting_replays_with_its_default(pack_file, tmp_path):
    older = {"ekf": {name: value for name, value in SETTINGS["ekf"].items() if name != "ahead_s"}}
    path = record_nothing(tmp_path / "flight.mcap", older, True)
    done = replay(path, pack_file, tmp_path / "out")
    assert "whose filter lacked ahead_s: defaults" in done.stderr
    assert "broke off before the first picture" in str(done.exception)


def test_an_input_that_breaks_the_filter_ends_its_replay_no_more_than_the_flight(
    flown, pack_file, tmp_path, monkeypatch
):
    monkeypatch.setattr(Ekf, "_handle_odometry", lambda *_: 1 / 0)
    done = replay(flown / "flight.mcap", pack_file, tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "the filter broke on an input" in done.stderr
    assert len(rows(tmp_path / "out" / "trajectory.csv")) == len(rows(flown / "trajectory.csv"))


@pytest.mark.parametrize("seed", range(24))
def test_damage_of_any_kind_is_one_clear_error_or_none(flown, pack_file, tmp_path, seed):
    rng = np.random.default_rng(seed)
    damaged = np.frombuffer((flown / "flight.mcap").read_bytes(), np.uint8).copy()
    at = rng.integers(0, len(damaged)) if seed else 0
    damaged[at : at + 1 + 40 * (seed % 2)] ^= np.uint8(rng.integers(1, 256))
    (tmp_path / "flight.mcap").write_bytes(damaged.tobytes())
    done = replay(tmp_path / "flight.mcap", pack_file, tmp_path / "out")
    assert done.exception is None or isinstance(done.exception, SourceError), done.exception
