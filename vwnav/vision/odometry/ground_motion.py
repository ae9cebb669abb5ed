"""The camera's motion over the ground from points seen twice, with what the attitude knows.

A plane seen from two places: a ground point G (NED, from camera 0, in units of its height above
ground, so that n . G = 1 with n = (a, b, 1)) is seen by camera 1 in direction
    R_ned_camera1^T exp(-phi) (G - t)
with t the way of the camera, phi the error of the rotation between the two attitudes, and (a, b)
the slope of the ground (and the error of attitude 0). These eight numbers are the homography; the
attitude comes in as prior on phi and (a, b). That chooses among the decompositions of the
homography the physically right one, and tells tilting from moving as well as image and autopilot
together can.

Ground that bends is higher than that plane by h = c . (x^2, x y, y^2), in the level coordinates
(x, y) of camera 0, and seen at G (1 - h): three numbers more, with a prior of their own.

The last one is the camera's read-out. A rolling shutter stretches the picture of a turn or a brake
along its columns, as a slope of the ground would: which of them it is, only the two together tell.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.types import Array

_T, _PHI, _SLOPE, _BEND, _READOUT = slice(0, 3), slice(3, 6), slice(6, 8), slice(8, 11), 11
_SIZE = 12
_ITERATIONS = 5
_RAYLEIGH_MEDIAN = 1.1774  # of residual lengths, in sigmas per axis
_TUKEY = 4.685  # 95 % efficiency for normal errors
_RANSAC_STEPS = 300
_LEAST_TOLD = 0.5  # of a slope, by the images and not by what was thought before
_LEAST_PARALLAX_PX = 1.0  # of a point as high over the ground as ...
_TOLD_HEIGHT = 0.1  # ... this, in heights of the camera
_HIGHEST = 0.6  # in heights of the camera: what seems higher is no point
_MOST_READOUT_S, _LEAST_READOUT_S = 0.05, 0.001  # of any camera; sigma of what was learned of it
_REGIONS = 4  # along each side of the image: tracks of one may hang together
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """The same ground points in two images.

    Attributes:
        rays0: (n, 3) directions from camera 0 in NED, as its attitude has it.
        rays1: (n, 3) directions in camera 1, camera axes, third component 1.
        R_ned_camera1: (3, 3) as its attitude has it.
        focal_px: what a direction's tangent is multiplied by to give pixels.
        skew0, skew1: (n, 3) what is to be added to rays0 and rays1 per second of read-out, see
            `skew_per_s`; zero where they were seen all at once.
    """

    rays0: Array
    rays1: Array
    R_ned_camera1: Array
    focal_px: float
    skew0: Array
    skew1: Array


@dataclass(frozen=True, slots=True, eq=False)
class MotionPrior:
    """One-sigma of what the attitude leaves open, and of a track.

    Attributes:
        slope_ne: (2,) what the ground is thought to rise by, to one sigma `slope`.
        readout_s: what the rows are thought to take, to one sigma `sigma_readout_s`.
    """

    tilt_increment_rad: float
    slope_ne: Array
    slope: float
    bend: float
    pixel: float
    readout_s: float
    sigma_readout_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Camera 0 to camera 1.

    Attributes:
        way: (3,) NED in units of the height of camera 0 above ground.
        turn_rad: (3,) rotation vector, NED: `exp(turn) @ R_ned_camera1` is the true rotation.
        slope: (2,) rise of the ground per north and east, in the frame of attitude 0.
        told_slope: the same and its covariance (2, 2) without the prior; None if that was all.
        covariance: (12, 12) of the three, of what the ground bends by, and of the read-out.
        doubt: times that, for roofs and crowns of trees move on planes of their own: which of them
            was taken for the ground, and how much the rest pulls at it, the inliers' scatter does
            not tell.
        inliers: (n,) bool. sigma_px: what the tracks that fit scatter by.
        relief: one sigma of the heights over the ground of what was seen, as a share of the height
            of camera 0; None where the way is too short to tell.
        readout_s: from the first row to the last, and one sigma of it: a prior for what comes.
    """

    way: Array
    turn_rad: Array
    slope: Array
    told_slope: tuple[Array, Array] | None
    covariance: Array
    doubt: float
    inliers: BoolArray
    sigma_px: float
    relief: float | None
    readout_s: tuple[float, float]


def fit_motion(seen: Sightings, prior: MotionPrior, threshold_px: float) -> Motion | None:
    """The motion that most points agree on; None when there is none.

    A similarity on the ground by RANSAC, then all numbers by least squares with Tukey's
    weights, whose scale is that of the residuals but never below `prior.pixel`.
    """
    parameters = _similarity(seen, threshold_px)
    if parameters is None:
        return None
    parameters[_READOUT] = prior.readout_s
    scale_px = threshold_px
    for _ in range(_ITERATIONS):
        residuals, J, _ = _linearise(seen, parameters)
        size_px = np.hypot(residuals[:, 0], residuals[:, 1])
        if np.any(size_px < threshold_px):
            sigma_px = float(np.median(size_px[size_px < threshold_px])) / _RAYLEIGH_MEDIAN
            scale_px = min(scale_px, max(sigma_px, prior.pixel))
        else:
            scale_px = min(scale_px, prior.pixel)
        weights = np.clip(1.0 - (size_px / (_TUKEY * scale_px)) ** 2, 0.0, None) ** 2
        information, gradient = _normal(residuals, J, weights / scale_px**2, parameters, prior)
        try:
            step = np.linalg.solve(information, gradient)
        except np.linalg.LinAlgError:
            return None
        if not np.all(np.isfinite(step)):
            return None
        parameters = parameters + step
    residuals, J, per_height = _linearise(seen, parameters)
    inliers = np.hypot(residuals[:, 0], residuals[:, 1]) < _TUKEY * scale_px
    weights = inliers / scale_px**2
    information, _ = _normal(residuals, J, weights, parameters, prior)
    if not np.all(np.isfinite(information)) or np.count_nonzero(inliers) < 4:
        return None
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    scores = np.einsum("nki,nk,n->ni", J, residuals, weights)
    hanging = _hanging_together(seen.rays1[:, :2], scores, covariance)
    doubt = float(np.mean(inliers)) ** -2
    # Of the read-out's posterior the prior stays as sure as it was.
    of_prior = covariance[_READOUT, _READOUT] / prior.sigma_readout_s**2
    gain = 1.0 / (1.0 - of_prior + of_prior * hanging * doubt)
    readout_s = prior.readout_s + gain * float(parameters[_READOUT] - prior.readout_s)
    sigma_s = math.sqrt(max(gain * hanging * doubt * covariance[_READOUT, _READOUT], 0.0))
    covariance *= hanging
    return Motion(
        parameters[_T],
        parameters[_PHI],
        parameters[_SLOPE],
        _told_slope(parameters[_SLOPE], doubt * covariance[_SLOPE, _SLOPE], prior),
        covariance,
        doubt,
        inliers,
        scale_px,
        _relief(residuals, per_height, scale_px),
        (min(max(readout_s, 0.0), _MOST_READOUT_S), max(sigma_s, _LEAST_READOUT_S)),
    )


def _similarity(seen: Sightings, threshold_px: float) -> Array | None:
    """First guess (12,): way and turn about down, level and with the attitude's word on tilt."""
    rays1 = seen.rays1 @ seen.R_ned_camera1.T
    front = (seen.rays0[:, 2] > 0.1) & (rays1[:, 2] > 0.1)
    if np.count_nonzero(front) < 4:
        return None
    ground0 = seen.rays0[front, :2] / seen.rays0[front, 2:]
    ground1 = rays1[front, :2] / rays1[front, 2:]
    # OpenCV's RANSAC here has its own generator with a fixed seed: equal input, equal output.
    M, _ = cv2.estimateAffinePartial2D(
        ground0, ground1, method=cv2.RANSAC, ransacReprojThreshold=threshold_px / seen.focal_px,
        maxIters=_RANSAC_STEPS, confidence=0.999, refineIters=0,
    )  # fmt: skip
    if M is None or not np.all(np.isfinite(M)):
        return None
    scale = float(np.hypot(M[0, 0], M[1, 0]))
    if not 0.2 < scale < 5.0:
        return None
    # ground1 = scale Rz(-turn) (ground0 - way)
    turn_rad = -float(np.arctan2(M[1, 0], M[0, 0]))
    way = -np.linalg.solve(M[:, :2], M[:, 2])
    parameters = np.zeros(_SIZE)
    parameters[:6] = way[0], way[1], 1.0 - 1.0 / scale, 0.0, 0.0, turn_rad
    return parameters


def _linearise(seen: Sightings, parameters: Array) -> tuple[Array, Array, Array]:
    """Residuals (n, 2), seen minus predicted in pixels, and the prediction's Jacobian (n, 2, 12).

    And how the prediction moves (n, 2) by the height of a point over the ground, in heights of the
    camera.
    """
    across = seen.rays0[:, :2]
    depth = seen.rays0[:, 2] + across @ parameters[_SLOPE]
    plane = seen.rays0 / depth[:, None]
    level = across / seen.rays0[:, 2:]
    bends = np.column_stack([level[:, :1] * level, level[:, 1] ** 2])
    lower = 1.0 - bends @ parameters[_BEND]
    R_camera1_ned = (cv2.Rodrigues(parameters[_PHI])[0] @ seen.R_ned_camera1).T
    away = plane * lower[:, None] - parameters[_T]
    q = away @ R_camera1_ned.T
    predicted = q[:, :2] / q[:, 2:]
    residuals = seen.focal_px * (seen.rays1[:, :2] - predicted)

    # M (n, 2, 3): how the pixels move with the point, in NED.
    M = R_camera1_ned[:2] - predicted[:, :, None] * R_camera1_ned[2]
    M *= (seen.focal_px / q[:, 2])[:, None, None]
    J = np.empty((len(q), 2, _SIZE))
    J[:, :, _T] = -M
    # A further turn d of the rotation moves the point by away x d.
    (m0, m1, m2), (a0, a1, a2) = M.transpose(2, 0, 1), away.T[:, :, None]
    J[:, :, 3], J[:, :, 4], J[:, :, 5] = m1 * a2 - m2 * a1, m2 * a0 - m0 * a2, m0 * a1 - m1 * a0
    per_height = -np.einsum("nij,nj->ni", M, plane)  # what is higher by h lies at plane (1 - h)
    J[:, :, _SLOPE] = per_height[:, :, None] * (across * (lower / depth)[:, None])[:, None]
    J[:, :, _BEND] = per_height[:, :, None] * bends[:, None]
    deeper = seen.skew0[:, 2] + seen.skew0[:, :2] @ parameters[_SLOPE]
    moves0 = (seen.skew0 - plane * deeper[:, None]) * (lower / depth)[:, None]
    moves1 = seen.skew1[:, :2] - seen.rays1[:, :2] * seen.skew1[:, 2:]
    J[:, :, _READOUT] = np.einsum("nij,nj->ni", M, moves0) - seen.focal_px * moves1
    residuals -= J[:, :, _READOUT] * parameters[_READOUT]
    return residuals, J, per_height


def _relief(residuals: Array, per_height: Array, sigma_px: float) -> float | None:
    """One sigma of the heights over the ground by the parallax of all tracks (n, 2), in pixels.

    A point of height h is seen h p beside its prediction, and what lies across p is the track's own
    error: those that are far off across are no tracks. So E[(r.p)^2] = s^2 p^2 + <h^2> p^4, fitted
    by least squares of (r.p)^2 - s^2 p^2 over p^4.
    """
    size2 = np.einsum("ni,ni->n", per_height, per_height)
    if not float(np.median(size2)) > (_LEAST_PARALLAX_PX / _TOLD_HEIGHT) ** 2:
        return None
    along = np.einsum("ni,ni->n", residuals, per_height)
    across = residuals[:, 0] * per_height[:, 1] - residuals[:, 1] * per_height[:, 0]
    tracks = (across**2 < (_TUKEY * sigma_px) ** 2 * size2) & (np.abs(along) < _HIGHEST * size2)
    if np.count_nonzero(tracks) < 4:
        return None
    excess = along[tracks] ** 2 - sigma_px**2 * size2[tracks]
    return math.sqrt(max(float(excess.sum() / (size2[tracks] ** 2).sum()), 0.0))


def _normal(
    residuals: Array, J: Array, weights: Array, parameters: Array, prior: MotionPrior
) -> tuple[Array, Array]:
    """Normal equations of a Gauss-Newton step: information (12, 12) and gradient (12,).

    The way and the turn about down are left to the image.
    """
    known = np.zeros(_SIZE)
    known[3:5] = prior.tilt_increment_rad**-2
    known[_SLOPE], known[_BEND] = prior.slope**-2, prior.bend**-2
    known[_READOUT] = prior.sigma_readout_s**-2
    thought = np.zeros(_SIZE)
    thought[_SLOPE], thought[_READOUT] = prior.slope_ne, prior.readout_s
    flat, twice = J.reshape(-1, _SIZE), np.repeat(weights, 2)
    information = flat.T @ (flat * twice[:, None]) + np.diag(known)
    gradient = flat.T @ (twice * residuals.ravel()) - known * (parameters - thought)
    return information, gradient


def _hanging_together(places: Array, scores: Array, covariance: Array) -> float:
    """By how much the way is less sure than so many independent tracks would have it, at least 1.

    Neighbours in a blurred image are off to the same side, each of them hardly. So the scores
    (n, 12) of the tracks at `places` (n, 2) in the image are summed by region before they are
    squared (cluster-robust covariance, Liang and Zeger 1986, eq. 5).
    """
    lowest, highest = places.min(axis=0), places.max(axis=0)
    cells = (places - lowest) / np.maximum(highest - lowest, 1e-9) * _REGIONS
    column, row = np.minimum(cells.astype(np.intp), _REGIONS - 1).T
    by_region = np.zeros((_REGIONS**2, scores.shape[1]))
    np.add.at(by_region, row * _REGIONS + column, scores)
    way = by_region @ covariance[:, _T]
    return max(1.0, float(np.sum(way**2) / np.trace(covariance[_T, _T])))


@dataclass(frozen=True, slots=True)
class TiltSeen:
    """What a fit and the attitudes say of each other.

    Attributes:
        share: how much of a change of tilt error, which the prior says is none, the fit takes for
            motion. With true tilts p and a prior of mean zero and information L, the fit's mean is
            off by -Cov L p (the posterior of a linear model); of that, the way's part along the
            tilt.
        along, turned: `OdometryMotion.tilts_along`, `.tilts_turned`.
    """

    share: float = 0.0
    along: float = 0.0
    turned: Array | None = None


def tilt_seen(motion: Motion, prior: MotionPrior, R0: Array, R1: Array) -> TiltSeen:
    """How a fit's own word on tilting stands to what the attitudes tell.

    That is w, the turn of the optical axis about north and east, in the heading that the image
    shows: an autopilot may have reset its own. With the prior N(0, s^2) of the turn beyond the
    attitudes' own taken out of its posterior N(m, c), the image says m / k, uncertain by c / k,
    with k = 1 - c / s^2. So it shows w + m / k, and the logarithm of
    N(w + m / k; w, V) / N(w + m / k; 0, V), V = s^2 + c / k = s^2 / k, is (m.w + k w.w / 2) / s^2.
    A camera that is turned by a shows the turn v = Rz(-a) w: (m.v + k (w.v - w.w / 2)) / s^2. Where
    its images are mirrored it shows S v, S = 2 r r' - I with r the image's right over the ground:
    the axis of a turn is a pseudovector.

    Args:
        motion: what was fitted.
        prior: with which.
        R0: (3, 3) R_ned_camera of the keyframe.
        R1: (3, 3) the same of the image, both as their attitudes have it.
    """
    axis0, axis1, (right_n, right_e, _) = R0[:, 2], R1[:, 2], R0[:, 0].tolist()
    c, s = math.cos(motion.turn_rad[2]), math.sin(motion.turn_rad[2])
    east, north = s * axis1[0] + c * axis1[1], c * axis1[0] - s * axis1[1]
    told_rad = np.cross(axis0, [north, east, axis1[2]])[:2]
    covariance, variance = motion.covariance, prior.tilt_increment_rad**2
    along = 0.5 * (abs(covariance[0, 4]) + abs(covariance[1, 3]))
    k = max(1.0 - 0.5 * float(covariance[3, 3] + covariance[4, 4]) / variance, 0.0)
    north, east = told_rad.tolist()
    turns_rad = np.array([[north, east], [east, -north], [-north, -east], [-east, north]])
    back, across = right_n**2 - right_e**2, 2.0 * right_n * right_e
    mirror = np.array([[back, across], [across, -back]]) / (right_n**2 + right_e**2)
    shown_rad = np.concatenate([turns_rad, turns_rad[:2] @ mirror])
    seen_rad = motion.turn_rad[:2] + k * told_rad
    ratios = (shown_rad @ seen_rad - 0.5 * k * told_rad @ told_rad) / variance
    return TiltSeen(min(float(along) / variance, 1.0), float(ratios[0]), ratios[1:])


def _told_slope(slope: Array, C: Array, prior: MotionPrior) -> tuple[Array, Array] | None:
    """Rise (2,) of the ground and its covariance, the prior taken out; None if that was all.

    A posterior N(p + m, C) of a prior N(p, s^2) measures p + K^-1 m to K^-1 C, K = I - C / s^2.
    """
    K = np.eye(2) - C / prior.slope**2
    if float(np.linalg.eigvalsh(0.5 * (K + K.T))[0]) < _LEAST_TOLD:
        return None
    told = np.linalg.solve(K, np.column_stack([slope - prior.slope_ne, C])).astype(np.float64)
    return prior.slope_ne + told[:, 0], 0.5 * (told[:, 1:] + told[:, 1:].T)
