"""How fast, how near, how hard: the numbers that guidance keeps to."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitsConfig:
    """Limits and gains of guidance.

    Attributes:
        cruise_m_s: speed along a leg.
        speed_max_m_s: horizontal, corrections included.
        climb_m_s, descend_m_s: vertical, both positive.
        acceleration_m_s2: of the horizontal setpoint, at most.
        braking_m_s2: deceleration planned before corners, acceleration along a leg.
        corner_change_m_s: change of velocity that a corner may ask for.
        position_gain_per_s: metres off the line to metres per second back to it.
        cross_speed_m_s: most of that.
        cross_slow_m: this far off the line the speed along it is halved.
        bias_gain_per_s2: growth of the correction for wind that position control leaves over.
        bias_max_m_s: most of that.
        latency_s: of estimate, link and velocity loop together.
        yaw_rate_rad_s: of the heading setpoint, at most.
        acceptance_m: a waypoint is reached this near, or within one sigma of the position if that
            is more, up to `acceptance_max_m`.
        height_acceptance_m: and this near in height.
        arrival_speed_m_s: the route is done when slower than this at its last waypoint.
    """

    cruise_m_s: float = 8.0
    speed_max_m_s: float = 10.0
    climb_m_s: float = 3.0
    descend_m_s: float = 2.0
    acceleration_m_s2: float = 2.5
    braking_m_s2: float = 1.2
    corner_change_m_s: float = 1.2
    position_gain_per_s: float = 1.0
    cross_speed_m_s: float = 3.0
    cross_slow_m: float = 15.0
    bias_gain_per_s2: float = 0.06
    bias_max_m_s: float = 1.5
    latency_s: float = 0.7
    yaw_rate_rad_s: float = 0.8
    acceptance_m: float = 1.0
    acceptance_max_m: float = 8.0
    height_acceptance_m: float = 2.0
    arrival_speed_m_s: float = 1.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not 0.0 < value < 1000.0:
                raise ValueError(f"expected {name} to be positive, got {value}")
