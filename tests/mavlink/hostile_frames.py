"""MAVLink frames that nobody honest sends, of every message there is, from a seed."""

import binascii
import random
from collections import deque
from collections.abc import Callable

from pymavlink.dialects.v20 import all as mavlink

AUTOPILOT, STATION, US = (7, 1), (255, 190), (245, 191)
# A second aircraft, a gimbal and a companion of ours, strangers, the ground station, our own echo.
OTHERS = ((9, 1), (7, 154), (7, 191), (42, 190), (0, 0), STATION, US)
KINDS = tuple(mavlink.mavlink_map.values())
_BY_NAME = {kind.msgname: kind for kind in KINDS}
_HEARD = ("HEARTBEAT", "ATTITUDE", "COMMAND_ACK", "HIGHRES_IMU", "SCALED_PRESSURE", "TIMESYNC",
          "PARAM_VALUE", "COMMAND_LONG", "COMMAND_INT", "EXTENDED_SYS_STATE", "GPS_GLOBAL_ORIGIN",
          "ESTIMATOR_STATUS", "EKF_STATUS_REPORT", "CURRENT_MODE", "STATUSTEXT", "SYS_STATUS",
          "DISTANCE_SENSOR", "LOCAL_POSITION_NED", "RAW_IMU")  # fmt: skip
HEARD = tuple(_BY_NAME[name] for name in _HEARD)
_COMMANDS = (_BY_NAME["COMMAND_LONG"], _BY_NAME["COMMAND_INT"])
_ORDERS = (21, 20, 300, 193)  # land, return, start, pause: what the navigator obeys
# NaN, infinities, the greatest numbers, integers' ends.
_FILLS = (
    *map(bytes.fromhex, ("00000000", "ffffffff", "0000c07f", "0000807f", "000080ff", "ffff7f7f")),
    *map(bytes.fromhex, ("00000080", "ffffff7f", "01000000", "000000000000f87f")),
)
_SIZES = {"char": 1, "int8_t": 1, "uint8_t": 1, "int16_t": 2, "uint16_t": 2, "int32_t": 4,
          "uint32_t": 4, "float": 4, "int64_t": 8, "uint64_t": 8, "double": 8}  # fmt: skip
_REVERSED = bytes(int(f"{i:08b}"[::-1], 2) for i in range(256))
_REPLAYED = 500


def checksum(data: bytes) -> bytes:
    """CRC-16/MCRF4XX, by way of its mirror image, which the standard library has."""
    mirrored = binascii.crc_hqx(data.translate(_REVERSED), 0xFFFF)
    return int(f"{mirrored:016b}"[::-1], 2).to_bytes(2, "little")


def offsets(kind) -> dict[str, int]:
    """Where each field begins in the payload."""
    found, at = {}, 0
    for length, name in zip(kind.array_lengths, kind.ordered_fieldnames, strict=True):
        found[name] = at
        at += _SIZES[kind.fieldtypes[kind.fieldnames.index(name)]] * max(length, 1)
    return found


_OFFSETS = {kind: offsets(kind) for kind in KINDS}


class HostileFrames:
    """Frames one after the other; `replay` takes what was honest when it was sent first.

    Attributes:
        seen: numbers of the messages that were made.
    """

    def __init__(self, seed: int) -> None:
        self._rng = random.Random(seed)
        self._past: deque[bytes] = deque(maxlen=_REPLAYED)
        self._next = 0
        self.seen: set[int] = set()

    def replay(self, frame: bytes) -> None:
        """To be said again later."""
        self._past.append(frame)

    def from_others(self) -> bytes:
        """Whole, of anybody but the autopilot; what is cut would swallow its neighbours."""
        sender = self._rng.choice(OTHERS)
        make: Callable[[tuple[int, int]], bytes] = self._rng.choices(
            (self._valid, self._damaged, self._signed, self._order, self._again),
            (70, 8, 8, 8, 6),
        )[0]
        return make(sender)

    def from_anybody(self) -> bytes:
        """Whatever there is, also of the autopilot itself, whole or not."""
        sender = AUTOPILOT if self._rng.random() < 0.6 else self._rng.choice(OTHERS)
        make: Callable[[tuple[int, int]], bytes] = self._rng.choices(
            (self._valid, self._damaged, self._signed, self._order, self._again, self._cut,
             self._odd, self._noise),
            (60, 6, 6, 6, 8, 8, 4, 2),
        )[0]  # fmt: skip
        return make(sender)

    def _kind(self):
        """Every message in turn, and between them those that somebody here listens to."""
        if self._rng.random() < 0.5:
            return self._rng.choice(HEARD)
        self._next = (self._next + 1) % len(KINDS)
        return KINDS[self._next]

    def _payload(self, kind, sender: tuple[int, int]) -> bytes:
        rng, size = self._rng, kind.unpacker.size
        payload = bytearray(rng.randbytes(size))
        if rng.random() < 0.7:
            fill, start = rng.choice(_FILLS), rng.choice((0, 0, rng.randrange(size)))
            payload[start:] = (fill * (size // len(fill) + 1))[: size - start]
        if rng.random() < 0.5:
            self._aim(payload, kind, sender)
        return bytes(payload)

    def _aim(self, payload: bytearray, kind, sender: tuple[int, int]) -> None:
        """At us, at the autopilot, at all; but orders of the station at us are no fuzz."""
        at = _OFFSETS[kind]
        targets = (AUTOPILOT, (0, 0)) if sender == STATION and kind in _COMMANDS else None
        system, component = self._rng.choice(targets or (US, AUTOPILOT, (0, 0)))
        if "target_system" in at:
            payload[at["target_system"]] = system
        if "target_component" in at:
            payload[at["target_component"]] = component
        if kind.msgname == "HEARTBEAT":
            payload[at["autopilot"]] = self._rng.choice((3, 8, 12))

    def _valid(self, sender: tuple[int, int], signature: bytes = b"") -> bytes:
        kind = self._kind()
        payload = self._payload(kind, sender)
        self.seen.add(kind.id)
        if kind.id < 256 and not signature and self._rng.random() < 0.25:
            head = bytes((len(payload), self._rng.randrange(256), *sender, kind.id))
            return b"\xfe" + head + payload + checksum(head + payload + bytes((kind.crc_extra,)))
        payload = payload.rstrip(b"\0") or b"\0"
        flags = (1 if signature else 0, self._rng.randrange(256), self._rng.randrange(256))
        head = bytes((len(payload), *flags, *sender)) + kind.id.to_bytes(3, "little")
        crc = checksum(head + payload + bytes((kind.crc_extra,)))
        frame = b"\xfd" + head + payload + crc + signature
        if sender != AUTOPILOT:
            self._past.append(frame)
        return frame

    def _damaged(self, sender: tuple[int, int]) -> bytes:
        frame = bytearray(self._valid(sender))
        frame[-1 - self._rng.randrange(2)] ^= 1 << self._rng.randrange(8)
        return bytes(frame)

    def _signed(self, sender: tuple[int, int]) -> bytes:
        return self._valid(sender, self._rng.randbytes(13))

    def _order(self, sender: tuple[int, int]) -> bytes:
        """A command to us; of those that are obeyed only from who may not give them."""
        rng = self._rng
        number = rng.choice((*_ORDERS, 176, 400, 22, rng.randrange(65536)))
        if sender == STATION and number in _ORDERS:
            number = 400
        param = rng.choice((0.0, 1.0, float("nan"), float("inf"), -1e38))
        message = mavlink.MAVLink_command_long_message(*US, number, 0, *[param] * 7)
        return bytes(message.pack(mavlink.MAVLink(None, *sender)))

    def _again(self, sender: tuple[int, int]) -> bytes:
        return self._rng.choice(self._past) if self._past else self._valid(sender)

    def _cut(self, sender: tuple[int, int]) -> bytes:
        frame = self._valid(sender)
        return frame[: self._rng.randrange(1, len(frame))]

    def _odd(self, sender: tuple[int, int]) -> bytes:
        """Length, flags or number of the message are not what they were."""
        frame = bytearray(self._valid(sender))
        frame[self._rng.choice((1, 2, 7))] = self._rng.randrange(256)
        return bytes(frame)

    def _noise(self, sender: tuple[int, int]) -> bytes:
        return self._rng.randbytes(self._rng.randrange(1, 40))
