"""What the gyro says of a step: by how much the error of the autopilot's attitude has changed.

The autopilot's attitude R_m is off by E: R_m = E R_true (left error, NED). The gyro counts the true
turn G of the body, but for its bias, so

    R_m1 G^T R_m0^T = E1 E0^T

shows how E has changed: tilt that builds up, a compass that is pulled aside, a heading that the
autopilot's own filter resets. Only changes: what E is, fixes and odometry tell.
"""

from dataclasses import dataclass

import numpy as np

from vwnav.estimation.config import EkfConfig
from vwnav.estimation.inertial.attitudes import level_axes, yaw_of
from vwnav.estimation.inertial.preintegration import Push
from vwnav.estimation.states import States
from vwnav.estimation.updates import CHI_SQUARE_GATE
from vwnav.geometry.rotations import quat_conjugate, quat_multiply, vector_from_quat
from vwnav.types import Array

_YAW = States.HEADING_BIAS.start
_TILT = States.TILT
_DOWN = 2
_LEVEL = np.eye(2)
_JUMP_UNSURE = 0.1  # of a jump's size: how well the gyro tells it
_TURN_UNSURE = 4.0  # tilts: whether a tilt error turns with the body or stays is not known


@dataclass(frozen=True, slots=True, eq=False)
class Turned:
    """A statement about both ends of a step: seen = A x1 - B x0 + noise, B within `C` = A F - B.

    Attributes:
        residual: (3,) rad, NED: seen minus predicted.
        A, C: (3, n). R: (3, 3).
    """

    residual: Array
    A: Array
    C: Array
    R: Array


def gyro_says(
    x: Array,
    push: Push,
    quats: tuple[Array, Array],
    span_s: float,
    F_tilt: Array,
    config: EkfConfig,
) -> Turned:
    """Compare the autopilot's attitudes (4,) at a step's ends with the gyro's turn between them.

    Args:
        x: (n,) the state before the step.
        push: what the IMU felt in it.
        quats: quat_wxyz of the autopilot before and after.
        span_s: length of the step.
        F_tilt: (2, 2) what the step makes of the tilt error.
        config: noises.
    """
    quat0, quat1 = quats
    seen = vector_from_quat(
        quat_multiply(quat_multiply(quat1, quat_conjugate(push.turn_wxyz)), quat_conjugate(quat0))
    )
    yaw0_rad = yaw_of(quat0) + float(seen[_DOWN])  # a jump of the heading turns the level axes
    level0, level1 = level_axes(yaw0_rad), level_axes(yaw_of(quat1))
    A = np.zeros((3, States.SIZE))
    A[:2, _TILT] = level1
    A[_DOWN, _YAW] = 1.0
    C = np.zeros((3, States.SIZE))
    C[:2, _TILT] = level1 @ F_tilt - level0
    C[:, States.GYRO_BIAS] = -push.rotation_s
    turn_rad = vector_from_quat(push.turn_wxyz)
    variance = config.gyro_noise_rad**2 * span_s + push.shaken_rad2
    variance += config.gyro_share**2 * float(turn_rad @ turn_rad)
    unsure = _TURN_UNSURE * config.tilt_sigma_rad * float(turn_rad[_DOWN])
    R = np.diag([variance + unsure**2, variance + unsure**2, variance])
    return Turned(seen - C @ x, A, C, R)


def conditioned(moved: Array, P: Array, F: Array, Q: Array, turned: Turned) -> tuple[Array, Array]:
    """The step x1 = F x0 + w, knowing also what the gyro said of it: (x, P) after it.

    The noise w is in what was seen, so it is a correlated measurement; its error is, in Joseph's
    form, (F - K C) x0 + (I - K A) w - K n. Gyros do not jump, attitude filters do: a change that
    the noises do not explain is one of the attitude's error.
    """
    A, C, R, r = turned.A, turned.C, turned.R, turned.residual
    PCt, QAt = P @ C.T, Q @ A.T
    S = C @ PCt + A @ QAt + R
    if r @ np.linalg.solve(S, r) > CHI_SQUARE_GATE[3]:
        R = R + np.diag((_JUMP_UNSURE * r) ** 2)
        Q = Q.copy()
        Q[_YAW, _YAW] += r[_DOWN] ** 2
        Q[_TILT, _TILT] += (r[0] ** 2 + r[1] ** 2) * _LEVEL
        QAt = Q @ A.T
        S = C @ PCt + A @ QAt + R
    K = np.linalg.solve(S, (F @ PCt + QAt).T).T
    M = F - K @ C
    crossed = K @ QAt.T
    return moved + K @ r, M @ P @ M.T + Q - crossed - crossed.T + K @ (A @ QAt + R) @ K.T
