"""The camera renderer: geometry to a pixel, and a sensor with the noise that was asked for."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from vwnav.geometry.rotations import rotation_from_euler, rotation_from_vector
from vwnav.sim.lens import RenderConfig, Sensor, streak
from vwnav.sim.map_warp import MapWarp
from vwnav.sim.relief import Relief
from vwnav.sim.renderer import CameraRenderer, default_camera
from vwnav.sim.scenery.landscape import LookName
from vwnav.sim.scenery.markings import white_marks
from vwnav.sim.site import Site
from vwnav.sim.tiles import TileStore
from vwnav.types import Array

STILL = np.zeros(3)
LEVEL = Relief()
PERFECT = RenderConfig(
    vibration_rad=0.0, wobble_px=0.0, readout_s=0.0, psf_px=0.0, vignetting=0.0, read_noise=0.0,
    shot_noise=0.0, light_sigma=0.0, background=False,
)  # fmt: skip


class ChessSite(Site):
    """A checkerboard of squares of 2 m instead of a landscape: every corner is known exactly."""

    def __init__(self) -> None:
        self.seed = 0

    def render(
        self,
        look: LookName,
        north0_m: float,
        east0_m: float,
        size: tuple[int, int],
        m_per_px: float,
    ) -> NDArray[np.uint8]:
        def wave(edge_m: Array) -> Array:
            """Mean of a square wave of period 4 m over each pixel, from its integral."""
            integral = np.abs(edge_m % 4.0 - 2.0)
            return np.diff(integral) / np.diff(edge_m)

        rows = wave(north0_m - np.arange(size[1] + 1) * m_per_px)
        cols = wave(east0_m + np.arange(size[0] + 1) * m_per_px)
        value = 120.0 + 80.0 * rows[:, None] * cols[None, :]
        return np.repeat(value[..., None], 3, axis=2).round().astype(np.uint8)


CHESS = ChessSite()


@pytest.fixture(scope="module")
def site() -> Site:
    return Site(1)


def make(site: Site, config: RenderConfig, seed: int = 0) -> CameraRenderer:
    return CameraRenderer(site, default_camera(), config, np.random.default_rng(seed))


def view_of(renderer: CameraRenderer, position: Array, R: Array, velocity: Array = STILL) -> Array:
    image = renderer.render(np.asarray(position), R, 0.0, velocity, STILL)
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def over_threshold(site: Site, height_m: float) -> Array:
    field = site.landscape.airfield
    centre = field.to_ne(np.array([[-field.length_m / 2.0 + 16.0, 0.0]]))[0]
    return np.array([centre[0], centre[1], -height_m])


def seen_at(
    points_ne: Array, position: Array, R_ned_body: Array, relief: Relief = LEVEL
) -> NDArray[np.float32]:
    """Where the camera model says that points (n, 2) of the ground are, well inside the image."""
    camera = default_camera()
    down = [-relief.height_m(*point) for point in points_ne.tolist()]
    offset = np.column_stack([points_ne, down]) - position
    uv = camera.project(offset @ R_ned_body @ camera.R_body_camera)
    inside = (uv > 12).all(axis=1) & (uv < [627, 467]).all(axis=1)
    return uv[inside].astype(np.float32)


def refined(view: Array, uv: NDArray[np.float32]) -> Array:
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 0.01)
    corners = cv2.cornerSubPix(view, uv.copy().reshape(-1, 1, 2), (4, 4), (-1, -1), criteria)
    return corners.reshape(-1, 2)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(
    "relief", [LEVEL, Relief(slope_ne=(0.1, -0.2)), Relief(slope_ne=(-0.1, 0.1), hills_m=3.0)]
)
def test_corners_of_the_ground_land_where_the_camera_projects_them(
    relief: Relief, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    R = rotation_from_euler(*rng.uniform(-0.45, 0.45, 2), rng.uniform(-np.pi, np.pi))
    position = np.array([*rng.uniform(-30.0, 30.0, 2), -rng.uniform(10.0, 55.0)])
    position[2] -= relief.height_m(position[0], position[1])
    view = view_of(make(CHESS, replace(PERFECT, relief=relief)), position, R)
    grid = 2.0 * np.stack(np.meshgrid(np.arange(-60, 61), np.arange(-60, 61)), -1).reshape(-1, 2)
    uv = seen_at(grid.astype(float), position, R, relief)
    near = np.hypot(*(uv[:, None] - uv[None] + 1e3 * np.eye(len(uv))[..., None]).T).min(axis=0)
    uv = uv[near > 14.0]  # squares too small on the image have no corner to refine
    assert len(uv) > 20
    apart = np.hypot(*(refined(view, uv) - uv).T)
    assert np.median(apart) < 0.2
    assert apart.max() < 1.0


@pytest.mark.parametrize("seed", range(4))
def test_what_stands_at_a_place_is_drawn_where_the_map_shows_it(seed: int) -> None:
    """The map's corners are the chess board's: on the ground they stand before its error."""
    error = MapWarp(sigma_m=0.5, seed=seed)
    rng = np.random.default_rng(seed)
    R, position = rotation_from_euler(0.1, -0.2, seed), np.array([*rng.uniform(-30, 30, 2), -40.0])
    on_map = 2.0 * np.stack(np.meshgrid(np.arange(-60, 61), np.arange(-60, 61)), -1).reshape(-1, 2)
    truly = on_map.astype(float)
    for _ in range(3):
        north_m, east_m = truly.astype(np.float32).T[..., None]
        truly = on_map - error.at_m(north_m, east_m)[:, 0]
    view = view_of(make(CHESS, replace(PERFECT, map_warp=error)), position, R)
    uv = seen_at(truly, position, R)
    assert np.abs(truly - on_map).max() > 0.4
    assert np.median(np.hypot(*(refined(view, uv) - uv).T)) < 0.2


def test_a_map_is_wrong_by_its_sigma_and_the_same_map_always_alike() -> None:
    places = np.linspace(-300.0, 300.0, 7, dtype=np.float32)
    grid = np.meshgrid(places, places)
    all_m = np.array([MapWarp(sigma_m=2.0, seed=seed).at_m(*grid) for seed in range(60)])
    assert all_m.std(axis=0).mean() == pytest.approx(2.0, rel=0.1)
    assert all_m.mean(axis=(1, 2)).std() == pytest.approx(2.0 * np.sqrt(0.5), rel=0.25)
    assert np.array_equal(all_m[3], MapWarp(sigma_m=2.0, seed=3).at_m(*grid))
    assert not MapWarp().at_m(*grid).any()


@pytest.mark.parametrize(
    ("height_m", "roll", "pitch", "yaw"), [(25, 0, 0, 0), (50, 0.1, -0.15, 1.1), (35, -0.3, 0.2, 3)]
)
def test_the_runways_threshold_is_seen_where_the_vectors_say(
    site: Site, height_m: float, roll: float, pitch: float, yaw: float
) -> None:
    R, position = rotation_from_euler(roll, pitch, yaw), over_threshold(site, height_m)
    view = view_of(make(site, PERFECT), position, R)
    uv = seen_at(np.concatenate(white_marks(site.landscape.airfield)[:8]), position, R)
    apart = refined(view, uv) - uv
    assert len(uv) >= 8
    assert np.hypot(*np.median(apart, axis=0)) < 0.5  # worn paint moves single corners, not all
    assert np.median(np.hypot(*apart.T)) < 1.0


def test_the_same_seed_renders_the_same_images() -> None:
    runs = []
    for _ in range(2):
        renderer = make(CHESS, RenderConfig(background=False), seed=4)
        R, velocity = rotation_from_euler(0.05, 0.0, 0.3), np.array([5.0, 1.0, 0.0])
        at = (np.array([0.5 * k, 0.1 * k, -25.0]) for k in range(3))
        runs.append([renderer.render(p, R, 0.1 * k, velocity, STILL) for k, p in enumerate(at)])
    np.testing.assert_array_equal(*runs)
    assert (runs[0][0] != runs[0][1]).any()


def sensor(**options: float) -> Sensor:
    defaults = {"light_sigma": 0.0, "psf_px": 0.0, "vignetting": 0.0}
    config = RenderConfig(color=False, **(defaults | options))  # type: ignore[arg-type]
    return Sensor(default_camera(), config, np.random.default_rng(1))


@pytest.mark.parametrize("level", [40.0, 110.0, 180.0])
def test_noise_has_the_configured_level(level: float) -> None:
    flat = np.full((480, 640, 3), 100, np.uint8)
    camera = sensor(target_level=level, read_noise=2.0, shot_noise=0.05)
    views = [camera.expose(flat, np.zeros(2), 0.0).astype(float) for _ in range(2)]
    assert views[0].mean() == pytest.approx(level, abs=1.0)
    assert np.std(views[0] - views[1]) / np.sqrt(2) == pytest.approx(
        np.sqrt(4.0 + 0.05 * level), rel=0.15
    )


def test_automatic_exposure_follows_with_a_lag() -> None:
    camera = sensor(target_level=112.0, agc_tau_s=0.5)
    bright, dark = (np.full((480, 640, 3), x, np.uint8) for x in (140, 70))
    camera.expose(bright, np.zeros(2), 0.0)
    just_after = camera.expose(dark, np.zeros(2), 0.05).mean()
    settled = [camera.expose(dark, np.zeros(2), 0.05 * k).mean() for k in range(2, 60)][-1]
    assert just_after < 75.0
    assert settled == pytest.approx(112.0, abs=3.0)


def test_the_light_wanders_slowly() -> None:
    flat = np.full((480, 640, 3), 100, np.uint8)
    camera = sensor(light_sigma=0.1, light_tau_s=10.0, agc_tau_s=1e6)
    means = np.array([camera.expose(flat, np.zeros(2), 0.1 * k).mean() for k in range(300)])
    assert 1.0 < means.std() < 25.0
    assert np.abs(np.diff(means)).max() < 8.0


def test_corners_are_darker_than_the_centre() -> None:
    flat = np.full((480, 640, 3), 100, np.uint8)
    view = sensor(vignetting=0.3).expose(flat, np.zeros(2), 0.0).astype(float)
    assert view[:40, :40].mean() < 0.8 * view[220:260, 300:340].mean()


@given(st.floats(-9, 9), st.floats(-9, 9))
def test_a_streak_spreads_light_along_the_motion_only(du: float, dv: float) -> None:
    kernel = streak(np.array([du, dv])).astype(float)
    half = kernel.shape[0] // 2
    v, u = np.indices(kernel.shape) - half
    assert kernel.sum() == pytest.approx(1.0, abs=1e-5)
    assert [(kernel * u).sum(), (kernel * v).sum()] == pytest.approx([0.0, 0.0], abs=1e-4)
    along = (kernel * (u * du + v * dv) ** 2).sum()
    length2 = du**2 + dv**2
    # A line of length L has variance L^2 / 12; linear splatting adds up to 1/4 px^2.
    assert along == pytest.approx(length2**2 / 12.0, abs=0.27 * length2 + 0.02 * length2**2 + 1e-9)


def test_motion_blurs_along_itself_only() -> None:
    config = replace(PERFECT, exposure_s=0.02)
    position = np.array([0.3, 0.4, -25.0])
    still, fast = (
        view_of(make(CHESS, config), position, np.eye(3), np.array(v)).astype(float)
        for v in ([0.0, 0.0, 0.0], [12.0, 0.0, 0.0])
    )
    steepest_down = [np.abs(np.diff(view, axis=0)).max() for view in (still, fast)]
    steepest_across = [np.abs(np.diff(view, axis=1)).max() for view in (still, fast)]
    assert steepest_down[1] < 0.5 * steepest_down[0]
    assert steepest_across[1] > 0.8 * steepest_across[0]


def test_a_rolling_shutter_shows_each_row_at_its_own_time() -> None:
    readout_s, speed, height_m = 0.02, 15.0, 20.0
    config = replace(PERFECT, readout_s=readout_s, exposure_s=1e-6)
    position, R = np.array([0.0, 0.0, -height_m]), np.eye(3)
    view = view_of(make(CHESS, config), position, R, np.array([0.0, speed, 0.0]))
    grid = 2.0 * np.stack(np.meshgrid(np.arange(-5, 6), np.arange(-5, 6)), -1).reshape(-1, 2)
    expected = np.concatenate([
        seen_at(corner[None], position + speed * time_s * np.array([0.0, 1.0, 0.0]), R)
        for corner in grid.astype(float)
        for time_s in (seen_at(corner[None], position, R)[:, 1] / 480.0 - 0.5) * readout_s
    ])  # fmt: skip
    apart = np.hypot(*(refined(view, expected) - expected).T)
    assert np.median(apart) < 0.2


def test_a_rolling_shutter_of_a_turning_camera_leans_each_row_its_own_way() -> None:
    """About the vertical, where the image's middle does not move at all."""
    readout_s, rates, height_m = 0.02, np.array([0.3, -0.2, 1.05]), 20.0
    config = replace(PERFECT, readout_s=readout_s, exposure_s=1e-6)
    position = np.array([0.0, 0.0, -height_m])
    view = cv2.cvtColor(
        make(CHESS, config).render(position, np.eye(3), 0.0, STILL, rates), cv2.COLOR_BGR2GRAY
    )
    grid = 2.0 * np.stack(np.meshgrid(np.arange(-5, 6), np.arange(-5, 6)), -1).reshape(-1, 2)
    expected, still = [], []
    for corner in grid.astype(float):
        uv = seen_at(corner[None], position, np.eye(3))
        for row in uv[:, 1]:
            turn = rates * (row / 480.0 - 0.5) * readout_s
            expected.append(seen_at(corner[None], position, rotation_from_vector(turn)))
            still.append(uv)
    uv = np.concatenate(expected)
    assert np.median(np.hypot(*(refined(view, uv) - uv).T)) < 0.2
    assert np.median(np.hypot(*(uv - np.concatenate(still)).T)) > 0.6


def test_a_camera_that_sees_the_horizon_shows_haze() -> None:
    R = rotation_from_euler(0.0, np.radians(75.0), 0.0)
    view = view_of(make(CHESS, PERFECT), np.array([0.0, 0.0, -5.0]), R)
    assert np.ptp(view[:40, 200:400]) <= 2
    assert np.ptp(view[400:]) > 40


def test_tiles_come_back_from_disk_and_damaged_ones_are_drawn_again(
    site: Site, tmp_path: Path
) -> None:
    key = (2, 0, 0)
    drawn = TileStore(site, tmp_path).make(key)
    (file,) = tmp_path.rglob("*.png")
    np.testing.assert_array_equal(TileStore(site, tmp_path).make(key), drawn)
    file.write_bytes(file.read_bytes()[:100])
    np.testing.assert_array_equal(TileStore(site, tmp_path).make(key), drawn)
    assert not [p for p in tmp_path.rglob("*") if p.is_file() and p.suffix != ".png"]


def test_missing_tiles_are_stood_in_for_and_then_drawn_in_the_background() -> None:
    renderer = make(CHESS, replace(PERFECT, background=True))
    try:
        position = np.array([40.0, 40.0, -20.0])
        first = view_of(renderer, position, np.eye(3))
        assert renderer.wait_until_drawn(timeout_s=60.0)
        second = view_of(renderer, position, np.eye(3))
    finally:
        renderer.close()
    exact = view_of(make(CHESS, PERFECT), position, np.eye(3))
    np.testing.assert_allclose(second, exact, atol=1.0)  # exposure began from the first
    assert 1.0 < np.abs(first.astype(float) - exact).max() < 80.0


def test_preparing_a_route_draws_all_that_is_flown_over() -> None:
    renderer = make(CHESS, PERFECT)
    heard: list[float] = []
    route = np.array([[0.0, 0.0, -30.0], [60.0, 0.0, -30.0]])
    renderer.prepare(route, heard.append, half_width_m=40.0)
    assert heard == sorted(heard)
    assert heard[-1] == 1.0
    drawn = renderer.tiles_in_memory
    for position in (*np.linspace(*route, 5), [0.0, 0.0, -4.0], [0.0, 0.0, -12.0]):
        view_of(renderer, position, rotation_from_euler(0.1, 0.1, 0.4))
    assert renderer.tiles_in_memory == drawn
