"""What a serial link carries each way, and what is asked of it: worked out before the flight.

A link that is asked for more than it carries delays everything by what stands in its queues, the
setpoint that stops the aircraft too.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from vwnav.mavlink.links import parse_link
from vwnav.mavlink.modes import AutopilotKind

_BITS_PER_BYTE = 10  # start, eight, stop
_SHARE = 0.8  # of what the line can do: bursts, answers and texts want the rest
_FRAME_BYTES = 12  # of MAVLink 2 around a payload
_ESTIMATE_HZ = 50.0
_LEAST_ESTIMATE_HZ = 10.0  # gaps of 0.2 s stop PX4's fusion, ArduPilot wants 4 Hz
_POSITION_BYTES, _SPEED_BYTES = 117 + _FRAME_BYTES, 57 + _FRAME_BYTES
_ODOMETRY_BYTES = 233 + _FRAME_BYTES
# Setpoints at 20 Hz, our and the watchdog's heartbeat, TIMESYNC five times asked and ten answered,
# and a command a second.
_ALSO_UP_BYTES_S = 20 * 65 + 2 * 21 + 15 * 28 + 45
_UNASKED_BYTES_S = 26e3  # PX4's default on a companion's link
_ALSO_DOWN_BYTES_S = 15 * 28 + 2 * 22  # TIMESYNC, answers


@dataclass(frozen=True, slots=True)
class Stream:
    """A message that is wanted of the autopilot.

    Attributes:
        payload_bytes: at its longest.
        rate_hz: how often, where there is room; `least_hz` where there is little.
        instead_of: another message, where that one does not come.
    """

    name: str
    number: int
    payload_bytes: int
    rate_hz: float
    least_hz: float
    instead_of: str | None = None

    @property
    def bytes_per_s(self) -> float:
        """What it takes of the link."""
        return self.rate_hz * (self.payload_bytes + _FRAME_BYTES)


# The first is raised first where there is room, and asked for first.
_IMU = Stream("HIGHRES_IMU", 105, 63, 50.0, 0.0)
_COMMON = (
    Stream("ATTITUDE", 30, 28, 50.0, 20.0),
    Stream("SCALED_PRESSURE", 29, 16, 10.0, 10.0),
    Stream("SYS_STATUS", 1, 43, 5.0, 2.0),
    Stream("EXTENDED_SYS_STATE", 245, 2, 5.0, 2.0),
    Stream("DISTANCE_SENSOR", 132, 39, 10.0, 5.0),
    Stream("LOCAL_POSITION_NED", 32, 28, 5.0, 2.0),
)
_PX4 = (
    Stream("CURRENT_MODE", 436, 9, 10.0, 5.0),  # comes when a mode changes, and twice a second
    Stream("ESTIMATOR_STATUS", 230, 42, 5.0, 2.0),
)
_ARDUPILOT = (
    Stream("HEARTBEAT", 0, 9, 5.0, 5.0),  # PX4 sends it once a second, and takes no other rate
    Stream("EKF_STATUS_REPORT", 193, 26, 5.0, 2.0),
    Stream("RAW_IMU", 27, 29, 50.0, 0.0, instead_of="HIGHRES_IMU"),
)
# What PX4 sends a companion unasked, and nobody here reads: ATTITUDE_QUATERNION, ODOMETRY,
# GLOBAL_POSITION_INT, ALTITUDE, ESC_INFO, ESC_STATUS, SERVO_OUTPUT_RAW, ATTITUDE_TARGET,
# POSITION_TARGET_LOCAL_NED and _GLOBAL_INT, VFR_HUD, GPS_RAW_INT, VIBRATION, OPTICAL_FLOW_RAD.
UNREAD = (31, 331, 33, 141, 290, 291, 36, 83, 85, 87, 74, 24, 241, 106)


@dataclass(frozen=True, slots=True)
class LinkBudget:
    """What is sent over a link.

    Attributes:
        streams: asked of the autopilot, the most needed first.
        estimate_hz: how often the estimate is sent at most.
        refusal: why no flight is possible on it, None when it is.
        is_tight: what nobody reads has to be switched off.
    """

    streams: tuple[Stream, ...]
    estimate_hz: float
    refusal: str | None
    is_tight: bool

    @property
    def odometry_hz(self) -> float:
        """How often one is sent that tells PX4 the velocity too, in a longer message."""
        return self.estimate_hz * _POSITION_BYTES / _ODOMETRY_BYTES


def bytes_per_s(url: str) -> float | None:
    """What a link carries each way; None where that is no limit (anything but a serial port).

    Raises:
        LinkError: it is no connection.
    """
    address = parse_link(url)
    return address.number / _BITS_PER_BYTE if address.kind == "serial" else None


def plan_link(kind: AutopilotKind, capacity_bytes_s: float | None) -> LinkBudget:
    """Rates that fit: everything at its least first, then raised in order."""
    wanted = (_IMU, *_COMMON, *(_PX4 if kind is AutopilotKind.PX4 else _ARDUPILOT))
    if capacity_bytes_s is None:
        return LinkBudget(_most_needed_first(wanted), _ESTIMATE_HZ, None, False)
    room_bytes_s = _SHARE * capacity_bytes_s
    room_down_bytes_s = room_bytes_s - _ALSO_DOWN_BYTES_S
    streams = _fitted(wanted, room_down_bytes_s)
    both = kind is AutopilotKind.ARDUPILOT
    estimate_bytes = _POSITION_BYTES + (_SPEED_BYTES if both else 0)
    estimate_hz = min((room_bytes_s - _ALSO_UP_BYTES_S) / estimate_bytes, _ESTIMATE_HZ)
    too_slow = estimate_hz < _LEAST_ESTIMATE_HZ or _taken(streams) > room_down_bytes_s
    refusal = None
    if too_slow:
        refusal = (
            f"a link of {capacity_bytes_s * _BITS_PER_BYTE:.0f} baud does not carry "
            f"{_LEAST_ESTIMATE_HZ:.0f} estimates and 20 attitudes a second: set it to 115200 or "
            "more, here and in the autopilot"
        )
    is_tight = room_down_bytes_s < _UNASKED_BYTES_S + _taken(streams)
    return LinkBudget(_most_needed_first(streams), max(estimate_hz, 1.0), refusal, is_tight)


def _fitted(wanted: tuple[Stream, ...], room_bytes_s: float) -> tuple[Stream, ...]:
    streams = {each.name: replace(each, rate_hz=each.least_hz) for each in wanted}
    for each in wanted:
        for rate_hz in (each.rate_hz, 0.5 * each.rate_hz):
            raised = streams | {each.name: replace(each, rate_hz=rate_hz)}
            if rate_hz > each.least_hz and _taken(raised.values()) <= room_bytes_s:
                streams = raised
                break
    imu_hz = streams[_IMU.name].rate_hz
    for each in wanted:
        if each.instead_of == _IMU.name:
            streams[each.name] = replace(each, rate_hz=imu_hz)
    return tuple(each for each in streams.values() if each.rate_hz > 0.0)


def _taken(streams: Iterable[Stream]) -> float:
    """A message and the one that stands in for it never come together."""
    return sum(each.bytes_per_s for each in streams if each.instead_of is None)


def _most_needed_first(streams: tuple[Stream, ...]) -> tuple[Stream, ...]:
    """The IMU last: without it an aircraft flies."""
    return tuple(sorted(streams, key=lambda each: each.name.endswith("_IMU")))
