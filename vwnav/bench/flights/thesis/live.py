"""The three tests in real time: `vwnav fly` against an autopilot in simulation."""

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from vwnav.bench.flights.live.session import LiveFlight, Simulator, live_flight
from vwnav.bench.flights.live.whereabouts import place_ned_m
from vwnav.bench.flights.thesis.samples import SAMPLE_S, Sample
from vwnav.bench.flights.thesis.tests import GIVES_BACK_S, HOVER, RADIO_OFF_S, TAKES_S, FlightTest
from vwnav.errors import VwnavError
from vwnav.mission.mission import Phase
from vwnav.vehicle import FlightMode, Order

_ROUTE_S, _DOWN_S, _PERSON_S = 150.0, 240.0, 60.0
_ISA_M, _ISA_POWER = 44330.8, 0.190263  # ISO 2533: height of a ratio of pressures

Say = Callable[[str], None]


def fly_live_test(
    test: FlightTest, simulator: Simulator, folder: Path, say: Say
) -> tuple[list[Sample], list[str]]:
    """Fly it; what was noted, and what the program said, a line each.

    Args:
        test: one of the three.
        simulator: that flies; without a pilot's link a person plays his part.
        folder: of everything that is written.
        say: tells that person what to do next.

    Raises:
        VwnavError: the program ended before it flew.
    """
    route = "".join(
        f"{i + 1},{north},{east},{-down}\n"
        for i, (north, east, down) in enumerate(test.scenario.setup.route_ned_m)
    )
    settings = ""
    if test.name == HOVER.name:
        flight_config = test.scenario.setup.config.flight
        settings = (
            f"[flight]\nfixes_to_start = {flight_config.fixes_to_start}\n"
            f"first_fix_timeout_s = {flight_config.first_fix_timeout_s}\n"
        )
    tell = say if simulator.where.reference == "fused" else _to_nobody
    with live_flight(simulator, folder, route, settings=settings, tell=tell) as flight:
        sampler = LiveSampler(flight)
        if flight.has_ended():
            raise VwnavError(f"it never got ready; the last it said is: {flight.last_words()}")
        sampler()  # one at least
        flight.see = sampler
        if test.name == "failsafe":
            _play_the_pilot(flight, say)
        flight.watch(lambda: flight.is_down() or flight.has_ended(), _DOWN_S)
    simulator.bring_down(_DOWN_S)
    return sampler.samples, [f"{each.t_s:.1f} s {each.text}" for each in flight.track.events]


def _to_nobody(line: str) -> None:
    """Where all is simulated, the program's own words are in its log."""


def _play_the_pilot(flight: LiveFlight, say: Say) -> None:
    """Takes over on the route, hands back, and switches the radio off; or asks a person to."""
    pilot = flight.simulator.pilot
    if not flight.watch(lambda: flight.is_in(Phase.ROUTE) or flight.has_ended(), _ROUTE_S):
        return
    _wait(flight, TAKES_S)
    if pilot is None:
        _ask(flight, say, "take over by the sticks, or by the mode switch", FlightMode.MANUAL)
        _ask(flight, say, f"hand back: {_how_to_hand_back(flight)}", FlightMode.OFFBOARD)
        _ask(flight, say, "switch the radio off, where the site is safe for it", FlightMode.HOLD)
        return
    pilot.take_over()
    _wait(flight, GIVES_BACK_S - TAKES_S)
    flight.simulator.order(Order.GO_ON)
    _wait(flight, RADIO_OFF_S - GIVES_BACK_S)
    pilot.switch_radio_off()


def _how_to_hand_back(flight: LiveFlight) -> str:
    system, component = flight.simulator.navigators_id or ("its own", "its own")
    return (
        "have a ground station send DO_PAUSE_CONTINUE (1: go on) to vwnav itself (system "
        f"{system}, component {component}); vwnav then asks for Offboard. The mode switch hands "
        "nothing back: PX4 takes Offboard from nobody who sends no setpoints"
    )


def _ask(flight: LiveFlight, say: Say, what: str, until: FlightMode) -> None:
    """Say what to do next, and wait for it."""
    say(f"now {what}")
    if not flight.watch(lambda: flight.simulator.mode is until, _PERSON_S):
        say(f"not seen within {_PERSON_S:.0f} s: going on")


def _wait(flight: LiveFlight, seconds: float) -> None:
    until_s = time.monotonic() + seconds
    flight.watch(lambda: time.monotonic() >= until_s, seconds)


class LiveSampler:
    """Notes a flight in real time: its truth, where that is told, and what passes the link."""

    def __init__(self, flight: LiveFlight) -> None:
        self.samples: list[Sample] = []
        self._flight = flight
        self._due_s = 0.0
        self._first_hpa: float | None = None

    def __call__(self) -> None:
        """Take a sample when one is due."""
        if self._flight.t_s >= self._due_s:
            self._due_s = self._flight.t_s + SAMPLE_S
            self.samples.append(self._sample())

    def _sample(self) -> Sample:
        flight, heard = self._flight, self._flight.simulator.heard
        where, told = flight.simulator.where, flight.track.truth[-1]
        yaw_deg = where.yaw_deg()
        true = told.position_ned_m if where.reference == "true" else np.full(3, math.nan)
        sent = place_ned_m(heard.get("VISION_POSITION_ESTIMATE"), heard, flight.home)
        fused = flight.simulator.own_place_ned_m(flight.home)
        attitude, order = heard.get("ATTITUDE"), heard.get("SET_POSITION_TARGET_LOCAL_NED")
        compass_deg = math.nan if attitude is None else math.degrees(attitude.yaw)
        commanded_deg = math.nan
        if order is not None and told.mode is FlightMode.OFFBOARD:
            # Headings are commanded by the compass: what matters is how well it is followed.
            off_deg = yaw_deg - compass_deg if where.reference == "true" else 0.0
            commanded_deg = math.degrees(order.yaw) + off_deg
        return Sample(
            t_s=flight.t_s,
            mode=told.mode.name,
            phase=flight.track.phases[-1].text if flight.track.phases else "",
            true_north_m=float(true[0]),
            true_east_m=float(true[1]),
            true_up_m=-float(true[2]),
            true_yaw_deg=yaw_deg,
            estimated_north_m=float(sent[0]),
            estimated_east_m=float(sent[1]),
            estimated_up_m=-float(sent[2]),
            estimated_yaw_deg=math.nan,  # the link carries the autopilot's own
            fused_north_m=float(fused[0]),
            fused_east_m=float(fused[1]),
            fused_up_m=-float(fused[2]),
            fused_yaw_deg=compass_deg,
            barometer_up_m=self._pressure_height_m(heard.get("SCALED_PRESSURE")),
            commanded_yaw_deg=commanded_deg,
        )

    def _pressure_height_m(self, message: Any) -> float:
        if message is None:
            return math.nan
        if self._first_hpa is None:
            self._first_hpa = message.press_abs
        return float(_ISA_M * (1.0 - (message.press_abs / self._first_hpa) ** _ISA_POWER))
