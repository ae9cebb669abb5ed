"""The thresholds of the control hierarchy, and of what an autopilot may be told."""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from vwnav.settings.ranges import Angle, Count, Settings, Within


@dataclass(frozen=True, slots=True, kw_only=True)
class SafetyConfig(Settings):
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
        return_height_m: above home, to which it climbs before it goes straight home, or more where
            the map's ground asks for it; never above the ceiling. Who is higher already stays so.
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

    AT_MOST: ClassVar[tuple[tuple[str, str], ...]] = (
        ("battery_critical_ratio", "battery_low_ratio"),
        ("battery_low_ratio", "battery_takeoff_ratio"),
        ("link_hold_s", "link_land_s"),
        ("slow_sigma_m", "hold_sigma_m"),
        ("slow_fix_age_s", "hold_fix_age_s"),
        ("hold_sigma_m", "return_sigma_m"),
        ("climb_after_s", "hold_time_s"),
        ("blind_hold_s", "blind_land_s"),
        ("gap_s", "resume_gap_s"),
    )

    battery_low_ratio: Annotated[float, Within(0.0, 1.0, above=True)] = 0.25
    battery_critical_ratio: Annotated[float, Within(0.0, 1.0, above=True)] = 0.12
    battery_takeoff_ratio: Annotated[float, Within(0.0, 1.0, above=True)] = 0.35
    battery_time_s: Annotated[float, Within(0.0, 60.0, above=True)] = 2.0
    # Heartbeats come once a second, and one may get lost
    link_hold_s: Annotated[float, Within(0.0, 60.0, above=True)] = 3.0
    link_land_s: Annotated[float, Within(0.0, 600.0, above=True)] = 10.0
    radio_return_s: Annotated[float, Within(0.0, 3600.0, above=True)] = 5.0
    ground_return_s: Annotated[float, Within(0.0, 3600.0, above=True)] = 30.0
    battery_home_share: Annotated[float, Within(1.0, 100.0)] = 1.3
    airspeed_m_s: Annotated[float, Within(0.0, 100.0, above=True)] = 12.0
    fence_m: Annotated[float, Within(0.0, 3599.0, above=True)] = 60.0
    slow_sigma_m: Annotated[float, Within(0.0, 1000.0, above=True)] = 4.0
    slow_fix_age_s: Annotated[float, Within(0.0, 3599.0, above=True)] = 8.0
    hold_sigma_m: Annotated[float, Within(0.0, 1000.0, above=True)] = 8.0
    resume_sigma_ratio: Annotated[float, Within(0.0, 1.0, above=True)] = 0.7
    hold_fix_age_s: Annotated[float, Within(0.0, 3599.0, above=True)] = 15.0
    estimate_age_s: Annotated[float, Within(0.0, 10.0, above=True)] = 1.0
    return_sigma_m: Annotated[float, Within(0.0, 1000.0, above=True)] = 30.0
    # Above trees and houses; ArduPilot's RTL_ALT is the same
    return_height_m: Annotated[float, Within(0.0, 1000.0, above=True)] = 15.0
    climb_after_s: Annotated[float, Within(0.0, 3599.0, above=True)] = 5.0
    climb_most_m: Annotated[float, Within(0.0, 1000.0, above=True)] = 30.0
    ceiling_m: Annotated[float, Within(0.0, 1000.0, above=True)] = 120.0
    hold_time_s: Annotated[float, Within(0.0, 3599.0, above=True)] = 15.0
    blind_hold_s: Annotated[float, Within(0.0, 60.0, above=True)] = 1.0
    blind_land_s: Annotated[float, Within(0.0, 60.0, above=True)] = 6.0
    lost_land_s: Annotated[float, Within(0.0, 60.0, above=True)] = 2.0
    gap_s: Annotated[float, Within(0.0, 10.0, above=True)] = 0.5
    gap_memory_s: Annotated[float, Within(0.0, 600.0, above=True)] = 10.0
    resume_gap_s: Annotated[float, Within(0.0, 60.0, above=True)] = 1.0
    unknown_mode_s: Annotated[float, Within(0.0, 60.0, above=True)] = 1.0

    @property
    def way_home_m(self) -> float:
        """Least height above home of the straight way there."""
        return min(self.return_height_m, self.ceiling_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimateLimits(Settings):
    """What may be sent to an autopilot.

    Attributes:
        max_age_s: against the clock, both ways.
        max_speed_m_s: horizontal; no multirotor of ours flies faster, wind included.
        max_tilt_rad: of the attitude that comes with it.
        max_velocity_sigma_m_s, max_position_sigma_m: larger semi-axis, while it is sent; the
            position's only after a first fix: before, the aircraft is wherever it stands. It is
            wide: what comes down without images needs a velocity, or the wind has it.
        new_velocity_sigma_m_s, new_position_sigma_m: of one that comes back, or that says by its
            reset counter that it jumped.
        max_jump_m: beyond what `max_speed_m_s` explains, without another reset counter. Autopilots
            follow a silent jump of 5 m within 3 s.
        max_velocity_jump_m_s: from one to the next.
        max_gap_s: between two; after a longer one nothing is sent at once.
        brief_gap_s: after a gap no longer than that it goes on as the same, once it is steady.
        settle_s: for how long it has to be steady then.
        settle_drift_m_s: off the course before the gap, per second of it, besides the jump.
        steady_s: between two jumps that are announced; one that jumps on and on tells nothing.
        held_back_s: by the watchdog, which looks at a new one for half a second or so.
        new_fixes, new_fixes_s: how many fixes, over how long, make a lost estimate a new one.
        unproven_s: for how long one without those fixes has had a sure velocity, by images or, once
            it had none, by the air that is felt, when it comes back. An autopilot that is told
            neither comes down with the wind.
        unproven_sigma_m: its place is told with at least this, whatever a fix or two have made of
            it: a match at a wrong place lies in the region that was searched.
    """

    AT_MOST: ClassVar[tuple[tuple[str, str], ...]] = (
        ("new_velocity_sigma_m_s", "max_velocity_sigma_m_s"),
        ("new_position_sigma_m", "unproven_sigma_m"),
        ("max_gap_s", "brief_gap_s"),
    )

    max_age_s: Annotated[float, Within(0.0, 5.0, above=True)] = 0.25
    max_speed_m_s: Annotated[float, Within(0.0, 100.0, above=True)] = 35.0
    max_tilt_rad: Angle = math.radians(70.0)
    max_velocity_sigma_m_s: Annotated[float, Within(0.0, 100.0, above=True)] = 4.0
    max_position_sigma_m: Annotated[float, Within(0.0, 1000.0, above=True)] = 60.0
    new_velocity_sigma_m_s: Annotated[float, Within(0.0, 100.0, above=True)] = 1.5
    new_position_sigma_m: Annotated[float, Within(0.0, 1000.0, above=True)] = 5.0
    max_jump_m: Annotated[float, Within(0.0, 100.0, above=True)] = 3.0
    max_velocity_jump_m_s: Annotated[float, Within(0.0, 100.0, above=True)] = 5.0
    max_gap_s: Annotated[float, Within(0.0, 10.0, above=True)] = 0.5
    brief_gap_s: Annotated[float, Within(0.0, 10.0, above=True)] = 1.0
    settle_s: Annotated[float, Within(0.0, 60.0, above=True)] = 0.5
    settle_drift_m_s: Annotated[float, Within(0.0, 100.0, above=True)] = 2.0
    steady_s: Annotated[float, Within(0.0, 60.0, above=True)] = 1.0
    held_back_s: Annotated[float, Within(0.0, 60.0, above=True)] = 1.5
    new_fixes: Count = 3
    new_fixes_s: Annotated[float, Within(0.0, 600.0, above=True)] = 1.0
    unproven_s: Annotated[float, Within(0.0, 600.0, above=True)] = 1.5
    unproven_sigma_m: Annotated[float, Within(0.0, 1000.0, above=True)] = 40.0
