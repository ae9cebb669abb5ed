"""Who plays the pilot for an autopilot in simulation, as that one hears it."""

import socket
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.bench.flights.live import session
from vwnav.bench.flights.live.relay import MavlinkPilot
from vwnav.errors import VwnavError

PX4, COPTER = mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA


class Autopilot:
    """The link of an autopilot that waits for its pilot, of which heartbeats alone come."""

    def __init__(self, kind: int) -> None:
        self._kind, self._heard = kind, list[Any]()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.2)
        self.others: tuple[int, ...] = ()
        self.url = f"udpout://127.0.0.1:{self._socket.getsockname()[1]}"

    def hear(self, until: Callable[[list[Any]], bool], seconds: float = 5.0) -> list[Any]:
        """What has come by the time that it is enough."""
        end_s = time.monotonic() + seconds
        while not until(self._heard) and time.monotonic() < end_s:
            try:
                data, pilot = self._socket.recvfrom(1000)
            except TimeoutError:
                continue
            self._heard += mavlink.MAVLink(None).parse_buffer(data) or []
            beat = mavlink.MAVLink_heartbeat_message(2, self._kind, 0, 0, 3, 3)
            for system in (3, *self.others):
                mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
                self._socket.sendto(beat.pack(mav), pilot)
        return self._heard

    def close(self) -> None:
        self._socket.close()


def told(heard: list[Any], name: str) -> list[Any]:
    return [each for each in heard if each.get_type() == name]


def receivers(heard: list[Any]) -> list[float]:
    """What was asked of the simulated receiver: 1 is no pulse at all, 0 as it was."""
    asked = told(heard, "PARAM_SET")
    return [each.param_value for each in asked if each.param_id == "SIM_RC_FAIL"]


@pytest.mark.parametrize(
    ("kind", "sticks", "expected"),
    [(PX4, "MANUAL_CONTROL", []), (COPTER, "RC_CHANNELS_OVERRIDE", [1.0, 0.0])],
)
def test_a_radio_that_is_off_leaves_no_receiver_that_still_hears(kind, sticks, expected):
    """ArduPilot's simulator has one of its own, which takes over when the sticks fall silent."""
    autopilot = Autopilot(kind)
    pilot = MavlinkPilot(autopilot.url, lambda _: None, lambda: 3)
    try:
        autopilot.hear(lambda heard: len(told(heard, sticks)) > 2)
        pilot.switch_radio_off()
        autopilot.hear(lambda heard: len(receivers(heard)) >= len(expected[:1]) and expected, 2.0)
    finally:
        pilot.close()
    assert receivers(autopilot.hear(lambda heard: receivers(heard) == expected, 2.0)) == expected
    autopilot.close()


def test_of_several_on_the_port_the_one_that_is_flown_has_the_pilot():
    """Every simulator of PX4's sends to its ground station's port, 14550."""
    autopilot = Autopilot(PX4)
    autopilot.others = (4,)
    pilot = MavlinkPilot(autopilot.url, lambda _: None, lambda: 3)
    try:
        autopilot.hear(lambda heard: len(told(heard, "MANUAL_CONTROL")) > 5)
        pilot.take_over()
        heard = autopilot.hear(lambda heard: bool(told(heard, "COMMAND_LONG")))
    finally:
        pilot.close()
        autopilot.close()
    assert {each.target for each in told(heard, "MANUAL_CONTROL")} == {3}
    assert [each.target_system for each in told(heard, "COMMAND_LONG")] == [3]


def test_a_pilot_whose_link_hears_nobody_is_told_before_anything_flies(monkeypatch):
    monkeypatch.setattr(session, "_PILOT_S", 0.1)
    deaf = SimpleNamespace(pilot=SimpleNamespace(hears=False))
    with pytest.raises(VwnavError, match=r"pilot's link udpout://127\.0\.0\.1:14550"):
        session.Simulator.wait_for_pilot(deaf, "udpout://127.0.0.1:14550")
    session.Simulator.wait_for_pilot(SimpleNamespace(pilot=None), None)


def test_what_a_flight_was_watched_for_is_noted_too():
    flight = object.__new__(session.LiveFlight)
    noted = []
    flight._look, flight.see = lambda: noted.append("looked"), lambda: noted.append("seen")
    assert flight.watch(lambda: True, 1.0)
    assert noted == ["looked", "seen"]
