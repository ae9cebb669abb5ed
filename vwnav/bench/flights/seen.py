"""What a row of the table waits for."""

from vwnav.bench.flights.scenario import Follows
from vwnav.bench.flights.track import FlightTrace


def mode(within_s: float, *names: str) -> Follows:
    """The vehicle flies one of these modes, as a navigator calls them: BRAKE is HOLD."""

    def when(track: FlightTrace, begun_s: float) -> list[float]:
        return [each.t_s - begun_s for each in track.truth if each.mode.name in names]

    return Follows(f"mode {' or '.join(names)}", within_s, when)


def phase(within_s: float, *names: str) -> Follows:
    """The mission stands in one of these phases."""

    def when(track: FlightTrace, _: float) -> list[float]:
        return [each.t_s for each in track.phases if each.text in names]

    return Follows(f"phase {' or '.join(names)}", within_s, when)


def said(within_s: float, text: str) -> Follows:
    """The program says so."""

    def when(track: FlightTrace, _: float) -> list[float]:
        return [each.t_s for each in track.events if text in each.text]

    return Follows(f"says {text!r}", within_s, when)


def down(within_s: float) -> Follows:
    """On the ground, motors off."""

    def when(track: FlightTrace, begun_s: float) -> list[float]:
        return [each.t_s - begun_s for each in track.truth if not each.armed]

    return Follows("down", within_s, when)
