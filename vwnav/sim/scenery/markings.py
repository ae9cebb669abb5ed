"""What is drawn on an airfield: paint, joints, repairs, cracks, tyre marks, drains and ruts."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vwnav.sim.scenery.landscape import Airfield
from vwnav.types import Array

# Strokes of digits on a grid 2 wide and 4 high, the foot at 0.
_STROKES: dict[str, list[list[tuple[float, float]]]] = {
    "0": [[(0, 0), (0, 4), (2, 4), (2, 0), (0, 0)]],
    "1": [[(0.4, 3.2), (1, 4), (1, 0)]],
    "2": [[(0, 4), (2, 4), (2, 2), (0, 2), (0, 0), (2, 0)]],
    "3": [[(0, 4), (2, 4), (2, 0), (0, 0)], [(0.4, 2), (2, 2)]],
    "4": [[(0, 4), (0, 1.6), (2, 1.6)], [(1.5, 4), (1.5, 0)]],
    "5": [[(2, 4), (0, 4), (0, 2), (2, 2), (2, 0), (0, 0)]],
    "6": [[(2, 4), (0, 4), (0, 0), (2, 0), (2, 2), (0, 2)]],
    "7": [[(0, 4), (2, 4), (0.8, 0)]],
    "8": [[(0, 0), (0, 4), (2, 4), (2, 0), (0, 0)], [(0, 2), (2, 2)]],
    "9": [[(0, 0), (2, 0), (2, 4), (0, 4), (0, 2), (2, 2)]],
}


@dataclass(frozen=True, slots=True, eq=False)
class Stroke:
    """A line (n, 2) of `width_m`, or a polygon where that is None, that scales what it covers.

    Attributes:
        gain: 1 leaves the ground as it is, 0.5 halves its brightness.
        ragged_m: by how much its edge wanders, 0 for a sharp one.
    """

    points: Array
    width_m: float | None
    gain: float
    ragged_m: float = 0.0


def white_marks(field: Airfield) -> list[Array]:
    """White marks of the runway as polygons (n, 2); the first threshold's bars come first."""
    marks: list[Array] = []
    half, wide = field.length_m / 2.0, field.width_m

    def bar(a0: float, a1: float, c0: float, c1: float) -> None:
        marks.append(field.to_ne(np.array([[a0, c0], [a1, c0], [a1, c1], [a0, c1]])))

    pitch = (wide - 3.0) / 8.0
    for end in (-1.0, 1.0):
        for k in range(8):
            c = -wide / 2 + 1.5 + pitch * (k + 0.2)
            bar(end * (half - 6.0), end * (half - 30.0), c, c + 0.6 * pitch)
        for c in (-wide / 4 - 1.5, wide / 4 - 1.5):
            bar(end * (half - 150.0), end * (half - 172.0), c, c + 3.0)
    for a in np.arange(-half + 60.0, half - 75.0, 50.0):
        bar(a, a + 28.0, -0.23, 0.23)
    for c in (-wide / 2 + 0.4, wide / 2 - 0.7):
        bar(-half, half, c, c + 0.3)
    return marks + _numbers(field) + _landing_pad()


def _numbers(field: Airfield) -> list[Array]:
    """The runway's numbers: its heading in tens of degrees, to be read on approach."""
    marks = []
    for end in (-1.0, 1.0):
        heading = field.azimuth_rad + (0.0 if end < 0 else np.pi)
        digits = f"{(round(np.degrees(heading) / 10.0) - 1) % 36 + 1:02d}"
        for k, digit in enumerate(digits):
            for stroke in _STROKES[digit]:
                grid = np.array(stroke, np.float64)
                up = field.length_m / 2.0 - 36.0 - grid[:, 1] * 2.4
                side = (grid[:, 0] - 1.0) * 1.4 + (k - 0.5) * 4.6
                line = np.stack([end * up, -end * side], axis=1)
                marks += [_thick(field.to_ne(line[i : i + 2]), 0.9) for i in range(len(line) - 1)]
    return marks


def _thick(ends: Array, width_m: float) -> Array:
    """The rectangle (4, 2) about a segment (2, 2), with square ends."""
    step = ends[1] - ends[0]
    step = step / np.hypot(*step)
    out = np.array([-step[1], step[0]]) * width_m / 2.0
    a, b = ends[0] - step * width_m / 2.0, ends[1] + step * width_m / 2.0
    return np.array([a + out, b + out, b - out, a - out])


def _landing_pad() -> list[Array]:
    """The pad at home: a painted ring with an H, 5 m across."""
    turn = np.linspace(0.0, 2.0 * np.pi, 33)
    ring = 2.5 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    marks = [np.array([a, b, b * 0.9, a * 0.9]) for a, b in pairwise(ring)]
    letter = ([[1, -0.6], [-1, -0.6]], [[1, 0.6], [-1, 0.6]], [[0, -0.35], [0, 0.35]])
    return marks + [_thick(np.array(line, np.float64), 0.25) for line in letter]


def pavement(field: Airfield) -> list[Stroke]:
    """Paving lanes of the runway, each batch its own grey, with their joints."""
    half, wide = field.length_m / 2.0, field.width_m / 2.0
    rng = np.random.default_rng([field.seed, 13])
    lanes = np.linspace(-wide, wide, 6)
    strokes = []
    for c0, c1 in pairwise(lanes):
        for a in np.arange(-half, half, 120.0):
            end = min(a + 120.0, half)
            lane = field.to_ne(np.array([[a, c0], [end, c0], [end, c1], [a, c1]]))
            strokes.append(Stroke(lane, None, 1.0 + float(rng.normal(0.0, 0.018))))
    for c in lanes[1:-1]:
        strokes.append(Stroke(field.to_ne(np.array([[-half, c], [half, c]])), 0.05, 0.6))
    return strokes


def slabs(field: Airfield) -> list[Stroke]:
    """Concrete slabs of 5 m on the apron, some replaced, joints filled with tar."""
    rng = np.random.default_rng([field.seed, 14])
    origin = field.apron[0]
    along, across = field.apron[1] - origin, field.apron[3] - origin
    nx, ny = int(np.hypot(*along) / 5.0), int(np.hypot(*across) / 5.0)
    tones = rng.normal(0.0, 0.025, (nx, ny)) + (rng.uniform(size=(nx, ny)) < 0.06) * 0.14
    strokes = []
    for i, j in np.ndindex(nx, ny):
        p = origin + along * i / nx + across * j / ny
        slab = np.array([p, p + along / nx, p + along / nx + across / ny, p + across / ny])
        strokes.append(Stroke(slab, None, 1.0 + float(tones[i, j])))
    for i in range(nx + 1):
        p = origin + along * i / nx
        strokes.append(Stroke(np.array([p, p + across]), 0.06, 0.5))
    for j in range(ny + 1):
        p = origin + across * j / ny
        strokes.append(Stroke(np.array([p, p + along]), 0.06, 0.5))
    return strokes


def wear(field: Airfield, day_seed: int) -> list[Stroke]:
    """Repairs and cracks of the runway that stay, a few of one day only, and its tyre marks."""
    strokes = []
    half, wide = field.length_m / 2.0, field.width_m / 2.0
    for salt, repairs, cracks in ((15, 110, 190), (16 + day_seed, 6, 25)):
        rng = np.random.default_rng([field.seed, salt])
        for _ in range(repairs):
            a, c = rng.uniform([-half, -wide], [half - 9.0, wide - 3.0])
            da, dc = rng.uniform(1.5, 9.0), rng.uniform(0.8, 3.0)
            box = field.to_ne(np.array([[a, c], [a + da, c], [a + da, c + dc], [a, c + dc]]))
            strokes.append(Stroke(box, None, float(rng.choice([0.6, 0.74, 1.2])), 0.1))
        for _ in range(cracks):
            line = field.to_ne(_crack(rng, half, wide))
            width_m = float(rng.uniform(0.12, 0.32)) if rng.uniform() < 0.5 else 0.03
            strokes.append(Stroke(line, width_m, 0.5))  # wide ones are sealed with tar
    rng = np.random.default_rng([field.seed, day_seed, 17])
    for _ in range(70):
        end = float(rng.choice([-1.0, 1.0]))
        a = end * (half - rng.gamma(5.0, 26.0))
        c, run = rng.normal(0.0, 1.5), rng.uniform(4.0, 26.0)
        skid = np.array([[a, c], [a - end * run, c + rng.normal(0.0, 0.2)]])
        strokes.append(Stroke(field.to_ne(skid), float(rng.uniform(0.15, 0.3)), 0.84))
    return strokes


def _crack(rng: np.random.Generator, half_m: float, wide_m: float) -> Array:
    """A jagged line: across the runway as a rule, along it now and then."""
    n = 24
    jitter = np.cumsum(rng.normal(0.0, 0.16, n))
    jitter -= np.linspace(0.0, jitter[-1], n)
    a = rng.uniform(-half_m, half_m - 40.0)
    if rng.uniform() < 0.7:
        c = np.linspace(-wide_m, wide_m * rng.choice([1.0, 1.0, 0.1]), n)
        return np.stack([a + jitter + rng.normal(0.0, 0.3) * c / wide_m, c], axis=1)
    along = np.linspace(0.0, rng.uniform(6.0, 40.0), n)
    return np.stack([a + along, rng.uniform(-wide_m, wide_m) * 0.9 + jitter], axis=1)


def turf_lines(field: Airfield, wet_is_darker: bool) -> list[Stroke]:
    """Drains under the turf, wet lines that stay, and old wheel ruts."""
    rng = np.random.default_rng([field.seed, 12])
    low, high = field.length_m / 2 + 55.0, 60.0
    strokes = []
    for a in np.arange(-low, low, rng.uniform(16.0, 24.0)):
        line = np.array([[a, -high], [a + rng.normal(0.0, 9.0), high]])
        gain = 0.9 if wet_is_darker else 1.07
        strokes.append(Stroke(field.to_ne(line), 1.1, gain, 0.5))
    for _ in range(7):
        line = np.linspace(rng.uniform([-low, -60], [low, 90]), rng.uniform([-low, -60], [low, 90]))
        line += np.sin(np.linspace(0, rng.uniform(2, 7), 50))[:, None] * rng.normal(0, 5, 2)
        for side in (-0.8, 0.8):
            strokes.append(Stroke(field.to_ne(line + np.array([0.0, side])), 0.5, 0.88, 0.3))
    return strokes
