"""STATUSTEXT: what an autopilot says to people."""

from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from vwnav.sim.mavlink.command import Severity

_CHARACTERS = 50


def text_messages(severity: Severity, text: str, number: int) -> list[Any]:
    """A long text goes in chunks of 50 characters under one number."""
    chunks = [text[i : i + _CHARACTERS] for i in range(0, len(text), _CHARACTERS)]
    own = number if len(chunks) > 1 else 0
    return [
        mavlink.MAVLink_statustext_message(severity, chunk.encode(), own, sequence)
        for sequence, chunk in enumerate(chunks)
    ]
