"""How fast, how near, how hard: the numbers that guidance keeps to."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from vwnav.settings.ranges import Settings, Within

_HEIGHT_GAIN_PER_S = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitsConfig(Settings):
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

    AT_MOST: ClassVar[tuple[tuple[str, str], ...]] = (
        ("cruise_m_s", "speed_max_m_s"),
        ("braking_m_s2", "acceleration_m_s2"),
        ("acceptance_m", "acceptance_max_m"),
    )

    cruise_m_s: Annotated[float, Within(0.0, 35.0, above=True)] = 8.0
    speed_max_m_s: Annotated[float, Within(0.0, 35.0, above=True)] = 10.0
    climb_m_s: Annotated[float, Within(0.0, 20.0, above=True)] = 3.0
    descend_m_s: Annotated[float, Within(0.0, 20.0, above=True)] = 2.0
    acceleration_m_s2: Annotated[float, Within(0.0, 20.0, above=True)] = 2.5
    braking_m_s2: Annotated[float, Within(0.0, 20.0, above=True)] = 1.2
    corner_change_m_s: Annotated[float, Within(0.0, 20.0, above=True)] = 1.2
    position_gain_per_s: Annotated[float, Within(0.0, 5.0, above=True)] = 1.0
    cross_speed_m_s: Annotated[float, Within(0.0, 35.0, above=True)] = 3.0
    cross_slow_m: Annotated[float, Within(0.0, 999.0, above=True)] = 15.0
    bias_gain_per_s2: Annotated[float, Within(0.0, 5.0, above=True)] = 0.06
    bias_max_m_s: Annotated[float, Within(0.0, 20.0, above=True)] = 1.5
    latency_s: Annotated[float, Within(0.0, 5.0, above=True)] = 0.7
    yaw_rate_rad_s: Annotated[float, Within(0.0, 10.0, above=True)] = 0.8
    acceptance_m: Annotated[float, Within(0.0, 100.0, above=True)] = 1.0
    acceptance_max_m: Annotated[float, Within(0.0, 100.0, above=True)] = 8.0
    height_acceptance_m: Annotated[float, Within(0.0, 100.0, above=True)] = 2.0
    arrival_speed_m_s: Annotated[float, Within(0.0, 20.0, above=True)] = 1.0


def vertical_speed_m_s(error_down_m: float, feed_m_s: float, limits: LimitsConfig) -> float:
    """Downward speed for a height error, down positive, on top of a speed that is due anyway."""
    speed_m_s = feed_m_s + _HEIGHT_GAIN_PER_S * error_down_m
    return min(max(speed_m_s, -limits.climb_m_s), limits.descend_m_s)
