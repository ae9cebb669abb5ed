"""Measurements of pictures as they are when the filter, not the autopilot, tells their attitude.

Where an attitude is late or lost the filter carries the last one on, and a picture is rectified
with that: what it tells leans by the error of that attitude, not by the autopilot's.
"""

import math
from dataclasses import replace

import numpy as np

from vwnav.bench.estimator.streams import MeasurementStream
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.inputs import Measurement
from vwnav.estimation.timeline import NedFix
from vwnav.geometry.rotations import rotation_from_quat, vector_from_rotation
from vwnav.types import Array, OdometryMotion

_SAME_RAD = math.radians(0.25)  # what interpolation between noisy attitudes makes of them


def rectified(seen: Measurement, ekf: Ekf, stream: MeasurementStream) -> Measurement:
    """`seen` in a stream that knows its autopilot's attitudes; anything else as it is."""
    if stream.measured_quats is None:
        return seen
    if isinstance(seen, NedFix) and np.all(np.isfinite(seen.position_ne_m)):
        turn = _turn(seen.t_s, ekf, stream)
        if turn is not None:
            agl_m = float(stream.truth.agl_m[stream.truth.index(seen.t_s)])
            return replace(seen, position_ne_m=seen.position_ne_m + agl_m * _shift(turn))
    if isinstance(seen, OdometryMotion):
        turn0, turn1 = (_turn(t_s, ekf, stream) for t_s in (seen.t0_s, seen.t1_s))
        if turn0 is not None or turn1 is not None:
            zero, one = (np.zeros(3) if turn is None else turn for turn in (turn0, turn1))
            way = seen.displacement_ned_m + np.cross(zero, seen.displacement_ned_m)
            way[:2] += seen.tilt_share * seen.agl_m * (_shift(one) - _shift(zero))
            return replace(seen, displacement_ned_m=way)
    return seen


def _turn(t_s: float, ekf: Ekf, stream: MeasurementStream) -> Array | None:
    """(3,) NED rotation vector from the autopilot's attitude to that of the filter."""
    known = ekf.attitude_at(t_s)
    if known is None or stream.measured_quats is None:
        return None
    R_measured = rotation_from_quat(stream.measured_quats[stream.truth.index(t_s)])
    turn = vector_from_rotation(rotation_from_quat(known.quat_wxyz) @ R_measured.T)
    return turn if float(np.linalg.norm(turn)) > _SAME_RAD else None


def _shift(turn: Array) -> Array:
    """(2,) by how much the ground point that seems to be below moves, per AGL."""
    return np.array([-turn[1], turn[0]])
