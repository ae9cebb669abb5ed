"""The verdicts of the thesis' tests, from made-up samples."""

import math
import subprocess
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from vwnav.bench.flights.faults.aircraft import PilotHandsBack, PilotSwitches, RadioOff
from vwnav.bench.flights.live import session
from vwnav.bench.flights.live.session import Simulator
from vwnav.bench.flights.live.whereabouts import ByItself, Eyes
from vwnav.bench.flights.thesis import live
from vwnav.bench.flights.thesis.plots import save_plots
from vwnav.bench.flights.thesis.report import report_on, statistics, steps
from vwnav.bench.flights.thesis.samples import Sample, write_csv
from vwnav.bench.flights.thesis.tests import FAILSAFE, HEIGHT_M, HOVER, WAYPOINTS, in_manners
from vwnav.geometry.geodesy import LocalFrame
from vwnav.vehicle import FlightMode

PLACE = ("north_m", "east_m", "up_m", "yaw_deg")
ON_THE_GROUND = Sample(
    t_s=0.0, mode="HOLD", phase="getting ready", true_north_m=0.0, true_east_m=0.0, true_up_m=0.0,
    true_yaw_deg=179.0, estimated_north_m=math.nan, estimated_east_m=math.nan,
    estimated_up_m=math.nan, estimated_yaw_deg=math.nan, fused_north_m=0.0, fused_east_m=0.0,
    fused_up_m=0.0, fused_yaw_deg=179.0, barometer_up_m=0.0, commanded_yaw_deg=math.nan,
)  # fmt: skip


def hover(hold_s: float = 40.0) -> list[Sample]:
    held = replace(
        ON_THE_GROUND, mode="OFFBOARD", phase="waiting for a fix", true_up_m=HEIGHT_M,
        true_north_m=0.1, estimated_north_m=0.2, estimated_east_m=0.0, estimated_up_m=HEIGHT_M,
        estimated_yaw_deg=-179.0, commanded_yaw_deg=-179.0,
    )  # fmt: skip
    plan = [(ON_THE_GROUND, 5.0), (replace(held, mode="TAKEOFF", phase="taking off"), 5.0)]
    plan += [(held, hold_s), (replace(held, mode="LAND", phase="landing"), 10.0)]
    plan += [(replace(ON_THE_GROUND, mode="LAND", phase="done"), 1.0)]
    samples = [sample for sample, seconds in plan for _ in range(round(10 * seconds))]
    return [replace(sample, t_s=0.1 * i) for i, sample in enumerate(samples)]


def test_a_hover_passes_when_it_was_held_and_came_home():
    assert all(step.passed for step in steps(HOVER, hover()))
    assert not all(step.passed for step in steps(HOVER, hover(hold_s=20.0)))


def test_a_hold_lasts_by_its_times_not_by_how_many_samples_a_busy_machine_took():
    late = [replace(sample, t_s=1.1 * sample.t_s) for sample in hover(hold_s=32.0)]
    assert all(step.passed for step in steps(HOVER, late))
    late = [replace(sample, t_s=1.1 * sample.t_s) for sample in hover(hold_s=29.0)]
    assert not all(step.passed for step in steps(HOVER, late))


def test_errors_are_of_the_hold_and_headings_pass_through_south():
    found = {each.name: each for each in statistics(HOVER, hover())}
    assert found["estimate off the truth"].rms == pytest.approx(0.1)
    assert found["held off the place"].thesis == 0.2
    assert found["heading off the commanded"].largest == pytest.approx(2.0)


def test_modes_must_come_in_the_order_asked_for():
    assert "manual is missing" in steps(FAILSAFE, hover())[0].detail


def test_each_autopilot_flies_the_failsafe_test_in_its_own_modes():
    assert in_manners(FAILSAFE, "px4") == FAILSAFE
    test = in_manners(FAILSAFE, "copter")
    assert test.scenario.setup.manners == "copter"
    assert test.modes == ("OFFBOARD", "MANUAL", "OFFBOARD", "RETURN")
    faults = [type(each.fault) for each in test.scenario.breaks]
    assert faults == [PilotSwitches, PilotHandsBack, RadioOff]  # a stick does not end GUIDED


def test_a_flight_that_never_leaves_the_ground_is_judged_and_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    samples = [replace(ON_THE_GROUND, t_s=0.1 * i) for i in range(50)]
    report = report_on(HOVER, samples, ["not ready to fly"], tmp_path)
    assert not report.passed
    assert all((tmp_path / name).stat().st_size > 100 for name in report.files)


def test_files_are_a_table_and_three_images(tmp_path):
    pytest.importorskip("matplotlib")
    names = save_plots(HOVER, hover(), tmp_path)
    assert names == ["hover_altitude.png", "hover_position.png", "hover_yaw.png"]
    assert all((tmp_path / name).stat().st_size > 1000 for name in names)
    write_csv(hover(), tmp_path / "hover.csv")
    lines = (tmp_path / "hover.csv").read_text().splitlines()
    assert lines[0].startswith("t_s,mode,phase,true_north_m")
    assert lines[1].count(",,") > 0
    assert len(lines) == 1 + len(hover())
    assert np.isfinite(float(lines[1].split(",")[0]))


@dataclass
class Written:
    """A simulator's link, of which only what the program is told is kept."""

    packets: list[bytes] = field(default_factory=list)
    asked: list[FlightMode] = field(default_factory=list)

    def write(self, data: bytes) -> None:
        self.packets.append(data)

    def take_over(self) -> None:
        pass

    def switch_radio_off(self) -> None:
        pass

    def ask(self, mode: FlightMode) -> None:
        self.asked.append(mode)


class ToldFlight:
    """A live flight of which whatever is waited for happens at once."""

    def __init__(self, pilot: Written | None) -> None:
        estimate = mavlink.MAVLink_vision_position_estimate_message(0, 0, 0, 0, 0, 0, 0)
        estimate._header.srcSystem, estimate._header.srcComponent = 1, 197
        self.written = Written()
        self.simulator = object.__new__(Simulator)
        self.simulator.heard = {"VISION_POSITION_ESTIMATE": estimate}
        self.simulator.pilot = pilot  # type: ignore[assignment]
        self.simulator.relay = SimpleNamespace(  # type: ignore[assignment]
            autopilot_link=SimpleNamespace(a=self.written)
        )

    def watch(self, done: object, timeout_s: float) -> bool:
        return True


def test_a_live_pilot_hands_back_by_a_ground_stations_command_to_the_navigator():
    pilot = Written()
    flight = ToldFlight(pilot)
    live._play_the_pilot(flight, pytest.fail)  # type: ignore[arg-type]
    assert pilot.asked == []  # no mode: PX4 takes Offboard from nobody who sends no setpoints
    (packet,) = flight.written.packets
    (told,) = mavlink.MAVLink(None).parse_buffer(bytearray(packet))
    assert (told.target_system, told.target_component, told.param1) == (1, 197, 1.0)
    assert told.command == mavlink.MAV_CMD_DO_PAUSE_CONTINUE
    assert told.get_srcSystem() == 255


def test_a_person_is_told_how_the_aircraft_is_handed_back():
    said: list[str] = []
    live._play_the_pilot(ToldFlight(None), said.append)  # type: ignore[arg-type]
    assert "DO_PAUSE_CONTINUE" in said[1]
    assert "system 1, component 197" in said[1]
    assert "switch to Offboard" not in said[1]


def without_truth(samples: list[Sample]) -> list[Sample]:
    """The same as a link without truth tells it: the autopilot's own position, 0.3 m beside."""
    nothing = dict.fromkeys((f"true_{each}" for each in PLACE), math.nan)
    return [
        replace(
            each, **nothing, fused_north_m=each.true_north_m + 0.3, fused_east_m=each.true_east_m,
            fused_up_m=each.true_up_m + 0.7, fused_yaw_deg=each.true_yaw_deg,
        )
        for each in samples
    ]  # fmt: skip


def test_without_truth_a_flight_is_scored_by_the_autopilot_and_says_so(tmp_path):
    pytest.importorskip("matplotlib")
    report = report_on(HOVER, without_truth(hover()), [], tmp_path, "fused")
    assert report.passed, report.steps
    assert "made of vwnav's estimates: this is consistency, not truth" in report.scored_against
    found = {each.name: each for each in report.statistics}
    own = found["estimate off the autopilot's own position"]
    assert own.rms == pytest.approx(0.2)
    assert all(each.thesis is None for each in report.statistics)  # the thesis' are of GPS
    assert not any("truth" in each.name for each in (*report.steps, *report.statistics))
    assert "landed within 3 m of the start, as the autopilot believes" in [
        step.name for step in report.steps
    ]
    assert report_on(HOVER, hover(), [], tmp_path).scored_against == "the simulator's truth"


def test_an_autopilot_that_never_had_a_position_has_passed_nothing(tmp_path):
    pytest.importorskip("matplotlib")
    nothing = dict.fromkeys((f"fused_{each}" for each in PLACE), math.nan)
    samples = [replace(each, **nothing) for each in without_truth(hover())]
    assert not steps(HOVER, samples, "fused")[1].passed
    assert not steps(WAYPOINTS, samples, "fused")[2].passed
    report_on(HOVER, samples, [], tmp_path, "fused")


def listening() -> Simulator:
    """A simulator without its links."""
    simulator = object.__new__(Simulator)
    simulator.heard, simulator.armed, simulator._stood_z_m = {}, False, 0.0
    simulator.system_id = 0
    return simulator


def heartbeat(armed: bool) -> mavlink.MAVLink_heartbeat_message:
    return mavlink.MAVLink_heartbeat_message(2, 12, 128 * armed, 0, 4, 3)


def test_where_nobody_tells_the_truth_the_autopilots_word_is_taken_about_home():
    home = LocalFrame(60.4, 22.5, 0.0)
    north = LocalFrame(
        *(float(each) for each in home.to_geodetic(np.array([10.0, 0.0, 0.0]))[:2]), 0.0
    )
    simulator = listening()
    eyes = Eyes("a.mbtiles", Path("cam.toml"), "rtsp://camera", "60.4,22.5")
    where = ByItself(eyes, simulator.heard, simulator.own_place_ned_m)
    assert where.reference == "fused"
    assert np.all(np.isnan(where.look(where.frame_here())))
    simulator._hear(heartbeat(armed=False))
    simulator._hear(mavlink.MAVLink_local_position_ned_message(0, 0, 0, -40.3, 0, 0, 0))
    assert where.look(home)[0] == pytest.approx([0.0, 0.0, 0.0])  # PX4's z is of its own origin
    simulator._hear(heartbeat(armed=True))
    simulator._hear(mavlink.MAVLink_local_position_ned_message(0, 1, 2, -70.3, 0.1, 0.2, 0.3))
    place_ned_m, velocity_ned_m_s = where.look(home)
    assert place_ned_m == pytest.approx([1.0, 2.0, -30.0])
    assert velocity_ned_m_s == pytest.approx([0.1, 0.2, 0.3])
    simulator.heard["GPS_GLOBAL_ORIGIN"] = SimpleNamespace(
        latitude=round(north.lat_deg * 1e7), longitude=round(north.lon_deg * 1e7)
    )
    assert where.look(home)[0] == pytest.approx([11.0, 2.0, -30.0], abs=0.05)
    words = where.fly_words()
    assert words[words.index("--video") + 1] == "rtsp://camera"
    assert "--truth" not in words  # nothing is drawn, and it does not arm by itself


def test_what_a_second_autopilot_on_the_link_says_is_not_the_flown_ones():
    simulator = listening()
    for system, armed in ((1, True), (2, False)):
        beat = heartbeat(armed)
        beat._header.srcSystem, beat._header.srcComponent = system, 1
        simulator._hear(beat)
    assert simulator.armed
    assert simulator.system_id == 1


def test_a_program_that_hangs_in_flight_is_not_waited_for_without_end(tmp_path, monkeypatch):
    hangs = (
        "import signal, time; signal.signal(15, signal.SIG_IGN); print(flush=True); time.sleep(40)"
    )
    where = SimpleNamespace(
        reference="fused", fly_words=list, frame_here=lambda: LocalFrame(47.0, 8.0, 0.0)
    )
    simulator = SimpleNamespace(armed=True, where=where, relay=SimpleNamespace(url=""))
    start = subprocess.Popen

    def hanging(_, **more):
        return start([sys.executable, "-c", hangs], **more)

    def until_it_runs(flight, *_):
        while not (flight.folder / "log").stat().st_size:
            time.sleep(0.01)

    monkeypatch.setattr(session.subprocess, "Popen", hanging)
    monkeypatch.setattr(session.LiveFlight, "watch", until_it_runs)
    monkeypatch.setattr(session, "_LANDS_S", 0.1, raising=False)
    began_s = time.monotonic()
    with session.live_flight(simulator, tmp_path, "") as flight:
        pass
    assert time.monotonic() - began_s < 30.0
    assert flight.process.returncode == -9
