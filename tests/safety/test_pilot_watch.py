"""The pilot's watch against modes as real autopilots reported them."""

import gzip
import os
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from vwnav.mavlink.modes import AutopilotKind, flight_mode
from vwnav.safety.conditions import PilotWatch
from vwnav.safety.monitor import SafetyConfig
from vwnav.vehicle import FlightMode

DATA = Path(os.environ.get("VWNAV_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
HEARTBEAT, AUTOPILOT_COMPONENT = 0, 1
V2_HEADER, SIGNATURE, LONGEST = 10, 13, 280


def modes(name: str) -> Iterator[tuple[float, FlightMode]]:
    """(seconds from the start, mode) of each HEARTBEAT of the autopilot in a recording."""
    path = DATA / "mavlink" / name
    if not path.is_file():
        pytest.skip(f"no recording at {path}: set VWNAV_DATA")
    log, at, start_us = gzip.decompress(path.read_bytes()), 0, None
    while at < len(log):
        (time_us,) = struct.unpack_from(">Q", log, at)
        start_us = time_us if start_us is None else start_us
        packet = log[at + 8 : at + 8 + LONGEST]
        at += 8 + packet[1] + V2_HEADER + 2 + SIGNATURE * (packet[2] & 1)
        if int.from_bytes(packet[7:10], "little") == HEARTBEAT and packet[6] == AUTOPILOT_COMPONENT:
            custom_mode, _, kind = struct.unpack_from("<IBB", packet, V2_HEADER)
            if kind in (3, 12):
                yield (time_us - start_us) / 1e6, flight_mode(AutopilotKind(kind), custom_mode)


@pytest.mark.parametrize(
    ("name", "taken_s", "word"),
    [
        ("px4-1.18_pilot_sticks.tlog.gz", 28.9, "pilot"),
        ("px4-1.16dev_pilot_sticks.tlog.gz", 28.8, "pilot"),
        ("px4-1.18_pilot_rcswitch.tlog.gz", 31.0, "pilot"),
        ("arducopter-4.7dev_pilot_rcswitch.tlog.gz", 33.4, "pilot"),
        ("px4-1.18_vpe_gps_lost.tlog.gz", 68.4, "descend"),
        ("px4-1.18_offboard_loss.tlog.gz", 38.2, "return"),
        ("px4-1.18_battery.tlog.gz", 61.4, "hold"),
        ("arducopter-4.7dev_battery.tlog.gz", 61.9, "return"),
    ],
)
def test_takeovers_are_noticed_at_once_and_remembered(name: str, taken_s: float, word: str) -> None:
    watch = PilotWatch(SafetyConfig())
    for t_s, mode in modes(name):
        watch.step(mode, landing=False, t_s=t_s)
        # All of them show OFFBOARD again later, without our asking.
        assert (watch.released is not None) == (t_s > taken_s - 0.1)
    assert watch.released is not None
    assert word in watch.released


@pytest.mark.parametrize("name", ["px4-1.18_nominal", "arducopter-4.7dev_nominal"])
def test_nobody_took_over_a_nominal_flight_before_its_end(name: str) -> None:
    watch, last_own_s = PilotWatch(SafetyConfig()), 0.0
    for t_s, mode in modes(f"{name}.tlog.gz"):
        watch.step(mode, landing=False, t_s=t_s)
        if mode is FlightMode.OFFBOARD:
            assert watch.released is None
            last_own_s = t_s
    assert last_own_s > 40.0
