"""What a flight's recording says, whatever kind of file it was."""

import math
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

    A sample that is not newer than the newest of its kind is dropped.

    Attributes:
        start_s: time of the recording at which the first image was taken.
        went_back: how many attitudes and other measurements were older than the one before.
    """

    def __init__(self) -> None:
        self.start_s = 0.0
        self.went_back = 0
        self._attitudes = AttitudeTrack(_SPARSE_GAP_S)
        self._others: list[Telemetry] = []
        self._agls: list[tuple[float, float]] = []
        self._armed: list[tuple[float, bool]] = []
        self._newest_s: dict[type[Telemetry], float] = {}

    @property
    def oldest_attitude(self) -> Attitude | None:
        """The oldest attitude; None where there are none."""
        return self._attitudes.oldest

    @property
    def empty(self) -> bool:
        """Whether nothing of use is in it."""
        return not (len(self._attitudes) or self._others or self._agls)

    def add_attitude(self, t_s: float, quat_wxyz: Array) -> None:
        """Append an attitude, (4,) of R_ned_body."""
        if self._is_newer(Attitude, t_s):
            self._attitudes.add(t_s, quat_wxyz)

    def add(self, measurement: Height | Range | ImuSample) -> None:
        """Append any other measurement."""
        if self._is_newer(type(measurement), measurement.t_s):
            self._others.append(measurement)

    def add_agl(self, t_s: float, agl_m: float) -> None:
        """Append a height above the ground below."""
        self._agls.append((t_s, agl_m))

    def add_armed(self, t_s: float, armed: bool) -> None:
        """Append whether the motors may turn; it holds until the next one."""
        self._armed.append((t_s, armed))

    def _is_newer(self, kind: type[Telemetry], t_s: float) -> bool:
        newest_s = self._newest_s.get(kind, -math.inf)
        self._newest_s[kind] = max(newest_s, t_s)
        self.went_back += t_s < newest_s
        return t_s > newest_s

    def measurements(self, first_image_s: float) -> list[Telemetry]:
        """All of it in order of time, on the clock on which the first image has that time."""
        ranges = (self._range(t_s, agl_m) for t_s, agl_m in self._agls)
        every = [
            *self._filled_attitudes(),
            *self._others,
            *(range_ for range_ in ranges if range_ is not None),
            *self._standing(),
        ]
        every.sort(key=lambda seen: (seen.t_s, _ORDER.index(type(seen))))
        shift_s = first_image_s - self.start_s
        return [replace(seen, t_s=seen.t_s + shift_s) for seen in every]

    def _filled_attitudes(self) -> list[Attitude]:
        """The filter bridges shorter gaps than a file that lacks nothing may have."""
        known = list(self._attitudes)
        filled = known[:1]
        for before, after in pairwise(known):
            gap_s = after.t_s - before.t_s
            count = math.ceil(gap_s / _FILLED_S) if MAX_GAP_S < gap_s <= _SPARSE_GAP_S else 1
            for i in range(1, count):
                between = self._attitudes.at(before.t_s + gap_s * i / count)
                assert between is not None
                filled.append(between)
            filled.append(after)
        return filled

    def _range(self, t_s: float, agl_m: float) -> Range | None:
        """A height above ground as the distance along the tilted down axis."""
        if not len(self._attitudes):
            return Range(t_s, agl_m)  # the whole recording is without attitude: taken as level
        attitude = self._attitudes.at(t_s)
        if attitude is None:
            return None
        cos_tilt = float(rotation_from_quat(attitude.quat_wxyz)[2, 2])
        return Range(t_s, agl_m / cos_tilt) if cos_tilt > _LEAST_COS_TILT else None

    def _standing(self) -> list[Stationary]:
        """It stands while it is disarmed, said with each height."""
        standing, armed, i = [], None, 0
        for seen in self._others:
            while i < len(self._armed) and self._armed[i][0] <= seen.t_s:
                armed, i = self._armed[i][1], i + 1
            if isinstance(seen, Height) and armed is False:
                standing.append(Stationary(seen.t_s))
        return standing
