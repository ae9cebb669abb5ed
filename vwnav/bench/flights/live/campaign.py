"""Rows of the table that can be broken from our side, flown one after the other in real time."""

import signal
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from vwnav.bench.flights.live.breaks import Reach, by_our_means, can_be_broken, patch_of
from vwnav.bench.flights.live.session import LiveFlight, Simulator, live_flight
from vwnav.bench.flights.planned import ARMED, BEGAN, Planned
from vwnav.bench.flights.rows import RowResult, draw_failure, timeline_of
from vwnav.bench.flights.scenario import Ending, Scenario, setup
from vwnav.bench.flights.setup import Setup
from vwnav.bench.flights.table.manners import in_manners
from vwnav.mission.mission import Phase
from vwnav.types import Array
from vwnav.vehicle import FlightMode, Order

ROUTE_TEXT = "1,45,0,50\n2,45,-40,50\n"
_AIR_S, _SPEED_S, _BREAKS_S, _DOWN_S = 300.0, 30.0, 150.0, 100.0
_AT_SPEED_M_S, _FAR_M = 4.0, 55.0
_STORM_M_S = 8.0


def live_rows(rows: Iterable[Scenario], has_pilot: bool) -> list[Scenario]:
    """Those that are broken from our side alone; those of a pilot need his link.

    An autopilot's parameters, its aircraft and its weather are its owner's: no row that names some.
    """
    return [row for row in rows if can_be_broken(row.breaks, has_pilot) and _is_as_any(row.setup)]


def _is_as_any(asked: Setup) -> bool:
    """Nothing but where it begins, a pilot's radio and a breeze is asked for."""
    usual = setup(asked.start, rc_on=asked.rc_on, wind_m_s=asked.wind_m_s)
    in_a_phase = asked.start is None or asked.start.phase is not None
    return asked == usual and asked.wind_m_s < _STORM_M_S and in_a_phase


def fly_live_row(row: Scenario, family: str, simulator: Simulator, folder: Path) -> RowResult:
    """Fly to where it breaks from where the last one came down, and see what becomes of it.

    Args:
        row: of `live_rows`.
        family: which the table has it in.
        simulator: the simulated autopilot.
        folder: for the flight's files.
    """
    began_s = time.process_time()
    patch = patch_of(row.breaks, folder)
    with live_flight(simulator, folder, ROUTE_TEXT, patch) as flight:
        row = in_manners(row, simulator.manners)
        wrong, breaks = _reach(row, flight), _LiveBreaks(row, flight)
        if not wrong:
            flight.see = breaks.step
            wrong = _follow(row, flight, breaks)
            breaks.finish()
        _clear_away(flight)
    track, begun_s, broke_s, picture = flight.track, flight.begun_s, breaks.broke_s, None
    if wrong:
        picture = draw_failure(row.name, track, begun_s, broke_s, wrong, folder)
    last = track.truth[-1]
    lands = last.on_ground and breaks.broke_at_ned_m is not None
    off_m = _off_m(row, last.position_ned_m, breaks.broke_at_ned_m) if lands else None
    return RowResult(
        name=row.name, family=family, expected=row.expected, where=row.where, when=row.when,
        wrong=tuple(wrong), broke_s=broke_s, landed_off_m=off_m,
        fastest_m_s=_fastest(flight, broke_s), worst_sigmas=None, flown_s=flight.t_s,
        cost_s=time.process_time() - began_s,
        timeline=tuple(timeline_of(track, begun_s)), picture=picture,
    )  # fmt: skip


class _LiveStage:
    """As much of a stage as faults of the link and orders of a station touch."""

    def __init__(self, flight: LiveFlight, since_s: float) -> None:
        self._flight, self._since_s = flight, since_s
        self.autopilot_link = flight.simulator.relay.autopilot_link
        self.note = flight.note

    @property
    def t_s(self) -> float:
        """Since the row began."""
        return self._flight.t_s - self._since_s

    @property
    def navigator(self) -> SimpleNamespace:
        """Whom a station speaks to."""
        return SimpleNamespace(port=SimpleNamespace(own_id=self._flight.simulator.navigators_id))


class _LiveBreaks:
    """What breaks in a flight, from now on; a row that begins at speed on the route breaks at once.

    Attributes:
        broke_s: when the first did, on the flight's clock, and where that was; None before.
    """

    def __init__(self, row: Scenario, flight: LiveFlight) -> None:
        start, first = row.setup.start, row.breaks[0]
        at_speed = start is not None and start.phase is Phase.ROUTE and first.phase is None
        self._began_s = flight.t_s - (first.at_s if at_speed else 0.0)
        self._flight, self._stage = flight, _LiveStage(flight, self._began_s)
        simulator = flight.simulator
        reach = Reach(flight.process, flight.folder, simulator.pilot, simulator.order)
        self._planned = [
            Planned(replace(each, fault=by_our_means(each.fault, i, reach)))
            for i, each in enumerate(row.breaks)
        ]
        self._begun = {BEGAN: 0.0}
        self.broke_s: float | None = None
        self.broke_at_ned_m: Array | None = None

    def step(self) -> None:
        """Begin and end what it is time for."""
        for line in self._flight.track.phases:
            self._begun.setdefault(line.text, line.t_s - self._began_s)
        if self._flight.simulator.armed:
            self._begun.setdefault(ARMED, self._stage.t_s)
        for each in self._planned:
            each.step(self._stage, self._begun)  # type: ignore[arg-type]
        if self.broke_s is None and any(each.begun_s is not None for each in self._planned):
            self.broke_s, self.broke_at_ned_m = self._flight.t_s, self._flight.place_ned_m()

    def finish(self) -> None:
        """Put back whatever is not."""
        for each in self._planned:
            each.finish(self._stage)  # type: ignore[arg-type]


def _reach(row: Scenario, flight: LiveFlight) -> list[str]:
    """Where the row begins: on the ground, in a phase of the mission, or on the route at speed."""
    start = row.setup.start
    if start is None or start.phase is None:
        return []
    entered = start.phase.value
    if start.phase is Phase.RETURN:
        flight.watch(lambda: _is_far(flight) or flight.has_ended(), _AIR_S)
        flight.simulator.order(Order.RETURN)

    def stopped() -> bool:
        return flight.has_ended() or any(line.text == entered for line in flight.track.phases)

    if not flight.watch(stopped, _AIR_S) or flight.has_ended():
        return [f"it never got {entered}; the last it said is: {flight.last_words()}"]

    def at_speed() -> bool:
        return bool(np.hypot(*flight.track.truth[-1].velocity_ned_m_s[:2]) > _AT_SPEED_M_S)

    if start.phase is Phase.ROUTE:
        flight.watch(at_speed, _SPEED_S)
    return []


def _is_far(flight: LiveFlight) -> bool:
    """On its route, and its way home takes longer than any row waits before it breaks."""
    off_m = float(np.hypot(*flight.place_ned_m()[:2]))
    return flight.is_in(Phase.ROUTE) and off_m > _FAR_M


def _follow(row: Scenario, flight: LiveFlight, breaks: _LiveBreaks) -> list[str]:
    """Let it break, be mended and end as the row does, and judge that."""

    def over() -> bool:
        return flight.is_down() or (flight.has_ended() and not flight.simulator.armed)

    flight.watch(lambda: breaks.broke_s is not None or over(), _BREAKS_S)
    if breaks.broke_s is None:
        return ["it never came to where it breaks"]
    flight.watch(over, _lasts_s(row))
    return _judge(row, flight, breaks.broke_s, breaks.broke_at_ned_m)


def _lasts_s(row: Scenario) -> float:
    """How long it is followed since it broke."""
    first = row.breaks[0]
    timed = first.phase is None and not first.armed
    rest_s = row.limit_s - (first.at_s if timed else 0.0)
    if row.ending is not Ending.LANDED:
        return rest_s
    mended_s = max(each.at_s + (each.for_s or 0.0) for each in row.breaks) - first.at_s
    return max(rest_s, mended_s + _DOWN_S)


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
    off_m = _off_m(row, flight.place_ned_m(), broke_at)
    match row.ending:
        case Ending.LANDED if not flight.is_down():
            wrong.append("it is not down")
        case Ending.LANDED if row.lands_within_m is not None and off_m > row.lands_within_m:
            wrong.append(f"it landed {off_m:.1f} m off, {row.lands_within_m:.0f} m are allowed")
        case Ending.FLIES_ON if not _flies_on(flight):
            wrong.append(f"it does not fly on: {flight.track.phases[-1].text}")
        case Ending.STAYED if track.flew:
            wrong.append("it took off")
        case Ending.PILOT | Ending.OTHERS if not flight.is_in(Phase.RELEASED):
            wrong.append(f"nobody else has it: {flight.track.phases[-1].text}")
    limit_m_s = row.setup.config.limits.speed_max_m_s + row.setup.wind_m_s + row.faster_m_s
    if _fastest(flight, broke_s) > limit_m_s and row.ending is not Ending.PILOT:
        wrong.append(f"{_fastest(flight, broke_s):.1f} m/s, {limit_m_s:.1f} are allowed")
    return wrong


def _off_m(row: Scenario, place_ned_m: Any, broke_at_ned_m: Any) -> float:
    """From where it is meant to come down: the row's place, else where it was when it broke."""
    meant = broke_at_ned_m[:2] if row.lands_at_ne_m is None else row.lands_at_ne_m
    return float(np.hypot(*(place_ned_m[:2] - meant)))


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
