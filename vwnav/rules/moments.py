"""When something was so in a flight: the spans and moments that the rules speak of."""

import math

from vwnav.mission.mission import ASKS, Phase
from vwnav.rules.flight_log import FlightLog, Sent
from vwnav.rules.temporal import Span, inside, spans_where
from vwnav.vehicle import FlightMode, Order

_HOLE_S = 1.0  # of telemetry: in it the mode may have been any
NOT_OURS = frozenset(FlightMode) - {FlightMode.OFFBOARD}


def armed(log: FlightLog) -> list[Span]:
    """The motors run."""
    return spans_where(log.vehicle, lambda row: row.armed)


def flying(log: FlightLog) -> list[Span]:
    """In the air, with motors running."""
    return spans_where(log.vehicle, lambda row: row.armed and row.in_air)


def steered(log: FlightLog) -> list[Span]:
    """In the air, in Offboard: by us."""
    return spans_where(
        log.vehicle,
        lambda row: row.armed and row.in_air and row.mode is FlightMode.OFFBOARD,
        _HOLE_S,
    )


def taken(log: FlightLog) -> list[Span]:
    """From when on a person has the aircraft, until it is handed back, or stands disarmed."""
    words = handed_back(log)
    spans: list[Span] = []
    since_s: float | None = None
    for row in log.vehicle:
        if since_s is None and row.armed and row.mode is FlightMode.MANUAL:
            since_s = row.t_s
        elif since_s is not None:
            word_s = next((t_s for t_s in words if since_s < t_s <= row.t_s), None)
            if word_s is not None or row.mode is FlightMode.OFFBOARD or not row.armed:
                spans.append((since_s, row.t_s if word_s is None else word_s))
                since_s = None
    return spans if since_s is None else [*spans, (since_s, log.end_s)]


def handed_back(log: FlightLog) -> list[float]:
    """When a ground station asked the navigator to go on."""
    return [each.t_s for each in log.events if each.text == f"{ASKS} {Order.GO_ON.value}"]


def in_phases(log: FlightLog, *phases: Phase) -> list[Span]:
    """While the mission stands in one of them: until the next begins; the last phase goes on."""
    rows = log.phases
    found = spans_where(rows, lambda row: row.phase in phases)
    spans = [(since_s, math.nextafter(until_s, since_s)) for since_s, until_s in found]
    if rows and rows[-1].phase in phases:
        spans[-1] = (spans[-1][0], math.inf)
    return spans


def phase_begins(log: FlightLog, *phases: Phase) -> list[float]:
    """When it came to one of them."""
    return [row.t_s for row in log.phases if row.phase in phases]


def in_modes(log: FlightLog, modes: frozenset[FlightMode]) -> list[float]:
    """When one of them was flown, or the aircraft stood disarmed."""
    return [row.t_s for row in log.vehicle if row.mode in modes or not row.armed]


def touch_down_s(log: FlightLog) -> float:
    """When it came to the ground for good; infinity while it flies, or never flew."""
    flown = [row.t_s for row in log.vehicle if row.in_air]
    return math.inf if not flown or flown[-1] >= log.end_s else flown[-1]


def sent_armed(log: FlightLog) -> list[Sent]:
    """Estimates of an armed aircraft: standing disarmed, they may jump."""
    spans = armed(log)
    return [each for each in log.estimates if inside(each.t_s, spans)]
