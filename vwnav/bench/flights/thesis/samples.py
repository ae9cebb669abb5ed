"""What is noted of a flight test ten times a second, wherever it is flown."""

import csv
import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np

from vwnav.bench.flights.world import World
from vwnav.geometry.rotations import euler_from_rotation, rotation_from_quat
from vwnav.types import Array

SAMPLE_S = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """A moment; places in metres north, east and up of where the aircraft stood, headings true.

    Values that nobody knows are NaN.

    Attributes:
        t_s: since the program began.
        true: of the simulator; `estimated` by vwnav; `fused` by the autopilot, whose position is
            made of our estimates and its barometer.
        barometer_up_m: the pressure's height.
        commanded_yaw_deg: of the setpoint.
    """

    t_s: float
    mode: str
    phase: str
    true_north_m: float
    true_east_m: float
    true_up_m: float
    true_yaw_deg: float
    estimated_north_m: float
    estimated_east_m: float
    estimated_up_m: float
    estimated_yaw_deg: float
    fused_north_m: float
    fused_east_m: float
    fused_up_m: float
    fused_yaw_deg: float
    barometer_up_m: float
    commanded_yaw_deg: float


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


def write_csv(samples: Sequence[Sample], path: Path) -> None:
    """One row a sample; what nobody knows is empty."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(field.name for field in fields(Sample))
        writer.writerows(map(_cells, samples))


def columns(samples: Sequence[Sample], *names: str) -> Array:
    """(n, k) of the named values."""
    return np.array([[getattr(each, name) for name in names] for each in samples], np.float64)


def _cells(sample: Sample) -> list[str]:
    return [
        value if isinstance(value, str) else "" if math.isnan(value) else f"{value:.3f}"
        for value in astuple(sample)
    ]


def _yaw_deg(quat_wxyz: Array) -> float:
    return math.degrees(euler_from_rotation(rotation_from_quat(quat_wxyz))[2])
