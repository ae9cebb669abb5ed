"""Recorded attitudes, interpolated between."""

from bisect import bisect_right
from collections.abc import Iterator

from vwnav.geometry.rotations import slerp
from vwnav.types import Array, Attitude


class AttitudeTrack:
    """Attitudes in order of time.

    Args:
        max_gap_s: neighbours farther apart than this are not interpolated between.
    """

    def __init__(self, max_gap_s: float) -> None:
        self._max_gap_s = max_gap_s
        self._times_s: list[float] = []
        self._quats_wxyz: list[Array] = []

    def __len__(self) -> int:
        return len(self._times_s)

    def __iter__(self) -> Iterator[Attitude]:
        return map(Attitude, self._times_s, self._quats_wxyz)

    @property
    def oldest(self) -> Attitude | None:
        """The oldest attitude."""
        return Attitude(self._times_s[0], self._quats_wxyz[0]) if self._times_s else None

    def add(self, t_s: float, quat_wxyz: Array) -> None:
        """Append an attitude (4,) of R_ned_body; one that is not newer is dropped."""
        if self._times_s and t_s <= self._times_s[-1]:
            return
        self._times_s.append(t_s)
        self._quats_wxyz.append(quat_wxyz)

    def at(self, t_s: float) -> Attitude | None:
        """The attitude at `t_s`; None where nothing near enough is known."""
        after = bisect_right(self._times_s, t_s)
        if after == 0:
            return None
        if t_s == self._times_s[after - 1]:
            return Attitude(t_s, self._quats_wxyz[after - 1])
        if after == len(self._times_s):
            return None
        t0_s, t1_s = self._times_s[after - 1], self._times_s[after]
        if t1_s - t0_s > self._max_gap_s:
            return None
        quat0, quat1 = self._quats_wxyz[after - 1], self._quats_wxyz[after]
        return Attitude(t_s, slerp(quat0, quat1, (t_s - t0_s) / (t1_s - t0_s)))
