"""Days on which things break as they come: two to six faults and persons at any moment.

Denser than `vwnav.bench.flights.table.drawn`, whose faults are those of its rows: here links are
cut one way, commands are refused for a while, and two or three persons act on one aircraft.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from vwnav.bench.flights.faults import aircraft, camera, computer, link
from vwnav.bench.flights.scenario import (
    CLIMB,
    DESCEND,
    RETURN,
    ROUTE,
    Break,
    Ending,
    Flown,
    Scenario,
    setup,
)
from vwnav.bench.flights.stage import Fault, FlightStage
from vwnav.sim.config import Manners
from vwnav.vehicle import FlightMode, Order

MANNERS: tuple[Manners, ...] = ("px4", "copter", "px4-1.16")
_SEED = 77
_UNTIL_S, _LIMIT_S = 28.0, 110.0
_COMMANDS = (176, 176, 21, 22)  # MAV_CMD_DO_SET_MODE, NAV_LAND, NAV_TAKEOFF
_STATIONS_WISH = (FlightMode.HOLD, FlightMode.LAND, FlightMode.RETURN)
_OBL_RC_ACT = (4, 4, 0, 1, 2, 3, 5, 6)
_OTHERWISE_SET = 0.4  # of the PX4s
_TAKES = "a second station asks for "
_GIVES_BACK = ("pilot hands back", "the ground station orders")
_HEARD_S, _AT_ONCE_S = 0.5, 0.5
_DEAF_S = 1.3  # who is told nothing asks for nothing from 1.2 s on
_LOST, _SETTLES_S = "the estimate is not sent any more", 8.0
_FLIES = frozenset({*_COMMANDS, 20, 400})
_ORDERS = tuple(each for each in Order if each is not Order.START)

Drawn = tuple[Fault, float | None]  # and for how long
_T = TypeVar("_T")


@dataclass(frozen=True)
class OneWayCut:
    """A broken wire: nothing passes up to the autopilot, or nothing down from it."""

    up: bool

    def begin(self, world: FlightStage) -> None:
        """Cut."""
        (world.autopilot_link.b_to_a if self.up else world.autopilot_link.a_to_b).cut = True

    def end(self, world: FlightStage) -> None:
        """Joined."""
        (world.autopilot_link.b_to_a if self.up else world.autopilot_link.a_to_b).cut = False


def day(number: int) -> Scenario:
    """Day `number`; nothing is asked of it but that it breaks no rule, and does not hang."""
    draw = _Draw(np.random.default_rng([_SEED, number]))
    manners = MANNERS[number % len(MANNERS)]
    radio = draw.chance(0.5)
    start = draw.one_of(ROUTE, ROUTE, RETURN, CLIMB, DESCEND)
    chances = _chances(draw, radio)
    weights = np.array([weight for weight, _ in chances], np.float64)
    breaks = []
    for _ in range(draw.count(2, 6)):
        fault, for_s = chances[draw.weighted(weights)][1]()
        breaks.append(Break(fault=fault, at_s=draw.between(0.5, _UNTIL_S), for_s=for_s))
    parameters: tuple[tuple[str, float], ...] = ()
    if manners != "copter" and draw.chance(_OTHERWISE_SET):
        parameters = (("COM_OBL_RC_ACT", draw.one_of(*_OBL_RC_ACT)),)
    assert start.phase is not None
    return Scenario(
        name=f"day {number}: {manners}{', a radio' if radio else ''}, {start.phase.value}",
        setup=setup(
            start, manners=manners, rc_on=radio, wind_m_s=draw.one_of(2.0, 4.0, 8.0),
            wind_from_deg=draw.between(0.0, 360.0), seed=draw.count(1, 2**31 - 1),
            parameters=parameters,
        ),
        breaks=tuple(sorted(breaks, key=lambda each: each.at_s)),
        limit_s=_LIMIT_S,
        ending=Ending.ANYHOW,
        faster_m_s=4.0,
    )  # fmt: skip


class _Draw:
    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng

    def chance(self, of: float) -> bool:
        return bool(self._rng.random() < of)

    def between(self, least: float, most: float) -> float:
        return float(self._rng.uniform(least, most))

    def count(self, least: int, most: int) -> int:
        return int(self._rng.integers(least, most + 1))

    def one_of(self, *choices: _T) -> _T:
        return choices[int(self._rng.integers(len(choices)))]

    def weighted(self, weights: np.ndarray) -> int:
        return int(self._rng.choice(len(weights), p=weights / weights.sum()))


def _chances(draw: _Draw, radio: bool) -> list[tuple[int, Callable[[], Drawn]]]:
    """What may happen, each with its weight."""

    def stands() -> Drawn:
        seconds = draw.between(0.2, 1.0)
        return aircraft.SimulatorStands(seconds), seconds

    def switched() -> Drawn:
        if radio:
            return aircraft.PilotSwitches(), None
        return link.StationCommands(draw.one_of(*_STATIONS_WISH)), None

    def pushed() -> Drawn:
        return (aircraft.PilotPushes(), None) if radio else switched()

    def radio_off() -> Drawn:
        return (aircraft.RadioOff() if radio else link.LinkCut()), draw.between(0.3, 15.0)

    return [
        (4, lambda: (link.LinkCut(), draw.between(0.3, 12.0))),
        (2, lambda: (OneWayCut(draw.chance(0.5)), draw.between(0.3, 10.0))),
        (1, lambda: (link.RoundTrip(0.3), draw.between(5.0, 20.0))),
        (1, lambda: (link.PacketsLost(draw.between(0.2, 0.6)), draw.between(3.0, 20.0))),
        (2, lambda: (computer.NavigatorStopped(draw.between(0.3, 6.0)), None)),
        (2, lambda: (computer.NavigatorKilled(), None)),
        (1, lambda: (computer.NavigatorLeaves(), None)),
        (2, lambda: (computer.WatchdogKilled(), None)),
        (2, lambda: (computer.WatchdogHangs(), None)),
        (1, lambda: (computer.LoopHangs(draw.one_of("link", "mission", "picture")), None)),
        (
            1,
            lambda: (
                computer.StepRaises(draw.one_of("link", "mission", "picture")),
                draw.between(0.2, 5.0),
            ),
        ),
        (1, lambda: (computer.Starved(draw.between(0.0, 0.3), draw.between(0.3, 3.0)), None)),
        (2, lambda: (camera.CameraTrouble(camera.no_images), draw.between(1.0, 30.0))),
        (1, lambda: (aircraft.BatteryAt(draw.one_of(0.2, 0.08)), None)),
        (2, lambda: (aircraft.CommandRefused(draw.one_of(*_COMMANDS)), draw.between(1.0, 20.0))),
        (1, stands),
        (3, switched),
        (1, pushed),
        (1, radio_off),
        (2, lambda: (aircraft.PilotHandsBack(), None)),
        (2, lambda: (link.StationCommands(draw.one_of(*_STATIONS_WISH)), None)),
        (2, lambda: (aircraft.StationOrders(draw.one_of(*_ORDERS)), None)),
    ]


def against_stations(flown: Flown) -> list[str]:
    """What was asked of an aircraft that a ground station had just taken out of Offboard.

    Until it is in another mode, or a person gives it back. By the rules of every flight only a
    pilot with sticks is known.
    """
    track, found = flown.track, []
    given_back = [each.t_s for each in track.events if each.text.startswith(_GIVES_BACK)]
    asked = [(each.t_s, each.text) for each in track.events if each.text.startswith(_TAKES)]
    trips_s = max((b.fault.seconds for b in flown.scenario.breaks
                   if isinstance(b.fault, link.RoundTrip)), default=0.0)  # fmt: skip
    for t_s, text in asked:
        mode = FlightMode[text.removeprefix(_TAKES)]
        rows = [row for row in track.truth if row.t_s >= t_s + flown.begun_s - 0.05]
        if not rows or rows[0].mode is not FlightMode.OFFBOARD:
            continue
        taken = next((row.t_s for row in rows if row.mode is not FlightMode.OFFBOARD), None)
        held = [row for row in rows if taken is not None and row.t_s >= taken]
        if taken is None or taken - rows[0].t_s > _AT_ONCE_S or held[0].mode is not mode:
            continue
        until_s = next((row.t_s for row in held if row.mode is not mode or not row.armed), math.inf)
        until_s = min([until_s, *(g + flown.begun_s for g in given_back if g >= t_s)])
        deaf = _is_deaf(flown, taken - flown.begun_s)
        since_s = taken + (_DEAF_S if deaf else _HEARD_S) + trips_s
        sent = [(e.t_s, "a setpoint") for e in track.heard.setpoints]
        sent += [(e.t_s, f"command {e.number}") for e in track.heard.commands if e.number in _FLIES]
        found += [
            f"{what} at {at_s - flown.begun_s:.2f} s against {text!r} at {t_s:.2f} s"
            for at_s, what in sent
            if since_s < at_s < until_s
        ]
    return found


def _is_deaf(flown: Flown, at_s: float) -> bool:
    """Whether the autopilot cannot be heard then, or from a moment later on, and itself hears."""
    cuts = [b for b in flown.scenario.breaks if isinstance(b.fault, OneWayCut) and not b.fault.up]
    return any(b.at_s - _HEARD_S <= at_s <= b.at_s + (b.for_s or math.inf) for b in cuts)


def restless(flown: Flown) -> list[str]:
    """Estimates that are lost again and again, when all that broke is whole again or settled."""
    ends = (b.at_s + (_SETTLES_S if b.for_s is None else b.for_s) for b in flown.scenario.breaks)
    calm_s = max(ends) + _SETTLES_S
    lost = [e.t_s for e in flown.track.events if e.text.startswith(_LOST) and e.t_s > calm_s]
    return [f"estimates are lost at {lost} s"] if len(lost) > 1 else []
