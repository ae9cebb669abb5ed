"""From a homography onto the map to where the camera is, and how well it maps that point.

Map pixels are those of one zoom level, u east and v south; `px_per_m` is (east, north), which
differ on a web-mercator map. Angles are clockwise positive as seen from above.
"""

import math
from dataclasses import dataclass

import numpy as np

from vwnav.geometry.camera import Rectification
from vwnav.geometry.homography import to_unit, transform_points
from vwnav.types import Array

_CROSS = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
_REACH = 0.1  # of the view's size, about the place whose heading and scale are asked
_MAX_CONDITION = 1e12
_QUADRANTS = 4
_HEARD = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseErrors:
    """One-sigma errors behind a pose.

    Attributes:
        sigma_px: of a matched pair on the map, per axis.
        sigma_tilt_rad: of roll and of pitch, which move the nadir.
        sigma_lean_rad: of what was taken for the vertical of the view, per axis. A view that leans
            is larger on one side than on the other.
        sigma_georeference_m: of the map itself, per axis.
    """

    sigma_px: float = 1.0
    sigma_tilt_rad: float = 0.035
    sigma_lean_rad: float = 0.035
    sigma_georeference_m: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapPose:
    """Where the camera is over the map.

    Attributes:
        nadir_px: (2,) map pixel of the ground point below the camera.
        covariance_ne_m2: (2, 2) of north and east.
        yaw_correction_rad: to add to the heading that was assumed.
        scale_ratio: true AGL over the AGL that was assumed.
    """

    nadir_px: Array
    covariance_ne_m2: Array
    yaw_correction_rad: float
    sigma_yaw_rad: float
    scale_ratio: float
    agl_m: float
    sigma_agl_m: float


def pose_from_rectified(
    H_map_rect: Array,
    view: Rectification,
    uv_rect: Array,
    uv_map: Array,
    px_per_m: tuple[float, float],
    errors: PoseErrors,
) -> MapPose | None:
    """Pose of a nadir view that was fitted to the map.

    The tilt was taken from the attitude, so its error moves the nadir by AGL times itself. It also
    makes the view larger on one side: over inliers that lie to one side the mean heading and scale
    are not those of the nadir, but 1 degree and 4 % off at 6 degrees of error half-way to the edge.
    A homography knows them at the nadir; a similarity does not, and the sigmas then say so. None
    when the pairs do not fix the pose.

    Args:
        H_map_rect: (3, 3) homography, or similarity, from view pixels to map pixels.
        view: the rectification that made the view.
        uv_rect: (n, 2) view pixels of the inlier pairs the fit was made of.
        uv_map: (n, 2) their map pixels.
        px_per_m: (east, north) of the map level at that place.
        errors: of matches, attitude and map.
    """
    homography = bool(np.any(H_map_rect[2, :2]))
    fit = linearised(uv_rect, uv_map, H_map_rect, view.nadir_uv, homography=homography)
    covariance_px2 = None if fit is None else scatter_covariance(fit, errors.sigma_px)
    if homography:
        turn = _turn_of_homography(H_map_rect, view, uv_rect, uv_map, px_per_m, errors)
    else:
        turn = _turn_of_similarity(H_map_rect, view, uv_rect, px_per_m, errors)
    nadir_px = transform_points(H_map_rect, view.nadir_uv)[0]
    if fit is None or covariance_px2 is None or turn is None or not np.all(np.isfinite(nadir_px)):
        return None
    covariance_px2 = with_regions(covariance_px2, regional_covariance(fit))
    agl_m = view.agl_m * turn.scale
    # Of north and east: the fit's, in metres, and the errors that no match shows.
    to_ne = np.array([[0.0, -1.0 / px_per_m[1]], [1.0 / px_per_m[0], 0.0]])
    unseen_m2 = (agl_m * errors.sigma_tilt_rad) ** 2 + errors.sigma_georeference_m**2
    if not homography:
        # A lean l maps x to x + (l x) x / agl. A similarity over what lies at m has the place, the
        # scale and the turn of there: it maps 0 to (l m^2 / 2 - (l m) m) / agl, l m^2 / 2 agl off.
        off_m = float(np.linalg.norm(uv_rect.mean(axis=0) - view.nadir_uv)) * view.m_per_px
        unseen_m2 += (0.5 * errors.sigma_lean_rad * off_m**2 / agl_m) ** 2
    return MapPose(
        nadir_px=nadir_px,
        covariance_ne_m2=np.asarray(to_ne @ covariance_px2 @ to_ne.T + unseen_m2 * np.eye(2)),
        yaw_correction_rad=turn.rotation_rad,
        sigma_yaw_rad=turn.sigma_rad,
        scale_ratio=turn.scale,
        agl_m=agl_m,
        sigma_agl_m=agl_m * turn.sigma_scale,
    )


@dataclass(frozen=True, slots=True)
class _Turn:
    """Rotation, clockwise, and scale of a view against the map; `sigma_scale` is relative."""

    rotation_rad: float
    scale: float
    sigma_rad: float
    sigma_scale: float


def _turn_of_similarity(
    H_map_rect: Array,
    view: Rectification,
    uv_rect: Array,
    px_per_m: tuple[float, float],
    errors: PoseErrors,
) -> _Turn | None:
    """The same everywhere: what a lean of the view adds to it, nobody knows."""
    turn = _turn_and_scale(H_map_rect, view.m_per_px, uv_rect, px_per_m, errors.sigma_px)
    if turn is None:
        return None
    rotation_rad, scale, sigma = turn
    off_m = float(np.linalg.norm(uv_rect.mean(axis=0) - view.nadir_uv)) * view.m_per_px
    lean = errors.sigma_lean_rad * off_m / view.agl_m
    return _Turn(rotation_rad, scale, math.hypot(sigma, 0.5 * lean), math.hypot(sigma, 1.5 * lean))


def _turn_of_homography(
    H_map_rect: Array,
    view: Rectification,
    uv_rect: Array,
    uv_map: Array,
    px_per_m: tuple[float, float],
    errors: PoseErrors,
) -> _Turn | None:
    """At the nadir, from where four places around it fall."""
    reach_px = _REACH * max(view.size_wh)
    around = view.nadir_uv + reach_px * _CROSS
    turn = _turn_and_scale(H_map_rect, view.m_per_px, around, px_per_m, errors.sigma_px)
    fit = linearised(uv_rect, uv_map, H_map_rect, around, homography=True)
    covariance_px2 = None if fit is None else scatter_covariance(fit, errors.sigma_px)
    if turn is None or covariance_px2 is None:
        return None
    rotation_rad, scale, _ = turn
    step_px = reach_px * view.m_per_px * math.sqrt(px_per_m[0] * px_per_m[1]) * scale
    return _Turn(rotation_rad, scale, *_cross_sigmas(covariance_px2 / step_px**2, rotation_rad))


def _cross_sigmas(covariance: Array, turn_rad: float) -> tuple[float, float]:
    """Sigma of rotation (radians) and of relative scale from where the four of `_CROSS` fell.

    `covariance` (8, 8) is in units of their distance from the middle. Each shows the rotation by
    its shift across its own direction, and the scale by that along it.
    """
    across = np.array([0.0, 1.0, -1.0, 0.0, 0.0, -1.0, 1.0, 0.0]) / 4.0
    along = np.array([1.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0, -1.0]) / 4.0
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    rotation, scale = c * across - s * along, c * along + s * across
    return (
        math.sqrt(float(rotation @ covariance @ rotation)),
        math.sqrt(float(scale @ covariance @ scale)),
    )


def _turn_and_scale(
    H_map_rect: Array,
    m_per_px: float,
    uv_rect: Array,
    px_per_m: tuple[float, float],
    sigma_px: float,
) -> tuple[float, float, float] | None:
    """(rotation clockwise, scale, sigma of both) of the view against the map, both in metres.

    Least squares over the places of the inliers; rotation in radians and relative scale have the
    same sigma, that of one match over the root of the summed squared distances to the middle.
    """
    view_m = uv_rect * m_per_px @ np.array([1.0, 1.0j])
    map_m = transform_points(H_map_rect, uv_rect) / px_per_m @ np.array([1.0, 1.0j])
    view_m, map_m = view_m - view_m.mean(), map_m - map_m.mean()
    spread = float(np.sqrt(np.sum(np.abs(view_m) ** 2)))
    if not spread > 0.0 or not np.all(np.isfinite(map_m)):
        return None
    turn = complex(np.sum(map_m * np.conj(view_m))) / spread**2
    scale = abs(turn)
    if not scale > 0.0:
        return None
    sigma_m = sigma_px / math.sqrt(px_per_m[0] * px_per_m[1])
    return math.atan2(turn.imag, turn.real), scale, sigma_m / (spread * scale)


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """A homography, or a similarity, about what it was fitted to.

    Attributes:
        uv0: (n, 2) the pairs in image 0.
        error_px: (2 n,) where they are in image 1, less where the fit maps them.
        design: (2 n, k) derivatives of the mapped pairs by the fit's k unknowns.
        design_at: (2 m, k) of the places that are asked for.
    """

    uv0: Array
    error_px: Array
    design: Array
    design_at: Array


def linearised(
    uv0: Array, uv1: Array, H_1_0: Array, at_uv: Array, *, homography: bool
) -> Linearised | None:
    """A fit to inlier pairs (n, 2), with places `at_uv` (m, 2) of image 0 or one (2,).

    In pixels that are centred and scaled, of image 1 as well: that only changes the unknowns.
    None where the numbers make no fit.
    """
    unit, mapped = to_unit(uv0), transform_points(H_1_0, uv0)
    points, at = np.split(transform_points(unit, np.vstack([uv0, at_uv])), [len(uv0)])
    error_px = (uv1 - mapped).ravel()
    if not homography:
        return Linearised(uv0, error_px, _similarity_design(points), _similarity_design(at))
    H_unit = to_unit(mapped) @ H_1_0 @ np.linalg.inv(unit)
    if not abs(H_unit[2, 2]) > 1e-12 * np.abs(H_unit).max():
        return None
    H_unit /= H_unit[2, 2]
    designs = _homography_design(points, H_unit), _homography_design(at, H_unit)
    return Linearised(uv0, error_px, *designs)


def scatter_covariance(fit: Linearised, sigma_px: float) -> Array | None:
    """Covariance (2 m, 2 m) in px^2 of where a fit maps its places.

    Linear propagation through the least-squares fit to the pairs, n > 4 of a homography, n > 2 of a
    similarity (Hartley and Zisserman, 2nd edition, section 5.2.3). `sigma_px` is the error of a
    pair in image 1; the pairs' own scatter is used where it is larger. None when they fix no fit.
    """
    design, design_at = fit.design, fit.design_at
    information = design.T @ design
    if len(design) < len(information) or np.linalg.cond(information) > _MAX_CONDITION:
        return None
    spare = len(design) - len(information)
    scatter = np.sum(fit.error_px**2) / spare if spare > 0 else 0.0
    variance_px2 = max(sigma_px**2, float(scatter))
    return np.asarray(variance_px2 * design_at @ np.linalg.solve(information, design_at.T))


def regional_covariance(fit: Linearised) -> Array:
    """Covariance (2, 2) in px^2 of where a fit maps its place, by leaving out regions.

    What pairs of one region share, their scatter does not show: roofs that lean alike, shadows
    that moved, a part of the map that was rectified otherwise. The fit is made anew, to first
    order, without each quadrant of the pairs (a grouped jackknife: Shao and Tu, "The Jackknife and
    Bootstrap", 1995). Zero where the other quadrants fix no fit.
    """
    design, error_px = fit.design, fit.error_px
    east, south = (fit.uv0 > np.median(fit.uv0, axis=0)).T
    inside = np.repeat(2 * south + east, 2) == np.arange(_QUADRANTS)[:, None]
    # What all regions say of the unknowns, less what one of them does.
    told, pulled = (inside[:, None, :] * design.T) @ design, (inside * error_px) @ design
    information, pull = told.sum(axis=0) - told, pulled.sum(axis=0) - pulled
    enough = np.count_nonzero(~inside, axis=1) >= design.shape[1]
    enough &= np.linalg.cond(information) <= _MAX_CONDITION
    unknowns = np.linalg.solve(information[enough], pull[enough][..., None])
    shifts = (fit.design_at @ unknowns)[..., 0]
    return np.asarray((_QUADRANTS - 1) / _QUADRANTS * shifts.T @ shifts)


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
