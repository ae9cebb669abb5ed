"""The recordings of real autopilots, where they are."""

import gzip
import os
import struct
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega, development

DATA = Path(os.environ.get("VWNAV_DATA", Path(__file__).parents[3] / "shared" / "data"))
RECORDS = DATA / "mavlink"
AUTOPILOT, COMPANION = 1, 191


def needs(name: str) -> pytest.MarkDecorator:
    """Skips, and says so, where a recording is not."""
    missing = not (RECORDS / f"{name}.tlog.gz").exists()
    return pytest.mark.skipif(missing, reason="needs the recordings of VWNAV_DATA")


@cache
def packets(name: str, component: int = AUTOPILOT) -> tuple[tuple[float, int, bytes], ...]:
    """(seconds since the autopilot's first, message number, packet) of all that one sent."""
    data = gzip.decompress((RECORDS / f"{name}.tlog.gz").read_bytes())
    found, at, began_s = [], 0, None
    while at + 20 < len(data):
        stamp_s = struct.unpack(">Q", data[at : at + 8])[0] * 1e-6
        packet = data[at + 8 : at + 20 + data[at + 9]]
        at += 8 + len(packet)
        if began_s is None and packet[6] == AUTOPILOT:
            began_s = stamp_s
        if packet[6] == component and began_s is not None:
            found.append((stamp_s - began_s, int.from_bytes(packet[7:10], "little"), packet))
    return tuple(found)


def recorded(name: str, number: int, component: int = AUTOPILOT) -> list[tuple[float, Any]]:
    """(seconds, message) of one kind."""
    dialect = ardupilotmega if name.startswith("arducopter") else development
    parser = dialect.MAVLink(None)
    ours = [(t_s, packet) for t_s, kind, packet in packets(name, component) if kind == number]
    return [(t_s, parser.parse_buffer(packet)[0]) for t_s, packet in ours]
