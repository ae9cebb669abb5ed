"""A quadrotor as a rigid body: four rotors with lag, drag, wind, and the ground below it.

Plain floats on purpose: at 250 Hz small numpy arrays would cost ten times as much.
"""

import math
from collections.abc import Callable

GRAVITY_M_S2 = 9.80665
MASS_KG = 1.5
INERTIA_XY_KG_M2 = 0.02
INERTIA_Z_KG_M2 = 0.035
LEVER_M = 0.16
ROTOR_MAX_N = MASS_KG * GRAVITY_M_S2 / 2.0  # thrust to weight 2: hovers at half throttle
ROTOR_LAG_S = 0.025
YAW_MOMENT_M = 0.05  # drag moment of a rotor per newton of thrust
ANGULAR_DRAG_PER_S = 0.4
_STANDS_M = 0.005  # so much higher than the ground it stands: a slope falls away below who slides


class Airframe:
    """Position and velocity in NED about the start place, quaternion of R_ned_body, body rates.

    Args:
        drag_per_s: of the rotors, by which the speed through the air falls: it grows with the
            speed alone.
        ground_m: height of the ground over the start place at (north, east).
    """

    __slots__ = (
        "_drag_per_s",
        "axb",
        "ayb",
        "azb",
        "d",
        "e",
        "ground_m",
        "n",
        "on_ground",
        "p",
        "q",
        "qw",
        "qx",
        "qy",
        "qz",
        "r",
        "rotation",
        "rotors",
        "vd",
        "ve",
        "vn",
    )

    def __init__(
        self, heading_rad: float, drag_per_s: float, ground_m: Callable[[float, float], float]
    ) -> None:
        self._drag_per_s, self.ground_m = drag_per_s, ground_m
        self.n = self.e = self.d = 0.0
        self.vn = self.ve = self.vd = 0.0
        self.qw, self.qx, self.qy = math.cos(heading_rad / 2.0), 0.0, 0.0
        self.qz = math.sin(heading_rad / 2.0)
        self.p = self.q = self.r = 0.0
        # specific force in the body, what a perfect accelerometer shows
        self.axb, self.ayb, self.azb = 0.0, 0.0, -GRAVITY_M_S2
        self.rotors = [0.0, 0.0, 0.0, 0.0]
        self.on_ground = True
        self.rotation = rotation_of(self.qw, self.qx, self.qy, self.qz)

    @property
    def agl_m(self) -> float:
        """Height above the ground right below."""
        return -self.d - self.ground_m(self.n, self.e)

    def fly_at(
        self,
        place_ned_m: tuple[float, float, float],
        velocity_ned_m_s: tuple[float, float, float],
        quat_wxyz: tuple[float, float, float, float],
        lift_m_s2: float,
    ) -> None:
        """Be in the air, turning nowhere, with rotors that push so much along the body's up."""
        self.n, self.e, self.d = place_ned_m
        self.vn, self.ve, self.vd = velocity_ned_m_s
        self.qw, self.qx, self.qy, self.qz = quat_wxyz
        self.p = self.q = self.r = 0.0
        self.rotation = rotation_of(*quat_wxyz)
        self.rotors = [lift_m_s2 * MASS_KG / (4.0 * ROTOR_MAX_N)] * 4
        self.on_ground = False

    @property
    def euler_rad(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw (Z-Y-X)."""
        return euler_of(self.rotation)

    def hover_force(self, un: float, ue: float, ud: float) -> tuple[float, float, float]:
        """Lift in NED (m/s^2) that keeps a velocity through the air (m/s)."""
        drag = self._drag_per_s
        return drag * un, drag * ue, drag * ud - GRAVITY_M_S2

    def step(
        self,
        commands: tuple[float, float, float, float],
        wind: tuple[float, float, float],
        dt_s: float,
    ) -> None:
        """Advance by `dt_s` with rotor commands 0..1 (quad x order) in a wind NED (m/s)."""
        rotors, gain = self.rotors, dt_s / ROTOR_LAG_S
        for i in range(4):
            rotors[i] += gain * (commands[i] - rotors[i])
        self._turn(dt_s)
        self._move(wind, dt_s)

    def _turn(self, dt_s: float) -> None:
        f0, f1, f2, f3 = self.rotors
        p, q, r = self.p, self.q, self.r
        lever = LEVER_M * ROTOR_MAX_N / INERTIA_XY_KG_M2
        gyroscopic = (INERTIA_Z_KG_M2 - INERTIA_XY_KG_M2) / INERTIA_XY_KG_M2
        # rotors: 0 front right, 1 rear left (both turn left), 2 front left, 3 rear right
        p_dot = lever * (f1 + f2 - f0 - f3) - gyroscopic * q * r - ANGULAR_DRAG_PER_S * p
        q_dot = lever * (f0 + f2 - f1 - f3) + gyroscopic * p * r - ANGULAR_DRAG_PER_S * q
        yaw = YAW_MOMENT_M * ROTOR_MAX_N / INERTIA_Z_KG_M2
        r_dot = yaw * (f0 + f1 - f2 - f3) - ANGULAR_DRAG_PER_S * r
        self.p, self.q, self.r = p + p_dot * dt_s, q + q_dot * dt_s, r + r_dot * dt_s
        if self.on_ground:
            self._rest(dt_s)
        self.qw, self.qx, self.qy, self.qz = turned(
            (self.qw, self.qx, self.qy, self.qz), self.p, self.q, self.r, dt_s
        )
        self.rotation = rotation_of(self.qw, self.qx, self.qy, self.qz)

    def _rest(self, dt_s: float) -> None:
        """The legs on the ground level the body and stop its rotation."""
        r20, r21, r22 = self.rotation[6:]
        self.p, self.q = -20.0 * r21 * r22, 20.0 * r20 * r22
        self.r *= max(0.0, 1.0 - 20.0 * dt_s)

    def _move(self, wind: tuple[float, float, float], dt_s: float) -> None:
        r00, r01, r02, r10, r11, r12, r20, r21, r22 = self.rotation
        lift = ROTOR_MAX_N * sum(self.rotors) / MASS_KG
        un, ue, ud = self.vn - wind[0], self.ve - wind[1], self.vd - wind[2]
        drag = self._drag_per_s
        fn = -lift * r02 - drag * un
        fe = -lift * r12 - drag * ue
        fd = -lift * r22 - drag * ud
        low = self.agl_m <= _STANDS_M
        self.on_ground = low and fd + GRAVITY_M_S2 >= 0.0
        if self.on_ground:
            self._touch(dt_s)
            fn, fe, fd = 0.0, 0.0, -GRAVITY_M_S2
        else:
            if low:
                self.vd = min(self.vd, 0.0)
            self.vn += fn * dt_s
            self.ve += fe * dt_s
            self.vd += (fd + GRAVITY_M_S2) * dt_s
        self.n += self.vn * dt_s
        self.e += self.ve * dt_s
        self.d += self.vd * dt_s
        self.axb = r00 * fn + r10 * fe + r20 * fd
        self.ayb = r01 * fn + r11 * fe + r21 * fd
        self.azb = r02 * fn + r12 * fe + r22 * fd

    def _touch(self, dt_s: float) -> None:
        """It slides to rest along the ground; legs level what it stands on."""
        friction = max(0.0, 1.0 - 8.0 * dt_s)
        self.vn *= friction
        self.ve *= friction
        self.vd = 0.0
        self.d += self.agl_m


def turned(
    quat_wxyz: tuple[float, float, float, float], p: float, q: float, r: float, dt_s: float
) -> tuple[float, float, float, float]:
    """Quaternion after body rates (rad/s) for `dt_s`: first order, then normalised."""
    w, x, y, z = quat_wxyz
    half = 0.5 * dt_s
    nw = w + half * (-x * p - y * q - z * r)
    nx = x + half * (w * p + y * r - z * q)
    ny = y + half * (w * q - x * r + z * p)
    nz = z + half * (w * r + x * q - y * p)
    scale = 1.0 / math.sqrt(nw * nw + nx * nx + ny * ny + nz * nz)
    return nw * scale, nx * scale, ny * scale, nz * scale


def euler_of(rotation: tuple[float, ...]) -> tuple[float, float, float]:
    """Roll, pitch, yaw (Z-Y-X) of the nine numbers of R_ned_body."""
    pitch = -math.asin(min(1.0, max(-1.0, rotation[6])))
    yaw = math.atan2(rotation[3], rotation[0])
    return math.atan2(rotation[7], rotation[8]), pitch, yaw


def rotation_of(w: float, x: float, y: float, z: float) -> tuple[float, ...]:
    """The nine numbers of R_ned_body, row by row."""
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )
