"""The autopilot's attitude in the filter's benchmark, and how the camera errs with it."""

import math

import numpy as np

from vwnav.bench.estimator.world import DT_S, FilterWorld, TrueTrajectory
from vwnav.geometry.rotations import rotation_from_quat
from vwnav.types import Array

_TILT_DRIFT_S = 20.0
_LEVELLED_S = 5.0  # real PX4, which is aided: none was left 3 to 5 s after a turn


class AttitudeErrors:
    """The autopilot's attitude Rz(yaw error) exp(tilt) R_true.

    Its gyro holds the tilt in NED while the body turns; within seconds it is levelled anew, to a
    bias of the body's, as by real PX4. Where no IMU is told it turns with the body at once.

    Attributes:
        quats: (n, 4) what is told.
        tilted: (n, 4) the same without its heading error, at the date that an image then has.
        seen_ne, seen_yaw: (n, 2), (n,) errors of the attitude that is taken for an image's: where
            images are dated late, the body has turned since.
        mount_turn: by how much the camera is turned.
    """

    def __init__(self, world: FilterWorld, truth: TrueTrajectory, rng: np.random.Generator) -> None:
        n = len(truth.t_s)
        keep = math.exp(-DT_S / _TILT_DRIFT_S)
        drive = math.radians(world.tilt_drift_deg) * math.sqrt(1.0 - keep**2)
        bias = math.radians(world.tilt_bias_deg) * rng.normal(size=2)
        walk = _first_order(keep, drive * rng.normal(size=(n, 2)))
        white = math.radians(world.tilt_noise_deg) * rng.normal(size=(n, 2))
        # Correlated over some 20 ms, as a filter's output is.
        white = (white + np.roll(white, 1, 0) + np.roll(white, 2, 0)) / math.sqrt(3.0)
        levelled = _in_ned(bias + walk, truth)
        share = DT_S / _LEVELLED_S if world.imu_hz else 1.0
        tilt_ne = _first_order(1.0 - share, share * levelled, levelled[0]) + white
        down = np.array([rotation_from_quat(quat)[:, 2] for quat in truth.quat_wxyz])
        lean = down[:, :2] / down[:, 2:]
        # A camera that is turned shows the heading for more, and leans another way than the body.
        self.mount_turn = math.radians(world.mount_turn_deg)
        mount_off = np.tile(np.radians(world.mount_off_deg), (n, 1))
        self.focal_shift = -world.focal_off * lean
        steps = math.radians(world.yaw_walk_deg) * math.sqrt(DT_S) * rng.normal(size=n)
        self.yaw = math.radians(world.yaw_bias_deg) * rng.normal() + np.cumsum(steps)
        self.yaw = self.yaw + math.radians(world.yaw_step_deg) * (truth.t_s >= world.yaw_step_s)
        tilted = multiply(_small_quats(tilt_ne), truth.quat_wxyz)
        turn = np.zeros((n, 4))
        turn[:, 0], turn[:, 3] = np.cos(self.yaw / 2.0), np.sin(self.yaw / 2.0)
        self.quats = multiply(turn, tilted)
        dated = np.clip(np.arange(n) + round(world.dated_late_s / DT_S), 0, n - 1)
        self.tilted = tilted[dated]
        since = multiply(self.tilted, truth.quat_wxyz * [1.0, -1.0, -1.0, -1.0])
        since_rad = 2.0 * np.sign(since[:, :1]) * since[:, 1:]
        self.seen_ne = since_rad[:, :2] + _in_ned(mount_off, truth) - self.mount_turn * lean
        self.seen_yaw = self.yaw[dated] + since_rad[:, 2]
        w, x, y, z = tilted.T
        self.map_yaw = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))

    @property
    def nadir_shift(self) -> Array:
        """(n, 2) where the ground point that seems to be below lies, per AGL."""
        by_tilt = np.stack([-self.seen_ne[:, 1], self.seen_ne[:, 0]], axis=1)
        return np.asarray(self.focal_shift + by_tilt)


def _in_ned(body: Array, truth: TrueTrajectory) -> Array:
    """(n, 2) about north and east, of turns (n, 2) about the body's level forward and right."""
    c, s = np.cos(truth.yaw_rad), np.sin(truth.yaw_rad)
    return np.stack([c * body[:, 0] - s * body[:, 1], s * body[:, 0] + c * body[:, 1]], axis=1)


def _first_order(keep: float, drive: Array, first: Array | float = 0.0) -> Array:
    out = np.zeros_like(drive)
    out[0] = first
    for i in range(1, len(drive)):
        out[i] = keep * out[i - 1] + drive[i]
    return out


def _small_quats(tilt_ne: Array) -> Array:
    half = 0.5 * np.hypot(tilt_ne[:, 0], tilt_ne[:, 1])
    quats = np.zeros((len(tilt_ne), 4))
    quats[:, 0] = np.cos(half)
    quats[:, 1:3] = 0.5 * np.sinc(half / math.pi)[:, None] * tilt_ne
    return quats


def multiply(a: Array, b: Array) -> Array:
    """Hamilton products (n, 4)."""
    w0, v0, w1, v1 = a[:, :1], a[:, 1:], b[:, :1], b[:, 1:]
    scalar = w0 * w1 - np.sum(v0 * v1, axis=1, keepdims=True)
    return np.concatenate([scalar, w0 * v1 + w1 * v0 + np.cross(v0, v1)], axis=1)
