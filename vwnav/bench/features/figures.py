"""Images of matches to look at: image and map side by side, joined by lines."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.bench.features.scoring import SceneResult
from vwnav.types import Array, Gray

_GREEN, _RED, _WHITE = (60, 220, 60), (60, 60, 230), (240, 240, 240)
_GAP_PX, _TITLE_PX, _MARGIN_PX = 12, 34, 40
_SIDE_PX = 640  # of each half, about
_FAINT = 0.3  # of the wrong matches
_SHIFT = 3  # OpenCV draws to an eighth of a pixel


def write_figures(folder: Path, samples: dict[str, list[SceneResult]]) -> None:
    """Write `GROUP_METHOD.jpg` for each method on one scene of each group."""
    folder.mkdir(parents=True, exist_ok=True)
    for group, outcomes in samples.items():
        for outcome in outcomes:
            image = draw(outcome)
            name = folder / f"{group}_{outcome.method}.jpg"
            cv2.imwrite(str(name), image, [cv2.IMWRITE_JPEG_QUALITY, 90])


def draw(outcome: SceneResult) -> NDArray[np.uint8]:
    """Inliers green, other matches faint red; the map is cut about the true place."""
    scene = outcome.scene
    rows, columns = np.nonzero(scene.mask)
    low0 = np.array([columns.min(), rows.min()], np.float64)
    high0 = np.array([columns.max(), rows.max()]) + 1.0
    half = (high0 - low0) / 2.0 + _MARGIN_PX
    map_wh = np.array(scene.map_.gray.shape[::-1], np.float64)
    low1 = np.maximum(np.floor(scene.point1_uv - half), 0.0)
    high1 = np.minimum(np.ceil(scene.point1_uv + half), map_wh)
    zoom = _SIDE_PX / max(*(high0 - low0), *(high1 - low1))
    left, right = (
        _cut(np.where(scene.mask, scene.image, 0).astype(np.uint8), low0, high0, zoom),
        _cut(scene.map_.gray, low1, high1, zoom),
    )
    height = max(left.shape[0], right.shape[0]) + _TITLE_PX
    canvas = np.full((height, left.shape[1] + _GAP_PX + right.shape[1], 3), 24, np.uint8)
    origin1 = np.array([left.shape[1] + _GAP_PX, _TITLE_PX], np.float64)
    canvas[_TITLE_PX : _TITLE_PX + left.shape[0], : left.shape[1]] = left
    canvas[_TITLE_PX : _TITLE_PX + right.shape[0], left.shape[1] + _GAP_PX :] = right
    seen = np.all((outcome.uv1 >= low1) & (outcome.uv1 < high1), axis=1)
    ends0 = (outcome.uv0 - low0 + 0.5) * zoom - 0.5 + (0.0, _TITLE_PX)
    ends1 = (outcome.uv1 - low1 + 0.5) * zoom - 0.5 + origin1
    wrong = canvas.copy()
    _lines(wrong, ends0, ends1, seen & ~outcome.right, _RED)
    canvas = cv2.addWeighted(wrong, _FAINT, canvas, 1.0 - _FAINT, 0.0).astype(np.uint8)
    _lines(canvas, ends0, ends1, seen & outcome.right, _GREEN)
    _title(canvas, outcome)
    return canvas


def _cut(gray: Gray, low: Array, high: Array, zoom: float) -> NDArray[np.uint8]:
    (u0, v0), (u1, v1) = low.astype(int), high.astype(int)
    size = (round((u1 - u0) * zoom), round((v1 - v0) * zoom))
    method = cv2.INTER_AREA if zoom < 1.0 else cv2.INTER_CUBIC
    part = cv2.resize(gray[v0:v1, u0:u1], size, interpolation=method)
    return np.asarray(cv2.cvtColor(part, cv2.COLOR_GRAY2BGR), np.uint8)


def _lines(
    canvas: NDArray[np.uint8],
    ends0: Array,
    ends1: Array,
    chosen: NDArray[np.bool_],
    colour: tuple[int, int, int],
) -> None:
    scale = float(2**_SHIFT)
    for end0, end1 in zip(ends0[chosen], ends1[chosen], strict=True):
        a, b = ((end * scale).round().astype(int).tolist() for end in (end0, end1))
        cv2.line(canvas, a, b, colour, 1, cv2.LINE_AA, _SHIFT)
        for end in (a, b):
            cv2.circle(canvas, end, round(2.5 * scale), colour, 1, cv2.LINE_AA, _SHIFT)


def _title(canvas: NDArray[np.uint8], outcome: SceneResult) -> None:
    scene = outcome.scene
    unit = scene.map_.unit
    placed = f"{outcome.place_error:.1f} {unit} off" if np.isfinite(outcome.place_error) else "lost"
    text = (
        f"{outcome.method} on {scene.group}, {scene.name}: "
        f"{int(outcome.right.sum())} inliers of {len(outcome.uv0)} matches, {placed}"
    )
    cv2.putText(canvas, text, (10, 23), cv2.FONT_HERSHEY_SIMPLEX, 0.55, _WHITE, 1, cv2.LINE_AA)
