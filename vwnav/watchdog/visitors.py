"""A navigator that is started again in flight finds the link taken, and asks who has it.

On Linux a watchdog owns its link by a name on this machine. Whoever calls that name is told once a
second what the watchdog does, one JSON object a datagram, until the watchdog has left.
"""

import contextlib
import json
import math
import socket
import struct
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass

from vwnav.errors import LinkError
from vwnav.mavlink.links import LinkAddress, parse_link
from vwnav.watchdog.keepalive import GuardState

_PERIOD_S = 1.0
_MOST_VISITORS = 4
_WORD_BYTES = 4096
_CREDENTIALS = struct.Struct("3i")  # process, user, group
_UNHEARD_S = 10.0  # a watchdog that says nothing for so long hangs
_FOLLOWED_S, _ASKS_EVERY_S = 2.0, 0.05  # by the spare one, of a watchdog that died
_DOES = {
    GuardState.RELAY: "guards it",
    GuardState.BRAKING: "brakes it",
    GuardState.HOLDING: "holds it where it is",
    GuardState.LANDING: "lands it",
    GuardState.STOOD_DOWN: "keeps out of the way of whoever flies it",
}


@dataclass(frozen=True, slots=True)
class Guarding:
    """What a watchdog says of itself.

    Attributes:
        navigator_ended: the one that started it is gone.
        armed: the aircraft is, as far as is known.
        estimates: the autopilot is told where it is.
    """

    state: GuardState
    navigator_ended: bool
    armed: bool
    estimates: bool

    def pack(self) -> bytes:
        """As a datagram."""
        return json.dumps({**asdict(self), "state": self.state.name}).encode()

    @staticmethod
    def unpack(data: bytes) -> "Guarding":
        """Of a datagram.

        Raises:
            LinkError: it is of another version.
        """
        try:
            told = json.loads(data)
            return Guarding(**{**told, "state": GuardState[told["state"]]})
        except (ValueError, KeyError, TypeError) as error:
            raise LinkError("the watchdog that has the link is of another version") from error

    @property
    def words(self) -> str:
        """For the operator."""
        told = "a second navigator gives" if self.estimates else "nobody gives at present"
        return f"its watchdog, which {_DOES[self.state]}, and {told} estimates of its place"


class Reception:
    """The watchdog's side: owns the name, and so the link, until it is closed.

    Raises:
        LinkError: another watchdog has it.
    """

    def __init__(self, address: LinkAddress) -> None:
        self._visitors: list[socket.socket] = []
        self._due_s = 0.0
        self._door: socket.socket | None = None
        if sys.platform != "linux":
            return
        self._door = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._door.bind(_name(address))  # abstract: leaves no file behind
        except OSError as error:
            self._door.close()
            raise LinkError(
                f"another watchdog has {address.port_name}: it guards the aircraft until that is "
                "disarmed, and leaves then"
            ) from error
        self._door.listen(_MOST_VISITORS)
        self._door.setblocking(False)

    def step(self, guarding: Guarding, t_s: float) -> None:
        """Let in who calls, and tell them all, once a second; never waits."""
        if self._door is None or t_s < self._due_s:
            return
        self._due_s = t_s + _PERIOD_S
        if len(self._visitors) < _MOST_VISITORS:
            with contextlib.suppress(OSError):
                visitor, _ = self._door.accept()
                visitor.setblocking(False)
                self._visitors.append(visitor)
        self._visitors = [each for each in self._visitors if _told(each, guarding)]

    def close(self) -> None:
        """Give the name back: whoever waits is told so by that."""
        for each in self._visitors:
            each.close()
        if self._door is not None:
            self._door.close()


def _told(visitor: socket.socket, guarding: Guarding) -> bool:
    """Whether it is still there. One that does not read misses what is said."""
    try:
        visitor.send(guarding.pack())
    except BlockingIOError:
        return True
    except OSError:
        visitor.close()
        return False
    return True


def visit(connection: str) -> Iterator[Guarding]:
    """What the watchdog says that has the link, once a second, until it leaves; else nothing.

    One that dies is followed by its spare one, which is asked in turn.

    Args:
        connection: URL of the autopilot's link.

    Raises:
        LinkError: the watchdog hangs, or speaks otherwise.
    """
    if sys.platform != "linux":
        return
    until_s = -math.inf  # a first one is there at once, or not at all
    while (door := _entered(connection, until_s)) is not None:
        with door:
            while data := _heard(door):
                yield Guarding.unpack(data)
        until_s = time.monotonic() + _FOLLOWED_S


def _entered(connection: str, until_s: float) -> socket.socket | None:
    """The door of whoever has the link by then, None where nobody has."""
    while True:
        door = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        door.settimeout(_UNHEARD_S)
        try:
            door.connect(_name(parse_link(connection)))
        except OSError:
            door.close()
            if time.monotonic() >= until_s:
                return None
            time.sleep(_ASKS_EVERY_S)
        else:
            return door


def _heard(door: socket.socket) -> bytes:
    try:
        return door.recv(_WORD_BYTES)
    except TimeoutError as error:
        pid, *_ = _CREDENTIALS.unpack(
            door.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        )
        raise LinkError(
            f"a watchdog (process {pid}) has the link and hangs: end it, and nobody guards the "
            "aircraft until vwnav is started again"
        ) from error
    except OSError:
        return b""  # it has left


def _name(address: LinkAddress) -> str:
    return f"\0vwnav watchdog of {address.port_name}"
