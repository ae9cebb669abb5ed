"""The camera turns out to be another than it was taken for: lens, dates, or how it hangs."""

import math
from dataclasses import replace

import numpy as np

from vwnav.estimation.beginning.lens import MOST_RATIO
from vwnav.estimation.beginning.misled import apply_misled
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.disputes import freed
from vwnav.estimation.events import Misled, Recalibrated
from vwnav.estimation.inertial.attitudes import level_axes
from vwnav.estimation.odometry import QUARTER_TURN
from vwnav.estimation.states import HEADINGS, FilterState, States
from vwnav.geometry.camera import MAX_TIME_OFFSET_S, UNMEASURED_FOCAL_RATIO
from vwnav.geometry.rotations import rotation_from_vector, wrap_pi
from vwnav.types import Array, Frame
from vwnav.vehicle import FoundCamera, Learned

LENS_DOUBT = 0.2  # one sigma of the focal length of a doubted lens, as a share of it
_RETURNED_DOUBT = 0.3  # the same of one that was gone
_REDATED_SHARE = 0.3  # of what was to be added to dates, one sigma of what is still
_TILT_DOUBT_RAD = 0.12  # per axis, of a mount that may hang otherwise


def found_by(event: Recalibrated, focal_ratio: float, before: FoundCamera | None) -> FoundCamera:
    """The camera that an event tells of, where another one was flown with, or that of the file.

    `focal_ratio`: of its focal length to the calibrated one.
    """
    R_mount, was_mirrored, time_offset_s = np.eye(3), False, event.redated_s
    if before is not None:
        R_mount, was_mirrored = np.reshape(before.R_mount, (3, 3)), bool(before.mirrored)
        time_offset_s += before.time_offset_s
    off_rad = np.array([event.forward_rad, event.right_rad, event.turned_rad])
    R_mount = rotation_from_vector(off_rad) @ R_mount
    mirrored = float(was_mirrored != event.mirrored)
    return FoundCamera(focal_ratio, mirrored, tuple(R_mount.ravel().tolist()), time_offset_s)


def found_in(learned: Learned | None) -> FoundCamera | None:
    """The camera that another navigator has found out; None where it is none that can be."""
    camera = None if learned is None else learned.camera
    if camera is None or not 1.0 / MOST_RATIO < camera.focal_ratio < MOST_RATIO:
        return None
    if not abs(camera.time_offset_s) < MAX_TIME_OFFSET_S:
        return None
    R = np.reshape(camera.R_mount, (3, 3))
    turns = np.allclose(R @ R.T, np.eye(3), atol=1e-6) and np.linalg.det(R) > 0.0
    return camera if turns else None


def seen_by(camera: FoundCamera, frame: Frame) -> Frame:
    """A frame (gray) as the camera would have sent it that was told: of its date, not mirrored."""
    frame = replace(frame, t_s=frame.t_s + camera.time_offset_s)
    if not camera.mirrored:
        return frame
    return replace(frame, image=np.ascontiguousarray(frame.image[:, ::-1]))


def apply_camera_returned(state: FilterState) -> FilterState:
    """Open the focal length; what ways have told so far was right.

    A camera that had come back with 1.3 times the focal length cost the aircraft 90 m, 10 sigmas.
    """
    return freed(state, States.FOCAL, _RETURNED_DOUBT)


def apply_lens_doubted(state: FilterState, config: EkfConfig) -> FilterState:
    """Open the focal length, and with it what ways have told so far.

    All of it is too short by the share f that the focal length is too long: place and velocity are
    off by f times the way flown, and f times the velocity. So what ways tell of f from now on tells
    how far it was too.
    """
    doubted = _refocused(state, config)
    G = _told_by_ways(state, np.eye(2))
    G[States.FOCAL] = 1.0
    return doubted._replace(P=doubted.P + LENS_DOUBT**2 * np.outer(G, G))


def apply_recalibrated(state: FilterState, event: Recalibrated, config: EkfConfig) -> FilterState:
    """What is seen from now on is seen by another camera: what it was wrong by before is not left.

    Of the mount or the dates, as far as the event says; else of the focal length. An image of the
    keyframe's time has another date now.
    """
    if event.redated_s:
        found = state.x - event.redated_s * (np.arange(States.SIZE) == States.TIME_OFFSET)
        found_s = _REDATED_SHARE * abs(event.redated_s)
        return freed(state._replace(x=found, anchor=None), States.TIME_OFFSET, found_s)
    if event.mirrored or event.turned_rad != 0.0:
        return _turned(state, event, config)
    if event.forward_rad == event.right_rad == 0.0:
        return _refocused(state, config)
    x = state.x.copy()
    x[States.CAMERA_TILT] += event.forward_rad, event.right_rad
    return state._replace(x=x)


def _refocused(state: FilterState, config: EkfConfig) -> FilterState:
    """The focal length is what it is taken for, but for an error as that of one by a data sheet.

    What ways seemed to tell of the dates of images was its error: nothing is known of them.
    """
    x = state.x.copy()
    x[[States.FOCAL, States.TIME_OFFSET]] = 0.0
    sigma = math.sqrt(float(state.P[States.FOCAL, States.FOCAL]))
    state = freed(state._replace(x=x), States.TIME_OFFSET, config.time_offset_sigma_s)
    if sigma > UNMEASURED_FOCAL_RATIO:
        return state  # as the ways have told it
    return freed(state, States.FOCAL, UNMEASURED_FOCAL_RATIO)


def _turned(state: FilterState, event: Recalibrated, config: EkfConfig) -> FilterState:
    """The camera is turned from how its mount was told: until now its error was the compass'.

    So it was in the heading bias, as far as fixes had told that, and velocity and way since the
    last fix that is trusted were turned by as much. Of one that was knocked just now neither was.
    """
    x, P = state.x.copy(), state.P
    if not event.knocked:
        state = apply_misled(state, Misled(state.t_s, state.t_s), config)
        # A mirror turns a way by twice its angle to the mirror, whatever that is.
        all_round, turned = [np.eye(2), QUARTER_TURN], [event.turned_rad * QUARTER_TURN]
        changes = all_round if event.mirrored else turned
        told = [_told_by_ways(state, change) for change in changes]
        x, P = state.x.copy(), state.P + sum(np.outer(G, G) for G in told)
    # How the camera hangs is known as well as the event says; what images showed of the heading, as
    # well as before: its error is that of the turn, the other way.
    G = np.eye(States.SIZE)
    unsure = np.zeros(States.SIZE)
    unsure[States.CAMERA_TURN] = event.sigma_turned_rad
    shown = state.t_last_fix_s is not None and not event.knocked
    if not event.knocked:
        G[States.CAMERA_TURN] = 0.0
    if shown:
        G[HEADINGS, States.CAMERA_TURN] = 1.0
        unsure[HEADINGS] = -event.sigma_turned_rad
    x, P = G @ x, G @ P @ G.T + np.outer(unsure, unsure)
    if shown:
        x[HEADINGS] = [wrap_pi(each + event.turned_rad) for each in x[HEADINGS].tolist()]
    return state._replace(x=x, P=P, anchor=None if event.knocked else state.anchor)


def apply_mount_doubted(state: FilterState, yaw_rad: float) -> FilterState:
    """Open how the camera is tilted on its mount, now, and from the start with what that has told.

    With d = (d_f, d_r) the error of the mount, fixes lay AGL (d_r forward, -d_f to the right) from
    the aircraft, and ways v seemed to be v + d x v. A keyframe may be of before: it is forgotten.
    What else was learned stays: an estimate whose velocity is opened is not flown on.
    """
    level = level_axes(yaw_rad)
    north, east, down = (_TILT_DOUBT_RAD * state.x[States.VELOCITY]).tolist()
    now = np.zeros((States.SIZE, 2))
    now[States.CAMERA_TILT] = _TILT_DOUBT_RAD * np.eye(2)
    always = now.copy()
    always[States.VELOCITY] = -np.array([[0.0, down], [-down, 0.0], [east, -north]]) @ level
    lever_m = _TILT_DOUBT_RAD * max(state.agl_m, 0.0) * QUARTER_TURN @ level
    always[States.POSITION_NE] = always[States.EXPOSED_POSITION] = -lever_m
    return state._replace(P=state.P + now @ now.T + always @ always.T, anchor=None)


def _told_by_ways(state: FilterState, change: Array) -> Array:
    """(n,) velocity, and the ways since the last fix that is trusted, under a `change` (2, 2)."""
    x, begun_ne_m = state.x, state.x[States.POSITION_NE]
    if state.trusted is not None:
        begun_ne_m = state.trusted.position_ne_m
    G = np.zeros(States.SIZE)
    G[States.VELOCITY_NE] = change @ x[States.VELOCITY_NE]
    for place in (States.POSITION_NE, States.ANCHOR_NE, States.EXPOSED_POSITION):
        G[place] = change @ (x[place] - begun_ne_m)
    return G
