"""How wrong fixes and odometry were in a flight, in units of the fast benchmark's `FilterWorld`.

The error of the attitude is taken out first, as `streams` puts it in: a tilt error moves
a fix by AGL times angle and turns every way seen. What is left is what images and map add.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from vwnav.bench.estimator.flown import Run
from vwnav.bench.estimator.scores import SETTLED_S, rms
from vwnav.bench.estimator.streams import MeasurementEvent
from vwnav.bench.estimator.world import TrueTrajectory
from vwnav.estimation.events import NedFix
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.states import Innovation
from vwnav.geometry.rotations import (
    euler_from_rotation,
    rotation_from_quat,
    rotation_from_vector,
    vector_from_rotation,
    wrap_pi,
)
from vwnav.types import Array, Attitude, OdometryMotion

LEVEL_SHARE, DOWN_SHARE = 0.7, 0.4  # of `FilterWorld.odometry_sigma`, per axis
_ALL_S = 1e9


@dataclass(frozen=True, slots=True)
class Parts:
    """One-sigma of an error per axis: new with each measurement, and shared with the one before."""

    white: float
    slow: float


@dataclass(frozen=True, slots=True, eq=False)
class FixErrors:
    """Of the accepted fixes of a flight, in order.

    Attributes:
        ne_m: (n, 2) with the attitude's tilt error taken out. yaw_rad, agl_ratio: (n,).
        way_m: (n,) flown so far.
    """

    ne_m: Array
    yaw_rad: Array
    agl_ratio: Array
    way_m: Array


@dataclass(frozen=True, slots=True, eq=False)
class WayErrors:
    """Of the motions of a flight that the filter took, in order; lengths in heights above ground.

    Attributes:
        key: (n,) number of the keyframe. seen: (n, 3) way seen less the true one, as the attitude
            at the keyframe turns it. true: (n, 3) that way. tilted: (n, 2) what a change of tilt
            error would move the ground by. yaw_rad: (n,) of the turn.
        nees: (n,) of the way by odometry's own covariance, tilt's share not taken out.
    """

    key: Array
    seen: Array
    true: Array
    tilted: Array
    yaw_rad: Array
    nees: Array


class _Told:
    """The attitude as the autopilot said it, and its error."""

    def __init__(self, events: list[MeasurementEvent], truth: TrueTrajectory) -> None:
        self._truth = truth
        self._said = AttitudeHistory(_ALL_S)
        for event in events:
            if isinstance(event.seen, Attitude):
                self._said.add(event.seen)

    def error(self, t_s: float) -> tuple[float, Array, float]:
        """Heading error, tilt error (2,) about north and east, and the tilted attitude's heading.

        The attitude is Rz(heading error) exp(tilt) R_true.
        """
        R_true = rotation_from_quat(self._truth.quat_wxyz[self._truth.index(t_s)])
        wrong = rotation_from_quat(self._said.held(t_s).quat_wxyz) @ R_true.T
        yaw_rad = math.atan2(wrong[1, 0] - wrong[0, 1], wrong[0, 0] + wrong[1, 1])
        untilted = rotation_from_vector([0.0, 0.0, -yaw_rad]) @ wrong
        map_yaw_rad = euler_from_rotation(untilted @ R_true)[2]
        return yaw_rad, vector_from_rotation(untilted)[:2], map_yaw_rad


def with_errors(
    answers: list[tuple[MeasurementEvent, Innovation]], truth: TrueTrajectory
) -> list[tuple[MeasurementEvent, Innovation]]:
    """The same events, each fix with how wrong it was, tilt left aside."""
    told = _Told([event for event, _ in answers], truth)
    return [
        (replace(event, error_m=float(np.hypot(*_fix_error(event.seen, truth, told)[0]))), answer)
        if isinstance(event.seen, NedFix)
        else (event, answer)
        for event, answer in answers
    ]


def _fix_error(fix: NedFix, truth: TrueTrajectory, told: _Told) -> tuple[Array, float, float]:
    """Place (2,) in metres, heading in radians, AGL as a ratio; NaN where the fix has none."""
    i = truth.index(fix.t_s)
    _, tilt, map_yaw_rad = told.error(fix.t_s)
    agl_m = float(truth.agl_m[i])
    below = truth.position_ned_m[i, :2] + agl_m * np.array([-tilt[1], tilt[0]])
    yaw_rad = math.nan if fix.yaw_rad is None else wrap_pi(fix.yaw_rad - map_yaw_rad)
    ratio = math.nan if fix.agl_m is None else fix.agl_m / agl_m - 1.0
    return fix.position_ne_m - below, yaw_rad, ratio


def fix_errors(run: Run) -> FixErrors:
    """Of the fixes that the filter took once it had settled."""
    truth = run.stream.truth
    told = _Told(run.stream.events, truth)
    steps = np.hypot(*np.diff(truth.position_ned_m[:, :2], axis=0, prepend=0.0).T)
    way_m = np.cumsum(steps)
    taken = [
        event.seen
        for event, answer in run.answers
        if isinstance(event.seen, NedFix) and answer.accepted and event.seen.t_s > SETTLED_S
    ]
    errors = [_fix_error(fix, truth, told) for fix in taken]
    return FixErrors(
        np.array([e[0] for e in errors]).reshape(-1, 2),
        np.array([e[1] for e in errors]),
        np.array([e[2] for e in errors]),
        np.array([way_m[truth.index(fix.t_s)] for fix in taken]),
    )


def parts(flights: list[Array]) -> Parts:
    """Of errors (n,) or (n, d), one array a flight: what neighbours share is the slow part."""
    series = [np.asarray(flight).reshape(len(flight), -1) for flight in flights]
    whole = float(np.mean(np.concatenate(series) ** 2))
    shared = float(np.mean(np.concatenate([each[1:] * each[:-1] for each in series])))
    return Parts(math.sqrt(max(whole - shared, 0.0)), math.sqrt(max(shared, 0.0)))


def way_errors(run: Run) -> WayErrors:
    """Of the motions that the filter took once it had settled."""
    truth = run.stream.truth
    told = _Told(run.stream.events, truth)
    taken = [
        event.seen
        for event, answer in run.answers
        if isinstance(event.seen, OdometryMotion)
        and answer.accepted
        and event.seen.t0_s > SETTLED_S
    ]
    rows = [_way_error(motion, truth, told) for motion in taken]
    seen, true, tilted, yaws, nees = zip(*rows, strict=True)
    _, key = np.unique([motion.t0_s for motion in taken], return_inverse=True)
    return WayErrors(
        np.asarray(key), np.array(seen), np.array(true), np.array(tilted), np.array(yaws),
        np.array(nees),
    )  # fmt: skip


def _way_error(
    motion: OdometryMotion, truth: TrueTrajectory, told: _Told
) -> tuple[Array, Array, Array, float, float]:
    key, now = truth.index(motion.t0_s), truth.index(motion.t1_s)
    yaw0_rad, tilt0, map_yaw0_rad = told.error(motion.t0_s)
    _, tilt1, map_yaw1_rad = told.error(motion.t1_s)
    way = (truth.position_ned_m[now] - truth.position_ned_m[key]) / truth.agl_m[key]
    turn = rotation_from_vector([0.0, 0.0, yaw0_rad]) @ rotation_from_vector([*tilt0, 0.0])
    error = motion.displacement_ned_m / motion.agl_m - turn @ way
    tilted = np.array([tilt0[1] - tilt1[1], tilt1[0] - tilt0[0]])
    yaw_rad = wrap_pi(motion.yaw_increment_rad - (map_yaw1_rad - map_yaw0_rad))
    covariance = motion.covariance_ned_m2 / motion.agl_m**2
    return error, turn @ way, tilted, yaw_rad, float(error @ np.linalg.solve(covariance, error))


def tilt_share(flights: list[WayErrors]) -> float:
    """Which share of a change of tilt error odometry took for motion, by least squares."""
    seen = np.concatenate([flight.seen[:, :2] for flight in flights])
    tilted = np.concatenate([flight.tilted for flight in flights])
    return float(np.sum(seen * tilted) / max(float(np.sum(tilted**2)), 1e-12))


@dataclass(frozen=True, slots=True)
class OdometryErrors:
    """In the units of `FilterWorld`.

    Attributes:
        image, image_down: what each image adds, level and vertical, by `odometry_sigma`.
        kept, kept_down: the same of image and keyframe at the keyframe's end, which adds up.
        yaw_image_rad, yaw_kept_rad: of the turn.
        tilt: share of a change of tilt error. scale: of the way, at the keyframes' ends.
    """

    image: float
    image_down: float
    kept: float
    kept_down: float
    yaw_image_rad: float
    yaw_kept_rad: float
    tilt: float
    scale: float


def odometry_errors(flights: list[WayErrors]) -> OdometryErrors:
    """Of all motions; a keyframe's error and an image's are alike in size, as in `FilterWorld`."""
    share = tilt_share(flights)
    news, ends, along, way = [], [], 0.0, 0.0
    for flight in flights:
        shift = np.column_stack([share * flight.tilted, np.zeros(len(flight.tilted))])
        error = np.column_stack([flight.seen - shift, flight.yaw_rad])
        same = flight.key[1:] == flight.key[:-1]
        news.append(np.diff(error, axis=0)[same] / math.sqrt(2.0))
        last = np.append(~same, True)
        ends.append(error[last] / math.sqrt(2.0))
        level, true = flight.seen[last, :2] - shift[last, :2], flight.true[last, :2]
        along += float(np.sum(level * true))
        way += float(np.sum(true * true))
    new, kept = np.concatenate(news), np.concatenate(ends)
    return OdometryErrors(
        image=rms(new[:, :2].ravel()) / LEVEL_SHARE,
        image_down=rms(new[:, 2]) / DOWN_SHARE,
        kept=rms(kept[:, :2].ravel()) / LEVEL_SHARE,
        kept_down=rms(kept[:, 2]) / DOWN_SHARE,
        yaw_image_rad=rms(new[:, 3]),
        yaw_kept_rad=rms(kept[:, 3]),
        tilt=share,
        scale=along / max(way, 1e-12),
    )
