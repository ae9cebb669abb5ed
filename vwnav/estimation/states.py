"""The filter as a table, what it believes, and its Kalman update: one for every measurement."""

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from vwnav.estimation.beginning.map_error import LearnedMapError
from vwnav.estimation.inertial.integrals import Exposure, Measured
from vwnav.geometry.rotations import without_errors, wrap_pi
from vwnav.types import Array, Estimate

# 99.9 % of chi-square by degrees of freedom (scipy.stats.chi2.ppf(0.999, dof)).
CHI_SQUARE_GATE = {1: 10.828, 2: 13.816, 3: 16.266}
_RIDGE = 1e-12
_MOST_HEADING_SIGMA_RAD = math.radians(45.0)  # of a heading that is known
_STEEPEST = 0.5  # slope that an image is told of
KNOWN_SHARE = 0.33  # of the drag, by which it must be known to tell the wind


class States:
    """Where each state stands in the vector `x` and in its covariance `P`.

    All errors add to their state, the heading bias modulo 2 pi. The attitude itself is the
    autopilot's stream; its error is three of the states (heading bias and tilt). What a keyframe
    (anchor) or an image that is being matched (exposed) is compared with later is cloned
    (stochastic cloning, Roumeliotis and Burdick 2002); dates are Li and Mourikis' (2014).
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
    WIND_FORCE = slice(37, 39)  # m/s^2, north and east, what the mean wind alone pushes by drag
    DRAG = 39  # 1/s, of a multirotor through air, across its thrust
    GUST_FORCE = slice(40, 42)  # m/s^2, north and east, what the air pushes besides
    CAMERA_TILT = slice(42, 44)  # rad, error of the camera's mount about the same axes as TILT
    FOCAL = 44  # share by which the camera's focal length is taken for longer than it is
    SLOPE = slice(45, 47)  # rise per metre north and east of the ground, beyond the terrain table
    FIX_LEAN = slice(47, 49)  # rad, as TILT, what fixes alone show as one: dates, lens, matching
    CAMERA_TURN = 49  # rad, by how much images show the heading bias for larger: the mount's
    TIME_OFFSET, SIZE = 50, 51  # s, by how much images were exposed later than they are dated


HEADINGS = [States.HEADING_BIAS, States.ANCHOR_HEADING_BIAS, States.EXPOSED_HEADING_BIAS]


@dataclass(frozen=True, slots=True, eq=False)
class TrustedPosition:
    """Where a fix that was believed, or a person, shows it: (2,) north and east, per-axis sigma."""

    t_s: float
    position_ne_m: Array
    sigma_m: float
    by_person: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class RejectedInnovation:
    """Of a measurement that its gate refused: residual (m,) and covariance (m, m) of its noise."""

    t_s: float
    residual: Array
    covariance: Array


RejectedInnovations = tuple[RejectedInnovation, ...]  # in order of time


@dataclass(frozen=True, slots=True, eq=False)
class RangeTrust:
    """How the rangefinder stands to the other witnesses of the height.

    Attributes:
        agreed_ne_m: where it last agreed, None before.
        doubted_s: when it last contradicted them while it is not believed; None while it is.
        barometer: time, bias of the barometer and its variance some seconds ago, by which it is
            seen whether distances, each inside its gate, draw height and bias along; None before.
        drawn_m: by so much they had when it was doubted.
        rejected: refused since the last accepted one.
    """

    agreed_ne_m: tuple[float, float] | None = None
    doubted_s: float | None = None
    barometer: tuple[float, float, float] | None = None
    drawn_m: float = 0.0
    rejected: RejectedInnovations = ()

    @property
    def is_borne(self) -> bool:
        """Whether it measures, and agrees."""
        return self.agreed_ne_m is not None and self.doubted_s is None

    def lost(self, t_s: float, drawn_m: float = 0.0) -> "RangeTrust":
        """Not believed from now on, until it has agreed for a while."""
        return RangeTrust(self.agreed_ne_m, t_s, drawn_m=drawn_m)


class FilterState(NamedTuple):
    """Everything the filter believes at `t_s`; its arrays are never changed in place.

    Attributes:
        x: (n,) see `States`, n its size. P: (n, n) its covariance.
        measured: what the autopilot tells of `t_s`, as it was known then: the next step goes on
            from just there. None before the first one.
        position_known, heading_known: False until the first fix when they started unknown.
        tracked_s, exposed_s: times of the last image whose way was told, and of the last one of
            which it was told whether it is; the start until then.
        anchor, exposure: the keyframe and the image that is being matched, whose poses are cloned.
        trusted: the last fix that agreed with one before it; the start until then.
        relief_m: one sigma of the ground's heights over their plane, as the newest ways show it.
        newest_height: time and height that the barometer told last, believed or not.
        stood_s: when it was told last that the aircraft stands.
        above_s: when it last stood, or was higher than one that touches the ground.
        baro_zeroed: where heights are counted from, as far as weather lets it; else it may be off.
        map_error: how large the error of the map has proved to be.
        height_stepped: the heights that are refused began with a step, not with a climb.
        rejected_*: refused since the last one that was believed; or, of a fix, believed by half.
    """

    t_s: float
    x: Array
    P: Array
    position_known: bool
    heading_known: bool
    tracked_s: float
    exposed_s: float
    measured: Measured | None = None
    anchor: Exposure | None = None
    exposure: Exposure | None = None
    t_last_fix_s: float | None = None
    trusted: TrustedPosition | None = None
    relief_m: float = 0.0
    newest_height: tuple[float, float] | None = None
    stood_s: float = -math.inf
    above_s: float = math.inf
    baro_zeroed: bool = True
    height_stepped: bool = False
    map_error: LearnedMapError = LearnedMapError()
    reset_counter: int = 0
    rejected_fixes: RejectedInnovations = ()
    rejected_headings: RejectedInnovations = ()
    rejected_agls: RejectedInnovations = ()
    rejected_heights: RejectedInnovations = ()
    rejected_ways: RejectedInnovations = ()
    range_trust: RangeTrust = RangeTrust()

    @property
    def agl_m(self) -> float:
        """Height above the ground below."""
        return float(-self.x[States.DOWN] - self.x[States.TERRAIN])


class Verdict(Enum):
    """What became of a measurement."""

    FUSED = "fused"
    GATED = "too far from the prediction"
    RELOCATED = "the filter jumped to it"
    UNCONFIRMED = "waits for a second one that agrees"
    NOT_FINITE = "not a finite, sensible measurement"
    TOO_LATE = "older than the history"
    AHEAD = "from the future"
    DUPLICATE = "already there"
    NO_ANCHOR = "its keyframe is not known"
    NO_ATTITUDE = "no attitude that is believed tells how it was seen"
    ON_GROUND = "the aircraft stands, or nearly"
    IMPOSSIBLE = "no aircraft does that"
    DOUBTED = "a rangefinder that contradicts map and barometer"
    DISTRUSTED = "most of its kind contradict the IMU"
    HEADING_UNKNOWN = "the heading is not known yet"
    NOT_STARTED = "the filter is not initialised"


@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """What a measurement said against the prediction.

    Attributes:
        nis: normalised innovation squared, None when it was not compared.
        dof: its degrees of freedom. residual: (dof,) measured minus predicted.
        parts: the heading and AGL of a fix, the heading of odometry.
    """

    verdict: Verdict
    nis: float | None = None
    dof: int = 0
    residual: Array | None = None
    parts: tuple["Innovation", ...] = ()

    @property
    def accepted(self) -> bool:
        """Whether the state now contains it."""
        return self.verdict in (Verdict.FUSED, Verdict.RELOCATED)


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """A linearised measurement: residual (m,), its Jacobian H (m, n) and noise R (m, m).

    Attributes:
        considered: consider states (Schmidt 1966), uncertain in it but not corrected by it: its
            model of them is too rough. Nor does it correct what their errors have done to other
            states: a place that is wrong because the heading is stays so until one of them is told.
    """

    residual: Array
    H: Array
    R: Array
    considered: tuple[int, ...] = ()


def fuse(
    state: FilterState, measurement: Measurement, visual_weight: float = 0.0
) -> tuple[FilterState, Innovation]:
    """Correct by a measurement unless its gate refuses it, by chi-square of its dimension.

    `visual_weight` is the lambda of the thesis' eq. 3.30: x + K r, then a part lambda of what is
    still missing. That part goes along the least change of the measured states that explains it:
    K' = K + lambda H^+ (I - H K).
    """
    innovation, K, PHt, S = _compare(state, measurement)
    if innovation.verdict is Verdict.GATED:
        return state, innovation
    if visual_weight > 0.0:
        H = measurement.H
        K = K + visual_weight * np.linalg.pinv(H) @ (np.eye(len(H)) - H @ K)
    return _corrected(state, measurement.residual, K, PHt, S), innovation


def correct(state: FilterState, measurement: Measurement) -> FilterState:
    """Correct by a measurement, whatever its gate says."""
    return _corrected(state, measurement.residual, *_compare(state, measurement)[1:])


def _compare(
    state: FilterState, measurement: Measurement
) -> tuple[Innovation, Array, Array, Array]:
    """The innovation, the gain K (n, m), best but for consider states, P H^T and S (m, m)."""
    r, H = measurement.residual, measurement.H
    PHt = state.P @ H.T
    S = H @ PHt + measurement.R
    if len(r) == 1:
        K, nis = PHt / S[0, 0], float(r[0] ** 2 / S[0, 0])
    elif measurement.considered:
        K = _schmidt_gain(state.P, PHt, measurement)
        nis = float(r @ np.linalg.solve(S, r))
    else:
        solved = np.linalg.solve(S, np.column_stack([r, PHt.T]))
        K, nis = solved[:, 1:].T, float(r @ solved[:, 0])
    verdict = Verdict.FUSED if nis <= CHI_SQUARE_GATE[len(r)] else Verdict.GATED
    return Innovation(verdict, nis, len(r), r), K, PHt, S


def _schmidt_gain(P: Array, PHt: Array, measurement: Measurement) -> Array:
    """The gain (n, m) that would be optimal if the consider states c were known as they are.

    P given c is P - P_c P_cc^-1 P_c^T; only its product with H^T is needed.

    With the optimal gain and its rows of c at zero, places far from the last fix were moved by the
    heading error that the residual seemed to show, metres at a time, and the heading was not.
    """
    c, H = list(measurement.considered), measurement.H
    P_c = P[:, c]
    # A clone of a state that is cloned anew has all but its covariance: the ridge keeps it regular.
    P_cc = P_c[c] + _RIDGE * np.eye(len(c))
    given = PHt - P_c @ np.linalg.solve(P_cc, PHt[c])
    K = np.array(np.linalg.solve(H @ given + measurement.R, given.T).T, dtype=np.float64)
    K[c] = 0.0
    return K


def _corrected(state: FilterState, residual: Array, K: Array, PHt: Array, S: Array) -> FilterState:
    """By Joseph's form, which holds for any gain; headings stay in [-pi, pi).

    Multiplied out, (I - K H) P (I - K H)^T + K R K^T = P + T + T^T, T = (K S / 2 - P H^T) K^T.
    """
    T = (0.5 * (K @ S) - PHt) @ K.T
    x = state.x + K @ residual
    for heading in HEADINGS:
        if abs(x[heading]) >= math.pi:
            x[heading] = wrap_pi(float(x[heading]))
    return state._replace(x=x, P=state.P + (T + T.T))


def tells_heading(P: Array) -> bool:
    """Whether a covariance (n, n) leaves the heading known well enough to turn ways by it."""
    return bool(P[States.HEADING_BIAS, States.HEADING_BIAS] < _MOST_HEADING_SIGMA_RAD**2)


def estimate_of(
    state: FilterState, quat_measured_wxyz: Array, turned_rad: float, slope_ne: Array
) -> Estimate:
    """What a state says of the aircraft, by the attitude (4,) that is known of it.

    It may have turned by `turned_rad` since then; `slope_ne` (2,) is the terrain table's.
    """
    x, P, down, terrain = state.x, state.P, States.DOWN, States.TERRAIN
    variance_agl = P[down, down] + P[terrain, terrain] + 2.0 * P[down, terrain]
    # A tilt error turns the heading of a nose that points up or down: by tan(pitch).
    qw, qx, qy, qz = quat_measured_wxyz.tolist()
    sin_pitch = min(max(2.0 * (qw * qy - qx * qz), -0.9), 0.9)
    tangent = sin_pitch / math.sqrt(1.0 - sin_pitch**2)
    yaw, forward = States.HEADING_BIAS, States.TILT.start
    turn = P[yaw, yaw] + 2.0 * tangent * P[yaw, forward] + tangent**2 * P[forward, forward]
    seen = turn + (2.0 * P[yaw] + P[States.CAMERA_TURN])[States.CAMERA_TURN]
    drag = float(x[States.DRAG])  # the mean wind is w = c / k, told once k is known to a third
    windless = P[States.DRAG, States.DRAG] > (KNOWN_SHARE * drag) ** 2
    return Estimate(
        t_s=state.t_s,
        position_ned_m=x[States.POSITION].copy(),
        velocity_ned_m_s=x[States.VELOCITY].copy(),
        covariance=P[States.MOTION, States.MOTION].copy(),
        quat_wxyz=without_errors(quat_measured_wxyz, float(x[States.HEADING_BIAS]), x[States.TILT]),
        sigma_yaw_rad=min(math.sqrt(float(turn) + turned_rad**2), math.pi),
        agl_m=max(state.agl_m, 0.0),
        sigma_agl_m=math.sqrt(variance_agl),
        t_last_fix_s=state.t_last_fix_s,
        reset_counter=state.reset_counter,
        map_sigma_m=state.map_error.sigma_m,
        camera_turn_rad=-float(x[States.CAMERA_TURN]),
        sigma_seen_yaw_rad=min(math.sqrt(max(float(seen), 0.0) + turned_rad**2), math.pi),
        wind_ne_m_s=None if windless else x[States.WIND_FORCE] / drag,
        slope_ne=tuple(np.clip(slope_ne + x[States.SLOPE], -_STEEPEST, _STEEPEST).tolist()),
    )
