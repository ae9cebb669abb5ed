"""Noises and limits of the filter, one visible number each."""

import math
from dataclasses import dataclass, replace
from typing import Annotated

from vwnav.settings.ranges import Angle, Count, NotNegative, Positive, Settings, Share, Within


@dataclass(frozen=True, slots=True, kw_only=True)
class EkfConfig(Settings):
    """Noises and limits. Sigmas are one standard deviation; densities are per root second."""

    # How the states change
    acceleration_noise_m_s2: NotNegative = 0.3  # per root hertz, horizontal, white
    vertical_noise_m_s2: NotNegative = 0.4  # per root hertz, white
    swing_noise_rad_s2: NotNegative = 0.0  # per root hertz, of a camera that nothing levels
    acceleration_sigma_m_s2: Positive = 1.5  # of the slow part, first-order Gauss-Markov
    acceleration_time_s: Positive = 5.0
    heading_walk_rad: Angle = math.radians(0.15)  # per root second
    heading_slew_rad: Angle = math.radians(0.3)  # by realigning: a gyro sees it, a silence hides it
    tilt_sigma_rad: Angle = math.radians(2.0)  # per axis, first-order Gauss-Markov
    tilt_time_s: Positive = 200.0  # mostly a bias of mounting and accelerometers
    tilt_slew_rad: Angle = math.radians(0.1)  # while a gyro tells: filters level anew
    # Of the camera, for good; `vwnav fly` takes them from its file
    mount_sigma_rad: Angle = math.radians(0.2)  # per axis
    mount_turn_sigma_rad: Angle = math.radians(1.5)  # about down: a turned one shows no tilt
    focal_sigma_ratio: Share = 0.001
    time_offset_sigma_s: Annotated[float, Within(0.0, 2.0, above=True)] = 0.08  # of its dates
    time_offset_walk_s: NotNegative = 3e-4  # per root second: 1 ms in 10 s, 18 ms in an hour
    # Of fixes, for good
    fix_lean_rad: Angle = math.radians(0.2)  # per axis, alike in every turn: 17 cm at 50 m
    # Of sensors and air
    # Per root second: 3.2 m in 10 minutes, as weather and warming do
    baro_walk_m: NotNegative = 0.13
    # Per root metre of climb: 0.35 m in 50, of warm or cold air
    baro_climb_walk_m: NotNegative = 0.05
    # Per root hertz, all axes, with vibration; instead of the above
    imu_noise_m_s2: NotNegative = 0.1
    # Bias at first, with a tilted mount's share of gravity
    accelerometer_sigma_m_s2: Positive = 0.3
    accelerometer_walk_m_s2: NotNegative = 0.003  # per root second
    gyro_noise_rad: Angle = math.radians(0.05)  # per root second: what a gyro's turn wanders
    gyro_share: Share = 0.001  # of a turn: scale factor, and what happens between samples
    gyro_sigma_rad_s: Angle = math.radians(0.5)  # bias at first
    gyro_walk_rad_s: Angle = math.radians(0.005)  # per root second
    # At first; from 0.1 of a slick large one to 1 of PX4's simulated one
    drag_per_s: Positive = 0.35
    drag_sigma_per_s: Positive = 0.3  # at first
    drag_walk_per_s: NotNegative = 0.001  # per root second
    drag_range_per_s: Annotated[tuple[float, float], Within(0.0, 10.0, above=True)] = (0.02, 2.0)
    # Of the force across the thrust, averaged, beyond what is shaken
    drag_noise_m_s2: NotNegative = 0.1
    drag_interval_s: Positive = 0.4  # between two
    wind_force_sigma_m_s2: Positive = 2.0  # at first
    wind_walk_m_s: NotNegative = 0.3  # per root second
    roughness_m: Positive = 0.1  # of open land with some obstacles: the wind is less towards it
    shear_share: Share = 0.6  # by which that profile is not the air's, one sigma
    gust_sigma_m_s: Positive = 0.1  # at first
    # Turbulence is a share of the wind (one sigma; MIL-F-8785C: 0.16 at 50 m, 0.19 at 10 m), and
    # passes with it in waves of such a length
    gust_share: Share = 0.2
    gust_length_m: Positive = 60.0
    terrain_walk_m: NotNegative = 0.10  # per root metre flown: 1 m in 100 m
    terrain_walk_known_m: NotNegative = 0.07  # with the terrain heights of a map: 1 m in 200 m
    terrain_bend_m: NotNegative = 2.0  # the same, times the slope: what slopes, bends
    relief_length_m: Positive = 40.0  # from wood to clearing, from roof to street
    slope: NotNegative = 0.1  # of the ground, one sigma per axis, where ways tell it
    slope_length_m: Positive = 40.0  # Gauss-Markov in the way flown
    slope_seen: NotNegative = 0.03  # what a view of houses, trees and hollows is no plane by
    map_sigma_m: Positive = 0.3  # Gauss-Markov in the way flown: all fixes of a place share it
    map_stated_sigma_m: NotNegative = 0.0  # at first, of a pack that knows it to be worse
    map_turn_rad: Angle = math.radians(0.25)  # likewise: a tilt that matching took for a turn, too
    map_scale: Share = 0.008
    map_length_m: Positive = 100.0  # waves of 50 m, and ways that lead back over the same ground
    # Per root hertz, horizontal, while no attitude tells the thrust
    lost_noise_m_s2: NotNegative = 5.0
    lost_climb_noise_m_s2: NotNegative = 2.0  # per root hertz, likewise
    thrust_aided: bool = True  # horizontal acceleration of a multirotor from its attitude
    # How sure the states are at first
    heading_sigma_rad: Angle = math.radians(15.0)  # a compass near motors and steel
    # Stands for no idea of the position
    unknown_sigma_m: Annotated[float, Within(0.0, 1e6, above=True)] = 2000.0
    baro_sigma_m: Positive = 1.0
    # Measurements
    height_sigma_m: Positive = 0.25  # barometer, white part
    height_lag_s: NotNegative = 0.05  # of the barometer, beyond what its stamps say
    rangefinder_lag_s: NotNegative = 0.15  # likewise: it is polled before it is stamped
    rangefinder_sigma_m: Positive = 0.05
    rangefinder_sigma_ratio: Share = 0.02  # of the distance
    stationary_sigma_m_s: Positive = 0.05
    # Of its turning, by the gyro.
    stationary_sigma_rad_s: Annotated[float, Within(0.0, math.pi, above=True)] = math.radians(0.4)
    stationary_s: Positive = 1.0  # who stood disarmed does not move sooner: rotors spin up first
    stationary_agl_m: Positive = 0.15  # height of the camera while the aircraft stands
    stationary_agl_sigma_m: Positive = 0.15
    # Lower than this it may strike the ground, shorter than an IMU hears
    blow_agl_m: NotNegative = 2.0
    blow_noise_m_s2: NotNegative = 1.0  # per root hertz, horizontal, instead of less
    touching_agl_m: NotNegative = 0.3  # lower than this it touches the ground, or is about to
    touching_speed_m_s: Positive = 1.5  # and no faster than this sideways
    touching_s: Positive = 10.0  # after which one that was not told to have landed flies so low
    touching_sigma_m_s: Positive = 0.5  # of its horizontal speed then, per barometric height
    slope_share: Share = 0.2  # of a way, times the slope of the ground
    relief_share: Share = 0.5  # of a way, times the relief's share of the height: of each image
    zoom_share: Share = 0.05  # of a climb that odometry sees; 1 % is wrong each time alike
    picture_date_s: NotNegative = 0.005  # error of an image's date, its read-out's part included
    anchor_share: Share = 0.5  # of an odometry covariance that is due to the keyframe
    odometry_turns_attitude: bool = False  # the heading stream is odometry's own: no new witness
    visual_weight: Share = 0.0  # lambda of the thesis' eq. 3.30: extra pull to the fix, 0 to 1
    # What no aircraft does: a state beyond these begins anew from the last trusted fix
    most_speed_m_s: Positive = 35.0
    most_climb_m_s: Positive = 25.0
    most_tilt_rad: Angle = math.radians(15.0)  # of the autopilot's attitude, its error
    restart_sigma_m: Positive = 10.0  # and half the way it may have flown since that fix
    restart_velocity_m_s: Positive = 15.0
    # Time
    # How late a measurement may be
    history_s: Annotated[float, Within(0.0, 60.0, above=True)] = 2.0
    # How far ahead of the newest time known one may be
    ahead_s: Annotated[float, Within(0.0, 60.0, above=True)] = 2.0
    # Re-localisation
    relocation_fixes: Count = 12  # refused fixes that must agree before the filter jumps to them
    relocation_span_s: Positive = 4.0  # and the least time between first and last of them
    relocation_drift_m_s: Positive = 0.5  # by which agreeing fixes may drift apart
    dispute_window_s: Positive = 30.0  # refused measurements are remembered this long
    sudden_sigma_m: Positive = 5.0  # a pull beyond what this explains needs ...
    sudden_fixes: Count = 2  # ... so many fixes that agree, however unsure the filter is
    lone_fix_sigma_m: Positive = 40.0  # by how much a sudden one that none agrees with may be wrong
    jump_m: Positive = 3.0  # a correction that is longer counts as a reset
    offset_count: Count = 4  # refused headings or AGLs that must agree before their state is freed
    felt_push_off_m_s2: Positive = 1.0  # by which an IMU may be wrong that contradicts ways ...
    push_off_m_s2: Positive = 5.0  # ... or the push as the attitude has it
    offset_span_s: Positive = 0.5  # and the least time they span
    # By which agreeing headings may drift apart
    heading_drift_rad_s: Angle = math.radians(2.0)

    @property
    def map_first_sigma_m(self) -> float:
        """What the map's error from place to place is taken for before anything was seen of it."""
        return max(self.map_sigma_m, self.map_stated_sigma_m)

    def without_telemetry(self) -> "EkfConfig":
        """For a video alone: the position is that of the image's centre, and nothing is felt.

        The centre swings with the camera, so accelerations are larger and unexplained, and grow
        with the height where the camera is fixed to a body that sways: by 5 degrees in 4 s it was
        41 m off at 18.7 sigmas. The heading stream is the one odometry turns from images.
        """
        return replace(
            self,
            acceleration_noise_m_s2=1.5,
            vertical_noise_m_s2=1.0,
            swing_noise_rad_s2=0.2,
            acceleration_sigma_m_s2=1.5,
            heading_walk_rad=math.radians(0.5),
            tilt_sigma_rad=math.radians(0.01),
            mount_sigma_rad=math.radians(0.01),
            mount_turn_sigma_rad=math.radians(0.01),
            fix_lean_rad=math.radians(0.01),
            focal_sigma_ratio=1e-4,
            time_offset_sigma_s=1e-6,
            time_offset_walk_s=0.0,
            heading_sigma_rad=math.pi,
            thrust_aided=False,
            odometry_turns_attitude=True,
        )
