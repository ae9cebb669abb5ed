"""Lays out a landscape from a seed: airfield, fields, roads, village, woods and water."""

import cv2
import numpy as np

from vwnav.sim.scenery.draft import HALF_EAST_M, HALF_NORTH_M, MARGIN_M, Draft
from vwnav.sim.scenery.landscape import (
    Airfield,
    Cell,
    Land,
    Landscape,
    ParkedVehicle,
    Strip,
    clip_half_plane,
    densified,
    inset,
    rectangle,
    spot,
    to_ne,
    wander,
)
from vwnav.sim.scenery.looks import flight_look, map_look
from vwnav.sim.scenery.settlement import farm, hangars, hedge, scatter, village, wood
from vwnav.types import Array


def lay_out(seed: int) -> Landscape:
    """The landscape of a seed: the same one every time."""
    rng = np.random.default_rng([0x5174, seed])
    draft = Draft(seed, rng)
    airfield = _airfield(draft)
    road, stream = _through_lines(draft, airfield)
    _fields(draft, airfield)
    _pond(draft)
    hangars(draft, airfield)
    village(draft, road)
    farm(draft)
    _plant_cells(draft)
    _plant_water(draft, stream)
    _bales(draft)
    return Landscape(
        seed,
        airfield,
        tuple(draft.cells),
        tuple(draft.strips),
        tuple(draft.plants),
        tuple(draft.buildings),
        tuple(draft.vehicles),
    )


def _airfield(draft: Draft) -> Airfield:
    rng = draft.rng
    azimuth = np.radians(rng.uniform(62.0, 118.0))
    length, width = rng.uniform(620.0, 720.0), rng.choice([18.0, 20.0, 23.0])
    # Home is on the apron, which lies right of the runway: 70 m across, somewhere along.
    along = rng.uniform(-120.0, 120.0)
    centre = spot(np.zeros(2), azimuth, -along, -72.0)

    def area(points: list[list[float]]) -> Array:
        return to_ne(np.array(points), centre, azimuth)

    half = length / 2.0
    strip = area([[-half - 60, -65], [half + 60, -65], [half + 60, 95], [-half - 60, 105]])
    apron = area([[along - 45, 52], [along + 45, 52], [along + 45, 92], [along - 45, 92]])
    taxi = area([[along - 6, width / 2], [along + 6, width / 2], [along + 6, 53], [along - 6, 53]])
    field_ = Airfield(
        float(centre[0]), float(centre[1]), azimuth, length, width, strip, apron, taxi, draft.seed
    )
    draft.ground.take(strip, 10.0)
    draft.ground.take(apron, 10.0)
    return field_


def _through_lines(draft: Draft, airfield: Airfield) -> tuple[Array, Array]:
    """A main road on one side of the airfield and a stream on the other, through the site."""
    rng = draft.rng
    ends = np.array([[-1150.0, 0.0], [1150.0, 0.0]])
    road_across, stream_across = rng.uniform(230.0, 310.0), -rng.uniform(190.0, 330.0)
    turn = np.radians(rng.uniform(-7.0, 7.0))
    road_line = airfield.to_ne(to_ne(ends, np.array([0.0, road_across]), turn))
    road = wander(road_line, 8.0, 14.0, rng)
    draft.strips.append(Strip(road, rng.uniform(6.0, 7.5), "asphalt", draft.seed + 1))
    draft.ground.take_line(road, 14.0)
    turn = np.radians(rng.uniform(-12.0, 12.0))
    stream = wander(
        airfield.to_ne(to_ne(ends, np.array([0.0, stream_across]), turn)), 4.0, 26.0, rng
    )
    draft.strips.append(Strip(stream, rng.uniform(2.5, 6.0), "water", draft.seed + 2))
    draft.ground.take_line(stream, 10.0)
    gate = (airfield.apron[1] + airfield.apron[2]) / 2.0 + spot(
        np.zeros(2), airfield.azimuth_rad, 14.0, 24.0
    )
    nearest = road[np.argmin(np.linalg.norm(road - gate, axis=1))]
    access = wander(np.stack([gate, nearest]), 6.0, 3.0, rng)
    draft.strips.append(Strip(access, 5.0, "asphalt", draft.seed + 3))
    draft.ground.take_line(access, 9.0)
    return road, stream


def _fields(draft: Draft, airfield: Airfield) -> None:
    """Halve the land until pieces are field-sized; some cuts become tracks or hedges."""
    rng = draft.rng
    north, east = HALF_NORTH_M + MARGIN_M, HALF_EAST_M + MARGIN_M
    whole = np.array([[-north, -east], [north, -east], [north, east], [-north, east]])
    turn = airfield.azimuth_rad + np.radians(rng.uniform(-14.0, 14.0))
    pending = [(whole, 0)]
    while pending:
        polygon, depth = pending.pop()
        hectares = polygon_area_m2(polygon) / 1e4
        if hectares < rng.uniform(1.0, 4.5) or depth > 9:
            _cell(draft, polygon)
            continue
        pending += [(part, depth + 1) for part in _halve(draft, polygon, turn, depth)]


def _halve(draft: Draft, polygon: Array, turn_rad: float, depth: int) -> list[Array]:
    rng = draft.rng
    axes = to_ne(np.eye(2), np.zeros(2), turn_rad)
    extents = np.ptp(polygon @ axes.T, axis=0)
    k = int(np.argmax(extents * rng.uniform(0.8, 1.25, 2)))
    spin = np.radians(rng.normal(0.0, 3.0))
    normal = spot(np.zeros(2), spin, *axes[k].tolist())
    offsets = polygon @ normal
    at = offsets.min() + np.ptp(offsets) * rng.uniform(0.33, 0.67)
    point = normal * at
    parts = [clip_half_plane(polygon, point, n) for n in (normal, -normal)]
    parts = [p for p in parts if len(p) >= 3]
    edge = _shared_edge(parts[0], point, normal)
    if edge is not None and float(np.hypot(*(edge[1] - edge[0]))) > 60.0:
        _border(draft, edge, depth)
    return parts


def _shared_edge(polygon: Array, point: Array, normal: Array) -> Array | None:
    on_cut = np.abs((polygon - point) @ normal) < 1e-6
    return polygon[on_cut] if on_cut.sum() == 2 else None


def _border(draft: Draft, edge: Array, depth: int) -> None:
    """What grows or runs along a cut between two fields."""
    rng = draft.rng
    draw = rng.uniform()
    line = draft.bend(wander(edge, 7.0, 1.5, rng))
    line = line[draft.ground.free(line)]
    if len(line) < 8 or np.linalg.norm(np.diff(line, axis=0), axis=1).max() > 40.0:
        return
    if depth < 4 and draw < 0.55:
        surface = rng.choice(["gravel", "dirt"], p=[0.55, 0.45])
        draft.strips.append(Strip(line, rng.uniform(2.8, 4.2), surface, int(rng.integers(2**31))))
        draft.ground.take_line(line, 6.0)
        if rng.uniform() < 0.4:
            hedge(draft, line, 6.0, rng.uniform(0.2, 0.7))
    elif draw < 0.75:
        hedge(draft, line, 0.0, rng.uniform(0.35, 1.0))


def _cell(draft: Draft, polygon: Array) -> None:
    rng = draft.rng
    edges = np.roll(polygon, -1, axis=0) - polygon
    longest = edges[np.argmax(np.linalg.norm(edges, axis=1))]
    lands: list[Land] = ["arable", "meadow", "pasture", "forest"]
    land = lands[int(rng.choice(4, p=[0.57, 0.17, 0.13, 0.13]))]
    margin = float(rng.uniform(1.5, 4.0))
    whole, core, inner = (
        draft.bend(densified(inset(polygon, m), 12.0)) for m in (0.0, margin, margin + 12.0)
    )
    row = float(np.arctan2(longest[1], longest[0]))
    draft.plots.append((land, polygon))
    draft.cells.append(Cell(whole, core, inner, land, row, int(rng.integers(2**31))))


def _pond(draft: Draft) -> None:
    """One or two ponds where nothing else is."""
    rng = draft.rng
    for _ in range(int(rng.integers(1, 3))):
        centre = rng.uniform([-HALF_NORTH_M, -HALF_EAST_M], [HALF_NORTH_M, HALF_EAST_M])
        turn = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
        phase = rng.uniform(0.0, 2.0 * np.pi, 4)
        lobes = sum(np.sin(k * turn + phase[k]) / (k + 1.0) for k in range(1, 4))
        radius = float(rng.uniform(9.0, 24.0)) * (1.0 + 0.35 * lobes)
        shore = centre + np.stack([radius * np.cos(turn), 1.3 * radius * np.sin(turn)], axis=1)
        if draft.ground.free(shore).all():
            draft.cells.append(Cell(shore, shore, shore, "pond", 0.0, int(rng.integers(2**31))))
            draft.ground.take(shore, 3.0)
            hedge(draft, np.vstack([shore, shore[:1]]), -5.0, 0.35)


def _bales(draft: Draft) -> None:
    """Round bales on some stubble fields, on the day that the field is stubble."""
    for look in (map_look(draft.seed), flight_look(draft.seed)):
        for cell in draft.cells:
            rng = np.random.default_rng([cell.seed, look.seed, 9])
            fresh = cell.land == "arable" and look.crop(cell.seed) == "stubble"
            if not fresh or rng.uniform() > 0.4 or len(cell.inner) < 3:
                continue
            low, high = cell.inner.min(axis=0), cell.inner.max(axis=0)
            points = rng.uniform(low, high, (int(np.prod(high - low) / 700.0), 2))
            for north, east in points[draft.ground.free(points)]:
                if cv2.pointPolygonTest(cell.inner.astype(np.float32), (north, east), False) > 0:
                    seed = int(rng.integers(2**31))
                    bale = ParkedVehicle(north, east, cell.row_rad, "bale", seed, (look.name,))
                    draft.vehicles.append(bale)


def polygon_area_m2(polygon: Array) -> float:
    """Area of a simple polygon (n, 2) by the shoelace formula."""
    n, e = polygon.T
    return float(abs(np.dot(n, np.roll(e, -1)) - np.dot(e, np.roll(n, -1))) / 2.0)


def _plant_cells(draft: Draft) -> None:
    for land, polygon in draft.plots:
        if land == "forest":
            wood(draft, polygon)
        elif land == "pasture":
            scatter(draft, polygon, 6, ("broadleaf", "bush", "bush"))
    apart = rectangle(np.zeros(2), 2 * HALF_NORTH_M, 2 * HALF_EAST_M, 0.0)
    scatter(draft, apart, 50, ("bush", "bush", "broadleaf"))


def _plant_water(draft: Draft, stream: Array) -> None:
    for side in (-7.0, 7.0):
        hedge(draft, stream, side, 0.45)
