"""Paints buildings: roof faces lit by the sun, with courses, ridge, chimney and windows."""

import numpy as np

from vwnav.sim.scenery.drawing import Canvas
from vwnav.sim.scenery.landscape import Building, rectangle, spot, to_ne
from vwnav.sim.scenery.looks import Look
from vwnav.types import Array

_ROOFS = ((142, 84, 66), (118, 72, 60), (92, 90, 92), (70, 70, 74), (150, 120, 98), (164, 160, 154))
_SHEETS = ((176, 180, 182), (132, 138, 142), (96, 112, 104), (150, 84, 70), (200, 202, 200))


def footprint(b: Building) -> Array:
    """Corners (4, 2) of the eaves."""
    return rectangle(b.centre_ne, b.length_m, b.width_m, b.azimuth_rad)


def ridge_line(b: Building) -> Array:
    """Ends (2, 2) of the ridge."""
    cut = b.width_m / 2.0 if b.roof == "hip" else 0.0
    half = max(b.length_m / 2.0 - cut, 0.2)
    ends = np.array([[-half, 0.0], [half, 0.0]])
    return to_ne(ends, b.centre_ne, b.azimuth_rad)


def paint_building(canvas: Canvas, b: Building, look: Look) -> None:
    """Draw a building of one look."""
    if canvas.box(footprint(b), 1.0) is None:
        return
    rng = np.random.default_rng(b.seed)
    pool = _SHEETS if b.roof in ("sheet", "flat") else _ROOFS
    colour = np.array(pool[int(rng.integers(len(pool)))], np.float64)[::-1] * rng.uniform(0.9, 1.1)
    fresh = np.random.default_rng([b.seed, look.seed])
    if fresh.uniform() < 0.06:  # roofed anew between the two days
        colour = np.array(pool[int(fresh.integers(len(pool)))], np.float64)[::-1]
    foot, ridge = footprint(b), ridge_line(b)
    if b.roof == "flat":
        _face(canvas, b, foot, colour, look, np.zeros(2))
        canvas.blend(canvas.ribbon(np.vstack([foot, foot[:1]]), 0.35), (colour * 1.1), 0.8)
    else:
        _pitched(canvas, b, foot, ridge, colour, look)
    _fittings(canvas, b, rng, look)


def _pitched(
    canvas: Canvas, b: Building, foot: Array, ridge: Array, colour: Array, look: Look
) -> None:
    rise = (b.ridge_m - b.eaves_m) / (b.width_m / 2.0)
    right = spot(np.zeros(2), b.azimuth_rad, 0.0, 1.0) * rise
    along = spot(np.zeros(2), b.azimuth_rad, 1.0, 0.0) * rise
    _face(canvas, b, np.array([foot[0], foot[1], ridge[1], ridge[0]]), colour, look, -right)
    _face(canvas, b, np.array([foot[2], foot[3], ridge[0], ridge[1]]), colour, look, right)
    if b.roof == "hip":
        _face(canvas, b, np.array([foot[1], foot[2], ridge[1]]), colour, look, along)
        _face(canvas, b, np.array([foot[3], foot[0], ridge[0]]), colour, look, -along)
    canvas.blend(canvas.ribbon(ridge, 0.25), colour * 1.15, 0.7)


def _face(
    canvas: Canvas, b: Building, polygon: Array, colour: Array, look: Look, slope: Array
) -> None:
    """One face; `slope` (2,) north, east is the horizontal part of its normal per unit of up."""
    patch = canvas.polygon(polygon)
    if patch is None:
        return
    normal = np.array([slope[0], slope[1], 1.0]) / np.sqrt(1.0 + slope @ slope)
    light = 0.42 + 0.78 * max(0.0, float(normal @ look.sun())) / max(look.sun()[2] + 0.25, 0.5)
    window = canvas.window
    north = (window.north_m()[patch.rows] - b.north_m).astype(np.float32)[:, None]
    east = (window.east_m()[patch.cols] - b.east_m).astype(np.float32)[None, :]
    turn = b.azimuth_rad
    along = north * np.cos(turn) + east * np.sin(turn)
    across = -north * np.sin(turn) + east * np.cos(turn)
    period = 1.1 if b.roof == "sheet" else 0.33
    axis = along if b.roof == "sheet" else across
    seen = np.clip(period / window.m_per_px / 3.0 - 0.6, 0.0, 1.0)
    courses = np.float32(0.07 * seen) * np.sin(2.0 * np.pi / period * axis)
    stains = patch.cut(canvas.noise.fractal(3.2, 0.1, 0.75, 10))
    value = np.float32(light) * (1.0 + courses + np.float32(0.05) * stains)
    canvas.blend(patch, colour.astype(np.float32) * value[..., None].astype(np.float32))


def _fittings(canvas: Canvas, b: Building, rng: np.random.Generator, look: Look) -> None:
    """Chimneys, roof windows and solar panels."""
    half = np.array([b.length_m, b.width_m]) / 2.0
    spots: list[tuple[float, float, float, float, tuple[float, float, float]]] = []
    if b.roof in ("gable", "hip"):
        spots.append((rng.uniform(-0.5, 0.5), 0.12, 0.9, 0.7, (64.0, 66.0, 92.0)))
        for _ in range(int(rng.integers(0, 4))):
            spots.append((rng.uniform(-0.7, 0.7), rng.choice([-0.5, 0.5]), 0.8, 1.2, (58, 54, 50)))
        if rng.uniform() < 0.25:
            spots.append((rng.uniform(-0.2, 0.2), 0.5, 5.0, 2.4, (70.0, 46.0, 38.0)))
    else:
        for _ in range(int(rng.integers(1, 7))):
            lamp = (198.0, 204.0, 204.0)
            spots.append((rng.uniform(-0.85, 0.85), rng.uniform(-0.8, 0.8), 1.6, 1.2, lamp))
    for along, across, length, width, colour in spots:
        place = spot(b.centre_ne, b.azimuth_rad, along * half[0], across * half[1])
        box = rectangle(place, length, width, b.azimuth_rad)
        canvas.scale(canvas.polygon(box + look.shadow_per_m() * 0.6), 0.75)
        canvas.blend(canvas.polygon(box), np.array(colour, np.float32))
