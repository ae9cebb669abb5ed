"""Faults do to bytes and images what they say, and the table holds what it must."""

import math
import random
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pymavlink.dialects.v20 import development as mavlink

from vwnav.bench.flights import fly as flying
from vwnav.bench.flights import lockstep_place
from vwnav.bench.flights.blame import blamed_wrongly
from vwnav.bench.flights.faults import camera, light, link, telemetry
from vwnav.bench.flights.judge import judge
from vwnav.bench.flights.live.campaign import live_rows
from vwnav.bench.flights.log import flight_log as log_of
from vwnav.bench.flights.rows import draw_failure, timeline_of
from vwnav.bench.flights.scenario import Flown, Scenario
from vwnav.bench.flights.stage import LINK_LATENCY_S
from vwnav.bench.flights.table import (
    FAMILIES,
    QUICK,
    TABLE,
    drawn_rows,
    family_of,
    manual,
    row_of,
    rows_named,
)
from vwnav.bench.flights.table.manners import in_manners
from vwnav.bench.flights.track import FlightTrace, LogLine, Truth
from vwnav.cli.flighttest import fly_row
from vwnav.geometry.geodesy import LocalFrame
from vwnav.mission.mission import Phase
from vwnav.rules import flight_log
from vwnav.rules.belief import estimate_sigmas
from vwnav.rules.flight_log import Sent
from vwnav.sim.memory_link import MemoryLink
from vwnav.sim.processor import SimulatedClock
from vwnav.types import Frame
from vwnav.vehicle import FlightMode

PACKER = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
DOCS = Path(__file__).resolve().parents[2] / "docs" / "flying.md"


def altered(fault: telemetry.Altered, message: mavlink.MAVLink_message) -> mavlink.MAVLink_message:
    tap = telemetry.altering(fault.numbers, fault.change)
    ((delay_s, packet),) = tap(message.pack(PACKER))
    assert delay_s == 0.0
    return mavlink.MAVLink(None).decode(bytearray(packet))


def attitude(yaw_rad: float) -> mavlink.MAVLink_message:
    return mavlink.MAVLink_attitude_message(1000, 0.1, 0.2, yaw_rad, 0.0, 0.0, 0.0)


def frame(index: int = 0) -> Frame:
    image = np.random.default_rng(index).integers(0, 256, (480, 640), np.uint8)
    return Frame(0.1 * index, image, index)


def test_headings_are_turned_and_stay_headings():
    message = altered(telemetry.turned(math.radians(30.0)), attitude(math.pi - 0.1))
    assert message.yaw == pytest.approx(-math.pi - 0.1 + math.radians(30.0), abs=1e-6)
    assert message.roll == pytest.approx(0.1)


def test_other_messages_pass_as_they_are():
    heartbeat = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(PACKER)
    tap = telemetry.altering((telemetry.ATTITUDE,), telemetry.level().change)
    assert list(tap(heartbeat)) == [(0.0, heartbeat)]


def test_an_imu_on_its_side_feels_gravity_to_the_right():
    imu = mavlink.MAVLink_highres_imu_message(
        1, 0.0, 0.0, -9.8, 0.1, 0.2, 0.3, 0, 0, 0, 1000.0, 0, 0, 20.0, 63
    )
    message = altered(telemetry.imu_on_its_side(), imu)
    assert (message.yacc, message.zacc) == pytest.approx((-9.8, 0.0))
    assert (message.ygyro, message.zgyro) == pytest.approx((0.3, -0.2))


@pytest.mark.parametrize(
    "make",
    [light.sun_glare, camera.half_covered, camera.out_of_focus, camera.upside_down,
     camera.repeating_ground, light.overexposed, light.exposure_following],
)  # fmt: skip
def test_poor_images_keep_size_and_time(make):
    seen = make()(frame(3))
    assert seen.image.shape == (480, 640)
    assert seen.image.dtype == np.uint8
    assert seen.t_s == frame(3).t_s
    assert not np.array_equal(seen.image, frame(3).image)


def test_a_loop_shows_ten_images_again_in_their_order():
    loop = camera.looping()
    seen = [loop(frame(i)) for i in range(25)]
    for i in (10, 19, 24):
        assert np.array_equal(seen[i].image, frame(i % 10).image)
        assert seen[i].t_s == frame(i).t_s


def test_bursts_are_eight_of_twenty():
    drop = camera.bursts_dropped()
    assert sum(drop(frame(i)) is None for i in range(40)) == 16


def test_the_table_has_families_and_no_name_twice():
    names = [row.name for row in TABLE]
    assert len(set(names)) == len(names) >= 40
    assert set(names) >= QUICK
    assert all(family_of(row) in FAMILIES for row in TABLE)
    assert [row.name for row in rows_named(["BATTERY low"])] == ["battery low"]
    assert rows_named([]) == TABLE


def test_drawn_flights_are_the_same_each_time_and_have_the_faults_of_several_rows():
    rows = drawn_rows(60, 5)
    names = [row.name for row in rows]
    assert len(set(names)) == 60
    assert names[0].startswith("drawn 5: ")
    assert {row.name for row in drawn_rows(10, 10)} <= set(names)
    for row in rows[:20]:
        again = row_of(row.name)
        assert (again.name, again.breaks, again.setup.seed) == (
            row.name, row.breaks, row.setup.seed,
        )  # fmt: skip
    mixed = [row.name.split(": ", 1)[1].rsplit(", ", 1)[0].split(" + ") for row in rows]
    assert {len(parts) for parts in mixed} == {2, 3, 4}
    table = {row.name: row for row in TABLE}
    for row, parts in zip(rows, mixed, strict=True):
        assert family_of(row) == "drawn"
        assert len({family_of(table[name]) for name in parts[:2]}) == 2
        assert len(row.breaks) == sum(len(table[name].breaks) for name in parts)
        at_times = [each for each in row.breaks if each.phase is None and not each.armed]
        assert list(row.breaks[: len(at_times)]) == at_times  # what waits may never come
        times_s = [each.at_s for each in at_times]
        assert times_s == sorted(times_s)
        assert all(each.at_s >= 0.0 for each in row.breaks)


def test_drawn_flights_begin_everywhere_and_have_persons_and_what_waits_for_a_phase():
    rows = drawn_rows(500, 0)
    starts = {None if row.setup.start is None else row.setup.start.phase for row in rows}
    assert starts == {None, Phase.CLIMB, Phase.ROUTE, Phase.RETURN, Phase.DESCEND}
    waits = {each.phase for row in rows for each in row.breaks}
    assert waits >= {Phase.TAKEOFF, Phase.LAND}
    for words in ("pilot takes over", "hands back", "the ground station", "link cut for 3 s"):
        assert any(words in row.name for row in rows)
    for row in rows:
        from_ground = [row_of(name).setup.start is None for name in parts_of(row)]
        assert row.setup.start is None or not any(from_ground)


def parts_of(row: Scenario) -> list[str]:
    return row.name.split(": ", 1)[1].rsplit(", ", 1)[0].split(" + ")


def test_faults_that_overlap_are_both_there_and_each_ends_alone():
    """The second took the place of the first, and the end of one ended both."""
    clock = SimulatedClock()
    stage = SimpleNamespace(
        autopilot_link=MemoryLink(clock, random.Random(1)), camera=SimpleNamespace(troubles={})
    )
    stage.autopilot_link.a_to_b.latency_s = LINK_LATENCY_S
    turned, late = telemetry.turned(0.5), telemetry.TelemetryLate(0.3, (telemetry.ATTITUDE,))
    cuts, slow = (link.LinkCut(), link.LinkCut()), link.RoundTrip(0.2)
    for fault in (turned, late, slow, *cuts):
        fault.begin(stage)

    def arrives() -> tuple[float, float] | None:
        stage.autopilot_link.a.write(attitude(0.1).pack(PACKER))
        for step in range(1000):
            clock.now_s += 0.001
            if data := stage.autopilot_link.b.read():
                yaw_rad = mavlink.MAVLink(None).decode(bytearray(data)).yaw
                return round(0.001 * (step + 1), 3), round(yaw_rad, 3)
        return None

    assert arrives() is None
    cuts[0].end(stage)
    assert arrives() is None
    cuts[1].end(stage)
    assert arrives() == pytest.approx((0.4, 0.6), abs=0.002)
    late.end(stage)
    assert arrives() == pytest.approx((0.1, 0.6), abs=0.002)
    turned.end(stage)
    slow.end(stage)
    assert arrives() == pytest.approx((LINK_LATENCY_S, 0.1), abs=0.002)
    troubles = camera.CameraTrouble(camera.black), camera.CameraTrouble(camera.black)
    for fault in troubles:
        fault.begin(stage)
    for fault in troubles:
        assert stage.camera.troubles
        fault.end(stage)
    assert not stage.camera.troubles


@pytest.mark.parametrize(
    ("mode", "said", "has_radio", "alone"),
    [
        (FlightMode.HOLD, "", False, True),
        (FlightMode.HOLD, "", True, True),
        (FlightMode.HOLD, "pilot switches", False, False),
        (FlightMode.MANUAL, "", False, True),
        (FlightMode.MANUAL, "", True, False),
        (FlightMode.OFFBOARD, "", False, False),
        (FlightMode.LAND, "", False, False),
    ],
)
def test_an_aircraft_that_nobody_flies_is_seen(mode, said, has_radio, alone):
    track = FlightTrace()
    for i in range(50):
        place = np.array([0.0, 0.0, -50.0])
        track.truth.append(Truth(100.0 + i, place, np.zeros(3), mode, True, False))
    if said:
        track.events.append(LogLine(2.0, said))
    row = drawn_rows(1, 0)[0]
    flown = Flown(
        scenario=replace(row, setup=replace(row.setup, rc_on=has_radio)),
        track=track, begun_s=100.0, flown_s=50.0,
        local_frame=LocalFrame(41.0, 29.0, 0.0), phase=Phase.RELEASED, steps=(), second_steps=(),
        broke_s=None, broken=(), stood=(), end=None,
    )  # fmt: skip
    assert any("nobody flies it" in each for each in judge(flown).wrong) is alone


def test_rows_of_a_pilot_are_flown_live_only_where_he_has_a_link():
    alone, together = ({row.name for row in live_rows(TABLE, p)} for p in (False, True))
    assert "pilot takes over while on the route" in together - alone
    assert {"navigator killed", "link cut for 1 s on the route"} <= alone
    assert "processor starved for 1 s" not in together  # nothing of ours can do that


def test_the_documentation_has_the_table():
    told = "make the table of docs/flying.md anew: python -m vwnav.bench.flights.table"
    assert manual() in DOCS.read_text(), told


def a_track() -> FlightTrace:
    track = FlightTrace()
    for i in range(20):
        t_s = 100.0 + i
        mode = FlightMode.OFFBOARD if i < 10 else FlightMode.LAND
        place = np.array([float(i), 0.0, -10.0 + 0.5 * i])
        track.truth.append(Truth(t_s, place, np.zeros(3), mode, i < 19, i == 19))
        believed = tuple((place + 0.3).tolist())
        track.heard.estimates.append(Sent(t_s, t_s, believed, (1.0, 0.0, 1.0), 0))
    track.phases.append(LogLine(0.0, "on route"))
    track.events.append(LogLine(9.0, "breaks: something"))
    return track


def test_a_phase_is_noted_once_and_at_the_step_in_which_it_is_entered():
    """Offboard that is asked for again sends setpoints at once: later they seem to be nobody's."""
    track = FlightTrace()
    for t_s, phase in ((1.0, "pilot flies"), (1.004, "pilot flies"), (1.008, "on route")):
        track.enters(phase, t_s)
    assert track.phases == [LogLine(1.0, "pilot flies"), LogLine(1.008, "on route")]


def test_a_failure_is_drawn_and_told_by_time(tmp_path):
    pytest.importorskip("matplotlib")
    name = draw_failure("link cut for 1 s", a_track(), 100.0, 9.0, ["it is not down"], tmp_path)
    assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    told = timeline_of(a_track(), 100.0)
    assert told == [
        "0.00 s mode OFFBOARD", "0.00 s phase: on route", "9.00 s breaks: something",
        "10.00 s mode LAND",
    ]  # fmt: skip


def test_an_error_of_the_map_is_no_error_of_the_estimate():
    sent = [Sent(1.0, 1.0, (0.3, 0.3, -50.0), (1.0, 0.0, 1.0), 0)]
    still = (0.0, 0.0, 0.0)
    truth = [flight_log.LoggedTruth(t_s, (0.0, 0.0, -50.0), still) for t_s in (0.9, 1.1)]
    log = flight_log.FlightLog(estimates=sent, truth=truth)
    assert estimate_sigmas(log)[0][1] == pytest.approx(np.hypot(0.3, 0.3))
    assert estimate_sigmas(replace(log, map_off_m=0.5))[0][1] == 0.0
    unknown = estimate_sigmas(replace(log, map_sigma_m=1.0))[0][1]
    assert unknown == pytest.approx(np.hypot(0.3, 0.3) / np.sqrt(2.0))


@pytest.mark.parametrize(
    ("text", "rightly"),
    [
        (
            "the camera hangs turned by 9 degrees clockwise, seen from above, from its "
            "mount_rpy_deg: it is taken for that from now on; calibrate it",
            "camera knocked in flight, round by 20 degrees",
        ),
        (
            "the camera sees 1.25 times as wide as its calibration says: it is taken for that",
            "a lens a fifth wider than calibrated",
        ),
        (
            "the autopilot's north is 60 degrees off: it is told its own, calibrate its compass",
            "compass 60 degrees off",
        ),
        (
            "the rangefinder contradicts map and barometer: it is not believed",
            "rangefinder 20 % short for good",
        ),
    ],
)
def test_no_part_is_blamed_that_is_as_it_should_be(text, rightly):
    """A mount was said to be turned by 9 degrees where the map showed another place."""
    for name, wrong in ((rightly, 0), ("map of another place", 1)):
        row = next(each for each in TABLE if each.name == name)
        assert len(list(blamed_wrongly(row, ["on route", text]))) == wrong


def test_a_flight_that_breaks_off_has_failed(monkeypatch, tmp_path):
    def burst(*_: object) -> None:
        raise RuntimeError("no such thing")

    monkeypatch.setattr(flying, "fly", burst)
    monkeypatch.setattr(lockstep_place, "lockstep_place", lambda: None)
    result = fly_row("battery low", tmp_path, "px4")
    assert not result.passed
    assert "no such thing" in result.wrong[0]


@pytest.mark.parametrize("asked", ["px4", "px4-1.16", "copter"])
def test_a_row_that_names_its_autopilot_is_flown_with_that_one(asked):
    own = [row for rows in FAMILIES.values() for row in rows if row.setup.parameters]
    assert {row.setup.manners for row in own} == {"px4", "px4-1.16"}
    assert [in_manners(row, asked) for row in own] == own
    assert in_manners(row_of("battery low"), asked).setup.manners == asked


def test_only_the_time_in_which_a_simulator_stood_is_left_out_of_sight():
    """Another fault of that flight hid what was sent for as long as it lasted."""
    row = drawn_rows(1, 0)[0]
    flown = Flown(
        scenario=row, track=a_track(), begun_s=100.0, flown_s=20.0,
        local_frame=LocalFrame(41.0, 29.0, 0.0), phase=Phase.LAND, steps=(), second_steps=(),
        broke_s=3.0, broken=((2.9, 4.1), (8.0, 15.0)), stood=((2.9, 4.1),), end=None,
    )  # fmt: skip
    left_s = [each.t_s for each in log_of(flown).estimates]
    assert left_s == [100.0 + i for i in range(20) if i not in (3, 4)]
