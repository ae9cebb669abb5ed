"""Rows of the table that can be broken from our side, flown one after the other in real time."""

import os
import signal
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from vwnav.bench.flights.faults import aircraft, camera, computer, link, telemetry
from vwnav.bench.flights.live.session import LiveFlight, Simulator, live_flight
from vwnav.bench.flights.rows import RowResult, draw_failure, timeline_of
from vwnav.bench.flights.scenario import Ending, Scenario
from vwnav.bench.flights.stage import Fault
from vwnav.bench.flights.table.manners import in_manners
from vwnav.mission.mission import Phase
from vwnav.vehicle import FlightMode

ROUTE_TEXT = "1,45,0,50\n2,45,-40,50\n"
_SPOILS_LINK = (
    link.LinkCut, link.RoundTrip, link.SlowLine, link.Garbage, link.PacketsLost, link.Replayed,
    telemetry.Missing, telemetry.Doubled, telemetry.Altered, telemetry.TelemetryLate,
)  # fmt: skip
_INSIDE = (camera.CameraTrouble, computer.ModelRaises)
_SIGNALS = (computer.NavigatorKilled, computer.NavigatorStopped)
_PILOTS = (aircraft.PilotSwitches, link.StationCommands)
_ROUTE_S, _SPEED_S, _DOWN_S = 150.0, 30.0, 100.0
_AT_SPEED_M_S = 4.0


def live_rows(rows: Iterable[Scenario], has_pilot: bool) -> list[Scenario]:
    """Those of the route that are broken from our side; those of a pilot need his link.

    Whose parameters an autopilot is set up with is its owner's: no row that names some.
    """
    kinds = (*_SPOILS_LINK, *_INSIDE, *_SIGNALS, *(_PILOTS if has_pilot else ()))
    return [
        row
        for row in rows
        if len(row.breaks) == 1
        and not row.setup.parameters
        and isinstance(row.breaks[0].fault, kinds)
        and row.setup.start is not None
        and row.setup.start.phase is Phase.ROUTE
    ]


def fly_live_row(row: Scenario, family: str, simulator: Simulator, folder: Path) -> RowResult:
    """Fly to the route from where the last one came down, break it there, see what becomes of it.

    Args:
        row: of `live_rows`.
        family: which the table has it in.
        simulator: the simulated autopilot.
        folder: for the flight's files.
    """
    plan = row.breaks[0]
    began_s = time.process_time()
    with live_flight(simulator, folder, ROUTE_TEXT, _inside(plan.fault)) as flight:
        wrong = _reach_route(flight)
        row = in_manners(row, simulator.manners)
        broke_s, broke_at = None if wrong else flight.t_s, flight.place_ned_m()
        if broke_s is not None:
            flight.note(f"breaks: {plan.fault}")
            _begin(plan.fault, flight)
            _follow(row, flight, plan.for_s)
            wrong = _judge(row, flight, broke_s, broke_at)
        _clear_away(flight)
    track, begun_s, picture = flight.track, flight.begun_s, None
    if wrong:
        picture = draw_failure(row.name, track, begun_s, broke_s, wrong, folder)
    last = track.truth[-1]
    off_m = float(np.hypot(*(last.position_ned_m - broke_at)[:2])) if last.on_ground else None
    return RowResult(
        name=row.name, family=family, expected=row.expected, where=row.where, when=row.when,
        wrong=tuple(wrong), broke_s=broke_s, landed_off_m=off_m,
        fastest_m_s=_fastest(flight, broke_s), worst_sigmas=None, flown_s=flight.t_s,
        cost_s=time.process_time() - began_s,
        timeline=tuple(timeline_of(track, begun_s)), picture=picture,
    )  # fmt: skip


def _reach_route(flight: LiveFlight) -> list[str]:
    def stopped() -> bool:
        return flight.has_ended() or flight.is_in(Phase.ROUTE)

    if not flight.watch(stopped, _ROUTE_S) or flight.has_ended():
        said = flight.track.events[-1].text if flight.track.events else "nothing"
        return [f"it never got to the route; the last it said is: {said}"]

    def at_speed() -> bool:
        return bool(np.hypot(*flight.track.truth[-1].velocity_ned_m_s[:2]) > _AT_SPEED_M_S)

    flight.watch(at_speed, _SPEED_S)
    return []


def _inside(fault: Fault) -> str:
    """What `live.inside` has to break, "" when nothing."""
    match fault:
        case camera.CameraTrouble(make):
            return make.__name__
        case computer.ModelRaises():
            return "model"
    return ""


def _begin(fault: Fault, flight: LiveFlight) -> None:
    pilot = flight.simulator.pilot
    match fault:
        case camera.CameraTrouble() | computer.ModelRaises():
            flight.trigger.touch()
        case computer.NavigatorKilled():
            flight.process.send_signal(signal.SIGKILL)
        case computer.NavigatorStopped(seconds):
            _signal(flight, signal.SIGSTOP)
            threading.Timer(seconds, _signal, (flight, signal.SIGCONT)).start()
        case aircraft.PilotSwitches():
            assert pilot is not None
            pilot.take_over()
        case link.StationCommands(mode):
            assert pilot is not None
            pilot.ask(mode)
        case _:
            fault.begin(_Spoiled(flight))  # type: ignore[arg-type]


def _end(fault: Fault, flight: LiveFlight) -> None:
    if isinstance(fault, _INSIDE):
        flight.trigger.unlink(missing_ok=True)
    elif isinstance(fault, _SPOILS_LINK):
        fault.end(_Spoiled(flight))  # type: ignore[arg-type]


class _Spoiled:
    """As much of a world as faults of the link change."""

    def __init__(self, flight: LiveFlight) -> None:
        self.autopilot_link = flight.simulator.relay.autopilot_link
        self.note = flight.note


def _signal(flight: LiveFlight, number: signal.Signals) -> None:
    if not flight.has_ended():
        os.kill(flight.process.pid, number)


def _follow(row: Scenario, flight: LiveFlight, for_s: float | None) -> None:
    """Let the fault last, mend it, and wait for what the row ends with."""
    lasts_s = row.limit_s - row.breaks[0].at_s if for_s is None else for_s
    flight.watch(flight.is_down, lasts_s)
    _end(row.breaks[0].fault, flight)
    if row.ending is Ending.LANDED:
        flight.watch(flight.is_down, _DOWN_S)
    elif for_s is not None:
        flight.watch(flight.is_down, row.limit_s - row.breaks[0].at_s - for_s)


def _judge(row: Scenario, flight: LiveFlight, broke_s: float, broke_at: Any) -> list[str]:
    """The row's own expectations; the rules of `judge` about estimates need a lockstep's track."""
    wrong, track = [], flight.track
    for each in row.follows:
        times = [t for t in each.when(track, flight.begun_s) if t >= broke_s]
        if not times:
            wrong.append(f"never seen: {each.what}")
        elif times[0] - broke_s > each.within_s:
            wrong.append(
                f"{each.what} after {times[0] - broke_s:.1f} s, {each.within_s:g} s are allowed"
            )
    off_m = float(np.hypot(*(flight.place_ned_m() - broke_at)[:2]))
    match row.ending:
        case Ending.LANDED if not flight.is_down():
            wrong.append("it is not down")
        case Ending.LANDED if row.lands_within_m is not None and off_m > row.lands_within_m:
            wrong.append(f"it landed {off_m:.1f} m off, {row.lands_within_m:.0f} m are allowed")
        case Ending.FLIES_ON if not _flies_on(flight):
            wrong.append(f"it does not fly on: {flight.track.phases[-1].text}")
        case Ending.PILOT | Ending.OTHERS if not flight.is_in(Phase.RELEASED):
            wrong.append(f"nobody else has it: {flight.track.phases[-1].text}")
    limit_m_s = row.setup.config.limits.speed_max_m_s + row.setup.wind_m_s + row.faster_m_s
    if _fastest(flight, broke_s) > limit_m_s and row.ending is not Ending.PILOT:
        wrong.append(f"{_fastest(flight, broke_s):.1f} m/s, {limit_m_s:.1f} are allowed")
    return wrong


def _flies_on(flight: LiveFlight) -> bool:
    gone_on = (Phase.ROUTE, Phase.RETURN, Phase.DESCEND, Phase.LAND, Phase.DONE)
    if flight.has_ended():
        return flight.process.returncode == 0
    return any(map(flight.is_in, gone_on))


def _clear_away(flight: LiveFlight) -> None:
    """Bring down whatever still flies: the pilot does it, or the program that is told to end."""
    simulator = flight.simulator
    if simulator.armed and not flight.has_ended():
        if flight.is_in(Phase.RELEASED) and simulator.pilot is not None:
            simulator.pilot.ask(FlightMode.LAND)
        else:
            flight.process.send_signal(signal.SIGTERM)  # it lands first
        flight.watch(flight.is_down, _DOWN_S)
    simulator.bring_down(_DOWN_S)


def _fastest(flight: LiveFlight, broke_s: float | None) -> float:
    """Over the ground since it broke, or began."""
    since_s = flight.begun_s + (broke_s or 0.0)
    speeds = (np.hypot(*e.velocity_ned_m_s[:2]) for e in flight.track.truth if e.t_s >= since_s)
    return max(map(float, speeds), default=0.0)
