"""The camera's motion over level ground from points seen twice, with what the attitude knows.

A plane seen from two places: a ground point G (NED, from camera 0, in units of its height above
ground, so that n . G = 1 with n = (a, b, 1)) is seen by camera 1 in direction
    R_ned_camera1^T exp(-phi) (G - t)
with t the way of the camera, phi the error of the rotation between the two attitudes, and (a, b)
the slope of the ground (and the error of attitude 0). These eight numbers are the homography; the
attitude comes in as prior on phi and (a, b). That chooses among the decompositions of the
homography the physically right one, and tells tilting from moving as well as image and autopilot
together can.
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.rotations import rotation_from_vector
from vwnav.types import Array

_T, _PHI, _SLOPE = slice(0, 3), slice(3, 6), slice(6, 8)
_ITERATIONS = 5
_TUKEY = 4.685  # 95 % efficiency for normal errors
_RANSAC_STEPS = 300


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """The same ground points in two images.

    Attributes:
        rays0: (n, 3) directions from camera 0 in NED, as its attitude has it.
        rays1: (n, 3) directions in camera 1, camera axes, third component 1.
        R_ned_camera1: (3, 3) as its attitude has it.
        focal_px: what a direction's tangent is multiplied by to give pixels.
    """

    rays0: Array
    rays1: Array
    R_ned_camera1: Array
    focal_px: float


@dataclass(frozen=True, slots=True)
class MotionPrior:
    """One-sigma of what the attitude leaves open, and of a track."""

    tilt_increment_rad: float
    slope: float
    pixel: float


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Camera 0 to camera 1.

    Attributes:
        way: (3,) NED in units of the height of camera 0 above ground.
        turn_rad: (3,) rotation vector, NED: `exp(turn) @ R_ned_camera1` is the true rotation.
        slope: (2,) of the ground in the frame of attitude 0, down per north and east.
        covariance: (8, 8) of the three.
        inliers: (n,) bool. sigma_px: what the tracks that fit scatter by.
    """

    way: Array
    turn_rad: Array
    slope: Array
    covariance: Array
    inliers: NDArray[np.bool_]
    sigma_px: float


def fit_motion(seen: Sightings, prior: MotionPrior, threshold_px: float) -> Motion | None:
    """The motion that most points agree on; None when there is none.

    A similarity on the ground by RANSAC, then all eight numbers by least squares with Tukey's
    weights, whose scale is that of the residuals but never below `prior.pixel`.
    """
    parameters = _similarity(seen, threshold_px)
    if parameters is None:
        return None
    scale_px = threshold_px
    weights = np.ones(len(seen.rays1))
    for _ in range(_ITERATIONS):
        residuals, J = _linearise(seen, parameters)
        size_px = np.hypot(residuals[:, 0], residuals[:, 1])
        scale_px = min(scale_px, _scale(size_px[size_px < threshold_px], prior.pixel))
        weights = np.clip(1.0 - (size_px / (_TUKEY * scale_px)) ** 2, 0.0, None) ** 2
        step = _solve(residuals, J, weights / scale_px**2, parameters, prior)
        if step is None:
            return None
        parameters = parameters + step
    residuals, J = _linearise(seen, parameters)
    size_px = np.hypot(residuals[:, 0], residuals[:, 1])
    inliers = size_px < _TUKEY * scale_px
    information = _information(J, inliers / scale_px**2, prior)
    if not np.all(np.isfinite(information)) or np.count_nonzero(inliers) < 4:
        return None
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return Motion(
        parameters[_T], parameters[_PHI], parameters[_SLOPE], covariance, inliers, scale_px
    )


def _scale(size_px: Array, least_px: float) -> float:
    """One sigma per axis of residual lengths, from their median (of a Rayleigh distribution)."""
    if len(size_px) == 0:
        return least_px
    return max(float(np.median(size_px)) / 1.1774, least_px)


def _similarity(seen: Sightings, threshold_px: float) -> Array | None:
    """First guess (8,): way and turn about down, level and with the attitude's word on tilt."""
    rays1 = seen.rays1 @ seen.R_ned_camera1.T
    front = (seen.rays0[:, 2] > 0.1) & (rays1[:, 2] > 0.1)
    if np.count_nonzero(front) < 4:
        return None
    ground0 = seen.rays0[front, :2] / seen.rays0[front, 2:]
    ground1 = rays1[front, :2] / rays1[front, 2:]
    # OpenCV's RANSAC here has its own generator with a fixed seed: equal input, equal output.
    M, _ = cv2.estimateAffinePartial2D(
        ground0,
        ground1,
        method=cv2.RANSAC,
        ransacReprojThreshold=threshold_px / seen.focal_px,
        maxIters=_RANSAC_STEPS,
        confidence=0.999,
        refineIters=0,
    )
    if M is None or not np.all(np.isfinite(M)):
        return None
    scale = float(np.hypot(M[0, 0], M[1, 0]))
    if not 0.2 < scale < 5.0:
        return None
    # ground1 = scale Rz(-turn) (ground0 - way)
    turn_rad = -float(np.arctan2(M[1, 0], M[0, 0]))
    way = -np.linalg.solve(M[:, :2], M[:, 2])
    return np.array([way[0], way[1], 1.0 - 1.0 / scale, 0.0, 0.0, turn_rad, 0.0, 0.0])


def _linearise(seen: Sightings, parameters: Array) -> tuple[Array, Array]:
    """Residuals (n, 2), seen minus predicted in pixels, and the prediction's Jacobian (n, 2, 8)."""
    x, y = seen.rays0[:, 0], seen.rays0[:, 1]
    a, b = parameters[_SLOPE]
    depth = seen.rays0[:, 2] + a * x + b * y
    G = seen.rays0 / depth[:, None]
    R_camera1_ned = (rotation_from_vector(parameters[_PHI]) @ seen.R_ned_camera1).T
    away = G - parameters[_T]
    q = away @ R_camera1_ned.T
    predicted = q[:, :2] / q[:, 2:]
    residuals = seen.focal_px * (seen.rays1[:, :2] - predicted)

    dq = np.empty((len(q), 3, 8))
    dq[:, :, _T] = -R_camera1_ned
    # A further turn d of the rotation moves q by R (away x d).
    dq[:, :, _PHI] = R_camera1_ned @ _cross_matrices(away)
    per_slope = -(G @ R_camera1_ned.T) / depth[:, None]
    dq[:, :, 6] = per_slope * x[:, None]
    dq[:, :, 7] = per_slope * y[:, None]
    J = seen.focal_px * (dq[:, :2] - predicted[:, :, None] * dq[:, 2:]) / q[:, 2, None, None]
    return residuals, J


def _cross_matrices(v: Array) -> Array:
    """(n, 3, 3) with [i] @ d == cross(v[i], d)."""
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2] = -v[:, 2], v[:, 1]
    out[:, 1, 0], out[:, 1, 2] = v[:, 2], -v[:, 0]
    out[:, 2, 0], out[:, 2, 1] = -v[:, 1], v[:, 0]
    return out


def _prior_information(prior: MotionPrior) -> Array:
    """(8,) diagonal; the way and the turn about down are left to the image."""
    tilt, slope = prior.tilt_increment_rad**-2, prior.slope**-2
    return np.array([0.0, 0.0, 0.0, tilt, tilt, 0.0, slope, slope])


def _information(J: Array, weights: Array, prior: MotionPrior) -> Array:
    flat = J.reshape(-1, 8)
    weighted = flat * np.repeat(weights, 2)[:, None]
    return np.asarray(flat.T @ weighted + np.diag(_prior_information(prior)))


def _solve(
    residuals: Array, J: Array, weights: Array, parameters: Array, prior: MotionPrior
) -> Array | None:
    """Gauss-Newton step (8,)."""
    flat = J.reshape(-1, 8)
    gradient = flat.T @ (np.repeat(weights, 2) * residuals.ravel())
    gradient -= _prior_information(prior) * parameters
    try:
        step = np.linalg.solve(_information(J, weights, prior), gradient)
    except np.linalg.LinAlgError:
        return None
    return np.asarray(step, dtype=np.float64) if np.all(np.isfinite(step)) else None


@dataclass(frozen=True, slots=True)
class TiltSeen:
    """What a fit and the attitudes say of each other.

    Attributes:
        share: how much of a change of tilt error, which the prior says is none, the fit takes for
            motion. With true tilts p and a prior of mean zero and information L, the fit's mean is
            off by -Cov L p (the posterior of a linear model); of that, the way's part along the
            tilt.
        along: `OdometryMotion.tilts_along`.
    """

    share: float = 0.0
    along: float = 0.0


def tilt_seen(motion: Motion, prior: MotionPrior, axis0: Array, axis1: Array) -> TiltSeen:
    """How a fit's own word on tilting stands to what the attitudes tell.

    That is w, the turn of the optical axis about north and east, in the heading that the image
    shows: an autopilot may have reset its own. With the prior N(0, s^2) of the turn beyond the
    attitudes' own taken out of its posterior N(m, c), the image says m / k, uncertain by c / k,
    with k = 1 - c / s^2. So it shows w + m / k, and the logarithm of
    N(w + m / k; w, V) / N(w + m / k; 0, V), V = s^2 + c / k = s^2 / k, is (m.w + k w.w / 2) / s^2.

    Args:
        motion: what was fitted.
        prior: with which.
        axis0: (3,) optical axis in NED of the keyframe.
        axis1: (3,) the same of the image, both as their attitudes have it.
    """
    c, s = math.cos(motion.turn_rad[2]), math.sin(motion.turn_rad[2])
    east, north = s * axis1[0] + c * axis1[1], c * axis1[0] - s * axis1[1]
    told_rad = np.cross(axis0, [north, east, axis1[2]])[:2]
    covariance, variance = motion.covariance, prior.tilt_increment_rad**2
    along = 0.5 * (abs(covariance[0, 4]) + abs(covariance[1, 3]))
    k = max(1.0 - 0.5 * float(covariance[3, 3] + covariance[4, 4]) / variance, 0.0)
    ratio = told_rad @ (motion.turn_rad[:2] + 0.5 * k * told_rad) / variance
    return TiltSeen(min(float(along) / variance, 1.0), float(ratio))


def off_plane(motion: Motion, share: float) -> Motion:
    """The motion, less sure where only a share of the tracks lies on its plane.

    Roofs and crowns of trees move on planes of their own: which of them was taken for the ground,
    and how much the rest pulls at it, the inliers' own scatter does not tell.
    """
    return replace(motion, covariance=motion.covariance / share**2)


def centre_way(motion: Motion, axis0: Array, axis1: Array) -> tuple[Array, Array]:
    """Way (3,) of the ground point in the image's centre, with its covariance (3, 3).

    Tilting moves it as flying does. It stays on the ground, which is turned to be level; the third
    component is how much shorter the way from the camera to that point became.

    Args:
        motion: since the keyframe.
        axis0: (3,) optical axis in NED of the keyframe.
        axis1: (3,) the same of the image, both as their attitudes have it.
    """
    parameters = np.concatenate([motion.way, motion.turn_rad, motion.slope])
    way = _centre(parameters, axis0, axis1)
    J = np.empty((3, 8))
    for i, step in enumerate(1e-6 * np.eye(8)):
        J[:, i] = (_centre(parameters + step, axis0, axis1) - way) / 1e-6
    return way, J @ motion.covariance @ J.T


def _centre(parameters: Array, axis0: Array, axis1: Array) -> Array:
    t, normal = parameters[:3], np.array([parameters[6], parameters[7], 1.0])
    axis = rotation_from_vector(parameters[3:6]) @ axis1
    range0 = 1.0 / (normal @ axis0)
    range1 = (1.0 - normal @ t) / (normal @ axis)
    along = t + range1 * axis - range0 * axis0
    level = rotation_from_vector(np.cross(normal / np.linalg.norm(normal), [0.0, 0.0, 1.0]))
    return np.array([*(level @ along)[:2], range0 - range1])
