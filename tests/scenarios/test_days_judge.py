"""What is asked of a day is red where it is broken, and green where it is not."""

from dataclasses import replace

import numpy as np
import pytest
from days import against_stations, day, restless

from vwnav.bench.flights.faults.link import LinkCut
from vwnav.bench.flights.scenario import Break, Flown
from vwnav.bench.flights.track import FlightTrace, LogLine, Truth
from vwnav.geometry.geodesy import LocalFrame
from vwnav.mission.mission import Phase
from vwnav.rules.flight_log import LoggedCommand, LoggedSetpoint
from vwnav.vehicle import FlightMode

BEGUN_S, ASKS_S, LAND = 5.0, 10.0, 21


def flown_day() -> Flown:
    """A station takes the aircraft into Hold ten seconds after the beginning; a link was cut."""
    track = FlightTrace()
    for t_s in np.arange(BEGUN_S, BEGUN_S + 60.0, 0.02).tolist():
        mode = FlightMode.OFFBOARD if t_s < BEGUN_S + ASKS_S + 0.1 else FlightMode.HOLD
        track.truth.append(Truth(t_s, np.zeros(3), np.zeros(3), mode, True, False, 0.9))
    track.events.append(LogLine(ASKS_S, "a second station asks for HOLD"))
    track.heard.setpoints.append(LoggedSetpoint(BEGUN_S + ASKS_S + 0.3, (0.0, 0.0, 0.0), 191))
    scenario = replace(day(0), breaks=(Break(fault=LinkCut(), at_s=3.0, for_s=4.0),))
    return Flown(
        scenario=scenario, track=track, begun_s=BEGUN_S, flown_s=60.0,
        local_frame=LocalFrame(50.0, 8.0, 0.0), phase=Phase.RELEASED, steps=(), second_steps=(),
        broke_s=3.0, broken=(), stood=(), end=None,
    )  # fmt: skip


def test_what_was_on_its_way_when_a_station_took_it_is_nothing_against_it() -> None:
    assert against_stations(flown_day()) == []


@pytest.mark.parametrize("gives_back_s", [None, 12.0])
def test_what_is_asked_for_later_is_until_a_person_gives_it_back(
    gives_back_s: float | None,
) -> None:
    flown = flown_day()
    late_s = BEGUN_S + ASKS_S + 5.0
    flown.track.heard.setpoints.append(LoggedSetpoint(late_s, (0.0, 0.0, 0.0), 191))
    flown.track.heard.commands.append(LoggedCommand(late_s, LAND, (0.0, 0.0, 0.0), 191))
    if gives_back_s is not None:
        flown.track.events.append(LogLine(gives_back_s, "pilot hands back"))
    assert len(against_stations(flown)) == (2 if gives_back_s is None else 0)


@pytest.mark.parametrize(("times_s", "is_red"), [((5.0, 8.0, 11.0), False), ((30.0, 33.0), True)])
def test_estimates_that_are_lost_again_and_again_long_after_are_restless(
    times_s: tuple[float, ...], is_red: bool
) -> None:
    flown = flown_day()
    lost = "the estimate is not sent any more: the watchdog does not hand it on"
    flown.track.events += [LogLine(t_s, lost) for t_s in times_s]
    assert bool(restless(flown)) is is_red
