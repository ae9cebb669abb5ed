"""A map fix meets the state: position, then heading and height, and the jump when it must be."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Context, patch_below
from vwnav.estimation.disputes import (
    agreeing,
    by_half,
    convinces,
    freed,
    leaning,
    moved_along,
    range_doubted,
    relocated,
    relocates,
    remember,
    seen_from,
    turned,
)
from vwnav.estimation.events import NedFix
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.inertial.integrals import Exposure
from vwnav.estimation.states import (
    CHI_SQUARE_GATE,
    FilterState,
    Innovation,
    Measurement,
    States,
    TrustedPosition,
    Verdict,
    correct,
    fuse,
    tells_heading,
)
from vwnav.geometry.rotations import wrap_pi

# A copy without any error of its own would make P singular: metres, radians, metres.
_CLONE_SIGMAS = np.array([0.01, 0.01, 1e-4, 1e-4, 1e-4, 0.01])
_UNSEEN_RAD = 0.1  # by which an image may lean otherwise than an attitude that is held
_SMALLEST_SIGMA_M = 0.03
_HOVERS_M_S, _OF_SCALE = 1.0, 0.15  # seen on and on, one place is out of scale, by less
_MOST_SCALE = 4.0  # sigmas that a map is out of scale at most
_SHARED = [States.CAMERA_TURN, States.MAP_TURN]
_SHOWN = np.array([1.0, 1.0, -1.0])  # what a fix shows of the compass' error and of those
_TURNED_COS = math.cos(math.radians(40.0))
_LONE_SHARE = 1.0 / 3.0  # of a variance, as noise: halves a sigma, from these sigmas on
_OPEN_M, _OPEN_RAD, _LONE_HEADING_RAD = 2.25, math.radians(4.0), math.radians(15.0)
_AGREEING_S = 10.0  # a fix that agrees with one so shortly before it is trusted


@dataclass(frozen=True, slots=True)
class _PoseSlices:
    """Where in the state the pose is that a fix tells; `agl` None: down and terrain."""

    ne: slice
    yaw: int
    tilt: slice
    agl: int | None


class _Compass(NamedTuple):
    """By how much the autopilot's heading is off, with one sigma, and how fast it turns then."""

    off_rad: float
    sigma_rad: float
    turns_rad_s: float


_NOW = _PoseSlices(States.POSITION_NE, States.HEADING_BIAS, States.TILT, None)
_THEN = _PoseSlices(
    States.EXPOSED_POSITION, States.EXPOSED_HEADING_BIAS, States.EXPOSED_TILT, States.EXPOSED_AGL
)


def apply_fix(
    state: FilterState, fix: NedFix, context: Context, late: bool = False
) -> tuple[FilterState, Innovation]:
    """Fuse a fix at its own time: heading and AGL only of one whose position is believed.

    Of one that is turned further than a compass errs nothing is believed before several are: either
    the compass looks the other way, or ground that looks alike has been taken for this.

    One that is `late` is of the image whose pose is cloned: with the clone all that came since
    moves. The map's own error there and here is not the same by now, so it is noise besides.
    """
    pose, exposure = _NOW, context.attitudes.exposure(fix.t_s, float(state.x[States.TIME_OFFSET]))
    exposure = exposure._replace(velocity_m_s=state.x[States.VELOCITY])
    if late:
        if state.exposure is None or state.exposure.t_s != fix.t_s:
            return state, Innovation(Verdict.TOO_LATE)
        pose, exposure = _THEN, state.exposure
    parts: list[Innovation] = []
    compass: _Compass | None = None
    # Against an attitude that is only held, a heading would take a turn for the compass' error.
    if exposure.told and fix.yaw_rad is not None and fix.sigma_yaw_rad is not None:
        off_rad, turns_rad_s = wrap_pi(exposure.yaw_rad - fix.yaw_rad), exposure.turns_rad_s[2]
        compass = _Compass(off_rad, fix.sigma_yaw_rad, float(turns_rad_s))
    if compass is not None and state.heading_known:
        off_rad = compass.off_rad - float(_SHOWN @ state.x[[pose.yaw, *_SHARED]])
        if math.cos(off_rad) < _TURNED_COS:
            found, part = _apply_heading(state, compass, context.config, pose.yaw)
            if not part.accepted:
                return found, part
            if part.verdict is Verdict.RELOCATED:
                state, parts, compass = found, [part], None
    position = _position(state, fix, exposure, pose)
    if late:
        position = replace(position, R=position.R + state.map_error.sigma_m**2 * np.eye(2))
    elif not exposure.told:
        position = _unseen(state, position, fix)
    state, innovation = _apply_position(state, fix, position, context)
    if not innovation.accepted:
        return state, innovation
    if compass is not None:
        state, part = _apply_heading(state, compass, context.config, pose.yaw)
        parts.append(part)
    if fix.agl_m is None or fix.sigma_agl_m is None:
        return state, replace(innovation, parts=tuple(parts))
    if pose.agl is None:
        state, part = apply_agl(state, fix.agl_m, fix.sigma_agl_m, context.config, by_map=True)
    else:
        H = np.zeros((1, States.SIZE))
        H[0, pose.agl] = 1.0
        H[0, [States.MAP_SCALE, States.FOCAL]] = float(state.x[pose.agl])
        R = np.array([[fix.sigma_agl_m**2 + state.relief_m**2]])
        state, part = fuse(state, Measurement(fix.agl_m - H @ state.x, H, R))
    return state, replace(innovation, parts=(*parts, part))


def apply_exposure(state: FilterState, attitudes: AttitudeHistory) -> FilterState:
    """Copy what a fix of this moment's image will tell: place, attitude error, height."""
    exposure = attitudes.exposure(state.t_s, float(state.x[States.TIME_OFFSET]))
    if not exposure.told:
        return state._replace(exposure=None)  # nobody knows how it was turned
    G = np.eye(States.SIZE)
    G[States.EXPOSED_POSITION] = G[States.POSITION_NE]
    G[States.EXPOSED_HEADING_BIAS] = G[States.HEADING_BIAS]
    G[States.EXPOSED_TILT] = G[States.TILT]
    G[States.EXPOSED_AGL] = -G[States.DOWN] - G[States.TERRAIN]
    P = G @ state.P @ G.T
    P[States.EXPOSED, States.EXPOSED] += np.diag(_CLONE_SIGMAS**2)
    exposure = exposure._replace(velocity_m_s=state.x[States.VELOCITY])
    return state._replace(x=G @ state.x, P=P, exposure=exposure)


def _position(
    state: FilterState, fix: NedFix, exposure: Exposure, pose: _PoseSlices
) -> Measurement:
    """The fix is where the camera seems to be: a tilt error moves it by AGL times that angle.

    Of the attitude or of the camera's mount; an IMU tells the one from the other. Ways and slopes
    lean by the same, but not by what fixes have alike in every turn besides: were that taken for a
    tilt, a level flight would seem to climb by it, all the way.

    With the rotation error d = (d_n, d_e) of the attitude, the nadir point that it shows lies
    AGL (-d_e, d_n) from the true one. A focal length taken for too long by a share f finds it by
    that share too far from the optical axis, which leans by a: -f AGL a from the true one. One of
    an image exposed later than dated by o is farther on by o v, and the attitude short by o w.
    """
    yaw_rad = exposure.yaw_rad - float(state.x[pose.yaw])
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    agl_m = state.agl_m if pose.agl is None else float(state.x[pose.agl])
    lever = agl_m * np.array([[-s, -c], [c, -s]])  # R2(yaw) @ [[0, -1], [1, 0]]
    H = np.zeros((2, States.SIZE))
    H[:, pose.ne] = np.eye(2)
    H[:, pose.tilt] = H[:, States.CAMERA_TILT] = H[:, States.FIX_LEAN] = lever
    H[:, States.CAMERA_TURN] = lever @ exposure.lean
    H[:, States.MAP] = np.eye(2)
    H[:, States.FOCAL] = -agl_m * np.array([[c, -s], [s, c]]) @ exposure.lean
    H[:, States.TIME_OFFSET] = exposure.velocity_m_s[:2] - lever @ exposure.turns_rad_s[:2]
    residual = fix.position_ne_m - H @ state.x
    # With the height that the fix itself was computed with: the tilt's share is most of the whole.
    agl_m = agl_m if fix.agl_m is None else fix.agl_m
    own_m2 = (max(agl_m, 0.0) * fix.sigma_tilt_rad) ** 2 + fix.sigma_map_m**2
    variances, axes = np.linalg.eigh(fix.covariance_ne_m2)
    rest = np.maximum(variances - own_m2, np.maximum(0.01 * variances, _SMALLEST_SIGMA_M**2))
    return Measurement(residual, H, axes @ np.diag(rest) @ axes.T)


def _unseen(state: FilterState, position: Measurement, fix: NedFix) -> Measurement:
    """No attitude that is believed tells how the image was turned: by how much, nobody knows."""
    H = position.H.copy()
    H[:, States.TILT] = H[:, [States.CAMERA_TURN]] = H[:, [States.TIME_OFFSET]] = 0.0
    wide_m2 = (_UNSEEN_RAD * max(state.agl_m, 0.0)) ** 2 * np.eye(2)
    residual = fix.position_ne_m - H @ state.x
    return Measurement(residual, H, fix.covariance_ne_m2 + wide_m2)


def _apply_position(
    state: FilterState, fix: NedFix, measurement: Measurement, context: Context
) -> tuple[FilterState, Innovation]:
    """Fuse where a fix shows the aircraft, or jump there."""
    config, r = context.config, measurement.residual
    lone = _alone(state, measurement, _OPEN_M)
    fused, innovation = fuse(state, lone, config.visual_weight)
    # A long pull, however wide the gate has become: one wrong fix must not do it.
    short = measurement.R + config.sudden_sigma_m**2 * np.eye(2)
    sudden = float(r @ np.linalg.solve(short, r)) > CHI_SQUARE_GATE[2]
    after = fused._replace(rejected_fixes=())
    if not state.position_known or innovation.verdict is not Verdict.FUSED or sudden:
        after, innovation = _disputed(state, fix, measurement, innovation, context)
        if not innovation.accepted:
            return after, innovation
    elif lone is not measurement:
        once, drift = state.rejected_fixes, config.relocation_drift_m_s
        after, once = by_half(state, fused, measurement, once, fix.t_s, drift)
        after = after._replace(rejected_fixes=once)
    before_s = after.t_last_fix_s
    if before_s is not None and 0.0 < fix.t_s - before_s < _AGREEING_S:
        # It agrees with one shortly before it: to begin anew from, should that be.
        place_ne_m, sigma_m = after.x[States.POSITION_NE], math.sqrt(max(np.diag(after.P)[_NOW.ne]))
        after = after._replace(trusted=TrustedPosition(after.t_s, place_ne_m.copy(), sigma_m))
    return after._replace(t_last_fix_s=fix.t_s), innovation


def _disputed(
    state: FilterState, fix: NedFix, measurement: Measurement, told: Innovation, context: Context
) -> tuple[FilterState, Innovation]:
    """What a fix tells that is not as was believed: others must agree."""
    config, drift = context.config, context.config.relocation_drift_m_s
    if state.position_known:
        window_s, least = config.dispute_window_s, 3 * config.relocation_fixes // 2
        rejected = remember(state.rejected_fixes, fix.t_s, measurement, window_s, least)
        if told.accepted and len(agreeing(rejected, drift, window_s)) >= config.sudden_fixes:
            return correct(state, measurement)._replace(rejected_fixes=()), told
        if told.accepted:
            after = leaning(state, measurement, config.lone_fix_sigma_m)
            kept = seen_from(rejected, state, after, measurement)
            return after._replace(rejected_fixes=kept), replace(told, verdict=Verdict.UNCONFIRMED)
        state = state._replace(rejected_fixes=rejected)
        if not relocates(state, config):
            return state, told
    after = relocated(state, measurement)
    old, new = patch_below(state, context), patch_below(after, context)
    if old is not None and new is not None:  # the ground below is that of the other place
        by_ground = [States.TERRAIN, States.ANCHOR_TERRAIN, States.EXPOSED_AGL]
        after.x[by_ground] += (new.height_m - old.height_m) * np.array([1.0, 1.0, -1.0])
    return after, replace(told, verdict=Verdict.RELOCATED)


def _alone(state: FilterState, measurement: Measurement, open_: float) -> Measurement:
    """What one fix tells where more is open: half of it, until another one agrees.

    It may be of ground that looks alike, turned or aside, and as sure of itself as any.
    """
    H, R = measurement.H, measurement.R
    variances, axes = np.linalg.eigh(H @ state.P @ H.T)  # it may be open to one side alone
    short = np.maximum(_LONE_SHARE * variances - np.diag(axes.T @ R @ axes), 0.0)
    short[variances <= open_**2] = 0.0
    return replace(measurement, R=R + (axes * short) @ axes.T) if np.any(short) else measurement


def _apply_heading(
    state: FilterState, compass: _Compass, config: EkfConfig, yaw: int
) -> tuple[FilterState, Innovation]:
    """Fuse the heading bias (state `yaw`) that a fix shows: less what the map is turned by.

    A compass that suddenly errs is refused at first; when several fixes agree, the bias is freed.
    """
    H = np.zeros((1, States.SIZE))
    H[0, [yaw, *_SHARED]] = _SHOWN
    H[0, States.TIME_OFFSET] = -compass.turns_rad_s
    residual = np.array([wrap_pi(float(compass.off_rad - H[0] @ state.x))])
    measurement = Measurement(residual, H, np.array([[compass.sigma_rad**2]]))
    jump = np.zeros((States.SIZE, 1))
    jump[[States.HEADING_BIAS, States.ANCHOR_HEADING_BIAS, _THEN.yaw]] = 1.0
    if not state.heading_known:
        R = measurement.R + _LONE_HEADING_RAD**2
        found = moved_along(state, replace(measurement, R=R), jump)
        # That of an image of long ago leaves the heading of now as open as it has been since.
        found = found._replace(heading_known=tells_heading(found.P))
        return found, replace(fuse(found, measurement)[1], verdict=Verdict.RELOCATED)
    lone = _alone(state, measurement, _OPEN_RAD)
    fused, innovation = fuse(state, lone, config.visual_weight)
    agrees, drift = innovation.verdict is Verdict.FUSED, config.heading_drift_rad_s
    if agrees and lone is measurement:
        return fused._replace(rejected_headings=()), innovation
    if agrees:
        after, one = by_half(state, fused, measurement, state.rejected_headings, state.t_s, drift)
        return after._replace(rejected_headings=one), innovation
    rejected = remember(state.rejected_headings, state.t_s, measurement, config.dispute_window_s)
    state = state._replace(rejected_headings=rejected)
    if not convinces(rejected, drift, config.offset_count, config.offset_span_s):
        return state, innovation
    if state.t_last_fix_s is None:  # it was off from the start, and so was all that is level
        state = turned(state, -float(residual[0]))
    found = moved_along(state, measurement, jump)
    # Whether the step came before the keyframe or after it is not known: its own bias is open.
    found = freed(found, States.ANCHOR_HEADING_BIAS, 2.0 * abs(float(residual[0])))
    return found._replace(rejected_headings=()), replace(innovation, verdict=Verdict.RELOCATED)


def apply_agl(
    state: FilterState,
    agl_m: float,
    sigma_m: float,
    config: EkfConfig,
    by_map: bool = False,
) -> tuple[FilterState, Innovation]:
    """Fuse a height above ground, of a fix or of who stands.

    A cliff or a quarry is refused at first; when several agree, the terrain height is freed, and a
    rangefinder that may have held the height has to bear them, or it would hold it again.
    Heights `by_map` share the errors of its scale and of the focal length, are those over what was
    matched, roofs or the street, and as wrong as the square of a camera's tilt makes them.
    """
    H = np.zeros((1, States.SIZE))
    H[0, States.DOWN] = H[0, States.TERRAIN] = -1.0
    H[0, [States.MAP_SCALE, States.FOCAL]] = scaled_m = state.agl_m if by_map else 0.0
    bent_m = scaled_m * float(state.x[States.CAMERA_TILT] @ state.x[States.CAMERA_TILT])
    variance = sigma_m**2 + (state.relief_m**2 if by_map else 0.0) + bent_m**2
    measurement = Measurement(agl_m - H @ state.x, H, np.array([[variance]]))
    fused, innovation = fuse(state, measurement)
    trust = state.range_trust
    heard = by_map and trust.agreed_ne_m is not None and trust.doubted_s is None
    most = _MOST_SCALE * config.map_scale * state.map_error.sigma_m / config.map_sigma_m
    drawn = heard and abs(float(fused.x[States.MAP_SCALE])) > most  # of a warped map, more
    if innovation.verdict is Verdict.FUSED and not drawn:
        return fused._replace(rejected_agls=()), innovation
    north_m_s, east_m_s, down_m_s = state.x[States.VELOCITY].tolist()
    stays = math.hypot(north_m_s, east_m_s) < _HOVERS_M_S and down_m_s > -_HOVERS_M_S
    if heard and stays and abs(float(measurement.residual[0])) < _OF_SCALE * state.agl_m:
        return state, replace(innovation, verdict=Verdict.GATED)  # one place, or sinking to it
    if drawn:  # inside its gate a height gives way each time, and the map's scale takes it
        unscaled = state.x * (np.arange(States.SIZE) != States.MAP_SCALE)
        state = freed(state._replace(x=unscaled), States.MAP_SCALE, config.map_scale)
        measurement = replace(measurement, residual=agl_m - H @ state.x)
    else:
        rejected = remember(state.rejected_agls, state.t_s, measurement, config.dispute_window_s)
        state = state._replace(rejected_agls=rejected)
        if not convinces(rejected, 1.0, config.offset_count, config.offset_span_s):
            return state, innovation
    open_m = 2.0 * abs(float(measurement.residual[0]))
    # Whether the keyframe's ground was believed wrong too is not known.
    state = freed(freed(state, States.TERRAIN, open_m), States.ANCHOR_TERRAIN, open_m)
    if heard:
        state = range_doubted(state, abs(float(measurement.residual[0])))
    fused = correct(state, measurement)
    return fused._replace(rejected_agls=()), replace(innovation, verdict=Verdict.RELOCATED)
