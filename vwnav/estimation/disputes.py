"""Innovations that are refused, or believed by half: enough must agree, and what follows then."""

import math
from dataclasses import replace

import numpy as np

from vwnav.estimation.beginning.map_error import LearnedMapError
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.inertial.attitudes import level_axes
from vwnav.estimation.inertial.integrals import white_acceleration
from vwnav.estimation.states import (
    CHI_SQUARE_GATE,
    FilterState,
    Measurement,
    RejectedInnovation,
    RejectedInnovations,
    States,
    correct,
)
from vwnav.types import Array

_LEVEL_VECTORS = (
    States.VELOCITY_NE,
    States.ACCELERATION,
    States.WIND_FORCE,
    States.GUST_FORCE,
    States.SLOPE,
)
_PLACES_BEFORE = (States.ANCHOR_NE, States.EXPOSED_POSITION)
BAROMETER_OFF_M = 8.0  # what weather, gusts and rotors do to it within a flight, at most
_MOST_REMEMBERED = 64  # rejected innovations
_DRIFTS_S = 30.0  # for so long at most: else all that is old would agree


def freed(state: FilterState, index: int, sigma: float) -> FilterState:
    """Forget how sure one state was: its correlations go, its sigma is as given."""
    P = state.P.copy()
    P[index, :] = 0.0
    P[:, index] = 0.0
    P[index, index] = sigma**2
    return state._replace(P=P)


def turned(state: FilterState, by_rad: float) -> FilterState:
    """All that is counted in north and east, turned about the place: its heading was so far off.

    A heading that is off by half a turn makes a head wind of a tail wind. Left as they were, both
    were explained by an attitude that leans, 2 degrees at 4 m/s of wind.
    """
    G, turn = np.eye(States.SIZE), level_axes(by_rad)
    for each in (*_LEVEL_VECTORS, *_PLACES_BEFORE):
        G[each, each] = turn
    for each in _PLACES_BEFORE:
        G[each, States.POSITION_NE] = np.eye(2) - turn
    return state._replace(x=G @ state.x, P=G @ state.P @ G.T)


def height_opened(state: FilterState, off_m: float) -> FilterState:
    """Height and barometer, together, may be wrong by so much more: now and at the keyframe."""
    G = np.zeros(States.SIZE)
    G[[States.DOWN, States.ANCHOR_DOWN, States.BARO]] = off_m
    G[States.EXPOSED_AGL] = -off_m
    return state._replace(P=state.P + np.outer(G, G))


def motion_opened(state: FilterState, span_s: float, config: EkfConfig) -> FilterState:
    """What an aircraft may do in a time in which no image tells its way, beyond the usual.

    The usual acceleration is that of a steady flight: what hides the way may be what the aircraft
    does, and a turn within seconds changes a velocity by twice itself.
    """
    P = state.P.copy()
    level, vertical = config.lost_noise_m_s2**2, config.lost_climb_noise_m_s2**2
    P[States.MOTION, States.MOTION] += white_acceleration(level, vertical, span_s)
    return state._replace(P=P)


def range_doubted(state: FilterState, drawn_m: float = 0.0) -> FilterState:
    """Do not believe the rangefinder until it has agreed for a while.

    Height and barometer are as unsure, together, as by what it may have drawn them.
    """
    drawn_m = min(drawn_m, BAROMETER_OFF_M)
    trust = state.range_trust.lost(state.t_s, drawn_m)
    return height_opened(state, drawn_m)._replace(range_trust=trust)


def remember(
    rejected: RejectedInnovations,
    t_s: float,
    measurement: Measurement,
    window_s: float,
    least: int = 0,
) -> RejectedInnovations:
    """The rejected innovations of the last `window_s`, with that of a measurement at the end.

    `least` of them however old they are: what is found seldom must be able to agree, too.
    """
    newest = RejectedInnovation(t_s, measurement.residual, measurement.R)
    recent = sum(before.t_s >= t_s - window_s for before in rejected)
    return (*rejected, newest)[-min(max(recent, least) + 1, _MOST_REMEMBERED) :]


def seen_from(
    rejected: RejectedInnovations, before: FilterState, after: FilterState, by: Measurement
) -> RejectedInnovations:
    """The same innovations about a state that has been moved, by a measurement, to another one."""
    moved = by.H @ (after.x - before.x)
    return tuple(replace(each, residual=each.residual - moved) for each in rejected)


def by_half(
    state: FilterState,
    half: FilterState,
    measurement: Measurement,
    before: RejectedInnovations,
    t_s: float,
    drift_per_s: float,
) -> tuple[FilterState, RejectedInnovations]:
    """What a lone fix has told by half, or all of it where the one before it says the same.

    The prediction may have drifted from one to the other, but by no more than both are unsure:
    after an outage anything would agree, and one wrong fix was believed whole, 28 sigmas off.
    Its innovation is handed back, as it is then, for the next one to meet.
    """
    newest = RejectedInnovation(t_s, measurement.residual, measurement.R)
    twice = any(_agree(each, newest, drift_per_s, capped=True) for each in before[-1:])
    after = correct(state, measurement) if twice else half
    return after, seen_from((newest,), state, after, measurement)


def agreeing(
    rejected: RejectedInnovations, drift_per_s: float, window_s: float = math.inf
) -> RejectedInnovations:
    """Those of the last `window_s` that want the same change as the newest one, itself included.

    Two agree when their residuals differ by no more than their covariances, and the drift that the
    prediction may have made between them, explain at 99.9 %.
    """
    newest = rejected[-1]
    recent = (each for each in rejected if each.t_s >= newest.t_s - window_s)
    return tuple(each for each in recent if _agree(each, newest, drift_per_s))


def _agree(
    before: RejectedInnovation,
    newest: RejectedInnovation,
    drift_per_s: float,
    capped: bool = False,
) -> bool:
    """Whether two want the same; `capped`: drift explains no more than they are unsure by."""
    apart, spread = newest.residual - before.residual, before.covariance + newest.covariance
    drift2 = (drift_per_s * min(newest.t_s - before.t_s, _DRIFTS_S)) ** 2
    if capped:
        drift2 = min(drift2, float(np.trace(spread)) / len(apart))
    spread = spread + drift2 * np.eye(len(apart))
    return bool(apart @ np.linalg.solve(spread, apart) <= CHI_SQUARE_GATE[len(apart)])


def convinces(rejected: RejectedInnovations, drift_per_s: float, count: int, span_s: float) -> bool:
    """Whether at least `count` over at least `span_s` agree, and at most a third does not."""
    same = agreeing(rejected, drift_per_s)
    recent = sum(each.t_s >= same[0].t_s for each in rejected)
    return (
        len(same) >= count
        and same[-1].t_s - same[0].t_s >= span_s
        and len(same) >= 2.0 / 3.0 * recent
    )


def is_told(state: FilterState) -> bool:
    """Whether nothing but a person's word says the place: no fix was believed yet."""
    return state.t_last_fix_s is None and state.trusted is not None and state.trusted.by_person


def relocates(state: FilterState, config: EkfConfig) -> bool:
    """Whether refused fixes agree enough to jump to them: a few do, over a person's word."""
    count, span_s = config.relocation_fixes, config.relocation_span_s
    if is_told(state):
        count, span_s = config.offset_count, config.offset_span_s
    return convinces(state.rejected_fixes, config.relocation_drift_m_s, count, span_s)


def leaning(state: FilterState, measurement: Measurement, sigma_m: float) -> FilterState:
    """A long pull that nothing confirms yet: believed as far as wrong ones usually are wrong.

    A filter that knows its place to 300 m only is better off with it, and one that knows it to 5 m
    is hardly moved.
    """
    doubted = measurement.R + sigma_m**2 * np.eye(2)
    return correct(state, replace(measurement, R=doubted))


def moved_along(state: FilterState, measurement: Measurement, jump: Array) -> FilterState:
    """The measured states, and those tied to them, move so that the measurement fits.

    `jump` (n, m) says which states move with the residual. The new error is e' = G e + jump v with
    G = I - jump H: what was known of the measured states' own error is forgotten.
    """
    G = np.eye(States.SIZE) - jump @ measurement.H
    P = G @ state.P @ G.T + jump @ measurement.R @ jump.T
    return state._replace(x=state.x + jump @ measurement.residual, P=0.5 * (P + P.T))


def relocated(state: FilterState, measurement: Measurement) -> FilterState:
    """Horizontal position from a fix alone; all that is known relative to it is kept.

    The keyframe moves along, so displacements measured from it stay good.
    """
    jump = np.zeros((States.SIZE, 2))
    jump[States.POSITION_NE] = jump[States.ANCHOR_NE] = jump[States.EXPOSED_POSITION] = np.eye(2)
    after, counter = moved_along(state, measurement, jump), state.reset_counter + 1
    return after._replace(position_known=True, reset_counter=counter, rejected_fixes=())


def learned_of_map(state: FilterState, config: EkfConfig) -> FilterState:
    """With what a fused fix shows of the map's size of error."""
    known, variance_m2 = state.map_error, np.diag(state.P)[States.MAP]
    here = state.x[States.POSITION_NE], state.x[States.MAP], variance_m2
    return _with_map_error(state, known.seen(*here, config.map_sigma_m, config.map_length_m))


def map_stepped(state: FilterState, by_m: float) -> FilterState:
    """At the seam between two pieces of a map, each off by an error of its own.

    Of that of the piece that begins nothing is known yet, and the one before was off by as much:
    the two differ by sqrt(2) times the size of one.
    """
    after = _with_map_error(state, state.map_error.stepped(by_m / math.sqrt(2.0)))
    P, x = after.P.copy(), after.x.copy()
    x[States.MAP] = 0.0
    P[States.MAP] = 0.0
    P[:, States.MAP] = 0.0
    P[States.MAP, States.MAP] = after.map_error.sigma_m**2 * np.eye(2)
    return after._replace(x=x, P=P, rejected_fixes=())


def _with_map_error(state: FilterState, found: LearnedMapError) -> FilterState:
    """With another size of the map's error.

    By as much as that is more than it was ever taken for, the place that fixes have told is open,
    too: the other way, because together they were seen right.
    """
    more_m2 = found.opened_m**2 - state.map_error.opened_m**2
    G = np.zeros((States.SIZE, 2))
    G[States.POSITION_NE] = G[States.ANCHOR_NE] = G[States.EXPOSED_POSITION] = np.eye(2)
    G[States.MAP] = -np.eye(2)
    return state._replace(P=state.P + more_m2 * G @ G.T, map_error=found)
