"""Paints what stands up: shadows first, then vehicles, buildings and trees by height."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.sim.scenery.buildings import footprint, paint_building, ridge_line
from vwnav.sim.scenery.drawing import Canvas
from vwnav.sim.scenery.index import Index
from vwnav.sim.scenery.landscape import (
    Building,
    Landscape,
    ParkedVehicle,
    Plant,
    rectangle,
    spot,
    to_ne,
)
from vwnav.sim.scenery.looks import Look
from vwnav.sim.scenery.trees import paint_plant, shade_plant
from vwnav.types import Array

_CARS = (
    (205, 207, 208),
    (60, 62, 66),
    (120, 124, 128),
    (150, 40, 38),
    (52, 74, 112),
    (228, 228, 226),
)
# Half outlines of a light aircraft, metres along and to the right of its nose direction.
_FUSELAGE = np.array([[3.6, 0.25], [2.0, 0.6], [-0.5, 0.55], [-3.6, 0.15]])
_WING = np.array([[1.8, 0.0], [1.6, 5.2], [0.3, 5.2], [0.1, 0.0]])
_TAIL = np.array([[-2.8, 0.0], [-2.8, 1.6], [-3.5, 1.6], [-3.5, 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """The things of one look near a window, picked by distance."""

    plants: list[Plant]
    buildings: list[Building]
    vehicles: list[ParkedVehicle]


def paint_objects(canvas: Canvas, standing: Standing, look: Look) -> None:
    """Shadows on the ground, then the things themselves from low to high."""
    _shadows(canvas, standing, look)
    for vehicle in standing.vehicles:
        _vehicle(canvas, vehicle)
    for building in sorted(standing.buildings, key=lambda b: b.ridge_m):
        paint_building(canvas, building, look)
    for plant in sorted(standing.plants, key=lambda p: p.height_m):
        paint_plant(canvas, plant, look)


def near(land: Landscape, canvas: Canvas, look: Look) -> Standing:
    """What of a landscape can be seen in the window, shadows included."""
    plants, buildings, vehicles = _indices(land, look)
    window = canvas.window
    return Standing(plants.near(window), buildings.near(window), vehicles.near(window))


@lru_cache(maxsize=16)
def _indices(
    land: Landscape, look: Look
) -> tuple[Index[Plant], Index[Building], Index[ParkedVehicle]]:
    per_m = look.shadow_per_m()

    def reach(north_m: float, east_m: float, radius_m: float, height_m: float) -> Array:
        spot = np.array([north_m, east_m])
        ends = np.array([spot, spot + per_m * height_m])
        return np.concatenate([ends - radius_m, ends + radius_m])

    plants = [p for p in land.plants if look.name in p.looks]
    buildings = [b for b in land.buildings if look.name in b.looks]
    vehicles = [v for v in land.vehicles if look.name in v.looks]
    return (
        Index(
            plants, [reach(p.north_m, p.east_m, 1.3 * p.radius_m, p.height_m) for p in plants], 0.5
        ),
        Index(
            buildings, [reach(b.north_m, b.east_m, b.length_m, b.ridge_m) for b in buildings], 1.0
        ),
        Index(vehicles, [reach(v.north_m, v.east_m, 6.0, 3.2) for v in vehicles], 1.0),
    )


def _shadows(canvas: Canvas, standing: Standing, look: Look) -> None:
    window = canvas.window
    shade = np.zeros((window.height, window.width), np.uint8)
    per_m = look.shadow_per_m()
    for vehicle in standing.vehicles:
        length, width, height = _vehicle_size(vehicle)
        foot = rectangle(vehicle.centre_ne, length, width, vehicle.azimuth_rad)
        if vehicle.kind == "aircraft":
            for part in _aircraft(vehicle):
                _fill(shade, canvas, part + per_m * 1.0, 235)
        else:
            _fill(shade, canvas, _hull(np.vstack([foot, foot + per_m * height])), 255)
    for b in standing.buildings:
        foot, ridge = footprint(b), ridge_line(b)
        points = np.vstack([foot, foot + per_m * b.eaves_m, ridge + per_m * b.ridge_m])
        _fill(shade, canvas, _hull(points), 255)
    for plant in standing.plants:
        shade_plant(shade, canvas, plant, look)
    soft = 0.12 / window.m_per_px + 0.45
    mask = cv2.GaussianBlur(shade, (0, 0), soft).astype(np.float32) / np.float32(255.0)
    # Open sky still lights the shade, and it is blue.
    tint = np.array([1.22, 1.0, 0.9], np.float32) * np.float32(look.shadow_gain)
    canvas.bgr *= 1.0 + mask[..., None] * (tint - 1.0)


def _fill(shade: NDArray[np.uint8], canvas: Canvas, polygon: Array, value: int) -> None:
    if canvas.box(polygon, 0.0) is not None:
        corners = np.round(canvas.window.uv(polygon) * 16.0).astype(np.int32)
        cv2.fillConvexPoly(shade, corners, value, cv2.LINE_AA, 4)


def _hull(points: Array) -> Array:
    return np.asarray(cv2.convexHull(points.astype(np.float32))[:, 0], np.float64)


def _vehicle_size(v: ParkedVehicle) -> tuple[float, float, float]:
    return {
        "car": (4.4, 1.8, 1.4),
        "lorry": (8.5, 2.5, 3.2),
        "aircraft": (7.2, 10.0, 2.0),
        "bale": (1.3, 1.3, 1.2),
    }[v.kind]


def _aircraft(v: ParkedVehicle) -> list[Array]:
    halves = (_FUSELAGE, _WING, _TAIL)
    wholes = [np.vstack([half, half[::-1] * np.array([1.0, -1.0])]) for half in halves]
    return [to_ne(whole, v.centre_ne, v.azimuth_rad) for whole in wholes]


def _vehicle(canvas: Canvas, v: ParkedVehicle) -> None:
    rng = np.random.default_rng(v.seed)
    paint = np.array(_CARS[int(rng.integers(len(_CARS)))], np.float32)[::-1]
    length, width, _ = _vehicle_size(v)
    if v.kind == "aircraft":
        for part in _aircraft(v):
            canvas.blend(canvas.polygon(part), np.array([224.0, 226.0, 226.0], np.float32))
        return
    if v.kind == "bale":
        paint = np.array([112.0, 160.0, 178.0], np.float32)
    canvas.blend(canvas.polygon(rectangle(v.centre_ne, length, width, v.azimuth_rad)), paint)
    if v.kind != "car":
        return
    for along, long in ((0.75, 0.7), (-1.45, 0.55)):
        place = spot(v.centre_ne, v.azimuth_rad, along, 0.0)
        glass = rectangle(place, long, 1.5, v.azimuth_rad)
        canvas.blend(canvas.polygon(glass), np.array([52.0, 48.0, 44.0], np.float32))
