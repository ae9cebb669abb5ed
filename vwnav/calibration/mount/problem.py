"""The least squares of the mount: what is unknown, what was seen, and how the two are related.

A point of the map at P is seen in row v of an image that is stamped t at

    X = R_body_camera^T R_ned_body(t + d + r rho)^T Exp(e)^T (P - p - r rho w),  rho = v / h - 1/2

with the time offset d, the read-out r, the camera's place p and velocity w, and the error e of the
autopilot's attitude, which wanders from image to image. Another focal length scales what is
seen after the distortion is removed: a lens whose focus moved bends the same pixels alike, and what
its distortion was calibrated to must not pass for knowledge of its focal length.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vwnav.calibration.mount.history import (
    FlownAttitudes,
    cross_matrices,
    rotations_from_vectors,
)
from vwnav.geometry.camera import Camera
from vwnav.geometry.rotations import rotation_from_vector
from vwnav.types import Array

# The unknowns that all images share. The mount's rotation vector is about the camera's axes.
MOUNT, OFFSET, READOUT, FOCAL, HEIGHT = slice(0, 3), 3, 4, 5, 6
SHARED: Final = 7
# Weak knowledge, so that what a flight does not tell has a large sigma instead of none.
PRIOR_SIGMAS = np.array([1.0, 1.0, 1.0, 1.0, 0.1, 0.3, 0.1])  # rad, s, s, log, m of the height
SIGMA_TILT_RAD, TILT_S = np.radians(0.6), 20.0  # of the autopilot's level, wandering
CARRIED = 0.5  # of its variance: what belongs to the sensors and turns with the nose
SIGMA_HEADING_RAD = np.radians(10.0)  # of its compass, for good
HEADING_WALK_RAD = np.radians(0.08)  # of its compass, per root second
SIGMA_JITTER_RAD = np.radians(0.07)  # of an image's own: vibration
CAUCHY_SIGMAS, TUKEY_SIGMAS = 2.5, 4.685  # 95 % efficiency for normal errors
SIGMA_HEIGHT_M, SIGMA_HEIGHT_RATIO = 0.1, 0.01


Weights = Callable[[Array], Array]
# What is known otherwise: columns, derivatives by them, and the residual, in sigmas.
Known = tuple[tuple[NDArray[np.int64], Array], float]


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """Points of the map that one image shows.

    Attributes:
        t_s: the image's stamp.
        uv: (n, 2) their pixels in the image as it was taken.
        ground_ned_m: (n, 3) where they are.
        independent: of them; neighbours err alike.
        place_ned_m: (3,) of the camera, roughly.
        height_m: of the camera above level ground, by a rangefinder; NaN where there is none.
    """

    t_s: float
    uv: Array
    ground_ned_m: Array
    independent: int
    place_ned_m: Array
    height_m: float = float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Values of all that is sought.

    Attributes:
        R_body_camera: (3, 3). log_focal: of the true focal length over the calibrated one.
        height_bias_m: of the rangefinder.
        tilts_rad: (n, 3) errors of the attitude, about north, east and down.
        places_ned_m: (n, 3) of the camera.
    """

    R_body_camera: Array
    offset_s: float
    readout_s: float
    log_focal: float
    height_bias_m: float
    tilts_rad: Array
    places_ned_m: Array

    def moved(self, step: Array) -> "Unknowns":
        """After a step (7 + 6 n,): shared ones, tilts, places."""
        n = len(self.tilts_rad)
        tilts, places = step[SHARED : SHARED + 3 * n], step[SHARED + 3 * n :]
        return replace(
            self,
            R_body_camera=self.R_body_camera @ rotation_from_vector(step[MOUNT]),
            offset_s=self.offset_s + float(step[OFFSET]),
            readout_s=self.readout_s + float(step[READOUT]),
            log_focal=self.log_focal + float(step[FOCAL]),
            height_bias_m=self.height_bias_m + float(step[HEIGHT]),
            tilts_rad=self.tilts_rad + tilts.reshape(n, 3),
            places_ned_m=self.places_ned_m + places.reshape(n, 3),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """Normal equations at some values: the step solves information @ step = gradient."""

    information: Array
    gradient: Array
    cost: float
    errors_px: Array


class MountProblem:
    """What one flight tells of one camera."""

    def __init__(
        self, camera: Camera, history: FlownAttitudes, sightings: list[Sighting], start: Unknowns
    ) -> None:
        self.camera, self.history, self.sightings = camera, history, sightings
        self._of = np.repeat(np.arange(len(sightings)), [len(s.uv) for s in sightings])
        self._ends = np.concatenate([[0], np.cumsum([len(s.uv) for s in sightings])])
        self._t_s = np.array([s.t_s for s in sightings])
        self._uv = np.concatenate([s.uv for s in sightings])
        self._ground = np.concatenate([s.ground_ned_m for s in sightings])
        self._rho = (self._uv[:, 1] + 0.5) / camera.height_px - 0.5
        share = np.array([min(1.0, s.independent / len(s.uv)) for s in sightings])
        self._share = share[self._of]
        self._heights = np.array([s.height_m for s in sightings])
        R = history.at(self._t_s + start.offset_s).R_ned_body
        headings_rad = np.arctan2(R[:, 1, 0], R[:, 0, 0])
        self._tilt_information = np.linalg.inv(tilt_covariance(self._t_s, headings_rad))
        rays = camera.bearings(self._uv)
        self._seen_px = camera.K[0, 0] * rays[:, :2] / rays[:, 2:]  # without distortion

    def equations(self, at: Unknowns, sigma_px: float, free: Array, weights: Weights) -> Equations:
        """Linearised at some values.

        Args:
            at: the values.
            sigma_px: of a point, per axis.
            free: (7,) which of the shared unknowns may move.
            weights: of errors in sigmas, `cauchy` or `tukey`.
        """
        n = len(self.sightings)
        errors_px, J_shared, J_tilt, J_place = self._points(at)
        weight = self._share * weights(np.linalg.norm(errors_px, axis=1) / sigma_px) / sigma_px**2
        J_shared = J_shared * free
        information = np.zeros((SHARED + 6 * n, SHARED + 6 * n))
        gradient = np.zeros(SHARED + 6 * n)
        for i in range(n):
            rows = slice(self._ends[i], self._ends[i + 1])
            J = np.concatenate([J_shared[rows], J_tilt[rows], J_place[rows]], axis=2)
            J = J.reshape(-1, SHARED + 6)
            w = np.repeat(weight[rows], 2)
            where = self._columns(i)
            information[np.ix_(where, where)] += J.T @ (w[:, None] * J)
            gradient[where] -= J.T @ (w * errors_px[rows].ravel())
        cost = float(np.sum(weight[:, None] * errors_px**2))
        tilts, known = slice(SHARED, SHARED + 3 * n), self._tilt_information
        information[tilts, tilts] += known
        gradient[tilts] -= known @ at.tilts_rad.ravel()
        cost += float(at.tilts_rad.ravel() @ known @ at.tilts_rad.ravel())
        for rows_, residual in self._known(at):
            columns, values = rows_
            information[np.ix_(columns, columns)] += np.outer(values, values)
            gradient[columns] -= values * residual
            cost += residual**2
        fixed = np.flatnonzero(~free.astype(bool))
        information[fixed, :] = information[:, fixed] = 0.0
        information[fixed, fixed] = 1.0
        gradient[fixed] = 0.0
        return Equations(information, gradient, cost, errors_px)

    def mean_tilt(self, at: Unknowns) -> Array:
        """(3, 7 + 6 n): the mount as the flight had it on average, linear in a step.

        What the autopilot calls level wanders; its mean over the flight belongs to the mount.
        """
        n = len(self.sightings)
        R = self.history.at(self._t_s + at.offset_s).R_ned_body
        found = np.zeros((3, SHARED + 6 * n))
        found[:, MOUNT] = np.eye(3)
        for i in range(n):
            leaning = at.R_body_camera.T @ R[i].T @ np.diag([1.0, 1.0, 0.0])
            found[:, SHARED + 3 * i : SHARED + 3 * i + 3] = leaning / n
        return found

    def _columns(self, i: int) -> NDArray[np.int64]:
        n = len(self.sightings)
        tilt, place = SHARED + 3 * i, SHARED + 3 * n + 3 * i
        columns = [*range(SHARED), *range(tilt, tilt + 3), *range(place, place + 3)]
        return np.array(columns, np.int64)

    def _points(self, at: Unknowns) -> tuple[Array, Array, Array, Array]:
        """Errors (m, 2) in pixels and their derivatives (m, 2, 7), (m, 2, 3), (m, 2, 3)."""
        of, rho, f_px = self._of, self._rho, float(self.camera.K[0, 0])
        velocity = _velocities(self._t_s, at.places_ned_m)[of]
        turned = self.history.at(self._t_s[of] + at.offset_s + at.readout_s * rho)
        to_body = np.swapaxes(turned.R_ned_body, 1, 2)
        away = self._ground - at.places_ned_m[of] - (at.readout_s * rho)[:, None] * velocity
        unleaned = np.swapaxes(rotations_from_vectors(at.tilts_rad), 1, 2)[of]
        level = np.einsum("kij,kj->ki", unleaned, away)
        in_body = np.einsum("kij,kj->ki", to_body, level)
        X = in_body @ at.R_body_camera
        to_camera = at.R_body_camera.T @ to_body
        later = -np.cross(turned.rates_rad_s, in_body) @ at.R_body_camera
        moved = np.einsum("kij,kj->ki", to_camera, velocity)
        # Pixels, not angles: the latter shrink, and their noise too, as the focal length grows.
        f_px *= float(np.exp(at.log_focal))
        onto, expected_px = _projection_derivative(X) * f_px, f_px * X[:, :2] / X[:, 2:]
        shared = np.zeros((len(X), 2, SHARED))
        shared[..., MOUNT] = onto @ cross_matrices(X)
        shared[..., OFFSET] = np.einsum("kij,kj->ki", onto, later)
        shared[..., READOUT] = np.einsum("kij,kj->ki", onto, rho[:, None] * (later - moved))
        shared[..., FOCAL] = expected_px
        errors = expected_px - self._seen_px
        errors[~turned.known] = 0.0
        return errors, shared, onto @ to_camera @ cross_matrices(level), -(onto @ to_camera)

    def _known(self, at: Unknowns) -> list[Known]:
        """What is known otherwise: (columns, derivatives) and residual of each, in sigmas."""
        shared = np.array(
            [0.0, 0.0, 0.0, at.offset_s, at.readout_s, at.log_focal, at.height_bias_m]
        )
        found = [
            ((np.array([k]), np.array([1.0 / PRIOR_SIGMAS[k]])), float(shared[k] / PRIOR_SIGMAS[k]))
            for k in range(3, SHARED)
        ]
        for i in np.flatnonzero(np.isfinite(self._heights)):
            height_m = float(self._heights[i])
            sigma_m = np.hypot(SIGMA_HEIGHT_M, SIGMA_HEIGHT_RATIO * height_m)
            columns = np.array([HEIGHT, SHARED + 3 * (len(self.sightings) + i) + 2])
            residual = (height_m + at.height_bias_m + at.places_ned_m[i, 2]) / sigma_m
            found.append(((columns, np.full(2, 1.0 / sigma_m)), float(residual)))
        return found


def tilt_covariance(t_s: Array, headings_rad: Array) -> Array:
    """(3 n, 3 n) of the attitude's errors about north, east and down in n images.

    An error of the level may belong to the world or to the sensors: over a turn it stays or is
    carried along, which no step from one image to the next can say of both. A heading errs for
    good, and walks. Both jitter.
    """
    n = len(t_s)
    turned = headings_rad[:, None] - headings_rad
    c, s = np.cos(turned), np.sin(turned)
    kept = SIGMA_TILT_RAD**2 * np.exp(-np.abs(t_s[:, None] - t_s) / TILT_S)
    found = np.zeros((n, 3, n, 3))
    found[:, 0, :, 0] = found[:, 1, :, 1] = kept * (1.0 - CARRIED + CARRIED * c)
    found[:, 0, :, 1], found[:, 1, :, 0] = -kept * CARRIED * s, kept * CARRIED * s
    walked_s = np.minimum(t_s[:, None], t_s) - t_s.min()
    found[:, 2, :, 2] = SIGMA_HEADING_RAD**2 + HEADING_WALK_RAD**2 * walked_s
    return np.asarray(found.reshape(3 * n, 3 * n) + SIGMA_JITTER_RAD**2 * np.eye(3 * n))


def cauchy(sigmas: Array) -> Array:
    """Weights of errors, in sigmas, far from the answer: what is far off still pulls."""
    return np.asarray(1.0 / (1.0 + (sigmas / CAUCHY_SIGMAS) ** 2))


def tukey(sigmas: Array) -> Array:
    """Weights near the answer: what is far off is a wrong match, and pulls no more.

    Wrong matches lie within the image, so more of them are too far in than too far out: with
    Cauchy's weights they made images, and the focal length, 0.1 % too small.
    """
    return np.asarray(np.clip(1.0 - (sigmas / TUKEY_SIGMAS) ** 2, 0.0, None) ** 2)


def _projection_derivative(X: Array) -> Array:
    """(k, 2, 3) of (x / z, y / z) by points (k, 3)."""
    x, y, z = X.T
    zero = np.zeros(len(X))
    rows = [[1.0 / z, zero, -x / z**2], [zero, 1.0 / z, -y / z**2]]
    return np.moveaxis(np.array(rows), 2, 0)


def _velocities(t_s: Array, places_ned_m: Array) -> Array:
    """(n, 3) between the neighbours of each image."""
    if len(t_s) < 3:
        return np.zeros_like(places_ned_m)
    return np.asarray(np.gradient(places_ned_m, t_s, axis=0))
