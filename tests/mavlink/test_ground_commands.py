"""A ground station that asks the navigator itself: who may, and what comes back."""

import math

import pytest
from autopilot_links import ACCEPTED, DENIED, PX4, Clock, End, Way
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from vwnav.mavlink.autopilot import LinkedAutopilot
from vwnav.mavlink.ports.pymavlink_port import PymavlinkPort
from vwnav.vehicle import Order

STATION, STRANGER = (255, 190), (77, 190)
UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED


class Bench:
    """The navigator's end of a link, and whoever speaks on it."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.down, self.up = Way(self.clock), Way(self.clock)
        self.port = PymavlinkPort(End(self.down, self.up), self.clock)
        self.autopilot = LinkedAutopilot(self.port, self.clock, ground_station_ids=(255,))
        self.speak(mavlink.MAVLink_heartbeat_message(2, PX4, 0, 0, 4, 3), (7, 1))

    def speak(self, message, sender=STATION) -> None:
        system, component = sender
        mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self.down.write(bytes(message.pack(mav)))
        self.port.poll()

    def command(self, number, parameter=0.0, sender=STATION, target=None) -> None:
        system, component = self.port.own_id if target is None else target
        rest = [0.0] * 6
        self.speak(
            mavlink.MAVLink_command_long_message(system, component, number, 0, parameter, *rest),
            sender,
        )

    def sent(self, name: str) -> list:
        data = b"".join(iter(self.up.read, b""))
        messages = mavlink.MAVLink(None).parse_buffer(data) or []
        return [each for each in messages if each.get_type() == name]


@pytest.mark.parametrize(
    ("number", "parameter", "order"),
    [
        (21, 0.0, Order.LAND), (20, 0.0, Order.RETURN), (193, 0.0, Order.PAUSE),
        (193, 1.0, Order.GO_ON), (300, 0.0, Order.START),
    ],
)  # fmt: skip
def test_a_station_of_ours_is_obeyed_and_answered(number, parameter, order):
    bench = Bench()
    bench.command(number, parameter)
    assert bench.autopilot.take_orders() == ((order,), ())
    assert bench.autopilot.take_orders() == ((), ())
    (answer,) = bench.sent("COMMAND_ACK")
    assert (answer.command, answer.result) == (number, ACCEPTED)
    assert (answer.target_system, answer.target_component) == STATION


@pytest.mark.parametrize("number", [21, 400, 176, 193])
def test_a_stranger_is_denied_and_it_is_said(number):
    bench = Bench()
    for _ in range(3):
        bench.command(number, sender=STRANGER)
    orders, refused = bench.autopilot.take_orders()
    assert orders == ()
    assert len(refused) == 1  # said once, answered each time
    assert "system 77" in refused[0]
    assert [each.result for each in bench.sent("COMMAND_ACK")] == [DENIED] * 3


def test_a_flood_of_strangers_is_not_answered_whole_and_hides_no_order():
    bench = Bench()
    bench.command(193)
    for _ in range(1000):
        bench.command(20, sender=STRANGER)
    assert bench.autopilot.take_orders()[0] == (Order.PAUSE,)
    for _ in range(200):
        bench.command(20, sender=STRANGER)
        bench.clock.t_s += 0.01
        assert bench.autopilot.take_orders() == ((), ())
    assert len(bench.sent("COMMAND_ACK")) < 20
    bench.clock.t_s += 1.0
    bench.command(20, sender=STRANGER)
    bench.autopilot.take_orders()
    assert [each.result for each in bench.sent("COMMAND_ACK")] == [DENIED]


def test_what_is_for_the_autopilot_or_for_everybody_is_not_ours():
    bench = Bench()
    for target in [(7, 1), (7, 0), (0, 0), (bench.port.own_id[0], 0)]:
        bench.command(21, target=target)
    assert bench.autopilot.take_orders() == ((), ())
    assert not bench.sent("COMMAND_ACK")


def test_a_command_that_the_navigator_does_not_know_is_unsupported():
    bench = Bench()
    bench.command(400)
    bench.command(193, math.nan)
    assert bench.autopilot.take_orders() == ((), ())
    assert [each.result for each in bench.sent("COMMAND_ACK")] == [UNSUPPORTED, UNSUPPORTED]


def test_a_station_is_heard_by_its_heartbeat_for_five_seconds():
    bench = Bench()
    assert not bench.autopilot.state().ground_station
    bench.speak(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), STRANGER)
    assert not bench.autopilot.state().ground_station
    bench.speak(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    assert bench.autopilot.state().ground_station
    bench.clock.t_s += 6.0
    assert not bench.autopilot.state().ground_station


@given(st.text(st.characters(min_codepoint=32), max_size=160), st.booleans())
def test_texts_reach_ground_stations_whole(text, warns):
    """Mission Planner shows warnings on its HUD, and no notice."""
    bench = Bench()
    bench.autopilot.send_text(text, warns)
    severity = mavlink.MAV_SEVERITY_WARNING if warns else mavlink.MAV_SEVERITY_NOTICE
    chunks = sorted(bench.sent("STATUSTEXT"), key=lambda each: each.chunk_seq)
    assert {each.severity for each in chunks} <= {severity}
    assert all(len(each.text) <= 50 for each in chunks)
    assert "".join(each.text for each in chunks) == text.encode("ascii", "replace").decode()
    assert len({each.id for each in chunks}) <= 1
