"""Paints the airfield: mown strip, runway with its marks and wear, taxiway and apron."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from vwnav.sim.scenery import markings, materials
from vwnav.sim.scenery.drawing import Canvas, Patch
from vwnav.sim.scenery.index import Index
from vwnav.sim.scenery.landscape import Airfield
from vwnav.sim.scenery.looks import Look
from vwnav.sim.scenery.markings import Stroke
from vwnav.sim.scenery.materials import stripes
from vwnav.types import Array

_PAINT = np.array([212.0, 216.0, 216.0], np.float32)
_YELLOW = np.array([70.0, 170.0, 196.0], np.float32)
_REACH_M = 3.0


def paint_airfield(canvas: Canvas, field: Airfield, look: Look, turf: NDArray[np.float32]) -> None:
    """Draw the airfield over the ground that is there."""
    if canvas.box(field.strip, 5.0) is None:
        return
    turf_lines, surfaces, wear, marks = _shapes(field, look)
    _strip(canvas, field, look, turf)
    _strokes(canvas, turf_lines)
    half, wide = field.length_m / 2.0, field.width_m / 2.0
    box = field.to_ne(np.array([[-half, -wide], [half, -wide], [half, wide], [-half, wide]]))
    for area, level in ((box, 126.0), (field.taxiway, 138.0), (field.apron, 160.0)):
        patch = canvas.polygon(area, 0.15)
        if patch is not None:
            canvas.blend(patch, patch.cut(materials.asphalt(canvas, look, level)))
    _strokes(canvas, surfaces)
    _strokes(canvas, wear)
    for mark in marks.near(canvas.window):
        _paint(canvas, canvas.polygon(mark), look, _PAINT)
    corners = field.taxiway
    line = np.array([(corners[0] + corners[1]) / 2, (corners[2] + corners[3]) / 2])
    _paint(canvas, canvas.ribbon(line, 0.2), look, _YELLOW)
    _windsock(canvas, field)


@lru_cache(maxsize=16)
def _shapes(
    field: Airfield, look: Look
) -> tuple[Index[Stroke], Index[Stroke], Index[Stroke], Index[Array]]:
    """Turf lines, surfaces, wear and white marks of one day, ready to be picked by window."""
    darker = look.season in ("late_summer", "autumn")
    groups = (
        markings.turf_lines(field, darker),
        markings.pavement(field) + markings.slabs(field),
        markings.wear(field, look.seed),
    )
    turf, surfaces, wear = (Index(g, [s.points for s in g], _REACH_M) for g in groups)
    marks = markings.white_marks(field)
    return turf, surfaces, wear, Index(marks, marks, 0.0)


def _strokes(canvas: Canvas, strokes: Index[Stroke]) -> None:
    for stroke in strokes.near(canvas.window):
        if stroke.width_m is None:
            patch = canvas.polygon(stroke.points, stroke.ragged_m)
        else:
            patch = canvas.ribbon(stroke.points, stroke.width_m, stroke.ragged_m)
        canvas.scale(patch, stroke.gain)


def _paint(canvas: Canvas, patch: Patch | None, look: Look, colour: NDArray[np.float32]) -> None:
    """Road paint, worn in places; it is renewed or wears on between the days."""
    if patch is None:
        return
    worn = patch.cut(canvas.noise.fractal(1.6, 0.1, 0.8, materials.STONES))
    day = patch.cut(canvas.noise.fractal(25.6, 6.4, 0.8, materials.day_salt(look, 9)))
    left = np.clip(0.72 + 0.18 * worn + 0.12 * day, 0.25, 0.95)
    canvas.blend(Patch(patch.rows, patch.cols, np.asarray(patch.alpha * left, np.float32)), colour)


def _strip(canvas: Canvas, field: Airfield, look: Look, turf: NDArray[np.float32]) -> None:
    """Mown grass with the stripes of the day."""
    patch = canvas.polygon(field.strip, 0.8)
    if patch is None:
        return
    canvas.blend(patch, patch.cut(turf) * np.array([0.97, 1.03, 1.0], np.float32))
    rng = np.random.default_rng([field.seed, look.seed, 11])
    heading = field.azimuth_rad + float(rng.choice([0.0, 0.0, 0.35, -0.5]))
    stripes(canvas, patch, heading, float(rng.choice([2.4, 3.2, 5.0])), 0.03, look)


def _windsock(canvas: Canvas, field: Airfield) -> None:
    """A white ring on the grass about the windsock's mast, and the orange sock."""
    centre = field.to_ne(np.array([[-0.22 * field.length_m, 40.0]]))[0]
    turn = np.linspace(0.0, 2.0 * np.pi, 41)
    ring = centre + 6.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    canvas.blend(canvas.ribbon(ring, 0.8), _PAINT, 0.75)
    sock = centre + np.array([[0.25, 0.0], [-0.25, 0.0], [-0.12, 2.4], [0.12, 2.4]])
    canvas.blend(canvas.polygon(sock), np.array([40.0, 110.0, 225.0], np.float32))
