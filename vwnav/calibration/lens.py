"""The lens from views of the board: focal length, principal point, distortion, and how sure."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from vwnav.calibration.board import BoardView
from vwnav.errors import CalibrationError
from vwnav.geometry.camera import Camera, CameraModel
from vwnav.types import Array

LEAST_VIEWS = 8
FOLDS = 4  # each is held out once
FISHEYE_WINS = 0.9  # of the pinhole's held-out error: less, or the plainer model is taken
STRAY_RATIO, STRAY_PX = 3.0, 1.0  # a view this much worse than most, and this bad, is left out
MOST_CONDITION = 1e9  # of the normal equations: beyond it some lenses cannot be told apart
NAMES = ("fx_px", "fy_px", "cx_px", "cy_px")
_FISHEYE_FLAGS = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW


@dataclass(frozen=True, slots=True, eq=False)
class LensFit:
    """A lens that was fitted.

    Attributes:
        camera: looking straight down; where it is mounted no board tells.
        sigmas: one sigma of fx_px, fy_px, cx_px, cy_px and of the distortion, by name.
        rms_px: of the corners it was fitted to, both axes together.
        held_out_px: the same of corners in views that it was not fitted to.
        views: that were used.
    """

    camera: Camera
    sigmas: dict[str, float]
    rms_px: float
    held_out_px: float
    views: int


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    camera: Camera
    poses: list[tuple[Array, Array]]  # rotation vector and place (3,) of each view's board


def fit_lens(views: Sequence[BoardView], size_wh: tuple[int, int]) -> LensFit:
    """The better of the two models for views of one camera.

    Raises:
        CalibrationError: too few views, or they fix no lens.
    """
    if len(views) < LEAST_VIEWS:
        raise CalibrationError(
            f"the board was found in {len(views)} different pictures; {LEAST_VIEWS} are needed, "
            "20 are good"
        )
    pinhole = _fit(list(views), size_wh, "pinhole")
    fisheye = _fit(list(views), size_wh, "fisheye")
    fits = [fit for fit in (pinhole, fisheye) if fit is not None]
    if not fits:
        raise CalibrationError(
            "these pictures fix no lens: show the board tilted, and at all sides of the picture"
        )
    if pinhole is not None and fisheye is not None:
        wins = fisheye.held_out_px < FISHEYE_WINS * pinhole.held_out_px
        return fisheye if wins else pinhole
    return fits[0]


def _fit(views: list[BoardView], size_wh: tuple[int, int], model: CameraModel) -> LensFit | None:
    """With the strays left out, its sigmas, and its error on views that it did not see."""
    solution = _solve(views, size_wh, model)
    if solution is None:
        return None
    errors = [
        _rms(_errors(solution.camera, *each)) for each in zip(views, solution.poses, strict=True)
    ]
    limit = max(STRAY_RATIO * float(np.median(errors)), STRAY_PX)
    kept = [view for view, error in zip(views, errors, strict=True) if error <= limit]
    if len(kept) < len(views):
        solution = _solve(kept, size_wh, model) if len(kept) >= LEAST_VIEWS else None
    held_out_px = None if solution is None else _held_out_px(kept, size_wh, model)
    if solution is None or held_out_px is None:
        return None
    residual = np.concatenate(
        [_errors(solution.camera, *each) for each in zip(kept, solution.poses, strict=True)]
    )
    sigmas = _sigmas(kept, solution, residual)
    return LensFit(solution.camera, sigmas, _rms(residual), held_out_px, len(kept))


def _solve(
    views: list[BoardView], size_wh: tuple[int, int], model: CameraModel
) -> _Solution | None:
    """The least squares of a model; None where it finds nothing."""
    places = [view.places.astype(np.float32)[None] for view in views]
    pixels = [view.uv.astype(np.float32)[None] for view in views]
    calibrate: Callable[..., Any] = cv2.calibrateCamera
    extra: dict[str, Any] = {}
    if model == "fisheye":
        calibrate = cv2.fisheye.calibrate
        extra = {"flags": _FISHEYE_FLAGS}
        places = [each.astype(np.float64) for each in places]
        pixels = [each.astype(np.float64) for each in pixels]
    try:
        _, K, distortion, turns, shifts = calibrate(places, pixels, size_wh, None, None, **extra)
        camera = Camera(
            width_px=size_wh[0],
            height_px=size_wh[1],
            K=K,
            distortion=tuple(np.ravel(distortion)),
            model=model,
        )
    except (cv2.error, ValueError):  # no progress, or numbers that make no camera
        return None
    poses = [(np.ravel(r), np.ravel(t)) for r, t in zip(turns, shifts, strict=True)]
    return _Solution(camera, poses)


def _errors(camera: Camera, view: BoardView, pose: tuple[Array, Array]) -> Array:
    """(n, 2) of the corners, seen less projected; NaN where the board lies behind the camera."""
    R, _ = cv2.Rodrigues(pose[0])
    return view.uv - camera.project(view.places @ np.asarray(R).T + pose[1])


def _rms(errors: Array) -> float:
    """Root mean square of the distances (n, 2)."""
    return float(np.sqrt(np.mean(np.sum(np.nan_to_num(errors, nan=1e3) ** 2, axis=1))))


def _held_out_px(
    views: list[BoardView], size_wh: tuple[int, int], model: CameraModel
) -> float | None:
    """Each view is measured with a lens that was fitted without it; its pose alone is free."""
    errors = []
    for fold in range(FOLDS):
        rest = [view for i, view in enumerate(views) if i % FOLDS != fold]
        solution = _solve(rest, size_wh, model)
        if solution is None:
            return None
        for view in views[fold::FOLDS]:
            pose = _pose(solution.camera, view)
            if pose is not None:
                errors.append(_errors(solution.camera, view, pose))
    return _rms(np.concatenate(errors)) if errors else None


def _pose(camera: Camera, view: BoardView) -> tuple[Array, Array] | None:
    """Of the board, from the directions of its corners."""
    rays = camera.bearings(view.uv)
    flat = rays[:, :2] / rays[:, 2:]
    good, turn, shift = cv2.solvePnP(view.places, flat, np.eye(3), None)
    return (np.ravel(turn), np.ravel(shift)) if good else None


def _sigmas(views: list[BoardView], solution: _Solution, residual: Array) -> dict[str, float]:
    """From the normal equations with each view's pose eliminated (Schur complement)."""
    camera = solution.camera
    count = 4 + len(camera.distortion)
    information = np.zeros((count, count))
    for view, pose in zip(views, solution.poses, strict=True):
        J_lens, J_pose = _jacobians(camera, view, pose)
        cross = J_lens.T @ J_pose
        information += J_lens.T @ J_lens - cross @ np.linalg.solve(J_pose.T @ J_pose, cross.T)
    free = max(residual.size - count - 6 * len(views), 1)
    variance_px2 = float(np.sum(residual**2)) / free
    scale = np.sqrt(np.diag(information))
    scaled = information / np.outer(scale, scale)
    if np.linalg.cond(scaled) > MOST_CONDITION:  # a pseudo-inverse would call it well known
        sigmas = np.full(count, np.inf)
    else:
        sigmas = np.sqrt(np.diag(np.linalg.inv(scaled)) * variance_px2) / scale
    terms = (
        ("k1", "k2", "k3", "k4") if camera.model == "fisheye" else ("k1", "k2", "p1", "p2", "k3")
    )
    return dict(zip((*NAMES, *terms), sigmas.tolist(), strict=True))


def _jacobians(camera: Camera, view: BoardView, pose: tuple[Array, Array]) -> tuple[Array, Array]:
    """Of the pixels (2n,) by the lens (2n, 4 + k) and by the pose (2n, 6)."""
    coefficients = np.array(camera.distortion)
    if camera.model == "fisheye":
        project = cv2.fisheye.projectPoints
        _, J = project(view.places[:, None], pose[0], pose[1], camera.K, coefficients)
        # Columns as OpenCV has them: f, c, k1 to k4, rotation, translation, skew.
        return np.asarray(J[:, :8], np.float64), np.asarray(J[:, 8:14], np.float64)
    _, J = cv2.projectPoints(view.places[:, None], pose[0], pose[1], camera.K, coefficients)
    # Columns as OpenCV has them: rotation, translation, f, c, k1 k2 p1 p2 k3.
    lens = J[:, 6 : 10 + len(coefficients)]
    return np.asarray(lens, np.float64), np.asarray(J[:, :6], np.float64)
