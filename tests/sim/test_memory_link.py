"""Links in memory: late, lossy, slow or cut, by the simulated clock; and the vehicle over one."""

import random

from pymavlink.dialects.v20 import development as mavlink

from vwnav.sim.config import VehicleConfig
from vwnav.sim.core import Peer, Role, VehicleCore
from vwnav.sim.mavlink.link import ByteLink
from vwnav.sim.memory_link import MemoryLink
from vwnav.sim.multirotor.simulated import STEP_S
from vwnav.sim.processor import SimulatedClock


def link_of(latency_s: float = 0.0) -> tuple[SimulatedClock, MemoryLink]:
    clock = SimulatedClock()
    return clock, MemoryLink(clock, random.Random(1), latency_s)


def test_a_packet_arrives_whole_and_after_the_latency():
    clock, link = link_of(0.25)
    link.a.write(b"one")
    link.a.write(b"two")
    clock.now_s = 0.24
    assert link.b.read() == b""
    clock.now_s = 0.25
    assert [link.b.read() for _ in range(3)] == [b"one", b"two", b""]
    assert link.a.read() == b""


def test_a_line_that_becomes_faster_overtakes_nothing():
    clock, link = link_of(0.25)
    link.a.write(b"one")
    link.a_to_b.latency_s = 0.1
    link.a.write(b"two")
    clock.now_s = 0.24
    assert link.b.read() == b""
    clock.now_s = 0.25
    assert [link.b.read() for _ in range(3)] == [b"one", b"two", b""]


def test_what_is_written_while_it_is_cut_never_arrives():
    _, link = link_of()
    link.cut(True)
    link.a.write(b"lost")
    link.b.write(b"lost")
    link.cut(False)
    link.a.write(b"after")
    assert link.b.read() == b"after"
    assert link.a.read() == b""


def test_one_way_alone_can_be_cut():
    _, link = link_of()
    link.a_to_b.cut = True
    link.a.write(b"lost")
    link.b.write(b"heard")
    assert (link.b.read(), link.a.read()) == (b"", b"heard")


def test_a_serial_line_carries_its_baud_rate_and_no_more():
    clock, link = link_of()
    link.a_to_b.baud = 57600
    for _ in range(20):
        link.a.write(bytes(576))
    clock.now_s = 1.0
    heard = 0
    while data := link.b.read():
        heard += len(data)
    assert heard == 5760


def test_a_full_serial_queue_drops_what_comes():
    clock, link = link_of()
    link.a_to_b.baud = 57600
    for _ in range(1000):
        link.a.write(bytes(1000))
    clock.now_s = 1000.0
    heard = 0
    while data := link.b.read():
        heard += len(data)
    assert 65536 < heard < 68000


def test_lost_packets_are_those_of_the_seed():
    heard = []
    for _ in range(2):
        _, link = link_of()
        link.a_to_b.loss = 0.5
        for number in range(100):
            link.a.write(bytes([number]))
        heard.append(b"".join(iter(link.b.read, b"")))
    assert heard[0] == heard[1]
    assert 30 < len(heard[0]) < 70


def bytes_of_a_vehicle(seconds: float, rate: float = 1.0) -> list[tuple[float, bytes]]:
    clock, link = link_of()
    peer = Peer(ByteLink(link.a, 1), Role.COMPANION)
    core = VehicleCore(VehicleConfig(seed=4), [peer], lambda: rate * clock())
    companion = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    heard = []
    for step in range(round(seconds / STEP_S)):
        clock.now_s = step * STEP_S
        if step % 100 == 0:
            link.b.write(mavlink.MAVLink_timesync_message(0, step * 4_000_000).pack(companion))
        core.step_to_now(10)
        heard += [(clock.now_s, data) for data in iter(link.b.read, b"")]
    return heard


def test_a_vehicle_in_memory_says_the_same_bytes_each_time():
    first = bytes_of_a_vehicle(3.0)
    assert len(first) > 1000
    assert first == bytes_of_a_vehicle(3.0)


def test_a_vehicle_whose_clock_is_slow_falls_behind_by_that():
    heard = bytes_of_a_vehicle(4.0, rate=0.98)
    parser = mavlink.MAVLink(None)
    stamps = [
        (t_s, message.time_boot_ms * 1e-3)
        for t_s, data in heard
        for message in parser.parse_buffer(data)
        if message.get_type() == "ATTITUDE"
    ]
    (first_s, first_boot_s), (last_s, last_boot_s) = stamps[0], stamps[-1]
    assert abs((last_boot_s - first_boot_s) / (last_s - first_s) - 0.98) < 0.005


def test_a_reboot_starts_the_vehicles_clock_anew():
    clock, link = link_of()
    core = VehicleCore(VehicleConfig(), [Peer(ByteLink(link.a, 1), Role.COMPANION)], clock)
    companion = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    clock.now_s = 2.0
    core.step_to_now(1000)
    reboot = mavlink.MAVLink_command_long_message(1, 1, 246, 0, 1, 0, 0, 0, 0, 0, 0)
    link.b.write(reboot.pack(companion))
    clock.now_s = 2.1
    core.step_to_now(1000)
    assert core.vehicle.t_s < 0.1
    assert abs(core.lag_s) < 2 * STEP_S
