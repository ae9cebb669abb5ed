"""What a simulator's truth says at one moment, from either message, and between two moments."""

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class TruthState:
    """Where the vehicle really is.

    Attributes:
        t_s: when it was so, on the reader's clock.
        quat_wxyz: of R_ned_body, w may be negative.
        rates_rad_s: of the body, forward-right-down.
    """

    t_s: float
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    quat_wxyz: tuple[float, float, float, float]
    velocity_ned_m_s: tuple[float, float, float]
    rates_rad_s: tuple[float, float, float]


def from_hil_state_quaternion(m: Any, t_s: float) -> TruthState | None:
    """PX4's truth; None for numbers that cannot be a state."""
    return _state(
        t_s,
        (m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3),
        tuple(m.attitude_quaternion),
        (m.vx * 0.01, m.vy * 0.01, m.vz * 0.01),
        (m.rollspeed, m.pitchspeed, m.yawspeed),
    )


def from_sim_state(m: Any, t_s: float) -> TruthState | None:
    """ArduPilot's; its float latitude is good to a metre only, hence the integers."""
    exact = m.lat_int != 0 or m.lon_int != 0
    place = (m.lat_int * 1e-7, m.lon_int * 1e-7) if exact else (m.lat, m.lon)
    return _state(
        t_s,
        (*place, m.alt),
        (m.q1, m.q2, m.q3, m.q4),
        (m.vn, m.ve, m.vd),
        (m.xgyro, m.ygyro, m.zgyro),
    )


def _state(
    t_s: float,
    place: tuple[float, float, float],
    quat_wxyz: tuple[float, ...],
    velocity_ned_m_s: tuple[float, float, float],
    rates_rad_s: tuple[float, float, float],
) -> TruthState | None:
    """None for numbers that cannot be a state."""
    numbers = (*place, *quat_wxyz, *velocity_ned_m_s, *rates_rad_s)
    norm = math.sqrt(sum(value * value for value in quat_wxyz))
    if not all(map(math.isfinite, numbers)) or abs(norm - 1.0) > 0.05:
        return None
    w, x, y, z = (value / norm for value in quat_wxyz)
    return TruthState(t_s, *place, (w, x, y, z), velocity_ned_m_s, rates_rad_s)


def between(a: TruthState, b: TruthState, t_s: float) -> TruthState:
    """Linear in position, velocity and rates; the attitude along the shorter arc."""
    share = (t_s - a.t_s) / max(b.t_s - a.t_s, 1e-9)
    if abs(b.lon_deg - a.lon_deg) > 180.0:  # over the antimeridian: the nearer state will do
        return a if share < 0.5 else b

    def mix(p: tuple[float, ...], q: tuple[float, ...], sign: float = 1.0) -> tuple[float, ...]:
        return tuple(u + share * (sign * v - u) for u, v in zip(p, q, strict=True))

    dot = sum(u * v for u, v in zip(a.quat_wxyz, b.quat_wxyz, strict=True))
    w, x, y, z = mix(a.quat_wxyz, b.quat_wxyz, -1.0 if dot < 0.0 else 1.0)
    norm = math.sqrt(w * w + x * x + y * y + z * z)  # states are 10 ms apart: nlerp is slerp
    lat, lon, alt = mix((a.lat_deg, a.lon_deg, a.alt_amsl_m), (b.lat_deg, b.lon_deg, b.alt_amsl_m))
    vn, ve, vd = mix(a.velocity_ned_m_s, b.velocity_ned_m_s)
    p, q, r = mix(a.rates_rad_s, b.rates_rad_s)
    quat_wxyz = (w / norm, x / norm, y / norm, z / norm)
    return TruthState(t_s, lat, lon, alt, quat_wxyz, (vn, ve, vd), (p, q, r))
