"""The truth reader, against a sender of either kind, and garbage between the messages."""

import math
import random
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from px4_client import free_port
from pymavlink.dialects.v20 import development as mavlink

from vwnav.errors import ConfigError, LinkError
from vwnav.sim.mavlink import truth_line
from vwnav.sim.truth import TruthReader
from vwnav.sim.truth_state import TruthState, between

PACKER = mavlink.MAVLink(None, srcSystem=3, srcComponent=1)
ANOTHERS = mavlink.MAVLink(None, srcSystem=4, srcComponent=1)


def hil(
    north_deg: float = 41.0, usec: int = 0, w: float = -1.0, x: float = 0.0, packer: Any = PACKER
) -> bytes:
    place = (round(north_deg * 1e7), 290000000, 50000)
    message = mavlink.MAVLink_hil_state_quaternion_message(
        usec, [w, x, 0.0, 0.0], 0.1, 0.2, 0.3, *place, 100, -200, 50, 0, 0, 0, 0, 0
    )
    return bytes(message.pack(packer))


def sim_state(north_deg: float = 41.0000001) -> bytes:
    message = mavlink.MAVLink_sim_state_message(
        *(1.0, 0.0, 0.0, 0.0), *([0.0] * 3), *([0.0] * 3), *([0.0] * 3),
        41.0, 29.0, 50.0, 0.0, 0.0, 1.0, 2.0, 3.0, round(north_deg * 1e7), 290000002,
    )  # fmt: skip
    return bytes(message.pack(PACKER))


def system_time(t_s: float) -> bytes:
    return bytes(mavlink.MAVLink_system_time_message(0, round(t_s * 1e3)).pack(PACKER))


class Sender:
    """A simulator on UDP that sends to the reader's port."""

    def __init__(self) -> None:
        self.port = free_port()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(3.0)
        self.reader = TruthReader(f"udpin:127.0.0.1:{self.port}")

    def send(self, data: bytes) -> None:
        self.socket.sendto(data, ("127.0.0.1", self.port))

    def heard(self, kind: str) -> Any:
        for _ in range(20):
            if (message := self._next(kind)) is not None:
                return message
        return None

    def asked(self, kind: str) -> Any:
        """One that has come already."""
        while select.select([self.socket], [], [], 0.0)[0]:
            if (message := self._next(kind)) is not None:
                return message
        return None

    def _next(self, kind: str) -> Any:
        for message in mavlink.MAVLink(None).parse_buffer(self.socket.recv(1000)) or []:
            if message.get_type() == kind:
                return message
        return None


@pytest.fixture
def sender() -> Iterator[Sender]:
    sender = Sender()
    yield sender
    sender.reader.close()
    sender.socket.close()


def test_it_reads_hil_state_quaternion_with_a_negative_w(sender: Sender) -> None:
    sender.send(hil())
    state = sender.reader.wait(2.0)
    assert state is not None
    assert (state.lat_deg, state.lon_deg, state.alt_amsl_m) == pytest.approx((41.0, 29.0, 50.0))
    assert state.velocity_ned_m_s == pytest.approx((1.0, -2.0, 0.5))
    assert state.quat_wxyz[0] == -1.0
    assert time.monotonic() - state.t_s < 1.0


def test_it_reads_the_integer_place_of_sim_state(sender: Sender) -> None:
    sender.send(sim_state())
    state = sender.reader.wait(2.0)
    assert state is not None
    assert state.lat_deg == pytest.approx(41.0000001, abs=1e-9)
    assert state.velocity_ned_m_s == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(("autopilot", "number"), [(12, 115), (3, 108)])
def test_it_asks_for_the_message_of_the_vehicle_it_hears(
    sender: Sender, autopilot: int, number: int
) -> None:
    for source, kind in ((1, autopilot), (154, 0), (190, 8)):  # autopilot, gimbal, ground station
        packer = mavlink.MAVLink(None, srcSystem=3, srcComponent=source)
        heartbeat = mavlink.MAVLink_heartbeat_message(2, kind, 0, 0, 3, 3)
        sender.send(bytes(heartbeat.pack(packer)))
    ask = sender.heard("COMMAND_LONG")
    assert (ask.target_system, ask.target_component, ask.command) == (3, 1, 511)
    assert (ask.param1, ask.param2) == (number, 10000.0)


def test_garbage_between_and_around_the_messages_does_not_matter(sender: Sender) -> None:
    rng = random.Random(1)
    for _ in range(50):
        sender.send(rng.randbytes(rng.randrange(1, 300)))
    sender.send(rng.randbytes(40) + hil() + rng.randbytes(40) + hil(42.0))
    sender.send(hil(43.0))
    sender.send(hil(43.0))
    end = time.monotonic() + 3.0
    while time.monotonic() < end:
        state = sender.reader.latest()
        if state is not None and state.lat_deg > 42.9:
            return
        sender.send(hil(43.0))
        time.sleep(0.02)
    pytest.fail("the last state did not come through")


def test_states_that_cannot_be_are_dropped(sender: Sender) -> None:
    sender.send(hil(w=math.nan))
    sender.send(hil(w=0.1))
    sender.send(hil(44.0))
    state = sender.reader.wait(2.0)
    assert state is not None
    assert state.lat_deg == pytest.approx(44.0)


def test_it_interpolates_between_two_states(sender: Sender) -> None:
    sender.send(hil(41.0))
    sender.reader.wait(2.0)
    time.sleep(0.1)
    sender.send(hil(42.0))
    time.sleep(0.1)
    first, last = sender.reader.at(0.0), sender.reader.at(math.inf)
    assert first is not None
    assert last is not None
    middle = sender.reader.at(0.5 * (first.t_s + last.t_s))
    assert middle is not None
    assert middle.lat_deg == pytest.approx(41.5, abs=1e-6)


def stamped(autopilot: int, i: int) -> bytes:
    """The state of 0.02 s times `i` after the first, as either simulator stamps it."""
    if autopilot == mavlink.MAV_AUTOPILOT_PX4:
        return hil(41.0 + i, usec=1_000_000 + 20_000 * i)
    return system_time(1.0 + 0.02 * i) + sim_state(41.0 + i)


@pytest.mark.parametrize("autopilot", [12, 3])
def test_a_burst_after_a_stall_is_spread_by_the_senders_stamps(
    sender: Sender, autopilot: int
) -> None:
    sender.send(stamped(autopilot, 0))
    sender.reader.wait(2.0)
    time.sleep(0.2)
    for i in range(1, 11):
        sender.send(stamped(autopilot, i))
    time.sleep(0.2)
    first, last = sender.reader.at(0.0), sender.reader.latest()
    assert first is not None
    assert last is not None
    assert last.t_s - first.t_s == pytest.approx(0.2, abs=0.05)
    middle = sender.reader.at(first.t_s + 0.1)
    assert middle is not None
    assert middle.lat_deg == pytest.approx(46.0, abs=2.5)


def test_a_state_without_a_time_among_stamped_ones_is_left_out(sender: Sender) -> None:
    sender.send(system_time(1.0) + sim_state(41.0) + sim_state(42.0))
    time.sleep(0.2)
    state = sender.reader.latest()
    assert state is not None
    assert state.lat_deg == pytest.approx(41.0)


def test_a_simulator_that_falls_behind_for_good_is_followed_by_its_answers(sender: Sender) -> None:
    """0.2 s behind: late messages look the same, its answers to TIMESYNC do not."""
    zero_s = time.monotonic() - 1.0  # when its clock showed zero
    for i in range(600):
        if i == 300:
            time.sleep(0.2)
            zero_s += 0.2  # it stood still meanwhile
        now_s = time.monotonic() - zero_s
        if i % 10 == 0:
            sent_s = now_s
            sender.send(hil(41.0 + i // 10, usec=round(now_s * 1e6)))
        if (question := sender.asked("TIMESYNC")) is not None:
            answer = mavlink.MAVLink_timesync_message(round(now_s * 1e9), question.ts1)
            sender.send(bytes(answer.pack(PACKER)))
        time.sleep(0.002)
    time.sleep(0.1)
    state = sender.reader.latest()
    assert state is not None
    assert state.t_s - zero_s == pytest.approx(sent_s, abs=0.03)


def test_of_two_vehicles_on_one_port_one_is_followed_until_it_is_silent(sender: Sender) -> None:
    """Ground stations' ports are shared: PX4's simulators all send to 14550."""
    sender.send(hil(41.0))
    sender.reader.wait(2.0)
    seen = set()
    for _ in range(20):
        sender.send(hil(51.0, packer=ANOTHERS) + hil(41.0) + hil(51.0, packer=ANOTHERS))
        time.sleep(0.01)
        seen.add(round(newest_deg(sender.reader)))
    assert seen == {41}
    time.sleep(3.1)
    sender.send(hil(51.0, packer=ANOTHERS))
    until(lambda: newest_deg(sender.reader) == pytest.approx(51.0))


def test_of_two_vehicles_on_one_port_the_one_that_is_followed_is_asked(sender: Sender) -> None:
    """The other one's rates are its owner's; what it does not hear, the right one cannot do."""
    sender.send(hil(41.0))
    sender.reader.wait(2.0)
    asked = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.setblocking(False)
        for _ in range(25):
            for socket_, packer in ((other, ANOTHERS), (sender.socket, PACKER)):
                beat = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)
                told = bytes(beat.pack(packer)) + hil(41.0, packer=packer)
                socket_.sendto(told, ("127.0.0.1", sender.port))
            time.sleep(0.05)
            if (request := sender.asked("COMMAND_LONG")) is not None:
                asked.append(request.target_system)
        assert set(asked) == {3}
        with pytest.raises(BlockingIOError):
            other.recv(1000)


def state_at(t_s: float, w: float = 1.0, lon_deg: float = 0.0) -> TruthState:
    return TruthState(t_s, 0.0, lon_deg, 0.0, (w, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3)


def test_the_longer_way_round_is_not_interpolated() -> None:
    middle = between(state_at(0.0), state_at(1.0, w=-1.0), 0.5)
    assert abs(middle.quat_wxyz[0]) == 1.0


def test_the_antimeridian_is_not_crossed_the_long_way() -> None:
    middle = between(state_at(0.0, lon_deg=179.9999), state_at(1.0, lon_deg=-179.9999), 0.4)
    assert middle.lon_deg == 179.9999


def test_it_reads_over_tcp() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]

        def serve() -> None:
            stream, _ = server.accept()
            with stream:
                stream.sendall(b"noise" + hil())
                stream.sendall(hil())
                time.sleep(0.5)

        thread = threading.Thread(target=serve)
        thread.start()
        reader = TruthReader(f"tcpout://127.0.0.1:{port}")
        assert reader.wait(2.0) is not None
        thread.join()
        reader.close()


def test_over_tcp_it_reads_on_when_the_simulator_has_started_anew() -> None:
    """ArduPilot's closes its ports when it is rebooted, and opens them again."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(5.0)
        reader = TruthReader(f"tcpout://127.0.0.1:{server.getsockname()[1]}")
        try:
            for north_deg in (41.0, 42.0):
                stream, _ = server.accept()
                with stream:
                    stream.sendall(hil(north_deg) + hil(north_deg))
                    until(lambda deg=north_deg: newest_deg(reader) == pytest.approx(deg))
        finally:
            reader.close()


def newest_deg(reader: TruthReader) -> float:
    state = reader.latest()
    return math.nan if state is None else state.lat_deg


def until(done: Callable[[], bool], timeout_s: float = 5.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not done():
        assert time.monotonic() < end_s
        time.sleep(0.01)


@pytest.mark.parametrize(
    "url", ["", "udpout::1", "serial:///dev/ttyACM0", "udpin:nowhere", "udpin:h:x"]
)
def test_a_url_that_is_none_says_so(url: str) -> None:
    with pytest.raises(ConfigError, match="udpout:HOST:PORT"):
        TruthReader(url)


def test_a_tcp_server_that_comes_a_moment_later_is_waited_for() -> None:
    """ArduPilot's simulator listens on its second port once its first one has somebody."""
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        threading.Timer(0.3, server.listen).start()
        reader = TruthReader(f"tcpout:127.0.0.1:{server.getsockname()[1]}")
        try:
            server.accept()[0].close()
        finally:
            reader.close()


def test_a_tcp_server_that_is_not_there_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(truth_line, "_CONNECT_S", 0.1)
    with pytest.raises(LinkError, match="cannot open tcpout"):
        TruthReader("tcpout:127.0.0.1:1")
