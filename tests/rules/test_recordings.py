"""Recordings against the rules: what the first release broke on real PX4, and how it is told."""

from pathlib import Path

import pytest
from good_flight import good_flight
from typer.testing import CliRunner

from vwnav.__main__ import app
from vwnav.errors import SourceError
from vwnav.recording.recorded_flight_log import recorded_flight_log
from vwnav.recording.recorder import Recorder
from vwnav.rules.rule import check
from vwnav.rules.table import RULES

pytest.importorskip("mcap")

# What each of the three did wrong, and in which order (seconds of the recording).
ESTIMATE_RUNS_AWAY = {
    "estimate speed", "estimate jump", "sigma bounded", "never 5 sigmas wrong",
    "seldom 3 sigmas wrong",
}  # fmt: skip
BROKEN = {
    "px4_attitude_missing": ESTIMATE_RUNS_AWAY,
    "px4_link_cut_5s": ESTIMATE_RUNS_AWAY | {"sigma without fixes"},
    "px4_stopped_20s": ESTIMATE_RUNS_AWAY | {"lost comes back new", "sigma without fixes"},
}
GOOD_UNTIL_S = {"px4_attitude_missing": 160.0, "px4_link_cut_5s": 43.0, "px4_stopped_20s": 42.0}


@pytest.mark.parametrize("name", BROKEN)
def test_flights_of_the_first_release_break_what_they_broke(data_folder: Path, name: str) -> None:
    folder = data_folder / "mavlink" / "vwnav_flights" / name
    if not folder.is_dir():
        pytest.skip(f"no recorded flight at {folder}")
    log = recorded_flight_log(folder / "flight.mcap", folder / "truth.csv")
    broken = {v.rule.name: v.breach for v in check(RULES, log) if v.breach is not None}
    assert set(broken) == BROKEN[name]
    first_s = min(breach.t_s for breach in broken.values()) - log.vehicle[0].t_s
    assert first_s > GOOD_UNTIL_S[name]


def record(path: Path, faster_m_s: float = 0.0) -> Path:
    """The good flight as the recorder keeps it, as far as these topics go."""
    log, recorder = good_flight(), Recorder(path, {})
    for row in log.vehicle[::4]:
        content = {
            "mode": row.mode, "armed": row.armed, "in_air": row.in_air,
            "battery_ratio": row.battery_ratio,
        }  # fmt: skip
        recorder.message("/vehicle", row.t_s, content)
    for at in log.setpoints[::4]:
        north, east, down = at.velocity_ned_m_s
        content = {"north_m_s": north + faster_m_s, "east_m_s": east, "down_m_s": down}
        recorder.message("/setpoint", at.t_s, content)
    for stage in log.phases[1:]:
        recorder.event(stage.t_s, stage.phase.value)
    recorder.close()
    return path


def test_a_good_recording_holds_and_says_what_it_cannot_tell(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["replay", str(record(tmp_path / "flight.mcap")), "--check"])
    assert done.exit_code == 0, done.output
    assert "held" in done.output
    assert "not to be told" in done.output
    assert "no commands" in done.output


def test_a_broken_rule_is_exit_code_1_with_its_time(tmp_path: Path) -> None:
    path = record(tmp_path / "flight.mcap", faster_m_s=10.0)
    done = CliRunner().invoke(app, ["replay", str(path), "--check"])
    assert done.exit_code == 1
    assert "broken" in done.output
    assert "setpoint (14.00, 0.00, 0.00)" in done.output


def test_what_is_no_flight_is_said_in_a_line(tmp_path: Path) -> None:
    Recorder(tmp_path / "empty.mcap", {}).close()
    with pytest.raises(SourceError, match="no telemetry"):
        recorded_flight_log(tmp_path / "empty.mcap")
    record(tmp_path / "flight.mcap")
    for text in ("a,b\n1,2\n", "", "t_s,north_m,east_m,alt_amsl_m\n"):
        (tmp_path / "truth.csv").write_text(text)
        with pytest.raises(SourceError, match="is no truth"):
            recorded_flight_log(tmp_path / "flight.mcap", tmp_path / "truth.csv")


def test_without_check_a_map_is_asked_for() -> None:
    done = CliRunner().invoke(app, ["replay", "flight.mcap"])
    assert done.exit_code == 2
    assert "--map" in done.output
