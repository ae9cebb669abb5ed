"""Trees: woods, hedges and single ones."""

import numpy as np

from vwnav.sim.scenery.draft import Draft
from vwnav.sim.scenery.drawing import offset_line
from vwnav.sim.scenery.landscape import LookName, Plant, Species
from vwnav.types import Array

_SIZES: dict[Species, tuple[float, float]] = {
    "conifer": (1.6, 3.2),
    "broadleaf": (2.2, 5.5),
    "bush": (0.6, 1.9),
}


def plant(draft: Draft, north_m: float, east_m: float, species: Species) -> None:
    """Put one tree where the ground is free; one in twelve stands in one look only."""
    rng = draft.rng
    low, high = _SIZES[species]
    radius = float(rng.uniform(low, high))
    tall = {"conifer": 4.2, "broadleaf": 2.6, "bush": 1.5}[species]
    looks: tuple[LookName, ...] = ("map", "flight")
    if rng.uniform() < 0.08:
        looks = ("map",) if rng.uniform() < 0.5 else ("flight",)
    height = radius * tall * float(rng.uniform(0.8, 1.2))
    seed = int(rng.integers(2**31))
    if draft.ground.free(np.array([[north_m, east_m]]))[0]:
        draft.plants.append(Plant(north_m, east_m, radius, height, species, seed, looks))


def hedge(draft: Draft, line: Array, right_m: float, density: float) -> None:
    """Bushes and trees along a line (n, 2), `density` 0 to 1."""
    rng = draft.rng
    path = offset_line(line, right_m)
    step = np.linalg.norm(np.diff(path, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    spacing = 2.6 / max(density, 0.1)
    t = np.arange(0.0, along[-1], spacing)
    t = t + rng.uniform(-0.4, 0.4, len(t)) * spacing
    north, east = (np.interp(t, along, path[:, k]) for k in range(2))
    gap = np.sin(t / rng.uniform(12.0, 30.0) + rng.uniform(0.0, 6.0)) < 2.0 * density - 0.6
    for n, e, keep in zip(north, east, gap, strict=True):
        species: Species = "broadleaf" if rng.uniform() < 0.3 else "bush"
        if keep:
            shift = rng.normal(0.0, 0.7, 2)
            plant(draft, float(n + shift[0]), float(e + shift[1]), species)


def wood(draft: Draft, polygon: Array) -> None:
    """A closed wood: jittered grid of trees with clearings."""
    rng = draft.rng
    share = float(rng.choice([0.1, 0.5, 0.85]))
    spacing = float(rng.uniform(4.6, 6.0))
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    north, east = np.meshgrid(
        np.arange(low[0], high[0], spacing), np.arange(low[1], high[1], spacing), indexing="ij"
    )
    points = np.stack([north.ravel(), east.ravel()], axis=1)
    points += rng.uniform(-0.42, 0.42, points.shape) * spacing
    centre = rng.uniform(low, high)
    clearing = float(rng.uniform(8.0, 22.0))
    keep = inside_convex(points, polygon) & (np.hypot(*(points - centre).T) > clearing)
    for n, e in draft.bend(points[keep]):
        plant(draft, float(n), float(e), "conifer" if rng.uniform() < share else "broadleaf")


def scatter(draft: Draft, polygon: Array, count: int, species: tuple[Species, ...]) -> None:
    """Single plants anywhere in a polygon (n, 2)."""
    rng = draft.rng
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    points = rng.uniform(low, high, (count, 2))
    for n, e in points[inside_convex(points, polygon)]:
        plant(draft, float(n), float(e), species[int(rng.integers(len(species)))])


def inside_convex(points: Array, polygon: Array) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which points (n, 2) lie in a convex polygon (m, 2)."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    rel = points[:, None, :] - polygon[None]
    cross = edges[None, :, 0] * rel[..., 1] - edges[None, :, 1] * rel[..., 0]
    return np.asarray((cross >= 0).all(axis=1) | (cross <= 0).all(axis=1), bool)
