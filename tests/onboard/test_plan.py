"""A route is held against the map before anything is armed, and by the commands that check it."""

import json
from contextlib import ExitStack, nullcontext
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from vwnav.cli.doctor import _map
from vwnav.cli.map import app
from vwnav.errors import PreflightError, RouteError
from vwnav.geometry.calibration import save_camera
from vwnav.geometry.geodesy import LocalFrame
from vwnav.guidance.plan_files import load_route
from vwnav.maps.build.builder import BuildOptions, build_pack
from vwnav.maps.build.raster import array_source, local_georeference
from vwnav.maps.heights import HeightGrid
from vwnav.onboard import plan as planning
from vwnav.onboard.options import FlyOptions
from vwnav.onboard.plan import plan_flight
from vwnav.safety.safety_config import SafetyConfig
from vwnav.sim.renderer import default_camera
from vwnav.vision.features.load import load_features

HOME = LocalFrame(47.0, 8.0, 500.0)
FILES_HOME = [47.0, 8.0, 500.0]
SIFT = load_features("sift")


def place(north_m: float, east_m: float = 0.0) -> list[float]:
    lat_deg, lon_deg, _ = HOME.to_geodetic([north_m, east_m, 0.0])
    return [float(lat_deg), float(lon_deg)]


@pytest.fixture(scope="session")
def packs(tmp_path_factory) -> tuple[Path, Path]:
    """Packs of 400 m by 400 m about home: a ridge of 60 m from 70 to 90 m north, and no heights."""
    folder = tmp_path_factory.mktemp("packs")
    north_m = np.linspace(200.0, -200.0, 81)
    column = 500.0 + 60.0 * ((north_m > 70.0) & (north_m < 90.0)) - 50.0 * (north_m < -120.0)
    south, west, north, east = *place(-200.0, -200.0), *place(200.0, 200.0)
    heights = HeightGrid((south, west, north, east), np.tile(column[:, None], 81).astype("f4"))
    pictures = np.full((1000, 1000, 3), 90, np.uint8)
    for name, grid in (("ridge", heights), ("flat", None)):
        source = array_source(pictures, local_georeference(HOME, (200.0, -200.0), 0.4), name="f")
        build_pack([source], folder / f"{name}.mbtiles", [], BuildOptions(heights=grid))
    return folder / "ridge.mbtiles", folder / "flat.mbtiles"


def plan_file(folder: Path, *stops: tuple[float, float], frame: int = 3) -> Path:
    """A QGroundControl plan through places (north, altitude)."""
    items = [
        {"type": "SimpleItem", "command": 16, "frame": frame,
         "params": [0, 0, 0, None, *place(north_m), altitude_m]}
        for north_m, altitude_m in stops
    ]  # fmt: skip
    mission = {"items": items, "plannedHomePosition": FILES_HOME}
    path = folder / "route.plan"
    path.write_text(json.dumps({"fileType": "Plan", "mission": mission}))
    return path


def planned(pack: Path, route: Path, **changes: object):
    asked = dict.fromkeys(field.name for field in fields(FlyOptions))
    asked |= {"sim": False, "rejoined": False, "route_frame": "local", "map_source": str(pack)}
    with ExitStack() as stack:
        return plan_flight(FlyOptions(**(asked | {"route": route} | changes)), stack)


def checked(pack: Path, route: Path, *words: str):
    return CliRunner().invoke(
        app, ["check", str(pack), "--route", str(route), "--margin-m", "20", *words]
    )


def test_a_route_over_a_ridge_is_refused_before_arming_and_by_each_command(packs, tmp_path):
    route = plan_file(tmp_path, (50.0, 30.0), (120.0, 30.0))
    with pytest.raises(PreflightError, match=r"leg to waypoint 2 .* 30.0 m below .* 35.0 m are"):
        planned(packs[0], route)
    failed = checked(packs[0], route, "--json")
    assert isinstance(failed.exception, PreflightError)
    values = json.loads(failed.stdout)
    assert values["ok"] is False
    assert values["lowest"] == pytest.approx(
        {"above_ground_m": -30.0, "to_waypoint": 2, "lat_deg": 47.00066, "lon_deg": 8.0}, abs=1e-4
    )
    told = _map(packs[0], load_route(route), None, SIFT, SafetyConfig())
    assert told.verdict == "FAIL"
    assert "35.0 m are missing" in told.detail


def test_one_that_clears_it_is_flown_and_how_low_it_comes_is_said(packs, tmp_path):
    route = plan_file(tmp_path, (50.0, 70.0), (120.0, 70.0))
    assert planned(packs[0], route).route_ned_m[:, 2].tolist() == pytest.approx(
        [-70.0] * 2, abs=0.1
    )
    assert "10.0 m above the ground" in checked(packs[0], route).stdout
    told = _map(packs[0], load_route(route), None, SIFT, SafetyConfig())
    assert told.verdict == "PASS"
    assert "10.0 m above the ground" in told.detail


@pytest.mark.parametrize(("height_m", "refused"), [(25.0, True), (36.0, False)])
def test_a_start_too_low_for_the_map_is_refused_before_arming(packs, tmp_path, height_m, refused):
    """It would climb, see nothing that the map shows, and come down again."""
    route = plan_file(tmp_path, (-50.0, height_m), (-50.0, 15.0))
    with pytest.raises(PreflightError, match="below 27 m") if refused else nullcontext():
        planned(packs[1], route)
    save_camera(default_camera(), tmp_path / "cam.toml")
    told = _map(packs[1], load_route(route), tmp_path / "cam.toml", SIFT, SafetyConfig())
    assert (told.verdict == "FAIL") is refused
    assert ("below 27 m" in told.detail) is refused


def test_a_home_on_another_continent_is_said_at_once_to_be_off_the_map(packs, tmp_path):
    route = plan_file(tmp_path, (50.0, 70.0), (120.0, 70.0))
    with pytest.raises(PreflightError, match=r"does not cover.*\(0.000000, 0.000000\)"):
        planned(packs[1], route, home="0,0")


def test_without_heights_or_a_home_it_is_said_that_nobody_knows(packs, tmp_path):
    route = plan_file(tmp_path, (50.0, 30.0), (120.0, 30.0))
    planned(packs[1], route)
    assert "is not known" in checked(packs[1], route).stdout
    assert json.loads(checked(packs[1], route, "--json").stdout)["lowest"] is None
    content = json.loads(route.read_text())
    content["mission"]["plannedHomePosition"] = None
    route.write_text(json.dumps(content))
    assert "is not known" in checked(packs[0], route).stdout


def test_a_route_whose_home_is_not_known_is_refused_once_it_is(packs, tmp_path):
    route = tmp_path / "r.txt"
    route.write_text("1,40,0,30\n2,60,0,30\n")
    with ExitStack() as stack:
        asked = dict.fromkeys(field.name for field in fields(FlyOptions))
        asked |= {"sim": False, "route_frame": "local", "map_source": str(packs[0])}
        plan = plan_flight(FlyOptions(**(asked | {"route": route, "rejoined": False})), stack)
        assert (
            plan.refuse(np.array([[40.0, 0.0, -30.0], [60.0, 0.0, -30.0], [0.0, 0.0, -30.0]])) == ""
        )
        over = np.array([[60.0, 0.0, -30.0], [80.0, 0.0, -30.0], [20.0, 0.0, -30.0]])
        assert "leg to waypoint 2" in plan.refuse(over)
        first = np.array([[40.0, 0.0, -30.0], [20.0, 0.0, -30.0], [110.0, 0.0, -30.0]])
        assert "leg to waypoint 1" in plan.refuse(first)


def test_altitudes_above_sea_level_are_flown_there_from_another_home(packs, tmp_path):
    route = plan_file(tmp_path, (0.0, 550.0), (20.0, 550.0), frame=0)
    valley = "{},{}".format(*place(-150.0))
    found = planned(packs[0], route, home=valley)
    assert found.local_frame.alt_amsl_m == pytest.approx(450.0)
    assert (450.0 - found.route_ned_m[:, 2]).tolist() == pytest.approx([550.0] * 2, abs=0.1)
    assert -planned(packs[1], route).route_ned_m[0, 2] == pytest.approx(50.0)
    with pytest.raises(RouteError, match="the ground at home is not known"):
        planned(packs[1], route, home=valley)


def test_doctor_lets_a_route_pass_that_counts_from_a_home_it_cannot_be_told(packs, tmp_path):
    route = tmp_path / "r.txt"
    route.write_text("1,40,0,30\n2,60,0,30\n")
    told = _map(packs[0], load_route(route), None, SIFT, SafetyConfig())
    assert told.verdict == "WARN"
    assert "vwnav map check" in told.detail
    assert "--home LAT,LON" in told.detail


def test_each_navigator_has_looked_once_at_a_view_as_large_as_in_flight(
    packs, tmp_path, monkeypatch
):
    class Seen:
        name, feature_set_id = "sift", "seen"

        def __init__(self):
            self.sizes = []

        def extract(self, gray, max_keypoints):
            self.sizes.append(gray.size)

    seen = Seen()
    monkeypatch.setattr(planning, "choose_features", lambda *_: (seen, None))
    save_camera(default_camera().scaled(4000, 3000), tmp_path / "large.toml")
    route = plan_file(tmp_path, (50.0, 70.0), (120.0, 70.0))
    found = planned(packs[0], route, camera=tmp_path / "large.toml")
    assert found.features == (seen, None)
    # Not of the camera's size: of 12 megapixels it took 13 s and 0.7 GB.
    assert seen.sizes == [pytest.approx(found.config.localizer.max_view_area_px, rel=0.01)]
