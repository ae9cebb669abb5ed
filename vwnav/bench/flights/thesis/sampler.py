"""Notes a flight test in lockstep, ten times a second."""

import math

import numpy as np

from vwnav.bench.flights.thesis.samples import SAMPLE_S, Sample
from vwnav.bench.flights.world import World
from vwnav.geometry.rotations import euler_from_rotation, rotation_from_quat
from vwnav.types import Array


class Sampler:
    """Notes a flight in lockstep; to be called at every step."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self._due_s = 0.0

    def __call__(self, world: World) -> None:
        """Take a sample when one is due."""
        if world.t_s >= self._due_s:
            self._due_s += SAMPLE_S
            self.samples.append(sample_of(world))


def sample_of(world: World) -> Sample:
    """What all of them know now, in lockstep."""
    vehicle, flight = world.core.vehicle, world.navigator.flight
    body, own = vehicle.body, vehicle.estimator
    estimate = world.navigator.runtime.navigation.estimate
    setpoint, nothing = flight.setpoint, np.full(3, math.nan)
    believed = nothing if estimate is None else estimate.position_ned_m
    stands_n_m, stands_e_m = world.setup.stands_ne_m
    commanded = None if setpoint is None else setpoint.yaw_rad
    true_quat = np.array([body.qw, body.qx, body.qy, body.qz])
    return Sample(
        t_s=world.t_s,
        mode=vehicle.flight_mode.name,
        phase=flight.phase.value,
        true_north_m=body.n,
        true_east_m=body.e,
        true_up_m=-body.d,
        true_yaw_deg=_yaw_deg(true_quat),
        estimated_north_m=float(believed[0]) - stands_n_m,
        estimated_east_m=float(believed[1]) - stands_e_m,
        estimated_up_m=-float(believed[2]),
        estimated_yaw_deg=math.nan if estimate is None else _yaw_deg(estimate.quat_wxyz),
        fused_north_m=own.north.x,
        fused_east_m=own.east.x,
        fused_up_m=-own.down.x,
        fused_yaw_deg=math.degrees(own.attitude.yaw_rad),
        barometer_up_m=vehicle.baro_height_m,
        commanded_yaw_deg=math.nan if commanded is None else math.degrees(commanded),
    )


def _yaw_deg(quat_wxyz: Array) -> float:
    return math.degrees(euler_from_rotation(rotation_from_quat(quat_wxyz))[2])
