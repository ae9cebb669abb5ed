"""The thresholds of the control hierarchy."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class SafetyConfig:
    """When safety overrules the route.

    Attributes:
        battery_low_ratio, battery_critical_ratio: of the full battery: return, and land.
        battery_takeoff_ratio: nobody takes off with less.
        battery_time_s: below that for so long; load pulls the voltage down for moments.
        link_hold_s: silence of the autopilot's heartbeat after which the aircraft is held.
        link_land_s: and after which it is landed.
        radio_return_s, ground_return_s: silence of the pilot's radio, of a ground station, after
            which it goes home. Only of one that has been heard: many fly without.
        battery_home_share: it goes home when what is left is so many times what that takes.
        airspeed_m_s: what the aircraft makes through the air for long.
        fence_m: off the route.
        slow_sigma_m, slow_fix_age_s: when it goes at half speed.
        hold_sigma_m: one-sigma of the horizontal position that stops the flight.
        resume_sigma_ratio: of `hold_sigma_m`; the flight goes on below that.
        hold_fix_age_s: age of the last map fix that stops the flight.
        estimate_age_s: age of the estimate itself that makes the position unusable.
        return_sigma_m: with at most this the way home can still be found.
        return_height_m: above home, to which it climbs before it goes straight home; never above
            the ceiling. Who is higher already stays so.
        climb_after_s: of holding for better times; then up, by at most `climb_most_m` and to
            `ceiling_m` above home: from higher up the map shows more.
        hold_time_s: of both; then home, or down where the way is not known.
        blind_hold_s, blind_land_s: since the last image that told a motion or a place; then the
            aircraft is held, and landed while its estimate is still good: without images it
            drifts, and a hold on a drifting estimate is no hold.
        lost_land_s: without any estimate to fly on; PX4 gives its position up 4.6 s, ArduCopter 8 s
            after the last one.
        gap_s: a silence of the link, or of ourselves, from which on autopilots act on their own.
        gap_memory_s: for so long a gap explains a failsafe of the autopilot.
        resume_gap_s: after a longer gap the route is not flown on.
        unknown_mode_s: a flight mode that nobody can name for so long is not ours.
    """

    battery_low_ratio: float = 0.25
    battery_critical_ratio: float = 0.12
    battery_takeoff_ratio: float = 0.35
    battery_time_s: float = 2.0
    link_hold_s: float = 3.0  # heartbeats come once a second, and one may get lost
    link_land_s: float = 10.0
    radio_return_s: float = 5.0
    ground_return_s: float = 30.0
    battery_home_share: float = 1.3
    airspeed_m_s: float = 12.0
    fence_m: float = 60.0
    slow_sigma_m: float = 4.0
    slow_fix_age_s: float = 8.0
    hold_sigma_m: float = 8.0
    resume_sigma_ratio: float = 0.7
    hold_fix_age_s: float = 15.0
    estimate_age_s: float = 1.0
    return_sigma_m: float = 30.0
    return_height_m: float = 15.0  # above trees and houses; ArduPilot's RTL_ALT is the same
    climb_after_s: float = 5.0
    climb_most_m: float = 30.0
    ceiling_m: float = 120.0
    hold_time_s: float = 15.0
    blind_hold_s: float = 1.0
    blind_land_s: float = 4.0
    lost_land_s: float = 2.0
    gap_s: float = 0.5
    gap_memory_s: float = 10.0
    resume_gap_s: float = 1.0
    unknown_mode_s: float = 1.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not 0.0 < value < 3600.0:
                raise ValueError(f"expected {name} to be positive, got {value}")
        for lower, upper in (
            ("battery_critical_ratio", "battery_low_ratio"),
            ("battery_low_ratio", "battery_takeoff_ratio"),
            ("link_hold_s", "link_land_s"),
            ("slow_sigma_m", "hold_sigma_m"),
            ("slow_fix_age_s", "hold_fix_age_s"),
            ("hold_sigma_m", "return_sigma_m"),
            ("climb_after_s", "hold_time_s"),
            ("blind_hold_s", "blind_land_s"),
            ("gap_s", "resume_gap_s"),
        ):
            if getattr(self, lower) > getattr(self, upper):
                raise ValueError(f"expected {lower} to be at most {upper}")

    @property
    def way_home_m(self) -> float:
        """Least height above home of the straight way there."""
        return min(self.return_height_m, self.ceiling_m)
