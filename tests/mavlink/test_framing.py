"""Packets are found by their headers in any bytes, however these are cut."""

import itertools

from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.mavlink.framing import Framer

MAV = mavlink.MAVLink(None, srcSystem=3, srcComponent=4)


def heartbeat(mavlink1: bool = False) -> bytes:
    message = mavlink.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3)
    return bytes(message.pack(MAV, force_mavlink1=mavlink1))


def command() -> bytes:
    return bytes(mavlink.MAVLink_command_long_message(1, 1, 176, 0, *[1.0] * 7).pack(MAV))


def signed() -> bytes:
    signer = mavlink.MAVLink(None, srcSystem=3, srcComponent=4)
    signer.signing.secret_key = bytes(32)
    signer.signing.sign_outgoing = True
    return bytes(mavlink.MAVLink_attitude_message(1, *[0.5] * 6).pack(signer))


def split_all(framer: Framer, data: bytes, cuts: list[int]):
    edges = [0, *sorted(c % (len(data) + 1) for c in cuts), len(data)]
    pieces = (data[a:b] for a, b in itertools.pairwise(edges))
    return [packet for piece in pieces for packet in framer.split(piece)]


@given(st.lists(st.binary(max_size=80), max_size=8), st.lists(st.integers(0, 10**6), max_size=6))
def test_no_byte_is_changed_or_lost(chunks, cuts):
    data = b"".join(chunks)
    framer = Framer()
    found = b"".join(p.data for p in split_all(framer, data, cuts))
    assert data.startswith(found)


@given(
    st.lists(st.sampled_from([heartbeat(), heartbeat(True), command(), signed()]), max_size=12),
    st.lists(st.integers(0, 10**6), max_size=10),
)
def test_packets_are_found_whatever_the_cuts(packets, cuts):
    # A last byte is missing until the next packet starts, so one more follows.
    found = split_all(Framer(), b"".join([*packets, heartbeat()]), cuts)
    assert [p.data for p in found] == [*packets, heartbeat()]


def test_headers_are_read_as_pymavlink_writes_them():
    heads = [(p.message_id, p.system_id, p.component_id) for p in Framer().split(heartbeat(True))]
    assert heads == [(0, 3, 4)]
    (packet,) = Framer().split(signed())
    assert (packet.message_id, packet.system_id, packet.component_id) == (30, 3, 4)


def test_a_start_byte_in_garbage_does_not_hide_the_packets_after_it():
    data = b"\xfd\x09 garbage" + heartbeat() * 30
    found = [p for p in Framer().split(data) if p.message_id == 0]
    assert len(found) == 30
