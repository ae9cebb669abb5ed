"""A Kalman filter along one axis of the world: position, velocity, error of the acceleration."""

import math

_VELOCITY_NOISE = 0.15  # m/s per sqrt(s): accelerometer noise and vibration
_ERROR_NOISE = 0.03  # m/s^2 per sqrt(s): how fast tilt and bias errors wander
_ERROR_LIMIT_M_S2 = 1.5


class AxisFilter:
    """State `x` (m), `v` (m/s), `b` (m/s^2, added to the measured acceleration).

    The covariance is the upper triangle p00 p01 p02 p11 p12 p22. Kept as plain floats: it runs at
    250 Hz for three axes.
    """

    __slots__ = ("b", "p00", "p01", "p02", "p11", "p12", "p22", "v", "x")

    def __init__(self, sigma_m: float) -> None:
        self.x = self.v = self.b = 0.0
        self.p00, self.p11, self.p22 = sigma_m**2, 0.5**2, 0.3**2
        self.p01 = self.p02 = self.p12 = 0.0

    def predict(self, acceleration_m_s2: float, dt_s: float) -> None:
        """Carry the state `dt_s` forward."""
        step = (acceleration_m_s2 + self.b) * dt_s
        self.x += (self.v + 0.5 * step) * dt_s
        self.v += step

    def grow(self, dt_s: float) -> None:
        """Carry the covariance `dt_s` forward: P = F P F' + Q."""
        h = 0.5 * dt_s * dt_s
        p01 = self.p01 + dt_s * self.p11 + h * self.p12
        p02 = self.p02 + dt_s * self.p12 + h * self.p22
        p12 = self.p12 + dt_s * self.p22
        self.p00 += dt_s * (self.p01 + p01) + h * (self.p02 + p02)
        self.p11 += dt_s * (self.p12 + p12) + _VELOCITY_NOISE**2 * dt_s
        self.p22 += _ERROR_NOISE**2 * dt_s
        self.p01 = p01 + h * p12
        self.p02, self.p12 = p02, p12

    def fuse_position(self, innovation_m: float, variance_m2: float) -> None:
        """Correct with a position that lies `innovation_m` past the state."""
        self._fuse(innovation_m, variance_m2, 0)

    def fuse_velocity(self, innovation_m_s: float, variance_m2_s2: float) -> None:
        """Correct with a velocity that lies `innovation_m_s` past the state."""
        self._fuse(innovation_m_s, variance_m2_s2, 1)

    def _fuse(self, innovation: float, variance: float, column: int) -> None:
        """Kalman update by the state number `column`: x += K y, P -= K P[column]."""
        column_0 = (self.p00, self.p01, self.p02)
        c0, c1, c2 = column_0 if column == 0 else (self.p01, self.p11, self.p12)
        scale = 1.0 / ((c0 if column == 0 else c1) + variance)
        self.x += c0 * scale * innovation
        self.v += c1 * scale * innovation
        self.b += c2 * scale * innovation
        self.b = min(max(self.b, -_ERROR_LIMIT_M_S2), _ERROR_LIMIT_M_S2)
        self.p00 -= c0 * c0 * scale
        self.p01 -= c0 * c1 * scale
        self.p02 -= c0 * c2 * scale
        self.p11 -= c1 * c1 * scale
        self.p12 -= c1 * c2 * scale
        self.p22 -= c2 * c2 * scale

    def reset_position(self, position_m: float, variance_m2: float) -> None:
        """Jump to a position; what was known of it is forgotten, the velocity is doubted."""
        self.x, self.p00 = position_m, variance_m2
        self.p01 = self.p02 = 0.0
        self.p11 = max(self.p11, 0.3**2)

    def test_ratio(self, innovation_m: float, variance_m2: float, gate: float) -> float:
        """Squared innovation over its gate; more than 1 is refused (EKF2's test ratio)."""
        return innovation_m**2 / (max(gate, 0.1) ** 2 * (self.p00 + variance_m2))

    @property
    def sigma_m(self) -> float:
        """One sigma of the position."""
        return math.sqrt(max(self.p00, 0.0))
