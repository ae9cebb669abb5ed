"""Whatever frames come over the link: nothing breaks, nobody is commanded, nothing is believed.

`make fuzz` takes a million of them.
"""

import gc
import logging
import sys

import numpy as np
import pytest
from autopilot_links import PX4_LAND
from hostile_frames import KINDS, HostileFrames, checksum
from hostile_rig import TICK_S, Rig, words
from pymavlink.dialects.v20 import all as mavlink

from vwnav.types import Attitude
from vwnav.watchdog.keepalive import GuardState

A_TICK, A_READ = 400, 40
LANDING_S = 5
COUNTS = [10_000, pytest.param(500_000, marks=pytest.mark.long)]
MOST_BLOCKS_MORE = 5_000  # one thing kept of every hundredth frame would be more
# What may be asked of an autopilot and tells it nothing; answers; what we are and where we are.
HARMLESS = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT,
    mavlink.MAVLINK_MSG_ID_TIMESYNC,
    mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
    mavlink.MAVLINK_MSG_ID_COMMAND_ACK,
    mavlink.MAVLINK_MSG_ID_STATUSTEXT,
    mavlink.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN,
    mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE,
    mavlink.MAVLINK_MSG_ID_VISION_SPEED_ESTIMATE,
}
QUESTIONS = {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE}


@pytest.fixture(autouse=True)
def quiet():
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


def storm(rig: Rig, make, count: int, each) -> int:
    """Ticks with hostile frames; returns how many blocks of memory it has taken for good."""
    blocks = 0
    for done in range(0, count, A_TICK):
        chunks = [b"".join(make() for _ in range(A_READ)) for _ in range(A_TICK // A_READ)]
        for chunk in chunks[1:]:
            rig.down.write(chunk)
        rig.tick(chunks[0])
        each()
        if done == count // 4 // A_TICK * A_TICK:
            gc.collect()
            blocks = sys.getallocatedblocks()
    gc.collect()
    return sys.getallocatedblocks() - blocks


def is_harmless(packet) -> bool:
    if packet.message_id != mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
        return packet.message_id in HARMLESS
    return mavlink.MAVLink(None).decode(bytearray(packet.data)).command in QUESTIONS


def test_the_frames_are_what_they_are_said_to_be():
    frames = HostileFrames(1)
    parser = mavlink.MAVLink(None)
    for _ in range(3000):
        frame = frames._valid((9, 1))
        assert parser.decode(bytearray(frame)).get_srcSystem() == 9
    assert checksum(b"123456789") == b"\x91\x6f"  # CRC-16/MCRF4XX, its check value
    assert frames.seen == {kind.id for kind in KINDS}


@pytest.mark.parametrize("count", COUNTS)
def test_what_others_say_changes_nothing_that_is_believed_or_said(count):
    """A twin that never hears them measures, estimates and says the same, bit by bit.

    Near the end the navigator falls silent: it is braked for, held and landed just the same.
    """
    rig, twin = Rig(steers=True), Rig(steers=True)
    frames = HostileFrames(seed=11)

    def compare() -> None:
        twin.tick()
        assert words(rig.said) == words(twin.said)
        assert [repr(m) for m in rig.heard] == [repr(m) for m in twin.heard]
        assert np.array_equal(rig.ekf.estimate(rig.clock()).covariance,
                              twin.ekf.estimate(twin.clock()).covariance)  # fmt: skip
        assert rig.autopilot.take_orders()[0] == ()
        assert rig.watchdog.state is twin.watchdog.state
        for packet in rig.said:
            frames.replay(packet.data)

    grown = storm(rig, frames.from_others, count, compare)
    assert rig.watchdog.state is GuardState.RELAY
    assert mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE in {p.message_id for p in rig.said}
    rig.beats = twin.beats = False
    for _ in range(round(LANDING_S / TICK_S)):
        rig.tick(b"".join(frames.from_others() for _ in range(A_READ)))
        compare()
    assert rig.peer.custom_mode == PX4_LAND
    assert grown < MOST_BLOCKS_MORE


@pytest.mark.parametrize("count", COUNTS)
def test_whatever_comes_and_whoever_says_it_nothing_breaks_and_nothing_commands(count):
    rig = Rig(steers=False)
    frames = HostileFrames(seed=12)

    def look() -> None:
        assert all(is_harmless(packet) for packet in rig.said), [p.message_id for p in rig.said]
        assert rig.autopilot.take_orders()[0] == ()
        assert rig.watchdog.state is GuardState.RELAY
        assert all(measured.t_s <= rig.clock() + 0.5 for measured in rig.heard)
        estimate = rig.ekf.estimate(rig.clock())
        assert np.isfinite(estimate.covariance).all()
        assert np.isfinite(estimate.position_ned_m).all()
        rig.autopilot.state()
        rig.autopilot.warnings()

    grown = storm(rig, frames.from_anybody, count, look)
    assert grown < MOST_BLOCKS_MORE
    heard = []
    for _ in range(round(4.0 / TICK_S)):
        rig.tick()
        heard += [each for each in rig.heard if isinstance(each, Attitude)]
    assert sum(each.t_s > rig.clock() - 1.0 for each in heard) > 20  # honest words are heard again
