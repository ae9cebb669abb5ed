"""Flights over generated sites: where they go, what the autopilot says, what the camera sees.

The attitudes and heights are those of the fast benchmark (`streams`), the ground is the
renderer's: level, so the height above it is the height above home.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vwnav.bench.estimator.streams import MeasurementEvent, sense
from vwnav.bench.estimator.world import DT_S, FilterWorld, TrueTrajectory, fly
from vwnav.geometry.camera import Camera
from vwnav.geometry.rotations import rotation_from_quat, vector_from_rotation
from vwnav.sim.camera_source import FRAME_HZ
from vwnav.sim.lens import RenderConfig
from vwnav.sim.named_sites import tiles_folder
from vwnav.sim.renderer import CameraRenderer
from vwnav.sim.site import FIRST_TRAINING_SEED, Site
from vwnav.types import Array, Attitude, Frame, Height, ImuSample

RENDERED_S = 130.0
_HEIGHTS_M = (40.0, 90.0)
_CLIMB_M_S = 4.0  # autopilots climb with 1.5 to 5
_SLOWING_S = 2.0  # at the end of the climb
_HOVER_S = 5.0  # after it, as `world` has it
_LEG_S = 20.0
_HALF_NORTH_M, _HALF_EAST_M = 380.0, 550.0  # what the camera sees from there is on the map
_DRAWS = 50  # of the next turn, until one stays inside


@dataclass(frozen=True, slots=True, eq=False)
class RenderedFlight:
    """One flight before it is navigated.

    Attributes:
        truth: to draw the images and to score; nothing else may see it.
        telemetry: attitudes, barometric heights and IMU samples in order of arrival.
        measured_yaw_rad: (n,) heading as the autopilot has it, at the truth's times.
        latencies: draws of how late fixes are.
    """

    site: Site
    world: FilterWorld
    truth: TrueTrajectory
    telemetry: list[MeasurementEvent]
    measured_yaw_rad: Array
    latencies: np.random.Generator
    noise: np.random.Generator


def site_seed(number: int) -> int:
    """The site of the flight of that number, from 0: another one for each."""
    return 1 + number % (FIRST_TRAINING_SEED - 1)


def plan_flight(number: int, seed: int, seconds: float, imu_hz: float = 0.0) -> RenderedFlight:
    """Flight `number` of a seed, over a site of its own; the same however many are flown."""
    legs, rng, latencies, noise = (np.random.default_rng([seed, number, part]) for part in range(4))
    height_m = float(legs.uniform(*_HEIGHTS_M))
    climb_s = height_m / _CLIMB_M_S + _SLOWING_S
    world = FilterWorld(
        seconds=seconds, height_m=height_m, climb_s=climb_s, relief_m=0.0, imu_hz=imu_hz
    )
    world = replace(world, headings_deg=_legs(legs, world))
    truth = fly(world, [rng])[0]
    stream = sense(world, truth, rng)
    kinds = Attitude | Height | ImuSample
    told = [event for event in stream.events if isinstance(event.seen, kinds)]
    return RenderedFlight(
        Site(site_seed(number)), world, truth, told, stream.measured_yaw_rad, latencies, noise
    )


def _legs(rng: np.random.Generator, world: FilterWorld) -> tuple[tuple[float, float], ...]:
    """(time, heading in degrees) of legs that stay over the site, with turns of 60 to 180."""
    heading_deg = float(rng.uniform(-180.0, 180.0))
    place = np.zeros(2)
    legs = [(0.0, heading_deg)]
    length_m, start_s = _LEG_S * world.speed_m_s, world.climb_s + _HOVER_S
    place += _way(heading_deg, length_m)
    for number in range(1, max(math.ceil((world.seconds - start_s) / _LEG_S), 1)):
        turns = rng.uniform(60.0, 180.0, _DRAWS) * rng.choice([-1.0, 1.0], _DRAWS)
        ends = [place + _way(heading_deg + turn, length_m) for turn in turns]
        outside = [max(abs(n) / _HALF_NORTH_M, abs(e) / _HALF_EAST_M, 1.0) for n, e in ends]
        chosen = int(np.argmin(outside))  # the first of those that are inside
        heading_deg, place = heading_deg + float(turns[chosen]), ends[chosen]
        legs.append((start_s + number * _LEG_S, heading_deg))
    return tuple(legs)


def _way(heading_deg: float, length_m: float) -> Array:
    angle = math.radians(heading_deg)
    return length_m * np.array([math.cos(angle), math.sin(angle)])


def exposures(truth: TrueTrajectory) -> NDArray[np.int64]:
    """Indices of the truth's samples at which the camera takes an image."""
    times_s = np.arange(0.0, float(truth.t_s[-1]), 1.0 / FRAME_HZ)
    return np.round(times_s / DT_S).astype(np.int64)


def images(flight: RenderedFlight, camera: Camera) -> Iterator[Frame]:
    """What the camera sees, drawn from the truth image by image."""
    config = RenderConfig(color=False, background=False)
    renderer = CameraRenderer(flight.site, camera, config, flight.noise, tiles_folder(flight.site))
    truth = flight.truth
    for number, i in enumerate(exposures(truth).tolist()):
        R_ned_body = rotation_from_quat(truth.quat_wxyz[i])
        after = rotation_from_quat(truth.quat_wxyz[min(i + 1, len(truth.t_s) - 1)])
        t_s = float(truth.t_s[i])
        image = renderer.render(
            truth.position_ned_m[i],
            R_ned_body,
            t_s,
            truth.velocity_ned_m_s[i],
            vector_from_rotation(R_ned_body.T @ after) / DT_S,
        )
        yield Frame(t_s, image, number)
