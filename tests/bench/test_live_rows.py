"""Rows of the table that are flown in real time are judged as the autopilot that flies them."""

import contextlib
import random
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from vwnav.bench.flights.live import campaign, session
from vwnav.bench.flights.live.campaign import fly_live_row, live_rows
from vwnav.bench.flights.live.session import LiveFlight
from vwnav.bench.flights.rows import RowResult
from vwnav.bench.flights.table import TABLE, row_of
from vwnav.bench.flights.thesis.live import fly_live_test
from vwnav.bench.flights.thesis.tests import TESTS
from vwnav.bench.flights.track import FlightTrace, LogLine, Truth
from vwnav.errors import VwnavError
from vwnav.geometry.geodesy import LocalFrame
from vwnav.mission.mission import Phase
from vwnav.sim.memory_link import MemoryLink
from vwnav.vehicle import FlightMode, Order


class CutFlight:
    """A live flight whose link is cut on the route: down after that, so many metres away."""

    def __init__(self, manners: str, landed_m: float, folder: Path, flies: bool = True) -> None:
        self.ordered: list[Order] = []
        self._flies = flies
        self.simulator = SimpleNamespace(
            manners=manners, armed=True, pilot=None,
            order=self.ordered.append, bring_down=lambda _: None,
            relay=SimpleNamespace(autopilot_link=MemoryLink(time.monotonic, random.Random(1))),
        )  # fmt: skip
        self.track, self.begun_s, self.t_s = FlightTrace(), time.monotonic(), 60.0
        self.track.phases.append(LogLine(50.0, Phase.ROUTE.value))
        self.process, self.folder = SimpleNamespace(pid=1, send_signal=print), folder
        self.see = lambda: None
        self._landed_m, self._broken = landed_m, False
        self._look(0.0)

    def watch(self, done: object, _: float) -> bool:
        self.see()
        if self._broken:
            self.simulator.armed = False
            self._look(self._landed_m)
        return True

    def is_in(self, phase: Phase) -> bool:
        return phase is Phase.ROUTE

    def is_down(self) -> bool:
        return not self.simulator.armed

    def has_ended(self) -> bool:
        return False

    def note(self, _: str) -> None:
        self._broken = True

    def place_ned_m(self) -> np.ndarray:
        return self.track.truth[-1].position_ned_m

    def _look(self, north_m: float) -> None:
        place, still, armed = np.array([north_m, 0.0, 0.0]), np.zeros(3), self.simulator.armed
        now_s, stands = time.monotonic(), not (armed and self._flies)
        self.track.truth.append(Truth(now_s, place, still, FlightMode.LAND, armed, stands))


def live(name: str, flight: CutFlight, monkeypatch: pytest.MonkeyPatch) -> RowResult:
    monkeypatch.setattr(campaign, "live_flight", lambda *_: contextlib.nullcontext(flight))
    return fly_live_row(row_of(name), "link", flight.simulator, flight.folder)


@pytest.mark.parametrize(("manners", "passes"), [("px4", False), ("copter", True)])
def test_a_bound_of_arducopters_own_counts_where_one_flies(manners, passes, monkeypatch, tmp_path):
    flight = CutFlight(manners, 40.0, tmp_path)
    result = live("link cut for 3 s on the route", flight, monkeypatch)
    assert result.passed is passes, result.wrong


@pytest.mark.parametrize(("flies", "wrong"), [(False, ()), (True, ("it took off",))])
def test_motors_that_ran_on_the_ground_are_no_take_off(flies, wrong, monkeypatch, tmp_path):
    """What breaks at the arming has always seen them run."""
    flight = CutFlight("px4", 0.0, tmp_path, flies=flies)
    assert live("link cut for 3 s while arming", flight, monkeypatch).wrong == wrong


@pytest.mark.parametrize(("name", "ordered"), [
    ("link cut for 1 s while returning", [Order.RETURN]), ("link cut for 1 s on the route", []),
])  # fmt: skip
def test_a_row_of_the_way_home_begins_by_an_order(name, ordered, monkeypatch, tmp_path):
    """No route enters that phase by itself: such rows never began."""
    flight = CutFlight("px4", 0.0, tmp_path)
    live(name, flight, monkeypatch)
    assert flight.ordered == ordered


def test_no_row_is_flown_live_that_wants_a_parameter_of_the_autopilot():
    named = [row.name for row in live_rows(TABLE, True) if row.setup.parameters]
    assert named == []


def test_a_row_on_the_ground_begins_while_it_gets_ready_which_status_lines_alone_tell(tmp_path):
    """Rows of the ground broke once it took off: their first phase that was said."""
    truth = Truth(0.0, np.zeros(3), np.zeros(3), FlightMode.HOLD, False, True)
    simulator = SimpleNamespace(
        look=lambda _: truth, where=SimpleNamespace(frame_here=lambda: LocalFrame(41.1, 29.0, 0.0))
    )
    status = "  0.2 s  getting ready     N    -0.0 E     0.0 up  -0.0 m  sigma  5.0 m  fix none"
    (tmp_path / "log").write_text(f"{status}\n{status}\n  5.4 s  taking off\n")
    flight = LiveFlight(simulator, SimpleNamespace(), tmp_path, lambda _: None)  # type: ignore[arg-type]
    flight.watch(lambda: True, 1.0)
    assert [each.text for each in flight.track.phases] == ["getting ready", "taking off"]
    flight.close()


def test_a_program_that_does_not_begin_is_quoted(tmp_path, monkeypatch):
    """A folder in use was told as "the last it said is: nothing"; its flight is another one's."""
    refused = f"vwnav: {tmp_path}/run already holds a run; give another folder with -o"
    started = []

    def ending(command, **more):
        started.append(command)
        return subprocess.Popen([sys.executable, "-c", f"print({refused!r})"], **more)

    truth = Truth(0.0, np.zeros(3), np.zeros(3), FlightMode.HOLD, False, True)
    where = SimpleNamespace(
        reference="true", fly_words=list, frame_here=lambda: LocalFrame(41.1, 29.0, 0.0)
    )
    simulator = SimpleNamespace(
        armed=False, pilot=None, manners="px4", where=where, look=lambda _: truth,
        relay=SimpleNamespace(url="", autopilot_link=None),
        order=lambda _: None, bring_down=lambda _: None,
    )  # fmt: skip
    (tmp_path / "run").mkdir()  # of a flight before
    monkeypatch.setattr(session, "subprocess", SimpleNamespace(Popen=ending))
    result = fly_live_row(row_of("link cut for 3 s on the route"), "link", simulator, tmp_path)
    assert result.wrong == (f"it never got on route; the last it said is: {refused}",)
    assert started[0][-1] == str(tmp_path / "run-2")
    with pytest.raises(VwnavError, match=f"never got ready; the last it said is: {refused}"):
        fly_live_test(TESTS["hover"], simulator, tmp_path, print)
