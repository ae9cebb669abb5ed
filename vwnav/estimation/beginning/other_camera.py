"""The camera turns out to be another than it was taken for: its lens, or how it hangs."""

import math
from dataclasses import replace

import numpy as np

from vwnav.estimation.config import EkfConfig
from vwnav.estimation.disputes import freed
from vwnav.estimation.events import Misled
from vwnav.estimation.odometry import QUARTER_TURN, apply_misled
from vwnav.estimation.states import HEADINGS, FilterState, States
from vwnav.geometry.camera import UNMEASURED_FOCAL_RATIO
from vwnav.geometry.rotations import wrap_pi
from vwnav.types import Array

LENS_DOUBT = 0.2  # one sigma of the focal length of a doubted lens, as a share of it
_TURN_DOUBT = 0.3  # one sigma of what a mount is turned, as a share of it


def apply_lens_doubted(state: FilterState) -> FilterState:
    """Open the focal length, and with it what ways have told so far.

    All of it is too short by the share f that the focal length is too long: place and velocity are
    off by f times the way flown, and f times the velocity. So what ways tell of f from now on tells
    how far it was too.
    """
    doubted = apply_recalibrated(state)
    G = _told_by_ways(state, np.eye(2))
    G[States.FOCAL] = 1.0
    return replace(doubted, P=doubted.P + LENS_DOUBT**2 * np.outer(G, G))


def apply_recalibrated(state: FilterState) -> FilterState:
    """The focal length is what it is taken for, but for an error as that of one by a data sheet."""
    x = state.x.copy()
    x[States.FOCAL] = 0.0
    sigma = math.sqrt(float(state.P[States.FOCAL, States.FOCAL]))
    state = replace(state, x=x)
    if sigma > UNMEASURED_FOCAL_RATIO:
        return state  # as the ways have told it
    return freed(state, States.FOCAL, UNMEASURED_FOCAL_RATIO)


def apply_turned(state: FilterState, turned_rad: float, config: EkfConfig) -> FilterState:
    """The camera is turned from how its mount was told: until now its error was the compass'.

    So it was in the heading bias, as far as fixes had told that, and velocity and way since the
    last fix that is trusted were turned by as much.
    """
    state = apply_misled(state, Misled(state.t_s, state.t_s), config)
    G = _told_by_ways(state, turned_rad * QUARTER_TURN)
    x, P = state.x.copy(), state.P + np.outer(G, G)
    if state.t_last_fix_s is not None:
        x[HEADINGS] = [wrap_pi(each + turned_rad) for each in x[HEADINGS].tolist()]
        unsure = np.zeros(States.SIZE)
        unsure[HEADINGS] = _TURN_DOUBT * turned_rad
        P = P + np.outer(unsure, unsure)
    return replace(state, x=x, P=P)


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
