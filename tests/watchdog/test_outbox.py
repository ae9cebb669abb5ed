"""A slow link: commands first, the newest of what repeats itself, whole packets only."""

import contextlib
import socket
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.mavlink import links
from vwnav.mavlink.framing import Framer, Packet, packet_at
from vwnav.mavlink.links import StreamLink, parse_link
from vwnav.watchdog.outbox import Outbox

MAV = mavlink.MAVLink(None, srcSystem=7, srcComponent=191)
BAUD = 57600


def packed(message) -> Packet:
    packet = packet_at(bytes(message.pack(MAV)), 0)
    assert packet is not None
    return packet


def estimate(t_s: float) -> Packet:
    usec = int(t_s * 1e6)
    values = [1.1, 2.2, -50.3, 0.4, 0.5, 0.6]
    message = mavlink.MAVLink_vision_position_estimate_message(usec, *values, [0.7] * 21, 1)
    return packed(message)


def setpoint(t_s: float) -> Packet:
    message = mavlink.MAVLink_set_position_target_local_ned_message(
        int(t_s * 1e3), 7, 1, 1, 2503, 0, 0, 0, 3.3, *[0.1] * 7
    )
    return packed(message)


def command(number: int) -> Packet:
    return packed(mavlink.MAVLink_command_long_message(7, 1, number, 0, *[1.5] * 7))


class Wire:
    """Takes so many packets and then has no room."""

    def __init__(self, room: int) -> None:
        self.room, self.written = room, []

    def has_room(self) -> bool:
        return self.room > 0

    def write(self, data: bytes) -> None:
        self.room -= 1
        self.written.append(data)


def test_own_words_go_before_commands_before_the_rest_before_streams():
    packets = [estimate(0.1), command(512), setpoint(0.1), command(400)]
    question = packed(mavlink.MAVLink_param_request_read_message(7, 1, b"A", -1))
    outbox, own, wire = Outbox(), command(176), Wire(99)
    for packet in (*packets, question):
        outbox.put(packet, 0.1)
    outbox.put_own(own, 0.1)
    outbox.flush(wire, 0.1)
    first = [p.data for p in (own, packets[1], packets[3], question)]
    assert wire.written == [*first, packets[0].data, packets[2].data]


def test_of_what_repeats_itself_the_newest_waits():
    outbox, wire = Outbox(), Wire(0)
    for i in range(100):
        outbox.put(estimate(i * 0.02), i * 0.02)
        outbox.put(setpoint(i * 0.02), i * 0.02)
        outbox.flush(wire, i * 0.02)
    wire.room = 99
    outbox.flush(wire, 1.98)
    assert wire.written == [estimate(1.98).data, setpoint(1.98).data]


def test_a_question_of_time_and_an_answer_are_two_things():
    outbox, wire = Outbox(), Wire(9)
    question = packed(mavlink.MAVLink_timesync_message(0, 7_000_000_001))
    answer = packed(mavlink.MAVLink_timesync_message(6_000_000_001, 5_000_000_001))
    for packet in (question, answer, question):
        outbox.put(packet, 0.0)
    outbox.flush(wire, 0.0)
    assert wire.written == [question.data, answer.data]


def test_what_has_waited_too_long_is_dropped():
    outbox, wire = Outbox(), Wire(0)
    outbox.put(estimate(0.0), 0.0)
    outbox.put(command(512), 0.0)
    outbox.flush(wire, 0.3)
    wire.room = 9
    outbox.flush(wire, 0.3)
    assert wire.written == [command(512).data]
    outbox.put(command(512), 0.3)
    outbox.flush(wire, 1.5)
    assert len(wire.written) == 1


def test_who_lost_the_aircraft_has_nothing_left_in_the_queue():
    outbox, wire = Outbox(), Wire(9)
    for packet in (estimate(0.0), setpoint(0.0), command(400)):
        outbox.put(packet, 0.0)
    outbox.drop_handed_on()
    outbox.flush(wire, 0.0)
    assert wire.written == []


@given(st.lists(st.integers(1, 30), max_size=60))
def test_the_queue_is_bounded_whatever_is_put(sizes):
    outbox, wire = Outbox(), Wire(10**6)
    for size in sizes:
        for _ in range(size):
            outbox.put(command(512), 0.0)
    outbox.flush(wire, 0.0)
    assert sum(map(len, wire.written)) <= 4096


def estimate_t_s(packet: Packet) -> float:
    return int.from_bytes(packet.data[10:18], "little") / 1e6


class SlowWire:
    """A serial line: what it has not carried yet waits in the system's buffer, as a UART's does."""

    def __init__(self, far: socket.socket) -> None:
        far.setblocking(False)
        self.far, self.link = far, StreamLink(parse_link(f"serial:///dev/ttyTEST:{BAUD}"))
        self.start_s, self.carried, self.framer = time.monotonic(), 0, Framer()

    def take(self) -> list[Packet]:
        """What has come through by now."""
        carries = int((time.monotonic() - self.start_s) * BAUD / 10) - self.carried
        if carries <= 0:
            return []
        self.carried += carries
        with contextlib.suppress(BlockingIOError):
            return self.framer.split(self.far.recv(carries))
        return []


@pytest.fixture
def wire(monkeypatch):
    near, far = socket.socketpair()
    near.setblocking(False)
    monkeypatch.setattr(links, "_open_stream", lambda *_: near)
    slow = SlowWire(far)
    yield slow
    slow.link.close()
    far.close()


def test_a_land_overtakes_the_estimates_on_a_slow_wire_and_no_packet_is_cut(wire):
    outbox, arrived, asked_s = Outbox(), [], 0.0
    while time.monotonic() - wire.start_s < 3.0:
        now_s = time.monotonic()
        outbox.put(estimate(now_s), now_s)
        outbox.put(setpoint(now_s), now_s)
        if not asked_s and now_s - wire.start_s > 2.0:
            asked_s = now_s
            outbox.put_own(command(176), now_s)
        outbox.flush(wire.link, now_s)
        arrived += [(time.monotonic(), p) for p in wire.take()]
        time.sleep(0.01)
    assert all(p.message_id is not None for _, p in arrived)
    land_s = next(t for t, p in arrived if p.message_id == 76)
    assert land_s - asked_s < 0.3  # behind 64 KiB it would be 11 s
    ages_s = [t - estimate_t_s(p) for t, p in arrived if p.message_id == 102]
    assert len(ages_s) > 40
    assert max(ages_s) < 0.3
