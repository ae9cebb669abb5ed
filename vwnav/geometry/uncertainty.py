"""How well a fitted homography or similarity maps a point."""

import numpy as np

from vwnav.geometry.homography import transform_points
from vwnav.types import Array

_MAX_CONDITION = 1e12
_QUADRANTS = 4
_HEARD = 3.0


def homography_covariance(
    uv0: Array, uv1: Array, H_1_0: Array, sigma_px: float, at_uv: Array
) -> Array | None:
    """Covariance (2, 2) in px^2 of where the fitted homography maps `at_uv` (2,).

    Linear propagation through the least-squares fit to the inlier pairs (n, 2), n > 4 (Hartley and
    Zisserman, 2nd edition, section 5.2.3). `sigma_px` is the error of a pair in picture 1;
    the pairs' own scatter is used where it is larger. None when they do not fix a homography.
    """
    designs = _designs(uv0, H_1_0, at_uv, homography=True)
    if designs is None:
        return None
    return _propagate(*designs, _variance(uv0, uv1, H_1_0, sigma_px, unknowns=8))


def similarity_covariance(
    uv0: Array, uv1: Array, H_1_0: Array, sigma_px: float, at_uv: Array
) -> Array | None:
    """As `homography_covariance`, for a fit by `estimate_similarity` to n > 2 pairs."""
    designs = _designs(uv0, H_1_0, at_uv, homography=False)
    if designs is None:
        return None
    return _propagate(*designs, _variance(uv0, uv1, H_1_0, sigma_px, unknowns=4))


def regional_covariance(uv0: Array, uv1: Array, H_1_0: Array, at_uv: Array) -> Array:
    """Covariance (2, 2) in px^2 of where a fit maps `at_uv` (2,), by leaving out regions.

    What pairs of one region share, their scatter does not show: roofs that lean alike, shadows
    that moved, a part of the map that was rectified otherwise. The fit is made anew, to first
    order, without each quadrant of the pairs (a grouped jackknife: Shao and Tu, "The Jackknife and
    Bootstrap", 1995). Zero where the other quadrants fix no fit.
    """
    designs = _designs(uv0, H_1_0, at_uv, homography=bool(np.any(H_1_0[2, :2])))
    if designs is None:
        return np.zeros((2, 2))
    design, design_at = designs
    residual = (uv1 - transform_points(H_1_0, uv0)).ravel()
    east, south = (uv0 > np.median(uv0, axis=0)).T
    quadrant = np.repeat(2 * south + east, 2)
    total = np.zeros((2, 2))
    for left_out in range(_QUADRANTS):
        A, e = design[quadrant != left_out], residual[quadrant != left_out]
        information = A.T @ A
        if len(A) < len(information) or np.linalg.cond(information) > _MAX_CONDITION:
            continue
        shift = design_at @ np.linalg.solve(information, A.T @ e)
        total += np.outer(shift, shift)
    return (_QUADRANTS - 1) / _QUADRANTS * total


def with_regions(scatter: Array, regional: Array) -> Array:
    """Covariance (2, 2) of a fit: that of its regions along an axis on which they say much more.

    Both tell the scatter of the pairs, so their sum would count it twice; and four quadrants tell
    it badly: of independent errors the larger axis is rarely over `_HEARD` times the true one.

    Args:
        scatter: of the fit, regular.
        regional: of `regional_covariance`.
    """
    root = np.linalg.cholesky(scatter)
    whitened = np.linalg.solve(root, np.linalg.solve(root, regional).T)
    variances, axes = np.linalg.eigh(whitened)
    told = np.where(variances > _HEARD, variances, 1.0)
    return np.asarray((root @ axes) * told @ (root @ axes).T)


def _designs(
    uv0: Array, H_1_0: Array, at_uv: Array, *, homography: bool
) -> tuple[Array, Array] | None:
    """Derivatives of the mapped pairs and of the mapped place by the unknowns.

    In pixels that are centred and scaled, of picture 1 as well: that only changes the unknowns.
    """
    to_unit = _to_unit(uv0)
    points, at = transform_points(to_unit, uv0), transform_points(to_unit, at_uv)
    if not homography:
        return _similarity_design(points), _similarity_design(at)
    H_unit = _to_unit(transform_points(H_1_0, uv0)) @ H_1_0 @ np.linalg.inv(to_unit)
    if not abs(H_unit[2, 2]) > 1e-12 * np.abs(H_unit).max():
        return None
    H_unit /= H_unit[2, 2]
    return _homography_design(points, H_unit), _homography_design(at, H_unit)


def _to_unit(uv: Array) -> Array:
    """Homography (3, 3) that centres the points and brings them to unit size, for conditioning."""
    centre = np.mean(uv, axis=0)
    size = max(float(np.sqrt(np.mean((uv - centre) ** 2))), 1e-9)
    return np.array(
        [[1 / size, 0.0, -centre[0] / size], [0.0, 1 / size, -centre[1] / size], [0.0, 0.0, 1.0]]
    )


def _homography_design(points: Array, H: Array) -> Array:
    """Derivatives (2 n, 8) of the mapped points by the elements of H but the last, which is 1."""
    ones = np.ones(len(points))
    homogeneous = np.column_stack([points, ones])
    w = homogeneous @ H[2]
    design = np.zeros((len(points), 2, 8))
    design[:, 0, :3] = design[:, 1, 3:6] = homogeneous
    design[:, :, 6:] = -transform_points(H, points)[:, :, None] * points[:, None, :]
    return np.asarray((design / w[:, None, None]).reshape(-1, 8))


def _similarity_design(points: Array) -> Array:
    """Derivatives (2 n, 4) of the mapped points by scale-rotation (2) and shift (2)."""
    x, y = points.T
    one, zero = np.ones(len(points)), np.zeros(len(points))
    u = np.stack([x, -y, one, zero], axis=-1)
    v = np.stack([y, x, zero, one], axis=-1)
    return np.asarray(np.stack([u, v], axis=1).reshape(-1, 4))


def _variance(uv0: Array, uv1: Array, H: Array, sigma_px: float, unknowns: int) -> float:
    spare = 2 * len(uv0) - unknowns
    scatter = np.sum((transform_points(H, uv0) - uv1) ** 2) / spare if spare > 0 else 0.0
    return max(sigma_px**2, float(scatter))


def _propagate(design: Array, design_at: Array, variance_px2: float) -> Array | None:
    information = design.T @ design
    if len(design) < len(information) or np.linalg.cond(information) > _MAX_CONDITION:
        return None
    spread = np.linalg.solve(information, design_at.T)
    return np.asarray(variance_px2 * design_at @ spread)
