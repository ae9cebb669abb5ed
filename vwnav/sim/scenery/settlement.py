"""What is built and planted: the airfield's hangars, a village, a farm; hedges, woods, bushes."""

import numpy as np

from vwnav.sim.scenery.draft import Draft
from vwnav.sim.scenery.drawing import offset_line
from vwnav.sim.scenery.landscape import (
    Airfield,
    Building,
    Cell,
    LookName,
    ParkedVehicle,
    Plant,
    Roof,
    Species,
    Strip,
    Surface,
    rectangle,
    spot,
    to_ne,
)
from vwnav.types import Array

BOTH: tuple[LookName, ...] = ("map", "flight")
_SIZES: dict[Species, tuple[float, float]] = {
    "conifer": (1.6, 3.2),
    "broadleaf": (2.2, 5.5),
    "bush": (0.6, 1.9),
}


def hangars(draft: Draft, airfield: Airfield) -> None:
    """Hangars and a clubhouse behind the apron, aircraft on it, cars beside it."""
    rng = draft.rng
    back = airfield.apron[2:4]  # far edge of the apron
    edge = back[0] - back[1]
    length = float(np.hypot(*edge))
    for at in np.arange(0.14, 0.9, 0.3):
        here = back[1] + edge * at
        place = spot(here, airfield.azimuth_rad, 0.0, 17.0)
        size = (float(rng.uniform(18, 26)), float(rng.uniform(14, 20)))
        _building(draft, place, size, airfield.azimuth_rad, (4.5, 6.5), "sheet", 0.0)
    for at in rng.uniform(0.08, 0.92, 7):
        here = back[1] + edge * at
        place = spot(here, airfield.azimuth_rad, 0.0, -rng.uniform(4.0, 12.0))
        look: LookName = "map" if rng.uniform() < 0.5 else "flight"
        turn = airfield.azimuth_rad + np.pi / 2 + rng.normal(0.0, 0.4)
        _vehicle(draft, place, turn, "aircraft", (look,))
    side = spot(back.mean(axis=0), airfield.azimuth_rad, length / 2 + 14.0, 0.0)
    park = rectangle(side, 22.0, 30.0, airfield.azimuth_rad)
    draft.cells.append(
        Cell(park, park, park, "yard", airfield.azimuth_rad, int(rng.integers(2**31)))
    )
    _parked(draft, park, airfield.azimuth_rad)


def village(draft: Draft, road: Array) -> None:
    """Plots with houses on both sides of a part of the road, and one side street."""
    rng = draft.rng
    inside = np.flatnonzero((np.abs(road) < np.array([560.0, 760.0])).all(axis=1))
    middle = int(rng.choice(inside))
    street = road[max(0, middle - 26) : middle + 26]
    _plots(draft, street, (-1.0, 1.0))
    start = road[middle]
    heading = float(np.arctan2(*(road[min(middle + 3, len(road) - 1)] - start)[::-1]))
    # The side street leads away from the airfield, which lies about home.
    away = 1.0 if start @ spot(np.zeros(2), heading, 0.0, 1.0) > 0.0 else -1.0
    end = spot(start, heading, rng.uniform(-20.0, 20.0), away * rng.uniform(120.0, 170.0))
    lane = np.linspace(spot(start, heading, 0.0, 8.0 * away), end, 30)
    free = draft.ground.free(lane)
    lane = lane[: int(np.argmin(free[3:])) + 3] if not free[3:].all() else lane
    if len(lane) > 12:
        draft.strips.append(Strip(lane, 4.5, "asphalt", int(rng.integers(2**31))))
        draft.ground.take_line(lane, 8.0)
        _plots(draft, lane, (-1.0, 1.0))
    for at in rng.choice(len(road) - 1, 14):
        turn = float(np.arctan2(*(road[at + 1] - road[at])[::-1]))
        side = float(rng.choice([-1.6, 1.6]))
        look: LookName = "map" if rng.uniform() < 0.5 else "flight"
        place = spot(road[at], turn, 0.0, side)
        kind = "lorry" if rng.uniform() < 0.15 else "car"
        _vehicle(draft, place, turn if side > 0 else turn + np.pi, kind, (look,))


def farm(draft: Draft) -> None:
    """Two farmyards with barns somewhere in the fields."""
    rng = draft.rng
    made = 0
    for _ in range(60):
        if made == 2:
            return
        centre = rng.uniform([-430.0, -620.0], [430.0, 620.0])
        turn = float(rng.uniform(0.0, np.pi))
        yard = rectangle(centre, 62.0, 44.0, turn)
        probe = np.concatenate([yard, yard.mean(axis=0)[None], (yard + np.roll(yard, 1, 0)) / 2])
        if draft.ground.free(probe).all():
            _farmyard(draft, centre, turn, yard)
            made += 1


def _farmyard(draft: Draft, centre: Array, turn_rad: float, yard: Array) -> None:
    rng = draft.rng
    draft.cells.append(Cell(yard, yard, yard, "yard", turn_rad, int(rng.integers(2**31))))
    for along, across, size, roof in (
        (-8.0, -17.0, (38.0, 15.0), "sheet"),
        (-14.0, 15.0, (26.0, 12.0), "sheet"),
        (20.0, 14.0, (13.0, 9.5), "gable"),
        (24.0, -14.0, (9.0, 7.0), "gable"),
    ):
        place = spot(centre, turn_rad, along, across)
        kind: Roof = "sheet" if roof == "sheet" else "gable"
        _building(draft, place, size, turn_rad, (4.0, 7.5), kind, 0.0)
    for _ in range(5):
        place = spot(centre, turn_rad, rng.uniform(-28, 28), rng.uniform(-6, 6))
        look: LookName = "map" if rng.uniform() < 0.5 else "flight"
        _vehicle(draft, place, float(rng.uniform(0, 6)), str(rng.choice(["car", "lorry"])), (look,))
    draft.ground.take(yard, 4.0)
    scatter(draft, rectangle(centre, 90.0, 70.0, turn_rad), 14, ("broadleaf", "bush", "conifer"))


def _plots(draft: Draft, street: Array, sides: tuple[float, ...]) -> None:
    rng = draft.rng
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(street, axis=0), axis=1))])
    for side in sides:
        t = float(rng.uniform(8.0, 20.0))
        while t < along[-1] - 12.0:
            width, depth = float(rng.uniform(19, 31)), float(rng.uniform(28, 44))
            k = min(int(np.searchsorted(along, t)), len(street) - 1)
            heading = float(np.arctan2(*(street[k] - street[k - 1])[::-1]))
            front = spot(street[k], heading, 0.0, side * (6.0 + depth / 2))
            _plot(draft, front, (width, depth), heading, side)
            t += width + float(rng.choice([0.5, 0.5, 9.0]))


def _plot(
    draft: Draft, centre: Array, size: tuple[float, float], heading_rad: float, side: float
) -> None:
    rng = draft.rng
    width, depth = size
    plot = rectangle(centre, width, depth, heading_rad)
    if not draft.ground.free(np.vstack([inset_corners(plot, 0.85), centre[None]])).all():
        return
    draft.cells.append(Cell(plot, plot, plot, "garden", heading_rad, int(rng.integers(2**31))))
    setback = side * (-depth / 2 + rng.uniform(9.0, 12.0))
    shift = float(rng.uniform(-0.12, 0.12) * width)
    house = spot(centre, heading_rad, shift, setback)
    dims = (float(rng.uniform(9.5, 14.5)), float(rng.uniform(7.5, 9.5)))
    turn = heading_rad + (np.pi / 2 if rng.uniform() < 0.3 else 0.0) + rng.normal(0.0, 0.02)
    roof: Roof = "gable" if rng.uniform() < 0.6 else ("hip" if rng.uniform() < 0.7 else "flat")
    _drive(draft, centre, heading_rad, (width, depth), side)
    _building(draft, house, dims, turn, (3.2, 6.8), roof, 0.06)
    if rng.uniform() < 0.4:  # a wing makes it L-shaped
        wing = spot(house, heading_rad, dims[0] * 0.28, side * dims[1] * 0.6)
        _building(draft, wing, (dims[1] * 0.9, dims[1] * 0.7), turn + np.pi / 2, (3, 6), roof, 0.1)
    if rng.uniform() < 0.7:
        shed = spot(centre, heading_rad, -0.33 * width, side * (depth / 2 - 5.0))
        small: Roof = "flat" if rng.uniform() < 0.5 else "gable"
        _building(draft, shed, (5.0, 3.4), heading_rad, (2.2, 3.2), small, 0.3)
    scatter(draft, inset_corners(plot, 0.95), 5, ("broadleaf", "bush", "bush", "conifer"))
    if rng.uniform() < 0.5:
        corners = plot[[1, 2]] if rng.uniform() < 0.5 else plot[[0, 3]]
        hedge(draft, np.linspace(corners[0], corners[1], 12), 0.0, 0.8)


def _drive(
    draft: Draft, centre: Array, heading_rad: float, size: tuple[float, float], side: float
) -> None:
    """A drive from the street to beside the house, with a car on it in some looks."""
    rng = draft.rng
    along = 0.36 * size[0]
    ends = np.array([[along, -side * (size[1] / 2 + 3.0)], [along, -side * size[1] / 2 * 0.35]])
    start, end = to_ne(ends, centre, heading_rad)
    line = np.linspace(start, end, 4)
    surface: Surface = "gravel" if rng.uniform() < 0.5 else "asphalt"
    draft.strips.append(Strip(line, 3.2, surface, int(rng.integers(2**31))))
    draft.ground.take_line(line, 3.5)
    for look in BOTH:
        if rng.uniform() < 0.55:
            place = line[int(rng.integers(1, 4))]
            turn = heading_rad + np.pi / 2 + rng.normal(0.0, 0.05)
            _vehicle(draft, place, turn, "car", (look,))


def _parked(draft: Draft, park: Array, turn_rad: float) -> None:
    rng = draft.rng
    centre = park.mean(axis=0)
    for row in (-9.0, 9.0):
        for along in np.arange(-9.0, 9.1, 2.6):
            for look in BOTH:
                if rng.uniform() < 0.45:
                    jitter = rng.normal(0.0, 0.15, 2)
                    place = spot(centre, turn_rad, along + jitter[0], row + jitter[1])
                    _vehicle(draft, place, turn_rad + np.pi / 2, "car", (look,))


def _building(
    draft: Draft,
    place: Array,
    size: tuple[float, float],
    turn_rad: float,
    heights_m: tuple[float, float],
    roof: Roof,
    change: float,
) -> None:
    """A building; with probability `change` it stands in one of the looks only."""
    rng = draft.rng
    looks: tuple[LookName, ...] = BOTH
    if rng.uniform() < change:
        looks = ("flight",) if rng.uniform() < 0.7 else ("map",)
    foot = rectangle(place, size[0], size[1], turn_rad)
    draft.ground.take(foot, 1.5)
    draft.buildings.append(
        Building(
            float(place[0]),
            float(place[1]),
            size[0],
            size[1],
            turn_rad,
            heights_m[0],
            heights_m[1] if roof != "flat" else heights_m[0],
            roof,
            int(rng.integers(2**31)),
            looks,
        )
    )


def _vehicle(
    draft: Draft, place: Array, turn_rad: float, kind: str, looks: tuple[LookName, ...]
) -> None:
    seed = int(draft.rng.integers(2**31))
    north, east = float(place[0]), float(place[1])
    match kind:
        case "car" | "lorry" | "aircraft" | "bale":
            draft.vehicles.append(ParkedVehicle(north, east, turn_rad, kind, seed, looks))
        case _:
            raise ValueError(f"expected car, lorry, aircraft or bale, got {kind}")


def inset_corners(rectangle_ne: Array, factor: float) -> Array:
    """A rectangle (4, 2) shrunk about its centre."""
    centre = rectangle_ne.mean(axis=0)
    return np.asarray(centre + (rectangle_ne - centre) * factor, np.float64)


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
