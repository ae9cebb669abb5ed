"""What comes back is chased: the simulated vehicle flies after wrong estimates as PX4 1.18 did.

The recordings are flights of the first release on real PX4 with GPS off, flown to grief; all that
the filter estimated is on their tapes. What was sent of it is told to the simulated vehicle here.
"""

import bisect
import csv
import json
import math
import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from px4_bench import Bench

from vwnav.sim.mavlink.command import Result
from vwnav.sim.multirotor.simulated import STEP_S
from vwnav.sim.px4 import messages
from vwnav.sim.px4.estimator import VisionSample
from vwnav.sim.px4.modes import NavState

DATA = Path(os.environ.get("VWNAV_DATA", Path(__file__).parents[3] / "shared" / "data"))
FLIGHTS = DATA / "mavlink" / "vwnav_flights"
needs_flights = pytest.mark.skipif(
    not (FLIGHTS / "px4_link_cut_5s").exists(), reason="needs the flights of VWNAV_DATA"
)
LANDS = (("COM_OBL_RC_ACT", 4),)  # as in the recorded flights
STATES = {
    "offboard": NavState.OFFBOARD,
    "land": NavState.LAND,
    "descend": NavState.DESCEND,
}


@dataclass(frozen=True)
class Told:
    """One recorded estimate; `sent` as the first release decided it."""

    t_s: float
    position_ned_m: tuple[float, float, float]
    velocity_ned_m_s: tuple[float, float, float]
    variance_m2: float
    sent: bool


def rows(name: str, topic: str) -> list[dict[str, Any]]:
    """The messages of a topic, their time from the start of the recording."""
    with (FLIGHTS / name / "flight.mcap").open("rb") as tape:
        found = [json.loads(m.data) for _, _, m in make_reader(tape).iter_messages(topics=[topic])]
    start_s = started_at(name)
    return [row | {"t_s": row["t_s"] - start_s} for row in found]


@cache
def started_at(name: str) -> float:
    with (FLIGHTS / name / "flight.mcap").open("rb") as tape:
        first = next(iter(make_reader(tape).iter_messages(topics=["/estimate"])))[2]
    return float(json.loads(first.data)["t_s"])


@cache
def told(name: str) -> list[Told]:
    found = []
    for row in rows(name, "/estimate"):
        velocity, covariance = row["velocity_ned_m_s"], row["covariance"]
        sure = max(covariance[3][3], covariance[4][4]) < 4.0**2
        sent = sure and math.hypot(*velocity[:2]) < 35.0
        place, variance_m2 = tuple(row["position_ned_m"]), covariance[0][0]
        found.append(Told(row["t_s"], place, tuple(velocity), variance_m2, sent))
    return found


def recorded_modes(name: str, start_s: float, end_s: float) -> list[tuple[float, NavState]]:
    """(seconds, mode) at each change, in the order they were heard."""
    found: list[tuple[float, NavState]] = []
    for row in rows(name, "/vehicle"):
        state = STATES[row["mode"]] if start_s <= row["t_s"] <= end_s else None
        if state is not None and (not found or found[-1][1] is not state):
            found.append((row["t_s"], state))
    return found


def fly_on(name: str, cut_s: float, back_s: float, end_s: float) -> list[tuple[float, NavState]]:
    """Cut the link of a vehicle on its route, then tell it what the recorded flight told."""
    bench = Bench(parameters=LANDS).hover(150.0).offboard((5.5, -4.0, 0.0))
    bench.run(10.0)
    bench.vision, bench.velocity = False, None
    estimates = told(name)
    times_s = [each.t_s for each in estimates]
    vehicle, found = bench.vehicle, []
    shift_s = vehicle.t_s - cut_s
    for step in range(round((end_s - cut_s) / STEP_S)):
        vehicle.step()
        t_s = vehicle.t_s - shift_s
        newest = estimates[bisect.bisect_right(times_s, t_s) - 1]
        if t_s > back_s and step % 5 == 0 and newest.sent:
            place = [
                p + v * (t_s - newest.t_s)
                for p, v in zip(newest.position_ned_m, newest.velocity_ned_m_s, strict=True)
            ]
            vehicle.estimator.handle_vision(vision(vehicle.t_s, place, newest.variance_m2))
        if not found or found[-1][1] is not bench.state:
            found.append((t_s, bench.state))
    return found


def vision(t_s: float, place: list[float], variance_m2: float = 0.25) -> VisionSample:
    north, east, down = place
    return VisionSample(t_s, (north, east, down), variance_m2, None, None, 1.0, 0, False)


@needs_flights
def test_it_alternates_descend_and_land_as_the_recorded_flight_did() -> None:
    """Each change within a second: the heartbeat that told the recorded ones comes once in one."""
    theirs = recorded_modes("px4_link_cut_5s", 71.8, 138.0)
    ours = fly_on("px4_link_cut_5s", 39.7, 45.4, 138.0)
    assert [state for _, state in ours[:4]] == [
        NavState.OFFBOARD,
        NavState.LAND,
        NavState.DESCEND,
        NavState.LAND,
    ]
    ours = ours[4:]
    assert [state for _, state in ours] == [state for _, state in theirs]
    for (our_s, _), (their_s, _) in zip(ours, theirs, strict=True):
        assert our_s == pytest.approx(their_s, abs=1.0)


@needs_flights
def test_levelled_it_slows_down_as_the_recorded_flight_did() -> None:
    """From 121.5 s PX4 flies Descend, level, at 45 m/s: the truth says what drag it has."""
    name = "px4_link_cut_5s"
    start_s = started_at(name)
    with (FLIGHTS / name / "truth.csv").open() as table:
        truth = [(float(r["t_s"]) - start_s, float(r["north_m"])) for r in csv.DictReader(table)]

    def speed(t_s: float) -> float:
        near = [(t, n) for t, n in truth if abs(t - t_s) < 0.25]
        return (near[-1][1] - near[0][1]) / (near[-1][0] - near[0][0])

    theirs = speed(124.0) / speed(122.2)
    bench = Bench().hover(150.0)
    bench.vision = False
    bench.run_until_state(NavState.DESCEND, 8.0)
    bench.run(1.0)
    bench.vehicle.body.vn = before = speed(122.2)
    bench.run(1.8)
    assert bench.vehicle.body.vn / before == pytest.approx(theirs, abs=0.05)


def blind_and_told_wrong(seconds: float) -> tuple[Bench, float, float]:
    """Blind at 100 m, then told of a place 65 m off that runs at 18 m/s; greatest speed, tilt."""
    bench = Bench(parameters=LANDS).hover(100.0).offboard((0.0, 0.0, 0.0))
    bench.vision, bench.velocity = False, None
    bench.run(6.0)
    assert bench.state is NavState.DESCEND
    vehicle, speed_m_s, tilt_deg = bench.vehicle, 0.0, 0.0
    start_s = vehicle.t_s
    for step in range(round(seconds / STEP_S)):
        vehicle.step()
        if step % 5 == 0:
            north_m = 65.0 + 18.0 * (vehicle.t_s - start_s)
            vehicle.estimator.handle_vision(vision(vehicle.t_s, [north_m, 0.0, -90.0]))
        body = vehicle.body
        speed_m_s = max(speed_m_s, math.hypot(body.vn, body.ve))
        tilt_deg = max(tilt_deg, math.degrees(math.acos(body.rotation[8])))
    return bench, speed_m_s, tilt_deg


def test_the_first_estimates_that_return_are_landed_on_with_position_control() -> None:
    bench, _, _ = blind_and_told_wrong(1.8)
    assert bench.state is NavState.LAND
    assert bench.position_error_m > 60.0


def test_it_flies_after_a_wrong_estimate_whatever_it_says() -> None:
    _, speed_m_s, tilt_deg = blind_and_told_wrong(25.0)
    assert tilt_deg > 40.0
    assert speed_m_s > 30.0


def modes(bench: Bench) -> tuple[int, int]:
    """(flown, intended) as CURRENT_MODE carries them."""
    m = messages.current_mode(bench.vehicle)
    return int(m.custom_mode), int(m.intended_custom_mode)


OFFBOARD = NavState.OFFBOARD.custom_mode


def test_the_intended_mode_stays_ours_through_every_failsafe() -> None:
    bench = Bench(parameters=LANDS).hover(30.0).offboard((1.0, 0.0, 0.0))
    assert modes(bench) == (OFFBOARD, OFFBOARD)
    bench.vision, bench.velocity = False, None
    bench.run(2.0)
    assert modes(bench) == (NavState.LAND.custom_mode, OFFBOARD)
    bench.run(5.0)
    assert modes(bench) == (NavState.DESCEND.custom_mode, OFFBOARD)
    bench.vision = True
    bench.run(3.0)
    assert modes(bench) == (NavState.LAND.custom_mode, OFFBOARD)


def test_the_intended_mode_changes_for_a_person() -> None:
    bench = Bench().hover(30.0).offboard((1.0, 0.0, 0.0))
    bench.sticks = (0, 0, 500, 0)
    bench.run(0.5)
    for push in range(0, 900, 100):
        bench.sticks = (push, 0, 500, 0)
        bench.run(0.04)
    position = NavState.POSITION.custom_mode
    assert modes(bench) == (position, position)


def test_what_brought_it_down_is_flown_until_it_is_disarmed() -> None:
    """Recorded: Descend for two seconds after the landing was detected, then the intended mode."""
    bench = Bench(parameters=LANDS).hover(4.0).offboard()
    bench.vision, bench.velocity = False, None
    bench.run_until_state(NavState.DESCEND, 8.0)
    while not bench.vehicle.landed:
        bench.run(0.02)
    for _ in range(90):
        assert bench.state is NavState.DESCEND
        assert bench.vehicle.commander.armed
        bench.run(0.02)
    bench.run(0.5)
    assert not bench.vehicle.commander.armed
    assert bench.state is NavState.OFFBOARD


def test_an_estimate_that_moves_keeps_it_armed_on_the_ground() -> None:
    """Recorded: 8 s on the ground, armed, while the estimate ran at 60 m/s."""
    bench = Bench(parameters=LANDS).hover(3.0).offboard()
    vehicle = bench.vehicle
    bench.velocity = None
    bench.vision = False
    start_s = vehicle.t_s
    down_since_s = None
    for step in range(round(20.0 / STEP_S)):
        vehicle.step()
        if step % 5 == 0:
            there = [4.0 * (vehicle.t_s - start_s), 0.0, vehicle.body.d]
            vehicle.estimator.handle_vision(vision(vehicle.t_s, there))
        if vehicle.body.on_ground and down_since_s is None:
            down_since_s = vehicle.t_s
    assert down_since_s is not None
    assert vehicle.commander.armed
    assert not vehicle.landed


def test_a_landing_asked_for_at_the_moment_of_disarming_stays_as_the_mode() -> None:
    bench = Bench().hover(3.0).offboard()
    assert bench.ask(NavState.LAND) is Result.ACCEPTED
    bench.velocity = None
    while bench.vehicle.commander.armed:
        bench.run(0.02)
    assert bench.state is NavState.OFFBOARD
    assert bench.ask(NavState.LAND) is Result.ACCEPTED
    bench.run(5.0)
    assert bench.state is NavState.LAND
    assert "mode not armable" in bench.vehicle.commander.problems(bench.vehicle.health)
