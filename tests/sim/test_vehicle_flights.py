"""Flights of the simulated vehicle over real MAVLink, all in the air at the same time."""

import random
import socket
import struct
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import mavsdk_flight
import pytest
from px4_client import Companion, Flight
from pymavlink.dialects.v20 import development as mavlink

HOLD, TAKEOFF, DESCEND = (4, 3), (4, 2), (4, 20)
POSITION, OFFBOARD = (3, 0), (6, 0)
Record = dict[str, Any]


def set_integer(c: Companion, name: str, value: int) -> None:
    wire = struct.unpack("<f", struct.pack("<i", value))[0]
    c.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), wire, 6))
    c.sleep(0.3)


def has_flags(flags: int) -> Callable[[Companion], bool]:
    return lambda c: "ESTIMATOR_STATUS" in c.latest and c.latest["ESTIMATOR_STATUS"].flags == flags


def fly_cycle() -> Record:
    """Refused, armed, up, Offboard, setpoints lost and back, down."""
    r: Record = {}
    with Flight(speed=2.0, wind_m_s=4.0) as c:
        c.wait(lambda c: "SYS_STATUS" in c.latest, 10.0)
        r["early_arm"] = c.command(400, 1)
        set_integer(c, "COM_OBL_RC_ACT", 5)
        r["up"] = c.take_off(8.0)
        r["offboard_without"] = c.set_mode(6)
        r["offboard"] = c.fly_offboard((3.0, 0.0, 0.0))
        c.sleep(5.0)
        r["speed"] = c.latest["LOCAL_POSITION_NED"].vx
        c.setpoint, r["lost_s"] = None, c.t_s
        r["held"] = c.wait(lambda c: c.mode() == HOLD, 5.0)
        r["status"] = c.latest["HEARTBEAT"].system_status
        c.setpoint = (0.0, 0.0, 0.0, 0.0)
        r["back"] = c.wait(lambda c: c.mode() == OFFBOARD, 5.0)
        r["land"] = c.command(21)
        r["down"] = c.wait(lambda c: not c.armed, 40.0)
        r["truth_m"] = c.truth.latest()
        r["texts"] = c.texts
        r["modes"] = [(main, sub) for _, main, sub in c.modes]
    return r


def fly_vision_loss() -> Record:
    """Vision stops in Offboard, and comes back."""
    r: Record = {}
    with Flight(speed=2.0) as c:
        r["up"] = c.take_off(12.0)
        c.fly_offboard((1.0, 0.0, 0.0))
        c.command(511, 230, 200_000)
        r["flying"] = c.wait(has_flags(0x17F), 4.0)
        c.vision, stopped_s = False, c.t_s
        r["dead_reckoning"] = c.wait(has_flags(0x07F), 4.0)
        r["descends"] = c.wait(lambda c: c.mode() == DESCEND, 8.0)
        r["after_s"] = c.t_s - stopped_s
        r["lost"] = c.wait(has_flags(0x065), 2.0)
        c.vision = True
        r["back"] = c.wait(lambda c: c.mode() == OFFBOARD, 5.0)
    return r


def fly_pilot() -> Record:
    """A pilot pushes a stick, hands back, and is a ground station that gets texts."""
    r: Record = {}
    with Flight(speed=2.0, mav_type=6) as c:
        r["up"] = c.take_off(8.0)
        r["texts"] = list(c.texts)
        c.fly_offboard((0.0, 0.0, 0.0))
        c.pitch = 0
        c.sleep(1.0)
        for i in range(60):  # forward and back, for a busy machine may swallow one push
            c.pitch = 40 * min(i % 20, 20 - i % 20)
            c.sleep(0.04)
        r["taken"] = c.wait(lambda c: c.mode() == POSITION, 3.0)
        c.pitch = 0
        c.sleep(1.0)
        r["given_back"] = c.set_mode(6)
        r["offboard"] = c.wait(lambda c: c.mode() == OFFBOARD, 3.0)
    return r


def stand_in_garbage() -> Record:
    """Noise, cut and changed packets, and strangers on the port, beside a companion."""
    r: Record = {}
    rng = random.Random(7)
    with Flight(speed=1.0) as c, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        c.wait(lambda c: "SYS_STATUS" in c.latest, 10.0)
        arm = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 21196, 0, 0, 0, 0, 0)
        packet = bytes(arm.pack(mavlink.MAVLink(None, srcSystem=9, srcComponent=9)))
        for i in range(400):
            cut, noise = packet[: rng.randrange(len(packet))], rng.randbytes(rng.randrange(1, 400))
            hurt = bytearray(packet)
            hurt[12 + i % 20] ^= 1 + i % 255
            for data in (cut, noise, bytes(hurt)):
                c.send_raw(data)
                stranger.sendto(data, c.peer)
        before, since_ms = c.count["ATTITUDE"], c.latest["ATTITUDE"].time_boot_ms
        c.sleep(2.0)
        ran_s = (c.latest["ATTITUDE"].time_boot_ms - since_ms) / 1e3  # by its own clock
        r["rate_hz"] = (c.count["ATTITUDE"] - before) / ran_s
        r["armed"] = c.armed
        r["answer"] = c.command(512, 148)
        c.wait(
            lambda c: "AUTOPILOT_VERSION" in c.latest, 2.0
        )  # a packet of its own, after the answer
        r["version"] = c.latest.get("AUTOPILOT_VERSION")
    return r


SCENARIOS = {
    "cycle": fly_cycle,
    "vision": fly_vision_loss,
    "pilot": fly_pilot,
    "garbage": stand_in_garbage,
    "mavsdk": mavsdk_flight.fly,
}


@pytest.fixture(scope="module")
def flights() -> Iterator[dict[str, Future[Any]]]:
    with ThreadPoolExecutor(len(SCENARIOS)) as pool:
        yield {name: pool.submit(scenario) for name, scenario in SCENARIOS.items()}


def test_arming_is_refused_without_a_position(flights: dict[str, Future[Record]]) -> None:
    assert flights["cycle"].result()["early_arm"] == 1


def test_it_arms_takes_off_flies_offboard_and_lands(flights: dict[str, Future[Record]]) -> None:
    r = flights["cycle"].result()
    assert r["up"]
    assert (r["offboard"], r["land"]) == (0, 0)
    assert r["speed"] == pytest.approx(3.0, abs=0.5)
    assert r["down"]
    assert r["truth_m"].alt_amsl_m == pytest.approx(40.0, abs=0.01)


def test_offboard_without_setpoints_is_temporarily_rejected(
    flights: dict[str, Future[Record]],
) -> None:
    assert flights["cycle"].result()["offboard_without"] == 1


def test_lost_setpoints_hold_and_offboard_returns_by_itself(
    flights: dict[str, Future[Record]],
) -> None:
    r = flights["cycle"].result()
    assert r["held"]
    assert r["status"] == 5
    assert r["back"]
    assert r["modes"][-1] == OFFBOARD  # after disarming too, as recorded


def test_lost_vision_clears_the_flags_and_descends_after_5_s(
    flights: dict[str, Future[Record]],
) -> None:
    r = flights["vision"].result()
    assert (r["flying"], r["dead_reckoning"], r["lost"], r["descends"]) == (True,) * 4
    assert 4.5 < r["after_s"] < 6.6  # HEARTBEAT is up to a second late
    assert r["back"]


def test_a_pilot_takes_over_and_hands_back(flights: dict[str, Future[Record]]) -> None:
    r = flights["pilot"].result()
    assert (r["up"], r["taken"], r["given_back"], r["offboard"]) == (True, True, 0, True)
    assert "Takeoff detected\t" in r["texts"]


def test_a_companion_alone_gets_no_text_but_its_mode(flights: dict[str, Future[Record]]) -> None:
    r = flights["cycle"].result()
    assert r["texts"] == []
    assert TAKEOFF in r["modes"]


def test_garbage_neither_arms_nor_stops_it(flights: dict[str, Future[Record]]) -> None:
    r = flights["garbage"].result()
    assert r["rate_hz"] == pytest.approx(100.0, rel=0.15)
    assert not r["armed"]
    assert r["answer"] == 0
    assert r["version"].flight_sw_version == 17301632


def test_mavsdk_reads_it_as_px4(flights: dict[str, Future[Any]]) -> None:
    report = flights["mavsdk"].result()
    assert report.vision_parameter == 5
    assert report.parameters > 100
    assert "COMMAND_DENIED" in report.early_arm
    assert report.origin_deg == pytest.approx(41.1)


def test_mavsdk_flies_it(flights: dict[str, Future[Any]]) -> None:
    report = flights["mavsdk"].result()
    assert (report.armable, report.local_position_ok, report.landed) == (True, True, True)
    assert report.height_m == pytest.approx(8.0, abs=0.8)
    assert report.speed_m_s == pytest.approx(3.0, abs=0.5)
    for mode in ("TAKEOFF", "HOLD", "OFFBOARD", "LAND"):
        assert mode in report.modes
