"""The autopilot's attitude at many times at once, and the heights that were measured."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vwnav.geometry.rotations import rotation_from_quat, vector_from_rotation
from vwnav.recording.telemetry_log import rising
from vwnav.types import Array, Attitude, Range

MAX_GAP_S = 0.5  # attitudes farther apart are not interpolated between
LEAST_COS_TILT = 0.7  # more oblique, a rangefinder looks elsewhere


@dataclass(frozen=True, slots=True, eq=False)
class Turned:
    """The attitude at k times.

    Attributes:
        R_ned_body: (k, 3, 3). rates_rad_s: (k, 3) about the body's axes.
        known: (k,) whether attitudes were told near enough.
    """

    R_ned_body: Array
    rates_rad_s: Array
    known: np.ndarray


class FlownAttitudes:
    """All attitudes of a flight, joined by cubics whose rates agree where two meet.

    Turning evenly between attitudes of 30 Hz cuts the corners of brisk turns: 0.3 ms of lateness.
    """

    def __init__(self, attitudes: Sequence[Attitude]) -> None:
        kept = [attitudes[i] for i in rising([each.t_s for each in attitudes])]
        self._t_s = np.array([each.t_s for each in kept])
        self._R = np.stack([rotation_from_quat(each.quat_wxyz) for each in kept])
        steps = [vector_from_rotation(a.T @ b) for a, b in zip(self._R, self._R[1:], strict=False)]
        spans = np.diff(self._t_s)
        self._steps, self._spans = np.array(steps), spans
        even = self._steps / spans[:, None]
        ahead = (spans[:-1] / (spans[:-1] + spans[1:]))[:, None]
        between = even[:-1] + ahead * (even[1:] - even[:-1])
        self._rates = np.concatenate([even[:1], between, even[-1:]])
        self._near = spans <= MAX_GAP_S

    def at(self, t_s: Array) -> Turned:
        """The attitude at times (k,)."""
        i = np.clip(np.searchsorted(self._t_s, t_s, side="right") - 1, 0, len(self._steps) - 1)
        inside = (t_s >= self._t_s[0]) & (t_s <= self._t_s[-1]) & self._near[i]
        span_s = self._spans[i, None]
        u = (t_s - self._t_s[i])[:, None] / span_s
        step, first, last = self._steps[i], span_s * self._rates[i], span_s * self._rates[i + 1]
        # Hermite's cubic from 0 to the step, with the rates at both ends.
        square, cube = 3.0 * step - 2.0 * first - last, first + last - 2.0 * step
        turned = u * (first + u * (square + u * cube))
        rates = (first + u * (2.0 * square + 3.0 * u * cube)) / span_s
        return Turned(self._R[i] @ rotations_from_vectors(turned), rates, inside)


def heights_at(ranges: Sequence[Range], history: FlownAttitudes, t_s: Array) -> Array:
    """(k,) height above level ground by the rangefinder at times (k,); NaN where there is none."""
    if len(ranges) < 2:
        return np.full(len(t_s), np.nan)
    told_s = np.array([each.t_s for each in ranges])
    cos_tilt = history.at(told_s).R_ned_body[:, 2, 2]
    upright = cos_tilt > LEAST_COS_TILT
    if upright.sum() < 2:
        return np.full(len(t_s), np.nan)
    told_s = told_s[upright]
    heights = np.array([each.distance_m for each in ranges])[upright] * cos_tilt[upright]
    found = np.interp(t_s, told_s, heights)
    nearest_s = np.abs(told_s[None] - t_s[:, None]).min(axis=1)
    return np.asarray(np.where(nearest_s <= MAX_GAP_S, found, np.nan))


def camera_heights_at(
    ranges: Sequence[Range], history: FlownAttitudes, t_s: Array, t_body_camera_m: Array
) -> Array:
    """(k,) the same of a camera on its lever arm (3,), which may sit lower than the autopilot."""
    below_m = history.at(t_s).R_ned_body[:, 2] @ t_body_camera_m
    return np.asarray(heights_at(ranges, history, t_s) - below_m)


def rotations_from_vectors(vectors_rad: Array) -> Array:
    """(k, 3, 3) of rotation vectors (k, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(vectors_rad, axis=1)[:, None, None]
    cross = cross_matrices(vectors_rad)
    # sin(a) / a and (1 - cos(a)) / a^2, whose limits at zero are 1 and 1/2.
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    return np.asarray(np.eye(3) + first * cross + second * (cross @ cross))


def cross_matrices(vectors: Array) -> Array:
    """(k, 3, 3) with which the cross product by vectors (k, 3) is a product."""
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.moveaxis(np.array(rows), 2, 0)
