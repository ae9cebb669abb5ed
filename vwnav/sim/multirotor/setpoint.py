"""What the position controller follows."""

from dataclasses import dataclass


@dataclass(slots=True)
class Setpoint:
    """What a flight task asks of the position controller; None leaves that axis to the next loop.

    Position wins over velocity (which is then feed-forward); without either the axis flies the
    acceleration. `thrust` (0..1) bypasses the vertical loops. `idle` stops the rotors' push.
    """

    north_m: float | None = None
    east_m: float | None = None
    down_m: float | None = None
    vn_m_s: float | None = None
    ve_m_s: float | None = None
    vd_m_s: float | None = None
    an_m_s2: float | None = None
    ae_m_s2: float | None = None
    yaw_rad: float | None = None
    yaw_rate_rad_s: float | None = None
    thrust: float | None = None
    idle: bool = False
