"""What a flight's recording says, whatever kind of file it was."""

import math
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from vwnav.estimation.inertial.attitudes import MAX_GAP_S
from vwnav.geometry.rotations import rotation_from_quat
from vwnav.recording.attitude_track import AttitudeTrack
from vwnav.types import Array, Attitude, Height, ImuSample, Range, Stationary, Telemetry

_SPARSE_GAP_S = 2.0  # between a file's attitudes, both of which are known: interpolated
_FILLED_S = 0.1
_LEAST_COS_TILT = 0.5  # more oblique, a height is not turned into a range
# At the same time the attitude comes first: the filter turns the IMU's samples by it.
_ORDER = (Attitude, ImuSample, Height, Range, Stationary)


class TelemetryLog:
    """What a flight's recording says, filled by a reader in its own order and on its own clock.

    Of each kind the longest series is taken whose times rise: a time that is not of those about it
    (a clock that jumped, a damaged or forged stamp) costs its own sample and no other.

    Attributes:
        start_s: time of the recording at which the first image was taken.
    """

    def __init__(self) -> None:
        self.start_s = 0.0
        self._told: defaultdict[type[Telemetry], list[Telemetry]] = defaultdict(list)
        self._agls: list[tuple[float, float]] = []
        self._armed: list[tuple[float, bool]] = []

    @property
    def oldest_attitude(self) -> Attitude | None:
        """The oldest attitude; None where there are none."""
        return self._attitudes().oldest

    @property
    def empty(self) -> bool:
        """Whether nothing of use is in it."""
        return not (any(self._told.values()) or self._agls)

    @property
    def left_out(self) -> int:
        """How many measurements have a time that is not of those about them."""
        series = [[seen.t_s for seen in told] for told in self._told.values()]
        series.append([t_s for t_s, _ in self._agls])
        kept = ({times_s[i] for i in rising(times_s)} for times_s in series)
        return sum(
            t_s not in found_s
            for times_s, found_s in zip(series, kept, strict=True)
            for t_s in times_s
        )

    def add_attitude(self, t_s: float, quat_wxyz: Array) -> None:
        """Append an attitude, (4,) of R_ned_body."""
        self._told[Attitude].append(Attitude(t_s, quat_wxyz))

    def add(self, measurement: Height | Range | ImuSample) -> None:
        """Append any other measurement."""
        self._told[type(measurement)].append(measurement)

    def add_agl(self, t_s: float, agl_m: float) -> None:
        """Append a height above the ground below."""
        self._agls.append((t_s, agl_m))

    def add_armed(self, t_s: float, armed: bool) -> None:
        """Append whether the motors may turn; it holds until the next one."""
        self._armed.append((t_s, armed))

    def measurements(self, first_image_s: float) -> list[Telemetry]:
        """All of it in order of time, on the clock on which the first image has that time."""
        attitudes = self._attitudes()
        agls = (self._agls[i] for i in rising([t_s for t_s, _ in self._agls]))
        ranges = (_range(attitudes, *each) for each in agls)
        every: list[Telemetry] = [
            *_filled(attitudes),
            *(seen for kind in self._told if kind is not Attitude for seen in self._rising(kind)),
            *(range_ for range_ in ranges if range_ is not None),
            *self._standing(),
        ]
        every.sort(key=lambda seen: (seen.t_s, _ORDER.index(type(seen))))
        shift_s = first_image_s - self.start_s
        return [replace(seen, t_s=seen.t_s + shift_s) for seen in every]

    def _rising(self, kind: type[Telemetry]) -> list[Telemetry]:
        told = self._told.get(kind, [])
        return [told[i] for i in rising([seen.t_s for seen in told])]

    def _attitudes(self) -> AttitudeTrack:
        track = AttitudeTrack(_SPARSE_GAP_S)
        for seen in self._rising(Attitude):
            assert isinstance(seen, Attitude)
            track.add(seen.t_s, seen.quat_wxyz)
        return track

    def _standing(self) -> list[Stationary]:
        """It stands while it is disarmed, said with each height."""
        told = [self._armed[i] for i in rising([t_s for t_s, _ in self._armed])]
        standing, armed, i = [], None, 0
        for seen in self._rising(Height):
            while i < len(told) and told[i][0] <= seen.t_s:
                armed, i = told[i][1], i + 1
            if armed is False:
                standing.append(Stationary(seen.t_s))
        return standing


def rising(times_s: Sequence[float]) -> list[int]:
    """Places of the longest series in it whose times rise; of several one (patience sorting)."""
    if all(before < after for before, after in pairwise(times_s)):
        return list(range(len(times_s)))
    least_s: list[float] = []  # at which a series of each length ends
    ends: list[int] = []
    before: list[int] = []
    for i, t_s in enumerate(times_s):
        length = bisect_left(least_s, t_s)
        before.append(ends[length - 1] if length else -1)
        least_s[length : length + 1], ends[length : length + 1] = [t_s], [i]
    series, at = [], ends[-1]
    while at >= 0:
        series.append(at)
        at = before[at]
    return series[::-1]


def _filled(attitudes: AttitudeTrack) -> list[Attitude]:
    """The filter bridges shorter gaps than a file that lacks nothing may have."""
    known = list(attitudes)
    filled = known[:1]
    for before, after in pairwise(known):
        gap_s = after.t_s - before.t_s
        count = math.ceil(gap_s / _FILLED_S) if MAX_GAP_S < gap_s <= _SPARSE_GAP_S else 1
        for i in range(1, count):
            between = attitudes.at(before.t_s + gap_s * i / count)
            assert between is not None
            filled.append(between)
        filled.append(after)
    return filled


def _range(attitudes: AttitudeTrack, t_s: float, agl_m: float) -> Range | None:
    """A height above ground as the distance along the tilted down axis."""
    if not len(attitudes):
        return Range(t_s, agl_m)  # the whole recording is without attitude: taken as level
    attitude = attitudes.at(t_s)
    if attitude is None:
        return None
    cos_tilt = float(rotation_from_quat(attitude.quat_wxyz)[2, 2])
    return Range(t_s, agl_m / cos_tilt) if cos_tilt > _LEAST_COS_TILT else None
