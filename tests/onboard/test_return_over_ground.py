"""A return that begins behind a ridge clears it, or goes back the flown way; and that is said."""

import json
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from test_flight import Scene
from test_plan import HOME, checked, place

from vwnav.cli.doctor import _map
from vwnav.guidance.plan_files import load_route
from vwnav.maps.build.builder import BuildOptions, build_pack
from vwnav.maps.build.raster import array_source, local_georeference
from vwnav.maps.heights import HeightGrid
from vwnav.mission.home import WayHome
from vwnav.mission.mission import Phase
from vwnav.onboard.flight_plan import FlightPlan
from vwnav.onboard.options import FlyOptions
from vwnav.onboard.plan import plan_flight
from vwnav.safety.safety_config import SafetyConfig
from vwnav.vision.features.load import load_features

SIFT = load_features("sift")
AROUND = [(0.0, 150.0), (150.0, 150.0), (150.0, 0.0), (150.0, -40.0), (150.0, 150.0), (0.0, 150.0)]
FLOWN_M = 30.0
SLACK_M = 2.1  # a height is reached within 2 m


def ground_m(north_m: float, east_m: float, ridge_m: float) -> float:
    return 500.0 + ridge_m * (70.0 < north_m < 90.0 and abs(east_m) < 100.0)


@pytest.fixture(scope="session")
def ridges(tmp_path_factory) -> dict[float, Path]:
    """Packs of 500 m by 500 m about home, with a ridge north of it that ends 100 m to each side."""
    folder = tmp_path_factory.mktemp("ridges")
    return {
        ridge_m: ridge_pack(folder / f"{ridge_m:.0f}.mbtiles", ridge_m) for ridge_m in (60.0, 160.0)
    }


def ridge_pack(path: Path, ridge_m: float) -> Path:
    along_m = np.linspace(-250.0, 250.0, 101)
    heights = [[ground_m(north_m, east_m, ridge_m) for east_m in along_m] for north_m in -along_m]
    south, west, north, east = *place(-250.0, -250.0), *place(250.0, 250.0)
    grid = HeightGrid((south, west, north, east), np.array(heights, "f4"))
    pictures = np.full((1250, 1250, 3), 90, np.uint8)
    source = array_source(pictures, local_georeference(HOME, (250.0, -250.0), 0.4), name="r")
    build_pack([source], path, [], BuildOptions(heights=grid))
    return path


@pytest.fixture
def around(tmp_path: Path) -> Path:
    items = [
        {"type": "SimpleItem", "command": 16, "frame": 3,
         "params": [0, 0, 0, None, *place(*stop), FLOWN_M]}
        for stop in AROUND
    ]  # fmt: skip
    mission = {"items": items, "plannedHomePosition": [47.0, 8.0, 500.0]}
    path = tmp_path / "around.plan"
    path.write_text(json.dumps({"fileType": "Plan", "mission": mission}))
    return path


@pytest.fixture
def plans(ridges, around) -> Iterator[dict[float, FlightPlan]]:
    asked = dict.fromkeys(field.name for field in fields(FlyOptions)) | {"home_sigma_m": 5.0}
    asked |= {"sim": False, "rejoined": False, "route_frame": "local", "route": around}
    with ExitStack() as stack:
        yield {
            ridge_m: plan_flight(FlyOptions(**(asked | {"map_source": str(pack)})), stack)
            for ridge_m, pack in ridges.items()
        }


def return_from_behind(plan: FlightPlan, ridge_m: float) -> tuple[Scene, list[np.ndarray]]:
    """A flight whose battery is low behind the ridge, and what it passes on its way home."""
    scene = Scene(mission=plan.mission)
    scene.run(lambda s: s.vehicle.position[0] > 145.0 and s.vehicle.position[1] < 0.0)
    scene.vehicle.be(battery_ratio=0.2)
    passed: list[np.ndarray] = []
    scene.run(lambda s: s.flight.phase is Phase.RETURN and passed.append(s.vehicle.position.copy()))
    return scene, passed


@pytest.mark.parametrize("ridge_m", [60.0, 160.0])
def test_a_return_from_behind_a_ridge_clears_the_ground(plans, ridge_m):
    scene, passed = return_from_behind(plans[ridge_m], ridge_m)
    above_m = [500.0 - down_m - ground_m(north, east, ridge_m) for north, east, down_m in passed]
    assert min(above_m) > 5.0 - SLACK_M
    assert np.hypot(*scene.vehicle.position[:2]) < 2.0
    highest_m = -min(down_m for _, _, down_m in passed)
    assert highest_m < 70.0 if ridge_m == 60.0 else highest_m == pytest.approx(FLOWN_M, abs=2.0)


def test_a_ridge_above_the_ceiling_is_flown_around_and_that_is_said(plans):
    scene, passed = return_from_behind(plans[160.0], 160.0)
    assert max(east_m for _, east_m, _ in passed) > 140.0
    assert any("too high: back the flown way" in said for said in scene.said)


def test_what_returns_ask_for_is_said_before_anything_is_armed(plans, ridges, around):
    low, high = plans[60.0].returns, plans[160.0].returns
    assert low == "a return climbs to 65 m above home, to clear the ground"
    assert "above the ceiling of 120 m: a return from there goes back along the flown way" in high
    for ridge_m, words in ((60.0, low), (160.0, high.partition(" of the route")[2])):
        assert words in checked(ridges[ridge_m], around).stdout
        assert words in _map(ridges[ridge_m], load_route(around), None, SIFT, SafetyConfig()).detail
        assert words in json.loads(checked(ridges[ridge_m], around, "--json").stdout)["returns"]


def test_doctor_says_what_returns_ask_for_by_the_settings_that_fly(ridges, around):
    told = _map(ridges[60.0], load_route(around), None, SIFT, SafetyConfig(ceiling_m=50.0)).detail
    assert "above the ceiling of 50 m: a return from there goes back along the flown way" in told


def test_the_last_leg_of_a_route_clears_the_ground_too(ridges, around):
    content = json.loads(around.read_text())
    content["mission"]["items"] = content["mission"]["items"][:3]  # it ends behind the ridge
    around.write_text(json.dumps(content))
    assert "lowest on the way home" in checked(ridges[60.0], around).stdout
    refused = checked(ridges[160.0], around)
    assert "too low on the way home" in str(refused.exception)


@pytest.mark.parametrize("knows_the_ground", [True, False])
def test_the_battery_is_asked_for_the_climb_over_the_ridge_in_time(plans, knows_the_ground):
    """From behind it the way home takes 119 s with the climb, and 49 s without."""
    mission = plans[60.0].mission
    scene = Scene(mission=mission if knows_the_ground else replace(mission, way_home=WayHome()))
    scene.vehicle.be(battery_ratio=0.9)
    scene.run(lambda s: s.vehicle.position[0] > 145.0 and s.vehicle.position[1] < 0.0)
    share = 1.3 * 100.0 / (scene.t_s - lifts_off_s(scene))
    scene.vehicle.be(battery_ratio=(0.12 + 0.9 * share) / (1.0 + share))  # enough for 100 s
    scene.go_on(0.2)
    assert (scene.flight.phase is Phase.RETURN) == knows_the_ground


def lifts_off_s(scene: Scene) -> float:
    """When it did, by a second flight of the same mission."""
    return Scene(mission=scene.mission).run(lambda s: s.vehicle.vehicle.in_air).t_s
