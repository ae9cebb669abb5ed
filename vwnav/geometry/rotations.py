"""Rotations: matrices, quaternions, Euler angles, rotation vectors.

`R_a_b` takes b-coordinates to a; quaternions are `quat_wxyz`, Hamilton product, and stand for the
same map. Euler angles are yaw about down, then pitch about right, then roll about forward (Z-Y-X).
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

MOST_TURN_RAD_S = 10.0  # what turns a multirotor faster is a correction of its attitude
_TWO_PI = 2.0 * math.pi


def wrap_pi(angle_rad: float) -> float:
    """The same angle within [-pi, pi)."""
    return (angle_rad + math.pi) % _TWO_PI - math.pi


def skew(v: ArrayLike) -> Array:
    """Matrix (3, 3) with `skew(v) @ w == cross(v, w)`."""
    x, y, z = np.asarray(v, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Array:
    """R_ned_body (3, 3) of Z-Y-X Euler angles."""
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def euler_from_rotation(R_ned_body: Array) -> tuple[float, float, float]:
    """(roll, pitch, yaw) in radians, pitch within +-pi/2; in gimbal lock roll is 0."""
    R = R_ned_body
    cos_pitch = math.hypot(R[0, 0], R[1, 0])
    pitch_rad = math.atan2(-R[2, 0], cos_pitch)
    if cos_pitch < 1e-9:
        return 0.0, pitch_rad, math.atan2(-R[0, 1], R[1, 1])
    return math.atan2(R[2, 1], R[2, 2]), pitch_rad, math.atan2(R[1, 0], R[0, 0])


def quat_multiply(quat_a_wxyz: Array, quat_b_wxyz: Array) -> Array:
    """Hamilton product (4,): the rotation b first, then a."""
    w0, x0, y0, z0 = quat_a_wxyz.tolist()
    w1, x1, y1, z1 = quat_b_wxyz.tolist()
    return np.array(
        [
            w0 * w1 - x0 * x1 - y0 * y1 - z0 * z1,
            w0 * x1 + x0 * w1 + y0 * z1 - z0 * y1,
            w0 * y1 - x0 * z1 + y0 * w1 + z0 * x1,
            w0 * z1 + x0 * y1 - y0 * x1 + z0 * w1,
        ]
    )


def quat_conjugate(quat_wxyz: Array) -> Array:
    """(4,) the way back: R_b_a of R_a_b."""
    w, x, y, z = quat_wxyz.tolist()
    return np.array([w, -x, -y, -z])


def rotation_from_quat(quat_wxyz: Array) -> Array:
    """Matrix (3, 3); the quaternion need not be of unit length.

    Raises:
        ValueError: its length is zero or not finite.
    """
    quat = np.asarray(quat_wxyz, dtype=np.float64)
    norm = math.sqrt(quat @ quat)
    if not (math.isfinite(norm) and norm > 0.0):
        raise ValueError(f"expected a quaternion of finite length, got {quat_wxyz}")
    w, x, y, z = (quat / norm).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quat_from_rotation(R: Array) -> Array:
    """quat_wxyz (4,) of unit length with w >= 0.

    Divides by the largest of the four components (Shepperd 1978), so no rotation is special.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R.tolist()
    trace = xx + yy + zz
    if trace >= max(xx, yy, zz):
        w, x, y, z = 1.0 + trace, zy - yz, xz - zx, yx - xy
    elif xx >= max(yy, zz):
        w, x, y, z = zy - yz, 1.0 + xx - yy - zz, yx + xy, zx + xz
    elif yy >= zz:
        w, x, y, z = xz - zx, xy + yx, 1.0 + yy - zz - xx, zy + yz
    else:
        w, x, y, z = yx - xy, xz + zx, yz + zy, 1.0 + zz - xx - yy
    length = math.copysign(math.sqrt(w * w + x * x + y * y + z * z), w)
    return np.array([w / length, x / length, y / length, z / length])


def rotation_from_vector(rotation_vector_rad: ArrayLike) -> Array:
    """Matrix (3, 3) that turns about the vector (3,) by its length (exponential map)."""
    return rotation_from_quat(quat_from_vector(rotation_vector_rad))


def quat_from_vector(rotation_vector_rad: ArrayLike) -> Array:
    """quat_wxyz (4,) that turns about the vector (3,) by its length."""
    x, y, z = np.asarray(rotation_vector_rad, dtype=np.float64).tolist()
    half_angle = 0.5 * math.sqrt(x * x + y * y + z * z)
    # The limit of sin(a) / a at zero is 1 - a^2 / 6.
    sinc = math.sin(half_angle) / half_angle if half_angle > 1e-4 else 1.0 - half_angle**2 / 6.0
    return np.array([math.cos(half_angle), 0.5 * sinc * x, 0.5 * sinc * y, 0.5 * sinc * z])


def vector_from_rotation(R: Array) -> Array:
    """Rotation vector (3,) with length within [0, pi] (logarithmic map)."""
    return vector_from_quat(quat_from_rotation(R))


def vector_from_quat(quat_wxyz: Array) -> Array:
    """Rotation vector (3,) of a unit quaternion, with length within [0, pi]."""
    w, x, y, z = quat_wxyz.tolist()
    sin_half = math.sqrt(x * x + y * y + z * z)
    sign = -1.0 if w < 0.0 else 1.0
    ratio = math.atan2(sin_half, abs(w)) / sin_half if sin_half > 1e-12 else 1.0
    return (2.0 * sign * ratio) * np.array([x, y, z])


def without_errors(quat_wxyz: Array, heading_rad: float, tilt_rad: Array) -> Array:
    """quat_wxyz (4,) of an attitude less its errors: R = Rz(-heading) exp(-tilt) R_measured.

    Args:
        quat_wxyz: (4,) of R_ned_body as it was measured.
        heading_rad: by how much its heading is off, clockwise.
        tilt_rad: (2,) by how much it leans wrongly about its level forward and right.
    """
    w, x, y, z = quat_wxyz.tolist()
    yaw_rad = math.atan2(2.0 * (x * y + w * z), w * w + x * x - y * y - z * z)
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    forward, right = tilt_rad.tolist()
    untilt = quat_from_vector([-c * forward + s * right, -s * forward - c * right, 0.0])
    unturn = quat_from_vector([0.0, 0.0, -heading_rad])
    quat = quat_multiply(quat_multiply(unturn, untilt), quat_wxyz)
    return quat / math.copysign(math.sqrt(quat @ quat), quat[0])


def slerp(quat0_wxyz: Array, quat1_wxyz: Array, fraction: float) -> Array:
    """Rotation (4,) on the short way from `quat0` (fraction 0) to `quat1` (fraction 1), w >= 0."""
    R0 = rotation_from_quat(quat0_wxyz)
    step = vector_from_rotation(R0.T @ rotation_from_quat(quat1_wxyz))
    return quat_from_rotation(R0 @ rotation_from_vector(fraction * step))
