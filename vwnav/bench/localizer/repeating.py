"""Ground that repeats: what looks alike turned or shifted may be refused, but not mistaken."""

import math
from collections.abc import Callable, Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.bench.features.scenes import generator
from vwnav.bench.localizer.boards import LEVELS, LOOKS_AN_IMAGE, pair_looks
from vwnav.bench.localizer.looks import ZOOM, Board, SeenGround, map_pixel
from vwnav.maps.build.raster import DrawnSource, array_source, level_georeference
from vwnav.types import Gray

SIDE_PX = 1000
DRAWN_PX = 0.1  # error of the truth: none but that of drawing
_CANVAS_PX = 1480  # turned by any angle it fills the image
TEXTURE = (3.0, 6.0)  # gray values: what both days have, and what one day has

Canvas = NDArray[np.float32]
Drawing = Callable[[Canvas, np.random.Generator], None]


def repeating_boards(looks: int, only: str | None) -> Iterator[Board]:
    """Drawn maps of each kind of ground, each looked at on another day."""
    for kind, draw in KINDS.items():
        if only not in (None, kind):
            continue
        for number in range(-(-looks // LOOKS_AN_IMAGE)):
            corner_px = map_pixel((0, 0))
            source, ground = drawn(kind, draw, number, corner_px, TEXTURE)
            found = pair_looks(
                kind, f"{kind} {number}", ground, corner_px, DRAWN_PX, searches=LOOKS_AN_IMAGE
            )
            yield Board([source], LEVELS, list(found))


def drawn(
    kind: str, draw: Drawing, number: int, corner_px: tuple[int, int], texture: tuple[float, float]
) -> tuple[DrawnSource, SeenGround]:
    """A map of a drawing, its first pixel at a global one of `ZOOM`, and how another day looks."""
    map_, today = (_day(kind, draw, number, day, texture) for day in (0, 1))
    image = np.asarray(cv2.cvtColor(map_, cv2.COLOR_GRAY2BGR), np.uint8)
    name, everywhere = f"{kind} {number}", np.ones(map_.shape, np.bool_)
    source = array_source(image, level_georeference(ZOOM, *corner_px), name=name)
    return source, SeenGround(today, everywhere, np.eye(3), everywhere)


def _day(kind: str, draw: Drawing, number: int, day: int, texture: tuple[float, float]) -> Gray:
    """One drawing; the plan and a faint texture last, the rest is of the day."""
    lasting, passing = generator(kind, number), generator(f"{kind} day", number, day)
    canvas = np.full((_CANVAS_PX, _CANVAS_PX), 105.0, np.float32)
    canvas += _texture(lasting, texture[0])
    draw(canvas, lasting)
    canvas += _texture(passing, texture[1])
    turn = cv2.getRotationMatrix2D((_CANVAS_PX / 2, _CANVAS_PX / 2), lasting.uniform(0, 360), 1.0)
    turn[:, 2] = turn[:, 2] - (_CANVAS_PX - SIDE_PX) / 2
    turned = cv2.warpAffine(canvas, turn, (SIDE_PX, SIDE_PX), flags=cv2.INTER_LINEAR)
    tone = passing.uniform(0.85, 1.1) * cv2.GaussianBlur(turned, (0, 0), 0.7)
    return np.asarray(np.clip(tone + passing.normal(0.0, 2.0, tone.shape), 0, 255), np.uint8)


def _texture(rng: np.random.Generator, sigma: float) -> Canvas:
    """Noise of several sizes."""
    total = np.zeros((_CANVAS_PX, _CANVAS_PX), np.float32)
    for size_px in (4, 12, 40):
        coarse = rng.normal(0.0, sigma, (_CANVAS_PX // size_px + 2,) * 2).astype(np.float32)
        side_wh = (_CANVAS_PX, _CANVAS_PX)
        total += np.asarray(cv2.resize(coarse, side_wh, interpolation=cv2.INTER_CUBIC), np.float32)
    return total / np.float32(math.sqrt(3.0))


def _crossings(canvas: Canvas, rng: np.random.Generator) -> None:
    """Straight roads that cross at right angles, all alike, fields between them."""
    step, width = int(rng.integers(150, 230)), int(rng.integers(10, 18))
    for at in range(step // 2, _CANVAS_PX, step):
        for road in (canvas[:, at : at + width], canvas[at : at + width]):
            road[:] = 165.0
    for at in range(step // 2, _CANVAS_PX, step):
        for line in (canvas[:, at + width // 2], canvas[at + width // 2]):
            line[::12] = line[1::12] = line[2::12] = 220.0


def _houses(canvas: Canvas, rng: np.random.Generator) -> None:
    """Rows of equal houses along streets."""
    street, house = int(rng.integers(80, 110)), int(rng.integers(36, 48))
    for y in range(0, _CANVAS_PX, street):
        canvas[y : y + 10] = 150.0
        for x in range(0, _CANVAS_PX, house):
            canvas[y + 24 : y + 46, x + 6 : x + 32] = 190.0
            canvas[y + 35 : y + 46, x + 6 : x + 32] = 135.0
            canvas[y + 46 : y + 50, x + 8 : x + 34] = 55.0
            canvas[y + 10 : y + 24, x + 16 : x + 20] = 150.0


def _vineyard(canvas: Canvas, rng: np.random.Generator) -> None:
    """Rows of vines in blocks of one size with a track between them."""
    row, block = int(rng.integers(8, 13)), int(rng.integers(260, 360))
    canvas += 25.0
    for x in range(0, _CANVAS_PX, row):
        canvas[:, x : x + row // 2] = 60.0
    for y in range(block // 2, _CANVAS_PX, block):
        canvas[y : y + 14] = 170.0


def sand(canvas: Canvas, rng: np.random.Generator) -> None:
    """Nothing that stands out."""


def _runway(canvas: Canvas, rng: np.random.Generator) -> None:
    """A runway that looks the same from both ends but for its numbers."""
    middle, half, width = _CANVAS_PX // 2, 430, 64
    left, right, top = middle - half, middle + half, middle - width // 2
    canvas[top : top + width, left:right] = 75.0
    for x in range(left + 90, right - 90, 40):
        canvas[middle - 1 : middle + 2, x : x + 20] = 225.0
    for end, step in ((left + 8, 1), (right - 9, -1)):
        for y in range(top + 6, top + width - 6, 10):
            canvas[y : y + 5, min(end, end + 30 * step) : max(end, end + 30 * step)] = 225.0
        for y in (top + 14, top + width - 22):
            at = end + 120 * step
            canvas[y : y + 8, min(at, at + 40 * step) : max(at, at + 40 * step)] = 225.0
    for end, text in ((left + 48, "09"), (right - 82, "27")):
        number = np.zeros(canvas.shape, np.uint8)
        cv2.putText(number, text, (end, middle + 8), cv2.FONT_HERSHEY_SIMPLEX, 0.8, 255, 2)
        canvas[number > 0] = 225.0
    canvas[top + width + 40 : top + width + 70, left:right] = 120.0
    canvas[top - 70 : top - 40, left:right] = 120.0
    for x in range(left, right, (right - left - 30) // 4):
        canvas[top - 70 : top, x : x + 30] = canvas[top + width : top + width + 70, x : x + 30] = (
            120
        )


KINDS: dict[str, Drawing] = {
    "crossings": _crossings,
    "houses": _houses,
    "vineyard": _vineyard,
    "runway": _runway,
}
