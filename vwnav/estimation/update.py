"""An event meets the state: predicted to the event's time, then corrected by what it says."""

from dataclasses import replace

import numpy as np

from vwnav.estimation.context import Context
from vwnav.estimation.fixes import apply_exposure, apply_fix, apply_late_fix
from vwnav.estimation.heights import apply_height, apply_range, apply_stationary
from vwnav.estimation.inertial.drag import apply_drag
from vwnav.estimation.kalman import Innovation, Verdict
from vwnav.estimation.odometry import (
    apply_displacement,
    apply_keyframe,
    apply_misled,
    apply_untracked,
)
from vwnav.estimation.process import predict
from vwnav.estimation.states import FilterState, States
from vwnav.estimation.timeline import (
    Displacement,
    Drag,
    Event,
    Exposed,
    LateFix,
    Misled,
    NedFix,
    NewKeyframe,
    Untracked,
)
from vwnav.types import Height, Range, Stationary


def apply(state: FilterState, event: Event, context: Context) -> tuple[FilterState, Innovation]:
    """Predict to an event's time, which is not before the state's, then correct by what it says."""
    if event.t_s > state.t_s:
        state = predict(state, event.t_s, context)
    after, innovation = _corrected(state, event, context)
    apart_m = float(np.linalg.norm((after.x - state.x)[States.POSITION]))
    if apart_m > context.config.jump_m and after.reset_counter == state.reset_counter:
        after = replace(after, reset_counter=state.reset_counter + 1)
    return after, innovation


def _corrected(
    state: FilterState, event: Event, context: Context
) -> tuple[FilterState, Innovation]:
    """A state by an event of its own time."""
    attitudes, config = context.attitudes, context.config
    match event:
        case NedFix():
            return apply_fix(state, event, context)
        case Displacement(_, motion):
            return apply_displacement(state, motion, context)
        case LateFix(_, fix):
            return apply_late_fix(state, fix, context)
        case Exposed():
            return apply_exposure(state, attitudes), Innovation(Verdict.FUSED)
        case Untracked():
            return apply_untracked(state, config), Innovation(Verdict.FUSED)
        case Misled():
            return apply_misled(state, event, config), Innovation(Verdict.FUSED)
        case NewKeyframe():
            return apply_keyframe(state, event, attitudes), Innovation(Verdict.FUSED)
        case Height():
            return apply_height(state, event, config)
        case Range():
            return apply_range(state, event, attitudes, config)
        case Drag():
            return apply_drag(state, context)
        case Stationary():
            return apply_stationary(state, context)
