"""Paints trees: crowns of spheres lit by the sun, and their shadows."""

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.sim.scenery.drawing import Canvas, Patch
from vwnav.sim.scenery.landscape import Plant
from vwnav.sim.scenery.looks import Look
from vwnav.types import Array


def _blobs(plant: Plant) -> Array:
    """Spheres of a crown (n, 4): north, east, height of the centre above ground, radius."""
    rng = np.random.default_rng(plant.seed)
    r, h = plant.radius_m, plant.height_m
    if plant.species == "conifer":
        level = np.linspace(0.0, 1.0, 9)
        size = r * (1.0 - 0.88 * level)
        turn = rng.uniform(0.0, 2.0 * np.pi, 9)
        shift = 0.28 * size
        return np.stack(
            [shift * np.cos(turn), shift * np.sin(turn), h * (0.25 + 0.75 * level) - size, size],
            axis=1,
        )
    count = 6 + int(4.0 * r)
    turn = rng.uniform(0.0, 2.0 * np.pi, count)
    out = r * 0.74 * np.sqrt(rng.uniform(0.0, 1.0, count))
    size = r * rng.uniform(0.22, 0.42, count)
    top = h * (0.95 - 0.4 * (out / r) ** 2) * rng.uniform(0.85, 1.05, count)
    return np.stack([out * np.cos(turn), out * np.sin(turn), top - size, size], axis=1)


def shade_plant(shade: NDArray[np.uint8], canvas: Canvas, plant: Plant, look: Look) -> None:
    """Add a tree's shadow to a mask (h, w), 255 for full shade."""
    per_m = look.shadow_per_m()
    bare = plant.species != "conifer" and look.leaf_cover() < 0.7
    value = 105 if bare else 240
    reach = plant.radius_m + float(np.hypot(*per_m)) * plant.height_m
    foot = np.array([[plant.north_m, plant.east_m]])
    if canvas.box(foot, reach) is None:
        return
    blobs = _blobs(plant)
    low = 0.35 if plant.species == "conifer" else 0.25
    for share in (low, 0.5 * (1.0 + low), 1.0):  # the crown's depth, from its skirt to its top
        centre = foot + blobs[:, :2] + per_m * np.maximum(blobs[:, 2:3] * share, 0.0)
        uv = np.round(canvas.window.uv(centre) * 16.0).astype(int).tolist()
        radii = np.round(blobs[:, 3] / canvas.window.m_per_px * 16.0).astype(int).tolist()
        for centre_px, radius in zip(uv, radii, strict=True):
            cv2.circle(shade, centre_px, radius, value, -1, cv2.LINE_AA, 4)


def paint_plant(canvas: Canvas, plant: Plant, look: Look) -> None:
    """A crown of spheres, each lit from the sun's side; bare crowns let the ground through."""
    window = canvas.window
    box = canvas.box(np.array([[plant.north_m, plant.east_m]]), plant.radius_m * 1.25)
    if box is None:
        return
    u0, v0, u1, v1 = box
    rows, cols = slice(v0, v1), slice(u0, u1)
    north = (window.north_m()[rows] - plant.north_m).astype(np.float32)[None, :, None]
    east = (window.east_m()[cols] - plant.east_m).astype(np.float32)[None, None, :]
    texture = canvas.noise.fractal(1.6, 0.1, 0.95, 9)[rows, cols]
    rough = np.maximum(1.0 + 0.28 * texture[None] / max(plant.radius_m, 1.0) ** 0.5, 0.0)
    blobs = _blobs(plant).astype(np.float32)
    value, cover = _crown(blobs, north, east, rough, look, window.m_per_px)
    rng = np.random.default_rng(plant.seed)
    colour, opacity = _foliage(plant, look, rng)
    value *= 1.0 + np.float32(0.2) * texture
    if opacity < 0.9:
        cover *= np.clip(opacity + 0.35 * texture, 0.05, 1.0)
    canvas.blend(Patch(rows, cols, cover), colour * value[..., None])


def _crown(
    blobs: NDArray[np.float32],
    north: NDArray[np.float32],
    east: NDArray[np.float32],
    rough: NDArray[np.float32],
    look: Look,
    m_per_px: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Brightness and coverage (h, w) of the upper surface of spheres (n, 4)."""
    bn, be, bz, br = (blobs[:, k, None, None] for k in range(4))
    dn, de = (north - bn) / br, (east - be) / br
    d2 = (dn * dn + de * de) * rough
    up = np.sqrt(np.maximum(1.0 - d2, 0.0))
    height = np.where(d2 < 1.0, bz + br * up, -1e3)
    top = np.argmax(height, axis=0)[None]
    sun = look.sun().astype(np.float32)
    lit = dn * sun[0] + de * sun[1] + up * sun[2]
    shade = np.take_along_axis(lit, top, axis=0)[0]
    peak = np.take_along_axis(height, top, axis=0)[0]
    low, high = float(bz.min()), float((bz + br).max())
    depth = np.clip((peak - low) / max(high - low, 0.1), 0.0, 1.0)
    edge = ((1.0 - np.sqrt(d2)) * br).max(axis=0)
    cover = np.clip(edge / m_per_px + 0.5, 0.0, 1.0)
    value = (0.34 + 0.72 * np.clip(shade, 0.0, 1.0)) * (0.62 + 0.45 * depth)
    return value.astype(np.float32), cover.astype(np.float32)


def _foliage(
    plant: Plant, look: Look, rng: np.random.Generator
) -> tuple[NDArray[np.float32], float]:
    """Colour (3,) BGR and opacity of a crown on that day."""
    if plant.species == "conifer":
        base = np.array([52.0, 72.0, 52.0]) * rng.uniform(0.8, 1.15)
        return base.astype(np.float32), 1.0
    rgb = np.array(look.leaves(), np.float64)
    if look.season == "autumn":
        turned = rng.uniform(0.0, 1.0)
        rgb = (1.0 - turned) * np.array([86.0, 90.0, 50.0]) + turned * rgb
    rgb = rgb * rng.uniform(0.82, 1.2) * (1.0 + rng.normal(0.0, 0.04, 3))
    if plant.species == "bush" and look.leaf_cover() < 1.0:
        return rgb[::-1].astype(np.float32), 0.5 * (1.0 + look.leaf_cover())
    return rgb[::-1].astype(np.float32), look.leaf_cover()
