"""What the gyro says of a step: by how much the error of the autopilot's attitude has changed.

The autopilot's attitude R_m is off by E: R_m = E R_true (left error, NED). The gyro counts the true
turn G of the body, but for its bias, so

    R_m1 G^T R_m0^T = E1 E0^T

shows how E has changed: tilt that builds up, a compass that is pulled aside, a heading that the
autopilot's own filter resets. Only changes: what E is, fixes and odometry tell.
"""

from typing import NamedTuple

import numpy as np

from vwnav.estimation.config import EkfConfig
from vwnav.estimation.inertial.attitudes import level_axes, yaw_of
from vwnav.estimation.inertial.preintegration import PreintegratedImu
from vwnav.estimation.states import CHI_SQUARE_GATE, States
from vwnav.geometry.rotations import quat_conjugate, quat_multiply, vector_from_quat
from vwnav.types import Array

_JUMP_UNSURE = 0.1  # of a jump's size: how well the gyro tells it


class DelayedStateMeasurement(NamedTuple):
    """About both ends of a step x1 = F x0 + w: z = A x1 - B x0 + n, which is C x0 + A w + n.

    Attributes:
        residual: (3,) rad, NED: measured minus predicted.
        A, C: (3, n), C = A F - B. R: (3, 3) covariance of n.
    """

    residual: Array
    A: Array
    C: Array
    R: Array


def gyro_measurement(
    x: Array,
    imu: PreintegratedImu,
    quats: tuple[Array, Array],
    span_s: float,
    F_tilt: Array,
    config: EkfConfig,
) -> DelayedStateMeasurement:
    """Compare the autopilot's attitudes (4,) at a step's ends with the gyro's turn between them.

    Args:
        x: (n,) the state before the step.
        imu: what the IMU felt in it.
        quats: quat_wxyz of the autopilot before and after.
        span_s: length of the step.
        F_tilt: (2, 2) what the step makes of the tilt error.
        config: noises.
    """
    quat0, quat1 = quats
    turned_wxyz = quat_multiply(quat0, imu.turn_wxyz)
    seen = vector_from_quat(quat_multiply(quat1, quat_conjugate(turned_wxyz)))
    yaw0_rad = yaw_of(quat0) + float(seen[2])  # a jump of the heading turns the level axes
    level0, level1 = level_axes(yaw0_rad), level_axes(yaw_of(quat1))
    A = np.zeros((3, States.SIZE))
    A[:2, States.TILT] = level1
    A[2, States.HEADING_BIAS] = 1.0
    C = np.zeros((3, States.SIZE))
    C[:2, States.TILT] = level1 @ F_tilt - level0
    C[:, States.GYRO_BIAS] = -imu.rotation_s
    turn_rad = vector_from_quat(imu.turn_wxyz)
    variance = config.gyro_noise_rad**2 * span_s + imu.turn_variance_rad2
    variance += config.gyro_share**2 * float(turn_rad @ turn_rad)
    return DelayedStateMeasurement(seen - C @ x, A, C, variance * np.eye(3))


def correlated_noise_update(
    x: Array, P: Array, F: Array, Q: Array, z: DelayedStateMeasurement
) -> tuple[Array, Array]:
    """Kalman filter with correlated process and measurement noise: (x, P) after a step.

    The step's noise w is also in what is measured, by E[w v^T] = Q A^T (Simon 2006, "Optimal State
    Estimation", section 7.1; of two ends of a step it is the delayed-state filter of Brown and
    Hwang, "Introduction to Random Signals and Applied Kalman Filtering"): the gain is K = W S^-1,
    with W = F P C^T + Q A^T and S = C P C^T + A Q A^T + R, and P' = F P F^T + Q - W K^T.

    Gyros do not jump, attitude filters do: a change that the noises do not explain is one of the
    attitude's error, and opens Q. `x` (n,) is predicted already, `P` (n, n) is not.
    """
    A, C, R, r = z.A, z.C, z.R, z.residual
    PCt = P @ C.T
    S, W = C @ PCt + R, F @ PCt
    AQAt, QAt = _noise(A, Q)
    weighed, K = _weighed(S + AQAt, W + QAt, r)
    if r @ weighed > CHI_SQUARE_GATE[3]:
        Q = _opened(Q, r)
        AQAt, QAt = _noise(A, Q)
        K = _weighed(S + AQAt + np.diag((_JUMP_UNSURE * r) ** 2), W + QAt, r)[1]
    return x + K @ r, F @ P @ F.T + Q - (W + QAt) @ K.T


def _weighed(S: Array, W: Array, r: Array) -> tuple[Array, Array]:
    """S^-1 r (3,) and W S^-1 (n, 3)."""
    solved = np.asarray(np.linalg.solve(S, np.column_stack([r, W.T])))
    return solved[:, 0], solved[:, 1:].T


def _noise(A: Array, Q: Array) -> tuple[Array, Array]:
    """A Q A^T (3, 3) and Q A^T (n, 3)."""
    QAt = Q @ A.T
    return A @ QAt, QAt


def _opened(Q: Array, r: Array) -> Array:
    """Q (n, n) with the attitude's error open to a jump r (3,)."""
    opened = Q.copy()
    opened[States.HEADING_BIAS, States.HEADING_BIAS] += r[2] ** 2
    opened[States.TILT, States.TILT] += (r[0] ** 2 + r[1] ** 2) * np.eye(2)
    return opened
