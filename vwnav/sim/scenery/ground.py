"""Paints the ground: fields, gardens, roads, tracks and water."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from vwnav.sim.scenery import materials
from vwnav.sim.scenery.drawing import Canvas, Patch, offset_line
from vwnav.sim.scenery.index import Index
from vwnav.sim.scenery.landscape import Cell, Landscape, Strip
from vwnav.sim.scenery.looks import Look
from vwnav.sim.scenery.materials import stripes
from vwnav.types import Array


def paint_ground(canvas: Canvas, land: Landscape, look: Look) -> NDArray[np.float32]:
    """Cover the canvas with everything that lies flat but the airfield; returns plain grass."""
    turf = materials.grass(canvas, look)
    canvas.bgr[...] = turf
    cells, strips = _indices(land)
    for cell in cells.near(canvas.window):
        _cell(canvas, cell, look, turf)
    near = strips.near(canvas.window)
    for strip in near:
        if strip.surface == "water":
            _stream(canvas, strip, look)
    for strip in near:
        if strip.surface in ("gravel", "dirt"):
            _track(canvas, strip, look, turf)
    for strip in near:
        if strip.surface == "asphalt":
            _road(canvas, strip, look)
    return turf


@lru_cache(maxsize=8)
def _indices(land: Landscape) -> tuple[Index[Cell], Index[Strip]]:
    return (
        Index(land.cells, [c.polygon for c in land.cells], 1.0),
        Index(land.strips, [s.points for s in land.strips], 12.0),
    )


def _cell(canvas: Canvas, cell: Cell, look: Look, turf: NDArray[np.float32]) -> None:
    match cell.land:
        case "arable":
            _arable(canvas, cell, look)
        case "meadow":
            _meadow(canvas, cell, look, turf)
        case "forest":
            floor = canvas.polygon(cell.polygon, 2.0)
            canvas.scale(floor, 0.72)
        case "yard":
            _yard(canvas, cell, look)
        case "garden":
            _garden(canvas, cell, turf)
        case "pond":
            _pond(canvas, cell, look)
        case "pasture":
            _pasture(canvas, cell, look, turf)


def _arable(canvas: Canvas, cell: Cell, look: Look) -> None:
    patch = canvas.polygon(cell.core, 0.6)
    if patch is None or patch.alpha.max() <= 0.0:
        return
    canvas.blend(patch, materials.crop(canvas, patch, cell, look))
    inner = canvas.polygon(cell.inner)
    if inner is not None:  # where machines turn, the soil is pressed and the crop thin
        _rim(canvas, patch, inner)


def _rim(canvas: Canvas, outer: Patch, inner: Patch) -> None:
    rim = outer.alpha.copy()
    top, left = inner.rows.start - outer.rows.start, inner.cols.start - outer.cols.start
    h, w = inner.alpha.shape
    rim[top : top + h, left : left + w] *= 1.0 - inner.alpha
    canvas.scale(Patch(outer.rows, outer.cols, rim), 0.95)


def _meadow(canvas: Canvas, cell: Cell, look: Look, turf: NDArray[np.float32]) -> None:
    """Hay meadow: on some days half mown, with swaths."""
    rng = np.random.default_rng([cell.seed, look.seed, 3])
    patch = canvas.polygon(cell.core, 0.6)
    if patch is None or patch.alpha.max() <= 0.0:
        return
    tone = rng.uniform(0.92, 1.1)
    canvas.blend(patch, patch.cut(turf) * np.array([0.96, 1.0, 1.0], np.float32) * np.float32(tone))
    if rng.uniform() < 0.6:
        stripes(canvas, patch, cell.row_rad, float(rng.choice([3.0, 6.0])), 0.035, look)


def _pasture(canvas: Canvas, cell: Cell, look: Look, turf: NDArray[np.float32]) -> None:
    """Grazed: shorter, with trodden ways to a corner and tufts the cattle leave."""
    patch = canvas.polygon(cell.polygon, 0.8)
    if patch is None:
        return
    canvas.blend(patch, patch.cut(turf) * np.array([0.98, 1.0, 0.98], np.float32))
    tufts = patch.cut(canvas.noise.fractal(3.2, 0.8, 0.8, materials.STONES))
    spots = np.clip(tufts * 0.9 - 1.0, 0.0, 1.0).astype(np.float32)
    canvas.scale(Patch(patch.rows, patch.cols, patch.alpha * spots), 0.8)
    rng = np.random.default_rng([cell.seed, 5])
    gate = cell.polygon[0]
    centre = cell.polygon.mean(axis=0)
    for _ in range(3):
        to = centre + rng.normal(0.0, 25.0, 2)
        path = np.linspace(gate, to, 12) + rng.normal(0.0, 1.6, (12, 2))
        worn = canvas.ribbon(path, 0.7, 0.3)
        canvas.blend(worn, materials.gravel_tone(look), 0.45)


def _yard(canvas: Canvas, cell: Cell, look: Look) -> None:
    patch = canvas.polygon(cell.polygon, 0.5)
    if patch is None:
        return
    worn = materials.gravel(canvas, look, 158.0)
    canvas.blend(patch, patch.cut(worn), 0.92)
    stains = patch.cut(canvas.noise.fractal(12.8, 1.6, 0.6, materials.STONES))
    dark = np.clip(stains * 0.5, 0.0, 0.6).astype(np.float32)
    canvas.scale(Patch(patch.rows, patch.cols, patch.alpha * dark), 0.6)


def _garden(canvas: Canvas, cell: Cell, turf: NDArray[np.float32]) -> None:
    rng = np.random.default_rng([cell.seed, 7])
    patch = canvas.polygon(cell.polygon)
    if patch is None:
        return
    tone = np.array([0.94, 1.04, 0.97]) * rng.uniform(0.85, 1.12)
    canvas.blend(patch, patch.cut(turf) * tone.astype(np.float32))
    fence = np.vstack([cell.polygon, cell.polygon[:1]])
    canvas.scale(canvas.ribbon(fence, 0.2), 0.8)
    corners = cell.polygon
    for _ in range(int(rng.integers(1, 4))):  # vegetable beds and terraces
        a, b = rng.uniform(0.1, 0.75, 2)
        p = corners[0] + a * (corners[1] - corners[0]) + b * (corners[3] - corners[0])
        ex = (corners[1] - corners[0]) * rng.uniform(0.08, 0.22)
        ey = (corners[3] - corners[0]) * rng.uniform(0.06, 0.16)
        bed = canvas.polygon(np.array([p, p + ex, p + ex + ey, p + ey]))
        paved = rng.uniform() < 0.4
        colour = np.array([150.0, 155.0, 158.0]) if paved else np.array([62.0, 80.0, 96.0])
        canvas.blend(bed, colour.astype(np.float32), 0.8)


def _pond(canvas: Canvas, cell: Cell, look: Look) -> None:
    shore = np.vstack([cell.polygon, cell.polygon[:1]])
    canvas.scale(canvas.ribbon(shore, 5.0, 1.2), 0.8)
    pool = canvas.polygon(cell.polygon, 0.5)
    if pool is not None:
        canvas.blend(pool, pool.cut(materials.water(canvas, look)))


def _stream(canvas: Canvas, strip: Strip, look: Look) -> None:
    canvas.scale(canvas.ribbon(strip.points, strip.width_m + 5.0, 1.0), 0.82)
    bed = canvas.ribbon(strip.points, strip.width_m, 0.6)
    if bed is not None:
        canvas.blend(bed, bed.cut(materials.water(canvas, look)))


def _track(canvas: Canvas, strip: Strip, look: Look, turf: NDArray[np.float32]) -> None:
    """Two wheel ruts with grass between them, on a verge."""
    verge = canvas.ribbon(strip.points, strip.width_m + 2.5, 0.6)
    if verge is None:
        return
    canvas.blend(verge, verge.cut(turf), 0.9)
    level = 172.0 if strip.surface == "gravel" else 138.0
    stone = materials.gravel(canvas, look, level)
    body = canvas.ribbon(strip.points, strip.width_m, 0.4)
    if body is not None:
        canvas.blend(body, body.cut(stone), 0.75 if strip.surface == "gravel" else 0.35)
    for side in (-0.85, 0.85):
        rut = canvas.ribbon(offset_line(strip.points, side), 0.75, 0.25)
        if rut is not None:
            canvas.blend(rut, rut.cut(stone), 0.85)


def _road(canvas: Canvas, strip: Strip, look: Look) -> None:
    body = canvas.ribbon(strip.points, strip.width_m)
    shoulder = canvas.ribbon(strip.points, strip.width_m + 1.6, 0.4)
    if shoulder is None or body is None:
        return
    canvas.blend(shoulder, shoulder.cut(materials.gravel(canvas, look, 150.0)), 0.8)
    rng = np.random.default_rng([strip.seed, 1])
    canvas.blend(body, body.cut(materials.asphalt(canvas, look, rng.uniform(112.0, 140.0))))
    for side in (-0.22, 0.22):
        wheels = canvas.ribbon(offset_line(strip.points, side * strip.width_m), 0.8)
        canvas.scale(wheels, 0.955)
    if strip.width_m > 5.5:
        paint = np.array([205.0, 208.0, 208.0], np.float32)
        for side in (-0.5, 0.5):
            edge = offset_line(strip.points, side * (strip.width_m - 0.5))
            canvas.blend(canvas.ribbon(edge, 0.12), paint, 0.75)
        for dash in _dashes(strip).near(canvas.window):
            canvas.blend(canvas.ribbon(dash, 0.12), paint, 0.8)


@lru_cache(maxsize=64)
def _dashes(strip: Strip) -> Index[Array]:
    """The dashes, each (3, 2), of a road's broken centre line: 3 m long, 9 m apart."""
    step = np.linalg.norm(np.diff(strip.points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    result = []
    for start in np.arange(0.0, along[-1] - 3.0, 12.0):
        t = start + np.array([0.0, 1.5, 3.0])
        north, east = (np.interp(t, along, strip.points[:, k]) for k in range(2))
        result.append(np.stack([north, east], axis=1))
    return Index(result, result, 0.5)
