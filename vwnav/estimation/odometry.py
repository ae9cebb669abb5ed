"""The way that images tell meets the state: a keyframe's clone, then displacements from it."""

import math
from dataclasses import replace

import numpy as np

from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Context, patch_below
from vwnav.estimation.disputes import convinces, motion_opened, remember
from vwnav.estimation.events import NewKeyframe
from vwnav.estimation.inertial.attitudes import (
    AttitudeHistory,
    level_axes,
    true_from_autopilot,
)
from vwnav.estimation.inertial.integrals import Exposure
from vwnav.estimation.states import (
    FilterState,
    Innovation,
    Measurement,
    States,
    Verdict,
    fuse,
)
from vwnav.geometry.rotations import wrap_pi
from vwnav.types import Array, OdometryMotion

_FAR_OFF, _LEAN_SHARE = 0.05, 0.3  # of a focal length; of what it makes of a change of lean
_RATE_SHARE = 0.3  # of how fast it turns: within an error of the dates that changes
_CLONE_SIGMA_RAD = 1e-4  # a copy without any error of its own would make P singular
_CLONE_SIGMA_M = 0.01
# What odometry measures in units of height.
_SCALED = np.r_[States.POSITION_NE, States.VELOCITY, States.ACCELERATION, States.ANCHOR_NE]
_LEAST_AGL_M = 0.1
QUARTER_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])  # a rotation about north shows as east
_SLOPE_UNTOLD = tuple(
    np.r_[States.TILT, States.ANCHOR_TILT, States.CAMERA_TILT, States.TIME_OFFSET].tolist()
)
_HEADINGS = (States.HEADING_BIAS, States.ANCHOR_HEADING_BIAS, States.CAMERA_TURN)
_APART_M_S = 20.0  # by which refused ways that agree may part
_WAYS_AGREE = 6
_GRASS_BELOW_M = 10.0  # so low blades and shadows stand out, and nothing tells but them
_NEWEST = 0.1  # share of the newest image's relief in what is known of it
_SHORTEST_S = 0.1
_LEAP, _NO_CLIMB_M_S = 0.03, 12.0  # of the height, from an image to the next; beyond the climb


def apply_keyframe(
    state: FilterState, event: NewKeyframe, attitudes: AttitudeHistory
) -> FilterState:
    """Copy position, attitude error and ground to the anchor, and add the keyframe's own error.

    The keyframe's image errs in how far later ones have turned from it. The way is counted in the
    attitude of that moment, which the image does not turn: so that error is a state of its own.
    """
    G = np.eye(States.SIZE)
    G[States.ANCHOR_POSITION] = G[States.POSITION]
    G[States.ANCHOR_HEADING_BIAS] = G[States.HEADING_BIAS]
    G[States.ANCHOR_TERRAIN] = G[States.TERRAIN]
    G[States.ANCHOR_TILT] = G[States.TILT]
    G[States.ANCHOR_TURN] = 0.0
    P = G @ state.P @ G.T
    P[States.ANCHOR_POSITION, States.ANCHOR_POSITION] += event.covariance_ned_m2
    P[States.ANCHOR_HEADING_BIAS, States.ANCHOR_HEADING_BIAS] += _CLONE_SIGMA_RAD**2
    P[States.ANCHOR_TILT, States.ANCHOR_TILT] += _CLONE_SIGMA_RAD**2 * np.eye(2)
    P[States.ANCHOR_TERRAIN, States.ANCHOR_TERRAIN] += _CLONE_SIGMA_M**2 + state.relief_m**2
    P[States.ANCHOR_TURN, States.ANCHOR_TURN] = event.sigma_yaw_rad**2
    anchor = attitudes.exposure(event.t_s, float(state.x[States.TIME_OFFSET]))._replace(
        velocity_m_s=state.x[States.VELOCITY]
    )
    return state._replace(x=G @ state.x, P=P, anchor=anchor)


def apply_displacement(
    state: FilterState, motion: OdometryMotion, context: Context
) -> tuple[FilterState, Innovation]:
    """Fuse the way from the keyframe; its heading first, which the displacement is turned by."""
    attitudes, config = context.attitudes, context.config
    anchor, before_s = state.anchor, state.exposed_s
    state = state._replace(tracked_s=motion.t1_s, exposed_s=motion.t1_s)
    if anchor is None or anchor.t_s != motion.t0_s:
        return state, Innovation(Verdict.NO_ANCHOR)
    if not state.heading_known:
        state = motion_opened(state, motion.t1_s - before_s, config)
        return state, Innovation(Verdict.HEADING_UNKNOWN)
    parts: tuple[Innovation, ...] = ()
    exposure = attitudes.exposure(motion.t1_s, float(state.x[States.TIME_OFFSET]))
    if not config.odometry_turns_attitude:
        state, heading = fuse(state, _turn(state, motion, anchor, exposure, config))
        parts = (heading,)
    keyframe_agl_m = -state.x[States.ANCHOR_DOWN] - state.x[States.ANCHOR_TERRAIN]
    agl_m = max(float(keyframe_agl_m), _LEAST_AGL_M)
    relief = motion.relief if agl_m > _GRASS_BELOW_M else 0.0
    if relief is not None:
        change_m2 = (relief * agl_m) ** 2 - state.relief_m**2
        state = state._replace(relief_m=math.sqrt(state.relief_m**2 + _NEWEST * change_m2))
    displacement = _displacement(state, motion, agl_m, anchor, exposure, config)
    fused, innovation = fuse(state, displacement)
    if innovation.verdict is Verdict.FUSED:
        fused = _in_scale(state, fused, agl_m)._replace(rejected_ways=())
        fused = _apply_slope(fused, motion, anchor, context)
    else:
        fused = _rejected(state, displacement, config)
    return fused, replace(innovation, parts=parts)


def _apply_slope(
    state: FilterState, motion: OdometryMotion, anchor: Exposure, context: Context
) -> FilterState:
    """Fuse how the ground rises, as the way shows it: less what the terrain table knows.

    To an attitude that is off by d = (d_n, d_e) level ground rises by (d_e, -d_n). Ground that no
    way has shown to rise is thought to be level: the slope is open as far as it may have changed
    since the keyframe, and to what is told alone. Nothing is learned of the attitude: a keyframe
    that was dated wrongly while it leaned shows every image the same slope that is none.
    """
    if motion.slope_ne is None or motion.slope_covariance is None:
        return state
    table = np.zeros(2)
    if context.ground is not None and (patch := patch_below(state, context)):
        table = np.array([patch.per_north, patch.per_east])
    turn = level_axes(-float(state.x[States.ANCHOR_HEADING_BIAS] + state.x[States.CAMERA_TURN]))
    config = context.config
    way_m = math.hypot(*(state.x[States.POSITION] - state.x[States.ANCHOR_POSITION]))
    P = state.P.copy()
    fed = config.slope**2 * (1.0 - math.exp(-2.0 * way_m / config.slope_length_m))
    P[States.SLOPE, States.SLOPE] += fed * np.eye(2)
    state = state._replace(P=P)
    H = np.zeros((2, States.SIZE))
    H[:, States.SLOPE] = np.eye(2)
    c, s = math.cos(anchor.yaw_rad), math.sin(anchor.yaw_rad)
    by_tilt = turn @ np.array([[s, c], [-c, s]])
    H[:, States.ANCHOR_TILT] = H[:, States.CAMERA_TILT] = by_tilt
    H[:, States.TIME_OFFSET] = -by_tilt @ anchor.turns_rad_s[:2]
    R = turn @ motion.slope_covariance @ turn.T + config.slope_seen**2 * np.eye(2)
    residual = turn @ motion.slope_ne - table - H @ state.x
    return fuse(state, Measurement(residual, H, R, considered=_SLOPE_UNTOLD))[0]


def _rejected(state: FilterState, way: Measurement, config: EkfConfig) -> FilterState:
    """Ways that are refused and agree: images or the push are wrong, and which is not known.

    What all of them are off by alike is an error of their keyframe (of its stamp, mostly), which
    becomes as unsure as that. What they part by from image to image is an error of the
    velocity, and that becomes as unsure, as far as the push may have been wrong since the first of
    them: an accelerometer that is believed is not off by a tenth of gravity, whatever images say.
    """
    rejected = remember(state.rejected_ways, state.t_s, way, config.dispute_window_s)
    if not convinces(rejected, _APART_M_S, _WAYS_AGREE, config.offset_span_s):
        return state._replace(rejected_ways=rejected)
    assert state.anchor is not None
    zero_s, zero_m = state.anchor.t_s, np.zeros(3)
    since = [each for each in rejected if each.t_s > state.anchor.t_s]
    if len(since) >= _WAYS_AGREE // 2:
        zero_s, zero_m = since[0].t_s, since[0].residual
    grew_m_s = (way.residual - zero_m) / max(state.t_s - zero_s, _SHORTEST_S)
    felt = state.measured is not None and state.measured.felt is not None
    push_m_s2 = config.felt_push_off_m_s2 if felt else config.push_off_m_s2
    most_m_s = push_m_s2 * (state.t_s - rejected[0].t_s + _SHORTEST_S)
    grew_m_s = np.minimum(np.abs(grew_m_s), most_m_s)
    P = state.P.copy()
    P[States.ANCHOR_POSITION, States.ANCHOR_POSITION] += np.diag(way.residual**2)
    P[States.VELOCITY, States.VELOCITY] += np.diag(grew_m_s**2)
    return state._replace(P=P, rejected_ways=())


def _in_scale(before: FilterState, after: FilterState, agl_m: float) -> FilterState:
    """The covariance after odometry, with what it changed tied to the scale it was measured in.

    A correction d made of a way seen is d / AGL heights long: had the AGL another error e, it would
    be longer by d e / AGL. So the errors of what it changed grow by that, the reset Jacobian of an
    error state that scales: P' = G P G^T with G = I + per_m dAGL/dx, of rank one and written out.
    Without it the way believed and its correlation with the AGL part, and the next images seem
    to say how high the camera is, which no image can. A focal length scales as the AGL does.
    """
    per_m = np.zeros(States.SIZE)
    change = after.x - before.x
    per_m[_SCALED] = change[_SCALED] / agl_m
    per_m[States.DOWN] = (change[States.DOWN] - change[States.ANCHOR_DOWN]) / agl_m
    P = after.P
    by_agl = agl_m * P[:, States.FOCAL] - P[:, States.ANCHOR_DOWN] - P[:, States.ANCHOR_TERRAIN]
    variance = agl_m * by_agl[States.FOCAL]
    variance -= by_agl[States.ANCHOR_DOWN] + by_agl[States.ANCHOR_TERRAIN]
    tied = np.outer(per_m, by_agl + 0.5 * variance * per_m)
    return after._replace(P=P + (tied + tied.T))


def _turn(
    state: FilterState,
    motion: OdometryMotion,
    anchor: Exposure,
    exposure: Exposure,
    config: EkfConfig,
) -> Measurement:
    """What the autopilot turned more than the image did is the change of its heading bias.

    Or it turns faster now, and the image was exposed later than it says.
    """
    off, faster_rad_s = States.TIME_OFFSET, float((exposure.turns_rad_s - anchor.turns_rad_s)[2])
    H = np.zeros((1, States.SIZE))
    H[0, [States.HEADING_BIAS, States.ANCHOR_HEADING_BIAS, States.ANCHOR_TURN]] = 1.0, -1.0, 1.0
    H[0, off] = -faster_rad_s
    change_rad = exposure.yaw_rad - anchor.yaw_rad - motion.yaw_increment_rad
    residual = wrap_pi(float(change_rad - H[0] @ state.x))
    variance = (1.0 - config.anchor_share) * motion.sigma_yaw_rad**2
    variance += (_RATE_SHARE * faster_rad_s) ** 2 * float(state.x[off] ** 2 + state.P[off, off])
    return Measurement(np.array([residual]), H, np.array([[variance]]))


def _displacement(
    state: FilterState,
    motion: OdometryMotion,
    agl_m: float,
    anchor: Exposure,
    exposure: Exposure,
    config: EkfConfig,
) -> Measurement:
    """The way in units of the keyframe's AGL, scaled by the AGL believed now.

    The way seen is u AGL0 with AGL0 = -(down0 + terrain0); the true way d is seen turned by the
    attitude's error at the keyframe, Rz(-b0) u AGL0 = d + tilt x d. So uncertainties of AGL and
    attitude come in by the Jacobian, and what ways tell about them when fixes and barometer say
    how far it was. A focal length taken for too long by a share f shows a level way shorter by that
    share, and a change of lean (2,) from a0 to a1 by f (a0 - a1) to one side. Of a turn by that
    angle the far side would grow; here it shrinks, so that images which see that (what they take
    for motion is a share s of a turn) think that they have turned back: a way of
    (2 - s) f AGL0 (a0 - a1). Of images that were exposed later than dated by o, with the velocity v
    and the turn rate w, the way is longer by o (v1 - v0), and both attitudes are short by o w.
    """
    x, lean, off = state.x, exposure.lean, States.TIME_OFFSET
    turn = true_from_autopilot(float(x[States.ANCHOR_HEADING_BIAS] + x[States.CAMERA_TURN]))
    way_m: Array = turn @ motion.displacement_ned_m * (agl_m / motion.agl_m)
    # The Jacobian is that of the way predicted: with the way measured in it, its noise would be in
    # residual and gain alike, and every image would pull height and place to the same side.
    predicted_m: Array = x[States.POSITION] - x[States.ANCHOR_POSITION]
    north_m, east_m, down_m = predicted_m.tolist()
    H = np.zeros((3, States.SIZE))
    H[:, States.POSITION] = np.eye(3)
    H[:, States.ANCHOR_POSITION] = -np.eye(3)
    H[:, States.ANCHOR_DOWN] += predicted_m / agl_m
    H[:, States.ANCHOR_TERRAIN] = predicted_m / agl_m
    H[:, States.ANCHOR_HEADING_BIAS] = -east_m, north_m, 0.0
    yaw0_rad = anchor.yaw_rad - float(x[States.ANCHOR_HEADING_BIAS])
    level0, level1 = level_axes(yaw0_rad), level_axes(yaw0_rad + motion.yaw_increment_rad)
    turned_m = np.array([[0.0, down_m], [-down_m, 0.0], [east_m, -north_m]])  # tilt x way
    by_tilt0 = turned_m @ level0
    # Of a change of the tilt error, in a turn with the body too, odometry takes a share for motion.
    by_tilt1 = np.zeros((3, 2))
    by_tilt1[:2] = motion.tilt_share * agl_m * QUARTER_TURN @ level1
    by_tilt0[:2] -= motion.tilt_share * agl_m * QUARTER_TURN @ level0
    H[:, States.TILT], H[:, States.ANCHOR_TILT] = by_tilt1, by_tilt0
    H[:, States.CAMERA_TILT] = by_tilt0 + by_tilt1  # the same at both ends, about the body
    by_turn = by_tilt0 @ anchor.lean + by_tilt1 @ lean  # besides what turns the way
    H[:, States.CAMERA_TURN] = H[:, States.ANCHOR_HEADING_BIAS] + by_turn
    shifted_m = (2.0 - motion.tilt_share) * agl_m * (level0 @ anchor.lean - level1 @ lean)
    H[:2, States.FOCAL] = shifted_m - predicted_m[:2]
    short_m_s = by_tilt0 @ anchor.turns_rad_s[:2] + by_tilt1 @ exposure.turns_rad_s[:2]
    short_m_s += H[:, States.ANCHOR_HEADING_BIAS] * anchor.turns_rad_s[2]
    H[:, off] = moved_m_s = x[States.VELOCITY] - anchor.velocity_m_s - short_m_s
    residual = way_m - x[States.POSITION] + x[States.ANCHOR_POSITION]
    residual -= by_tilt0 @ x[States.ANCHOR_TILT] + by_tilt1 @ x[States.TILT]
    residual -= H[:, States.CAMERA_TILT] @ x[States.CAMERA_TILT]
    residual -= by_turn * x[States.CAMERA_TURN]
    residual -= H[:, States.FOCAL] * x[States.FOCAL] + moved_m_s * x[off]
    scale = (1.0 - config.anchor_share) * (agl_m / motion.agl_m) ** 2
    R = scale * turn @ motion.covariance_ned_m2 @ turn.T
    R[2, 2] += (config.zoom_share * down_m) ** 2
    unsure = config.slope_share * math.hypot(*x[States.SLOPE])
    unsure += config.relief_share * state.relief_m / agl_m
    R += unsure**2 * float(predicted_m @ predicted_m) * np.eye(3)
    # What a focal length that is far off, or may be, makes of a change of lean is known to a third.
    far2 = float(x[States.FOCAL]) ** 2 + float(state.P[States.FOCAL, States.FOCAL]) - _FAR_OFF**2
    R[:2, :2] += (_LEAN_SHARE**2 * max(far2, 0.0)) * np.outer(shifted_m, shifted_m)
    # How fast it turns within an error of the dates, the moment before an image tells to a third.
    R += _RATE_SHARE**2 * float(x[off] ** 2 + state.P[off, off]) * np.outer(moved_m_s, moved_m_s)
    # The heading would be told by how the aircraft moves when it tilts, but wind moves it too: at
    # take-off, when the wind takes hold, that turned the heading by up to 25 degrees.
    return Measurement(residual, H, R, considered=_HEADINGS)


def zoomed(before: OdometryMotion | None, motion: OdometryMotion, state: FilterState) -> bool:
    """Whether the view grew or shrank from one image to the next as no climb makes it: by a lens.

    Of a tenth the ways are not so wrong that the IMU contradicts them: the rangefinder was blamed,
    4.1 m off at 7.7 sigmas. Before a first fix neither height nor climb is sure enough.
    """
    since_s, sunk_m = motion.t0_s, 0.0
    if before is not None and before.t0_s == motion.t0_s:
        since_s, sunk_m = before.t1_s, float(before.displacement_ned_m[2])
    span_s = motion.t1_s - since_s
    leapt_m = float(motion.displacement_ned_m[2]) - sunk_m - span_s * state.x[States.VELOCITY_DOWN]
    least_m = max(_LEAP * motion.agl_m, _NO_CLIMB_M_S * span_s)
    return state.t_last_fix_s is not None and abs(leapt_m) > least_m


def between(before: OdometryMotion, after: OdometryMotion) -> OdometryMotion:
    """The way from one image to a later one that were both compared with the same keyframe.

    For a keyframe that the filter has forgotten: over a spot where nothing changes odometry keeps
    it for minutes, and a filter that begins anew meanwhile would have no ways at all. How the
    ground rises all of these ways show by that one keyframe, and err in alike.
    """
    return replace(
        after,
        t0_s=before.t1_s,
        displacement_ned_m=after.displacement_ned_m - before.displacement_ned_m,
        covariance_ned_m2=after.covariance_ned_m2 + before.covariance_ned_m2,
        yaw_increment_rad=wrap_pi(after.yaw_increment_rad - before.yaw_increment_rad),
        sigma_yaw_rad=math.hypot(after.sigma_yaw_rad, before.sigma_yaw_rad),
        slope_ne=None,
        slope_covariance=None,
    )
