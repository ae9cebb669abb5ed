"""The filter as a table: what is estimated, how sure it is at first, and how fast it may change."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from vwnav.estimation.inertial.imu import ImuIntegrals
from vwnav.types import Array


class States:
    """Where each state stands in the vector `x` and in its covariance `P`.

    All errors add to their state, the heading bias modulo 2 pi. The attitude itself is the
    autopilot's stream; its error is three of the states (heading bias and tilt).
    """

    POSITION = slice(0, 3)  # m, NED about the origin
    VELOCITY = slice(3, 6)  # m/s, NED
    ACCELERATION = slice(6, 8)  # m/s^2, north and east, beyond what thrust explains: drag, wind
    HEADING_BIAS = slice(8, 9)  # rad, heading of the autopilot minus true heading
    TILT = slice(9, 11)  # rad, error of the autopilot's attitude about the body's level fwd, right
    BARO = slice(11, 12)  # m, barometric height minus height above the origin
    TERRAIN = slice(12, 13)  # m, height above the origin of the ground below
    ANCHOR_POSITION = slice(13, 16)  # m, NED, the position at the keyframe of odometry
    ANCHOR_HEADING_BIAS = slice(16, 17)  # rad, the heading bias at the keyframe
    MAP = slice(17, 19)  # m, north and east, by how much the map here is off, and matching on it
    ACCELEROMETER_BIAS = slice(19, 22)  # m/s^2, body; at rest where no IMU is streamed
    ANCHOR_TURN = slice(22, 23)  # rad, what the keyframe's own picture adds to every turn from it
    ANCHOR_TERRAIN = slice(23, 24)  # m, height of the keyframe's own ground, which scales its ways
    ANCHOR_TILT = slice(24, 26)  # rad, the tilt error at the keyframe
    GYRO_BIAS = slice(26, 29)  # rad/s, body; at rest where no IMU is streamed
    MAP_TURN = slice(29, 30)  # rad, by how much headings by this map, and matching on it, are off
    MAP_SCALE = slice(30, 31)  # the same of heights above ground, as a share of them
    EXPOSED_POSITION = slice(31, 33)  # m, north and east of the picture that is being matched
    EXPOSED_HEADING_BIAS = slice(33, 34)  # rad, the heading bias at its exposure
    EXPOSED_TILT = slice(34, 36)  # rad, the tilt error then
    EXPOSED_AGL = slice(36, 37)  # m, the height above ground then
    WIND_FORCE = slice(37, 39)  # m/s^2, north and east, what the wind alone pushes by drag
    DRAG = slice(39, 40)  # 1/s, of a multirotor through air, across its thrust
    SIZE = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class EkfConfig:
    """Noises and limits. Sigmas are one standard deviation; densities are per root second."""

    # How the states change
    acceleration_noise_m_s2: float = 0.3  # per root hertz, horizontal, white
    vertical_noise_m_s2: float = 0.4  # per root hertz, white
    acceleration_sigma_m_s2: float = 1.5  # of the slow part, first-order Gauss-Markov
    acceleration_time_s: float = 5.0
    heading_walk_rad: float = math.radians(0.15)  # per root second
    heading_slew_rad: float = math.radians(0.3)  # the same while a gyro tells: filters realign
    tilt_sigma_rad: float = math.radians(2.0)  # per axis, first-order Gauss-Markov
    tilt_time_s: float = 200.0  # mostly a bias of mounting and accelerometers
    baro_walk_m: float = 0.13  # per root second: 3.2 m in 10 minutes, as weather and warming do
    baro_climb_walk_m: float = 0.05  # per root metre of climb: 0.35 m in 50, of warm or cold air
    imu_noise_m_s2: float = 0.1  # per root hertz, all axes, with vibration; instead of the above
    accelerometer_sigma_m_s2: float = 0.3  # bias at first, with a tilted mount's share of gravity
    accelerometer_walk_m_s2: float = 0.003  # per root second
    gyro_noise_rad: float = math.radians(0.1)  # per root second: what a gyro's turn wanders
    gyro_share: float = 0.001  # of a turn: scale factor, and what happens between samples
    gyro_sigma_rad_s: float = math.radians(0.5)  # bias at first
    gyro_walk_rad_s: float = math.radians(0.005)  # per root second
    drag_per_s: float = 0.35  # at first; from 0.1 of a slick large one to 1 of PX4's simulated one
    drag_sigma_per_s: float = 0.3  # at first
    drag_walk_per_s: float = 0.001  # per root second
    drag_range_per_s: tuple[float, float] = (0.02, 2.0)
    drag_noise_m_s2: float = 0.1  # of the force across the thrust, averaged, beyond what is shaken
    drag_interval_s: float = 0.4  # between two
    wind_force_sigma_m_s2: float = 2.0  # at first
    wind_walk_m_s: float = 0.3  # per root second: gusts of 1 m/s that last 30 s
    terrain_walk_m: float = 0.10  # per root metre flown: 1 m in 100 m
    terrain_walk_known_m: float = 0.07  # with the terrain heights of a map: 1 m in 200 m
    map_sigma_m: float = 0.3  # Gauss-Markov in the way flown: all fixes of a place share it
    map_turn_rad: float = math.radians(0.25)  # likewise: a tilt that matching took for a turn, too
    map_scale: float = 0.008
    map_length_m: float = 100.0  # waves of 50 m, and ways that lead back over the same ground
    lost_noise_m_s2: float = 5.0  # per root hertz, horizontal, while no attitude tells the thrust
    lost_climb_noise_m_s2: float = 2.0  # per root hertz, likewise
    thrust_aided: bool = True  # horizontal acceleration of a multirotor from its attitude
    # How sure the states are at first
    heading_sigma_rad: float = math.radians(15.0)  # a compass near motors and steel
    unknown_sigma_m: float = 2000.0  # stands for no idea of the position
    baro_sigma_m: float = 1.0
    # Measurements
    height_sigma_m: float = 0.25  # barometer, white part
    height_lag_s: float = 0.05  # of the barometer, beyond what its stamps say
    rangefinder_lag_s: float = 0.15  # likewise: it is polled before it is stamped
    rangefinder_sigma_m: float = 0.05
    rangefinder_sigma_ratio: float = 0.02  # of the distance
    stationary_sigma_m_s: float = 0.05
    stationary_sigma_rad_s: float = math.radians(0.4)  # of its turning, by the gyro
    stationary_agl_m: float = 0.15  # height of the camera while the aircraft stands
    stationary_agl_sigma_m: float = 0.15
    blow_agl_m: float = 2.0  # lower than this it may strike the ground, shorter than an IMU hears
    blow_noise_m_s2: float = 1.0  # per root hertz, horizontal, instead of less
    touching_agl_m: float = 0.3  # lower than this it touches the ground, or is about to
    touching_speed_m_s: float = 1.5  # and no faster than this sideways
    touching_sigma_m_s: float = 0.5  # of its horizontal speed then, per barometric height
    zoom_share: float = 0.05  # of a climb that odometry sees; 1 % is wrong each time alike
    picture_date_s: float = 0.005  # error of a picture's date, its read-out's part included
    anchor_share: float = 0.5  # of an odometry covariance that is due to the keyframe
    odometry_turns_attitude: bool = False  # the heading stream is odometry's own: no new witness
    visual_weight: float = 0.0  # lambda of the thesis' eq. 3.30: extra pull to the fix, 0 to 1
    # What no aircraft does: a state beyond these begins anew from the last trusted fix
    most_speed_m_s: float = 35.0
    most_climb_m_s: float = 25.0
    most_tilt_rad: float = math.radians(15.0)  # of the autopilot's attitude, its error
    restart_sigma_m: float = 10.0  # and half the way it may have flown since that fix
    restart_velocity_m_s: float = 15.0
    # Time
    history_s: float = 2.0  # how late a measurement may be
    ahead_s: float = 2.0  # how far ahead of the newest time known one may be
    # Re-localisation
    relocation_fixes: int = 12  # refused fixes that must agree before the filter jumps to them
    relocation_span_s: float = 4.0  # and the least time between first and last of them
    relocation_drift_m_s: float = 0.5  # by which agreeing fixes may drift apart
    dispute_window_s: float = 30.0  # refused measurements are remembered this long
    sudden_sigma_m: float = 5.0  # a pull beyond what this explains needs ...
    sudden_fixes: int = 2  # ... so many fixes that agree, however unsure the filter is
    lone_fix_sigma_m: float = 40.0  # by how much a sudden one that none agrees with may be wrong
    jump_m: float = 3.0  # a correction that is longer counts as a reset
    offset_count: int = 4  # refused headings or AGLs that must agree before their state is freed
    offset_span_s: float = 0.5  # and the least time they span
    heading_drift_rad_s: float = math.radians(2.0)  # by which agreeing headings may drift apart

    def without_telemetry(self) -> "EkfConfig":
        """For a video alone: the position is that of the picture's centre, and nothing is felt.

        The centre swings with the camera, so accelerations are larger and unexplained; the heading
        stream is the one odometry turns from pictures.
        """
        return replace(
            self,
            acceleration_noise_m_s2=1.5,
            vertical_noise_m_s2=1.0,
            acceleration_sigma_m_s2=1.5,
            heading_walk_rad=math.radians(0.5),
            tilt_sigma_rad=math.radians(0.01),
            heading_sigma_rad=math.pi,
            thrust_aided=False,
            odometry_turns_attitude=True,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """The keyframe whose position is cloned in the state: its exposure and autopilot heading."""

    t_s: float
    yaw_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """The picture that is being matched, whose pose is cloned: its time and autopilot heading."""

    t_s: float
    yaw_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class TrustedPosition:
    """Where a fix that was believed has shown it: (2,) north and east, per-axis sigma."""

    t_s: float
    position_ne_m: Array
    sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Dispute:
    """A measurement that the gate refused: what it wanted to change (n,), and its covariance."""

    t_s: float
    offset: Array
    covariance: Array


class Measured(NamedTuple):
    """What the autopilot tells of a moment.

    Attributes:
        quat_wxyz: (4,) its attitude.
        felt: what its IMU had felt until then.
        carried_rad: how far its gyro alone had turned the heading on, from its last attitude.
    """

    quat_wxyz: Array
    felt: ImuIntegrals | None
    carried_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class FilterState:
    """Everything the filter believes at `t_s`. Never changed in place.

    Attributes:
        x: (n,) see `States`, n its size. P: (n, n) its covariance.
        measured: what the autopilot tells of `t_s`, as it was known then: the next step goes on
            from just there. None before the first one.
        position_known, heading_known: False until the first fix when they started unknown.
        trusted: the last fix that agreed with one before it; the start until then.
        newest_height: time and height that the barometer told last, believed or not.
        height_stepped: the heights that are refused began with a step, not with a climb.
        disputed_fixes, disputed_headings, disputed_agls, disputed_heights, disputed_ways: refused
            since the last accepted one.
    """

    t_s: float
    x: Array
    P: Array
    position_known: bool
    heading_known: bool
    measured: Measured | None = None
    anchor: Anchor | None = None
    exposure: Exposure | None = None
    t_last_fix_s: float | None = None
    trusted: TrustedPosition | None = None
    newest_height: tuple[float, float] | None = None
    height_stepped: bool = False
    reset_counter: int = 0
    disputed_fixes: tuple[Dispute, ...] = ()
    disputed_headings: tuple[Dispute, ...] = ()
    disputed_agls: tuple[Dispute, ...] = ()
    disputed_heights: tuple[Dispute, ...] = ()
    disputed_ways: tuple[Dispute, ...] = ()

    @property
    def agl_m(self) -> float:
        """Height above the ground below."""
        return float(-self.x[States.POSITION][2] - self.x[States.TERRAIN][0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Start:
    """What is known at first. On the ground nothing moves; in the air nothing is sure.

    Attributes:
        position_ned_m: (3,), None when unknown; its sigma is per horizontal axis.
        sigma_baro_m: of the barometer's zero; None takes the configured one, of a barometer that
            was zeroed where the height is counted from.
    """

    t_s: float
    position_ned_m: Array | None = None
    sigma_m: float = 5.0
    agl_m: float = 0.15
    sigma_agl_m: float = 0.15
    sigma_velocity_m_s: float = 0.1
    sigma_baro_m: float | None = None


def first_state(start: Start, config: EkfConfig) -> FilterState:
    """The state before any measurement.

    Raises:
        ValueError: a number that is not finite, or a sigma that is not positive.
    """
    known = start.position_ned_m is not None
    position = np.zeros(3) if start.position_ned_m is None else np.array(start.position_ned_m)
    sigmas = np.array([start.sigma_m, start.sigma_agl_m, start.sigma_velocity_m_s])
    if position.shape != (3,) or not np.all(np.isfinite([*position, start.t_s, start.agl_m])):
        raise ValueError(f"expected a finite position (3,), time and height, got {start}")
    if not (np.all(np.isfinite(sigmas)) and np.all(sigmas > 0.0)):
        raise ValueError(f"expected positive sigmas, got {sigmas}")
    x = np.zeros(States.SIZE)
    x[States.POSITION] = position
    x[States.TERRAIN] = -position[2] - start.agl_m
    x[States.DRAG] = config.drag_per_s
    variance = first_variance(config)
    variance[States.POSITION] = (start.sigma_m if known else config.unknown_sigma_m) ** 2
    variance[2] = 0.1**2  # the height is counted from here
    variance[States.VELOCITY] = start.sigma_velocity_m_s**2
    variance[States.TERRAIN] = start.sigma_agl_m**2
    variance[States.BARO] = (start.sigma_baro_m or config.baro_sigma_m) ** 2
    heading_known = config.heading_sigma_rad < math.radians(45.0)
    trusted = TrustedPosition(start.t_s, position[:2], start.sigma_m) if known else None
    return FilterState(start.t_s, x, np.diag(variance), known, heading_known, trusted=trusted)


def first_variance(config: EkfConfig) -> Array:
    """(n,) of what the settings know of at first; of the rest, which the start tells, ones."""
    variance = np.ones(States.SIZE)
    variance[States.ACCELERATION] = config.acceleration_sigma_m_s2**2
    variance[States.HEADING_BIAS] = config.heading_sigma_rad**2
    variance[States.TILT] = config.tilt_sigma_rad**2
    variance[States.BARO] = config.baro_sigma_m**2
    variance[States.ACCELEROMETER_BIAS] = config.accelerometer_sigma_m_s2**2
    variance[States.GYRO_BIAS] = config.gyro_sigma_rad_s**2
    variance[States.WIND_FORCE] = config.wind_force_sigma_m_s2**2
    variance[States.DRAG] = config.drag_sigma_per_s**2
    variance[States.MAP] = config.map_sigma_m**2
    variance[States.MAP_TURN] = config.map_turn_rad**2
    variance[States.MAP_SCALE] = config.map_scale**2
    return variance
