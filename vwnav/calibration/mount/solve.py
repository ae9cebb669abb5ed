"""Solves the mount, and says how sure each number is."""

from dataclasses import dataclass, replace

import numpy as np

from vwnav.calibration.mount.history import FlownAttitudes
from vwnav.calibration.mount.problem import (
    FOCAL,
    HEIGHT,
    OFFSET,
    READOUT,
    SHARED,
    MountProblem,
    Sighting,
    Unknowns,
    Weights,
    cauchy,
    tukey,
)
from vwnav.geometry.camera import MAX_READOUT_S, Camera
from vwnav.geometry.rotations import rotation_from_vector, vector_from_rotation
from vwnav.types import Array

START_OFFSETS_S = (0.0, -0.15, 0.15, -0.3, 0.3)
FIRST_SIGMA_PX, LEAST_SIGMA_PX = 2.0, 0.2
BLOCKS = 8  # each left out once, for sigmas that no model makes
STEPS, FEW_STEPS = 15, 4
START_IMAGES = 40
STILL = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class MountFit:
    """What a flight tells.

    Attributes:
        R_body_camera: (3, 3) against what the autopilot called level, on average over the flight.
        sigmas_rad: (3,) of it, about the body's axes: roll, pitch, yaw.
        sigma_px: of a matched point.
        images: that told it.
    """

    R_body_camera: Array
    sigmas_rad: Array
    offset_s: float
    sigma_offset_s: float
    readout_s: float
    sigma_readout_s: float
    focal_ratio: float
    sigma_focal_ratio: float
    sigma_px: float
    images: int


def fit_mount(
    camera: Camera, history: FlownAttitudes, sightings: list[Sighting], focal: bool
) -> MountFit:
    """The mount, time offset and read-out, and the focal length if it is asked.

    The sigmas are those of the model, or those that leaving out parts of the flight gives, if
    these are larger.
    """
    free = np.ones(SHARED)
    if not focal:
        free[[FOCAL, HEIGHT]] = 0.0
    held = free.copy()
    held[[READOUT, FOCAL, HEIGHT]] = 0.0
    few = sightings[:: max(1, len(sightings) // START_IMAGES)]
    begun = [(_left_over(camera, history, few, each, held), each) for each in START_OFFSETS_S]
    start = _start(camera, sightings, min(begun)[1])
    problem = MountProblem(camera, history, sightings, start)
    at, sigma_px = _converge(problem, start, FIRST_SIGMA_PX, free, STEPS, cauchy)
    at, sigma_px = _converge(problem, at, sigma_px, free, FEW_STEPS, tukey)
    found = _summary(problem, at)
    equations = problem.equations(at, sigma_px, free, tukey)
    covariance = np.linalg.inv(equations.information)
    rows = np.zeros((6, len(covariance)))
    rows[:3] = at.R_body_camera @ problem.mean_tilt(at)
    rows[3, OFFSET], rows[4, READOUT], rows[5, FOCAL] = 1.0, 1.0, float(focal)
    modelled = np.einsum("ij,jk,ik->i", rows, covariance, rows)
    sigmas = np.sqrt(np.maximum(modelled, _jackknife(problem, at, sigma_px, free, found)))
    R = rotation_from_vector(found[:3]) @ camera.R_body_camera
    return MountFit(
        R_body_camera=R,
        sigmas_rad=sigmas[:3],
        offset_s=float(found[3]),
        sigma_offset_s=float(sigmas[3]),
        readout_s=float(np.clip(found[4], 0.0, MAX_READOUT_S)),
        sigma_readout_s=float(sigmas[4]),
        focal_ratio=float(np.exp(found[5])),
        sigma_focal_ratio=float(sigmas[5]),
        sigma_px=sigma_px,
        images=len(sightings),
    )


def _start(camera: Camera, sightings: list[Sighting], offset_s: float) -> Unknowns:
    """As the calibration has it, with a time offset."""
    return Unknowns(
        R_body_camera=camera.R_body_camera,
        offset_s=offset_s,
        readout_s=camera.readout_s or 0.0,
        log_focal=0.0,
        height_bias_m=0.0,
        tilts_rad=np.zeros((len(sightings), 3)),
        places_ned_m=np.stack([each.place_ned_m for each in sightings]),
    )


def _left_over(
    camera: Camera,
    history: FlownAttitudes,
    sightings: list[Sighting],
    offset_s: float,
    free: Array,
) -> float:
    """The cost after a few steps from a time offset: it alone has more than one minimum."""
    start = _start(camera, sightings, offset_s)
    problem = MountProblem(camera, history, sightings, start)
    at, _ = _converge(problem, start, FIRST_SIGMA_PX, free, FEW_STEPS, cauchy)
    return problem.equations(at, FIRST_SIGMA_PX, free, cauchy).cost


def _converge(
    problem: MountProblem,
    at: Unknowns,
    sigma_px: float,
    free: Array,
    steps: int,
    weights: Weights,
) -> tuple[Unknowns, float]:
    """Gauss-Newton; the sigma of a point comes from the errors as they are."""
    for _ in range(steps):
        equations = problem.equations(at, sigma_px, free, weights)
        step = np.asarray(np.linalg.solve(equations.information, equations.gradient), np.float64)
        at = at.moved(step)
        # Of a normal distribution in the plane the median distance is 1.177 sigma.
        apart = np.linalg.norm(equations.errors_px, axis=1)
        sigma_px = max(float(np.median(apart)) / 1.177, LEAST_SIGMA_PX)
        if np.abs(step[:SHARED]).max() < STILL:
            break
    return at, sigma_px


def _summary(problem: MountProblem, at: Unknowns) -> Array:
    """(6,): the mount's change about the body's axes, offset, read-out, log of the focal ratio."""
    linear = problem.mean_tilt(at)
    leaning = at.R_body_camera @ linear[:, SHARED : SHARED + at.tilts_rad.size]
    mean = rotation_from_vector(leaning @ at.tilts_rad.ravel())
    turned = vector_from_rotation(mean @ at.R_body_camera @ problem.camera.R_body_camera.T)
    return np.array([*turned, at.offset_s, at.readout_s, at.log_focal])


def _jackknife(
    problem: MountProblem, at: Unknowns, sigma_px: float, free: Array, found: Array
) -> Array:
    """Variances (6,) by leaving out one stretch of the flight after the other."""
    n = len(problem.sightings)
    apart = []
    for left_out in np.array_split(np.arange(n), BLOCKS):
        kept = np.setdiff1d(np.arange(n), left_out)
        if len(left_out) == 0 or len(kept) < 3:
            continue
        start = replace(at, tilts_rad=at.tilts_rad[kept], places_ned_m=at.places_ned_m[kept])
        part = MountProblem(
            problem.camera, problem.history, [problem.sightings[i] for i in kept], start
        )
        solved, _ = _converge(part, start, sigma_px, free, FEW_STEPS, tukey)
        apart.append(_summary(part, solved) - found)
    blocks = len(apart)
    return np.asarray((blocks - 1.0) / blocks * np.sum(np.square(apart), axis=0))
