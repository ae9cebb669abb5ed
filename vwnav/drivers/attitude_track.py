"""Attitudes over time, interpolated to the moment a picture was exposed."""

from bisect import bisect_right
from collections.abc import Iterator

import numpy as np

from vwnav.geometry.rotations import (
    quat_from_rotation,
    rotation_from_quat,
    rotation_from_vector,
    slerp,
)
from vwnav.types import Array, Attitude


class AttitudeTrack:
    """Attitudes in order of time.

    Args:
        max_gap_s: neighbours farther apart than this are not interpolated between.
        keep: how many are kept at most, the newest; None keeps all.
    """

    def __init__(self, max_gap_s: float, keep: int | None = None) -> None:
        self._max_gap_s = max_gap_s
        self._keep = keep
        self._times_s: list[float] = []
        self._quats_wxyz: list[Array] = []
        self._rates_rad_s: Array | None = None

    def __len__(self) -> int:
        return len(self._times_s)

    def __iter__(self) -> Iterator[Attitude]:
        return map(Attitude, self._times_s, self._quats_wxyz)

    @property
    def oldest(self) -> Attitude | None:
        """The oldest attitude that is kept."""
        return Attitude(self._times_s[0], self._quats_wxyz[0]) if self._times_s else None

    @property
    def newest(self) -> Attitude | None:
        """The newest attitude."""
        if not self._times_s:
            return None
        return Attitude(self._times_s[-1], self._quats_wxyz[-1])

    def add(self, t_s: float, quat_wxyz: Array, rates_rad_s: Array | None = None) -> None:
        """Append an attitude; one that is not newer than the newest is dropped.

        Args:
            t_s: its time.
            quat_wxyz: (4,) of R_ned_body.
            rates_rad_s: (3,) body rates, to carry the newest attitude forward.
        """
        if self._times_s and t_s <= self._times_s[-1]:
            return
        self._times_s.append(t_s)
        self._quats_wxyz.append(quat_wxyz)
        self._rates_rad_s = rates_rad_s
        if self._keep is not None and len(self._times_s) > 2 * self._keep:
            del self._times_s[: -self._keep], self._quats_wxyz[: -self._keep]

    def clear(self) -> None:
        """Forget all: the clock of their stamps has jumped."""
        self._times_s.clear()
        self._quats_wxyz.clear()

    def at(self, t_s: float, ahead_s: float = 0.0) -> Attitude | None:
        """The attitude at `t_s`; None where nothing near enough is known.

        Args:
            t_s: wanted time.
            ahead_s: how far the newest attitude may be carried forward by its body rates.
        """
        after = bisect_right(self._times_s, t_s)
        if after == 0:
            return None
        if after == len(self._times_s):
            return self._ahead(t_s, ahead_s)
        t0_s, t1_s = self._times_s[after - 1], self._times_s[after]
        if t1_s - t0_s > self._max_gap_s:
            return None
        fraction = (t_s - t0_s) / (t1_s - t0_s)
        quat0, quat1 = self._quats_wxyz[after - 1], self._quats_wxyz[after]
        return Attitude(t_s, slerp(quat0, quat1, fraction))

    def _ahead(self, t_s: float, ahead_s: float) -> Attitude | None:
        dt_s = t_s - self._times_s[-1]
        quat_wxyz = self._quats_wxyz[-1]
        if dt_s > ahead_s:
            return None
        if dt_s > 0.0 and self._rates_rad_s is not None:
            turn = rotation_from_vector(np.asarray(self._rates_rad_s) * dt_s)
            quat_wxyz = quat_from_rotation(rotation_from_quat(quat_wxyz) @ turn)
        return Attitude(t_s, quat_wxyz)
