"""The filter as a table: what is estimated, how sure it is at first, and how fast it may change."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vwnav.estimation.config import EkfConfig
from vwnav.estimation.inertial.integrals import ImuIntegrals
from vwnav.geometry.rotations import quat_from_rotation, rotation_from_quat, rotation_from_vector
from vwnav.types import Array, Estimate

_HEIGHT_SIGMA_M = 30.0  # the barometer tells it again
_TERRAIN_SIGMA_M = 30.0
_BARO_SIGMA_M = 2.0
_MOST_HEADING_SIGMA_RAD = math.radians(45.0)  # of a heading that is known
_KNOWN_SHARE = 0.33  # of the drag, by which it must be known to tell the wind


class States:
    """Where each state stands in the vector `x` and in its covariance `P`.

    All errors add to their state, the heading bias modulo 2 pi. The attitude itself is the
    autopilot's stream; its error is three of the states (heading bias and tilt). What an odometry
    keyframe (anchor) or an image at the map's matching (exposed) is compared with later is cloned
    when it is taken (stochastic cloning, Roumeliotis and Burdick 2002).
    """

    POSITION = slice(0, 3)  # m, NED about the origin
    POSITION_NE, DOWN = slice(0, 2), 2
    VELOCITY = slice(3, 6)  # m/s, NED
    VELOCITY_NE, VELOCITY_DOWN = slice(3, 5), 5
    MOTION = slice(0, 6)  # position and velocity
    ACCELERATION = slice(6, 8)  # m/s^2, north and east, beyond what thrust explains: drag, wind
    HEADING_BIAS = 8  # rad, heading of the autopilot minus true heading
    TILT = slice(9, 11)  # rad, error of the autopilot's attitude about the body's level fwd, right
    BARO = 11  # m, barometric height minus height above the origin
    TERRAIN = 12  # m, height above the origin of the ground below
    ANCHOR_POSITION = slice(13, 16)  # m, NED, the position at the keyframe of odometry
    ANCHOR_NE, ANCHOR_DOWN = slice(13, 15), 15
    ANCHOR_HEADING_BIAS = 16  # rad, the heading bias at the keyframe
    MAP = slice(17, 19)  # m, north and east, by how much the map here is off, and matching on it
    ACCELEROMETER_BIAS = slice(19, 22)  # m/s^2, body; at rest where no IMU is streamed
    ACCELEROMETER_BIAS_LEVEL = slice(19, 21)  # forward and right
    ANCHOR_TURN = 22  # rad, what the keyframe's own image adds to every turn from it
    ANCHOR_TERRAIN = 23  # m, height of the keyframe's own ground, which scales its ways
    ANCHOR_TILT = slice(24, 26)  # rad, the tilt error at the keyframe
    GYRO_BIAS = slice(26, 29)  # rad/s, body; at rest where no IMU is streamed
    MAP_TURN = 29  # rad, by how much headings by this map, and matching on it, are off
    MAP_SCALE = 30  # the same of heights above ground, as a share of them
    EXPOSED = slice(31, 37)
    EXPOSED_POSITION = slice(31, 33)  # m, north and east of the image that is being matched
    EXPOSED_HEADING_BIAS = 33  # rad, the heading bias at its exposure
    EXPOSED_TILT = slice(34, 36)  # rad, the tilt error then
    EXPOSED_AGL = 36  # m, the height above ground then
    WIND_FORCE = slice(37, 39)  # m/s^2, north and east, what the wind alone pushes by drag
    DRAG = 39  # 1/s, of a multirotor through air, across its thrust
    SIZE = 40


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """The keyframe whose position is cloned in the state: its exposure and autopilot heading."""

    t_s: float
    yaw_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """The image that is being matched, whose pose is cloned: its time and autopilot heading."""

    t_s: float
    yaw_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class TrustedPosition:
    """Where a fix that was believed has shown it: (2,) north and east, per-axis sigma."""

    t_s: float
    position_ne_m: Array
    sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class RejectedInnovation:
    """Of a measurement that its gate refused: residual (m,) and covariance (m, m) of its noise."""

    t_s: float
    residual: Array
    covariance: Array


RejectedInnovations = tuple[RejectedInnovation, ...]  # in order of time


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
        tracked_s, exposed_s: times of the last image whose way was told, and of the last one of
            which it was told whether it is; the start until then.
        trusted: the last fix that agreed with one before it; the start until then.
        newest_height: time and height that the barometer told last, believed or not.
        height_stepped: the heights that are refused began with a step, not with a climb.
        rejected_fixes, rejected_headings, rejected_agls, rejected_heights, rejected_ways: refused
            since the last accepted one.
    """

    t_s: float
    x: Array
    P: Array
    position_known: bool
    heading_known: bool
    tracked_s: float
    exposed_s: float
    measured: Measured | None = None
    anchor: Anchor | None = None
    exposure: Exposure | None = None
    t_last_fix_s: float | None = None
    trusted: TrustedPosition | None = None
    newest_height: tuple[float, float] | None = None
    height_stepped: bool = False
    reset_counter: int = 0
    rejected_fixes: RejectedInnovations = ()
    rejected_headings: RejectedInnovations = ()
    rejected_agls: RejectedInnovations = ()
    rejected_heights: RejectedInnovations = ()
    rejected_ways: RejectedInnovations = ()

    @property
    def agl_m(self) -> float:
        """Height above the ground below."""
        return float(-self.x[States.DOWN] - self.x[States.TERRAIN])


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
    variance[States.DOWN] = 0.1**2  # the height is counted from here
    variance[States.VELOCITY] = start.sigma_velocity_m_s**2
    variance[States.TERRAIN] = start.sigma_agl_m**2
    variance[States.BARO] = (start.sigma_baro_m or config.baro_sigma_m) ** 2
    trusted = TrustedPosition(start.t_s, position[:2], start.sigma_m) if known else None
    P, t_s = np.diag(variance), start.t_s
    return FilterState(t_s, x, P, known, tells_heading(P), t_s, t_s, trusted=trusted)


def tells_heading(P: Array) -> bool:
    """Whether a covariance (n, n) leaves the heading known well enough to turn ways by it."""
    return bool(P[States.HEADING_BIAS, States.HEADING_BIAS] < _MOST_HEADING_SIGMA_RAD**2)


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


def outside(state: FilterState, config: EkfConfig) -> str | None:
    """Why a state cannot be that of an aircraft; None while it can."""
    x, variances = state.x, np.diag(state.P)
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(state.P)) and np.all(variances >= 0.0)):
        return "it is not finite"
    north, east, down = x[States.VELOCITY].tolist()
    if math.hypot(north, east) > config.most_speed_m_s:
        return f"{math.hypot(north, east):.0f} m/s"
    if abs(down) > config.most_climb_m_s:
        return f"{-down:.0f} m/s of climb"
    tilt_rad = float(np.linalg.norm(x[States.TILT]))
    if tilt_rad > config.most_tilt_rad:
        return f"the attitude off by {math.degrees(tilt_rad):.0f} degrees of tilt"
    return None


def begun_anew(state: FilterState, config: EkfConfig) -> FilterState:
    """At the last trusted fix, as unsure as an aircraft can have flown since.

    Heights keep their values where they are numbers: they have witnesses of their own, and are open
    to them. Of the attitude's error nothing is believed but that it is as at first.
    """
    x, variance = np.zeros(States.SIZE), first_variance(config)
    x[States.DRAG] = config.drag_per_s
    heights = [States.DOWN, States.BARO, States.TERRAIN]
    if np.all(np.isfinite(state.x[heights])):
        x[heights] = state.x[heights]
        # Nor may what it took the barometer's bias for be far from what weather does in an hour.
        x[States.BARO] = np.clip(x[States.BARO], -_BARO_SIGMA_M, _BARO_SIGMA_M)
    variance[States.DOWN], variance[States.TERRAIN] = _HEIGHT_SIGMA_M**2, _TERRAIN_SIGMA_M**2
    variance[States.BARO] = _BARO_SIGMA_M**2
    variance[States.VELOCITY] = config.restart_velocity_m_s**2
    known = state.trusted is not None
    sigma_m = config.unknown_sigma_m
    if state.trusted is not None:
        x[States.POSITION_NE] = state.trusted.position_ne_m
        flown_m = 0.5 * config.most_speed_m_s * max(state.t_s - state.trusted.t_s, 0.0)
        sigma_m = min(math.hypot(config.restart_sigma_m, state.trusted.sigma_m) + flown_m, sigma_m)
    variance[States.POSITION_NE] = sigma_m**2
    P = np.diag(variance)
    return FilterState(
        state.t_s,
        x,
        P,
        position_known=known,
        heading_known=tells_heading(P),
        tracked_s=state.tracked_s,
        exposed_s=state.exposed_s,
        t_last_fix_s=state.t_last_fix_s,
        trusted=state.trusted,
        reset_counter=state.reset_counter + 1,
    )


def estimate_of(state: FilterState, quat_measured_wxyz: Array, turned_rad: float) -> Estimate:
    """What a state says of the aircraft.

    Args:
        state: the filter's.
        quat_measured_wxyz: (4,) the attitude that it knows of that moment.
        turned_rad: how far the aircraft may have turned since that was known.
    """
    x, P = state.x, state.P
    down, terrain = States.DOWN, States.TERRAIN
    variance_agl = P[down, down] + P[terrain, terrain] + 2.0 * P[down, terrain]
    # A tilt error turns the heading of a nose that points up or down: by tan(pitch).
    qw, qx, qy, qz = quat_measured_wxyz.tolist()
    sin_pitch = min(max(2.0 * (qw * qy - qx * qz), -0.9), 0.9)
    tangent = sin_pitch / math.sqrt(1.0 - sin_pitch**2)
    yaw, forward = States.HEADING_BIAS, States.TILT.start
    turn = P[yaw, yaw] + 2.0 * tangent * P[yaw, forward] + tangent**2 * P[forward, forward]
    return Estimate(
        t_s=state.t_s,
        position_ned_m=x[States.POSITION].copy(),
        velocity_ned_m_s=x[States.VELOCITY].copy(),
        covariance=P[States.MOTION, States.MOTION].copy(),
        quat_wxyz=_true_attitude(x, quat_measured_wxyz),
        sigma_yaw_rad=min(math.sqrt(float(turn) + turned_rad**2), math.pi),
        agl_m=max(state.agl_m, 0.0),
        sigma_agl_m=math.sqrt(variance_agl),
        t_last_fix_s=state.t_last_fix_s,
        reset_counter=state.reset_counter,
        wind_ne_m_s=wind_ne_m_s(state),
    )


def _true_attitude(x: Array, quat_measured_wxyz: Array) -> Array:
    """quat_wxyz (4,) with heading bias and tilt removed: R = Rz(-b) exp(-tilt) R_measured."""
    R_measured = rotation_from_quat(quat_measured_wxyz)
    yaw_rad = math.atan2(R_measured[1, 0], R_measured[0, 0])
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    forward, right = x[States.TILT]
    untilt = rotation_from_vector([-c * forward + s * right, -s * forward - c * right, 0.0])
    unturn = rotation_from_vector([0.0, 0.0, -float(x[States.HEADING_BIAS])])
    return quat_from_rotation(unturn @ untilt @ R_measured)


def wind_ne_m_s(state: FilterState) -> Array | None:
    """(2,) the wind w = c / k, where it blows to; None until the drag is known to a third."""
    drag = float(state.x[States.DRAG])
    if state.P[States.DRAG, States.DRAG] > (_KNOWN_SHARE * drag) ** 2:
        return None
    return np.asarray(state.x[States.WIND_FORCE] / drag)


def white_acceleration(level: float, vertical: float, dt_s: float) -> Array:
    """(6, 6) what it adds to position and velocity in a time, (m/s^2)^2 per hertz."""
    q = np.diag([level, level, vertical])
    both = q * dt_s**2 / 2.0
    return np.block([[q * dt_s**3 / 3.0, both], [both, q * dt_s]])
