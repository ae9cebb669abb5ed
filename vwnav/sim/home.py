"""Where an autopilot's own return goes."""

from dataclasses import dataclass


@dataclass(slots=True)
class HomePosition:
    """Geodetic and local (north, east, down in m); `t_s` is when it was set."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    local_m: tuple[float, float, float]
    t_s: float
