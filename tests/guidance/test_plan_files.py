import contextlib
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.errors import RouteError
from vwnav.geometry.geodesy import LocalFrame
from vwnav.guidance.plan_files import GlobalWaypoint, LocalWaypoint, load_route

HOME = [47.397742, 8.545594, 488.0]
IN_ORDER = [[47.398, 8.546, 50.0], [47.399, 8.546, 50.0], [47.399, 8.547, 55.0]]


MULTI = "MultiLineString"


def item(command: int, place: list[float | None] | None = None, frame: int = 3) -> dict:
    params = [0, 0, 0, None, *(place or [0, 0, 0])]
    return {
        "type": "SimpleItem",
        "command": command,
        "frame": frame,
        "params": params,
        "autoContinue": True,
        "doJumpId": 1,
    }


def plan(items: list[dict], home: list[float] | None = HOME) -> dict:
    mission = {"items": items, "plannedHomePosition": home, "firmwareType": 12, "vehicleType": 2}
    return {"fileType": "Plan", "groundStation": "QGroundControl", "mission": mission, "version": 1}


def survey(items: list[dict]) -> dict:
    return {
        "type": "ComplexItem",
        "complexItemType": "survey",
        "TransectStyleComplexItem": {"Items": items, "VisualTransectPoints": []},
        "polygon": [[47.39, 8.54], [47.4, 8.54], [47.4, 8.55]],
    }


def line(coordinates: list[list[float]], kind: str = "LineString") -> dict:
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}}


@pytest.fixture
def write(tmp_path: Path):
    def file(name: str, content: object) -> Path:
        path = tmp_path / name
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return path

    return file


def refused(path: Path, frame: str = "local") -> str:
    with pytest.raises(RouteError) as caught:
        load_route(path, frame)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    assert len(message) < 400
    return message


def test_plan_gives_its_waypoints_and_home(write) -> None:
    items = [item(22, [None, None, 20]), *(item(16, p) for p in IN_ORDER), item(20)]
    route = load_route(write("route.plan", plan(items)))
    assert route.waypoints == tuple(GlobalWaypoint(*p) for p in IN_ORDER)
    assert route.home == (HOME[0], HOME[1])


def test_survey_gives_its_nested_waypoints_in_order(write) -> None:
    nested = [item(16, IN_ORDER[1]), item(206), item(16, IN_ORDER[2]), item(206)]
    route = load_route(write("route.plan", plan([item(16, IN_ORDER[0]), survey(nested)])))
    assert route.waypoints == tuple(GlobalWaypoint(*p) for p in IN_ORDER)


def test_delays_and_regions_of_interest_are_no_places(write) -> None:
    others = [item(93), item(80, [47.3, 8.5, 0.0]), item(178), item(201, [47.3, 8.5, 0.0])]
    items = [item(16, IN_ORDER[0]), *others, item(16, IN_ORDER[1])]
    route = load_route(write("route.plan", plan(items)))
    assert route.waypoints == tuple(GlobalWaypoint(*p) for p in IN_ORDER[:2])
    rows = (FLOWN[1], "3 0 3 93 5 0 0 0 0 0 0 1", "4 0 3 80 0 0 0 0 47.3 8.5 0 1", FLOWN[3])
    assert len(load_route(write("r.waypoints", wpl(*rows))).waypoints) == 2


ABOVE_SEA = plan([item(16, [47.398, 8.546, 548.0], frame=0), item(21, [47.4, 8.55, 0])])
VALLEY = (47.39, 8.54)


@pytest.mark.parametrize(
    ("home", "surveyed_m", "height_m"),
    [
        (HOME[:2], None, 60.0),
        ((47.3977, 8.5456), None, 60.0),  # the same with fewer digits
        (HOME[:2], 490.0, 58.0),
        (VALLEY, 438.0, 110.0),
    ],
)
def test_altitude_above_sea_level_is_flown_there_wherever_home_is(
    write, home, surveyed_m, height_m
) -> None:
    route = load_route(write("route.plan", ABOVE_SEA))
    ground_m = route.ground_amsl_m(tuple(home), surveyed_m)
    frame = LocalFrame(*home, 0.0)
    assert -route.to_ned(frame, 50.0, ground_m)[:, 2] == pytest.approx([height_m] * 2, abs=0.2)


def test_altitude_above_sea_level_is_refused_where_map_and_route_know_another_ground(write) -> None:
    """Heights above the ellipsoid, 47 m off in Europe: the route would be flown 47 m too low."""
    route = load_route(write("route.plan", ABOVE_SEA))
    with pytest.raises(RouteError, match="488 m above sea level by the route, 535 m by the map"):
        route.ground_amsl_m(HOME[:2], 535.0)
    relative = load_route(write("b.plan", plan([item(16, IN_ORDER[0])])))
    assert relative.ground_amsl_m(HOME[:2], 535.0) == 535.0


@pytest.mark.parametrize("home", [VALLEY, None])
def test_altitude_above_sea_level_is_refused_where_the_ground_at_home_is_not_known(
    write, home
) -> None:
    route = load_route(write("route.plan", ABOVE_SEA))
    frame = LocalFrame(*VALLEY, 0.0)
    with pytest.raises(RouteError, match="above sea level, and the ground at home is not known"):
        route.to_ned(frame, 50.0, route.ground_amsl_m(home, None))
    relative = load_route(write("b.plan", plan([item(16, IN_ORDER[0])])))
    assert len(relative.to_ned(frame, 50.0, None)) == 1


def test_altitude_above_sea_level_that_is_under_the_ground_at_home_is_refused(write) -> None:
    route = load_route(write("route.plan", ABOVE_SEA))
    with pytest.raises(RouteError, match="height -2 m above home"):
        route.to_ned(LocalFrame(*HOME), 50.0, 550.0)


@pytest.mark.parametrize("after", [item(16, IN_ORDER[1]), item(17, IN_ORDER[1]), item(177)])
def test_a_mission_ends_where_it_returns(write, after: dict) -> None:
    route = load_route(write("a.plan", plan([item(16, IN_ORDER[0]), item(20), after])))
    assert route.waypoints == (GlobalWaypoint(*IN_ORDER[0]),)


@pytest.mark.parametrize("landing", [item(21), item(21, [47.4, 8.55, 0])])
def test_a_mission_that_goes_on_after_a_landing_is_refused(write, landing: dict) -> None:
    items = [item(16, IN_ORDER[0]), landing, item(22), item(16, IN_ORDER[1])]
    assert "item 4: comes after a landing" in refused(write("a.plan", plan(items)))


def test_landing_place_is_flown_over_and_landing_anywhere_is_not(write) -> None:
    items = [item(16, IN_ORDER[0]), item(21, [47.4, 8.55, 0])]
    route = load_route(write("route.plan", plan(items)))
    assert route.waypoints[1] == GlobalWaypoint(47.4, 8.55, 50.0)
    assert len(load_route(write("b.plan", plan([items[0], item(21)]))).waypoints) == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (plan([]), "no waypoints"),
        (plan([item(22)]), "no waypoints"),
        (plan([item(16, [95.0, 8.5, 50.0])]), "not on the globe"),
        (plan([item(16, [47.0, 8.5, 5000.0])]), "height 5000"),
        (plan([item(16, [47.0, 8.5, 0.0])]), "height 0"),
        (plan([item(16, [None, 8.5, 50.0])]), "latitude"),
        (plan([item(16, ["47", 8.5, 50.0])]), "expected a number"),
        (plan([item(17, IN_ORDER[0])]), "command 17"),
        (plan([item(16, IN_ORDER[0], frame=10)]), "make it relative"),
        (plan([{"type": "SimpleItem", "command": 16, "frame": 3, "params": [1]}]), "seven params"),
        (plan([{"type": "ComplexItem", "complexItemType": "StructureScan"}]), "StructureScan"),
        (plan([{"type": "Other"}]), "unknown type"),
        (plan(IN_ORDER, home=[1.0]), "plannedHomePosition"),
        ({"fileType": "Plan", "mission": {}}, "without mission items"),
        ({"fileType": "GeoFence"}, "not a QGroundControl plan"),
        ("{", "not JSON"),
        ("[" * 100_000, "not JSON"),
        (json.dumps(plan([item(16, [47.0, float("nan"), 50.0])])), "longitude is nan"),
        (json.dumps(plan([item(16, [47.0, 8.5, float("inf")])])), "height is inf"),
        (json.dumps(plan([item(16, [47.0, 10**400, 50.0])])), "longitude"),
    ],
)
def test_senseless_plan_is_refused_in_one_line(write, content: object, message: str) -> None:
    assert message in refused(write("route.plan", content))


def wpl(*rows: str, home: str = "0 1 0 16 0 0 0 0 47.397742 8.545594 488.0 1") -> str:
    items = ["\t".join(row.split()) for row in (home, *rows) if row]
    return "\r\n".join(["QGC WPL 110", *items, ""])


FLOWN = (
    "1 0 3 22 0 0 0 0 0 0 30 1",
    "2 0 3 16 0 0 0 0 47.398 8.546 50 1",
    "3 0 3 178 1 5 0 0 0 0 0 1",
    "4 0 0 16 0 0 0 0 47.399 8.546 538 1",
    "5 0 3 20 0 0 0 0 0 0 0 1",
)


@pytest.mark.parametrize("name", ["r.waypoints", "r.txt"])
def test_mission_text_is_flown_as_the_same_plan_would_be(write, name: str) -> None:
    route = load_route(write(name, wpl(*FLOWN)))
    assert route.home == (47.397742, 8.545594)
    assert route.waypoints == (
        GlobalWaypoint(47.398, 8.546, 50.0),
        GlobalWaypoint(47.399, 8.546, None, 538.0),
    )
    assert route.home_amsl_m == 488.0


def test_mission_text_ends_where_it_returns(write) -> None:
    after = "6 0 3 16 0 0 0 0 47.4 8.546 50 1"
    assert len(load_route(write("r.waypoints", wpl(*FLOWN, after))).waypoints) == 2


def test_mission_text_may_not_know_home(write) -> None:
    nowhere = wpl(FLOWN[1], home="0 1 0 16 0 0 0 0 0 0 0 1")
    assert load_route(write("r.waypoints", nowhere)).home is None
    without = load_route(write("r.waypoints", wpl(FLOWN[1], home="")))
    assert (without.home, len(without.waypoints)) == (None, 1)


def test_a_heading_that_a_px4_left_open_is_no_damage(write) -> None:
    row = "2 0 3 16 0 0 0 nan 47.398 8.546 50 1"
    route = load_route(write("r.waypoints", wpl(row)))
    assert route.waypoints == (GlobalWaypoint(47.398, 8.546, 50.0),)


@pytest.mark.parametrize("part", ["geoFence", "rallyPoints"])
def test_what_a_plan_fences_in_is_said_not_to_be_kept(write, caplog, part: str) -> None:
    bare = {"geoFence": {"circles": [], "polygons": []}, "rallyPoints": {"points": []}}
    content = plan([item(16, IN_ORDER[0])]) | bare
    load_route(write("bare.plan", content))
    assert not caplog.messages
    held = {"circles": [{"circle": {"radius": 5}}], "points": [IN_ORDER[0]]}
    load_route(write("fenced.plan", content | {part: held}))
    assert "not kept by vwnav" in "".join(caplog.messages)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "first line is not 'QGC WPL'"),
        ("1,2,3,4", "first line is not 'QGC WPL'"),
        (wpl("1 0 3 16 0 0 0 0 47.398 8.546 50"), "line 3: 11 fields, expected 12"),
        (wpl("1 0 3 16 0 0 0 0 north 8.546 50 1"), "line 3: a field is 'north'"),
        (wpl("1 0 3 16 0 0 0 0 nan 8.546 50 1"), "line 3: a field is nan"),
        (wpl("1 0 3 16 0 0 0 0 147.398 8.546 50 1"), "mission item 1: latitude 147.398"),
        (wpl("1 0 10 16 0 0 0 0 47.398 8.546 50 1"), "mission item 1: altitude frame 10"),
        (wpl(*FLOWN[:4], "5 0 3 177 1 3 0 0 0 0 0 1"), "mission item 5: a jump back"),
        (wpl(FLOWN[1], home="0 1 0 16 0 0 0 0 147.4 8.5 488 1"), "latitude 147.4"),
        (wpl(), "it holds no waypoints"),
    ],
)
def test_senseless_mission_text_is_refused_in_one_line(write, content: str, message: str) -> None:
    assert message in refused(write("r.waypoints", content))


def test_line_string_gives_waypoints_lon_lat_height(write) -> None:
    coordinates = [[8.546, 47.398, 50.0], [8.547, 47.399]]
    for content in (
        line(coordinates),
        line(coordinates)["geometry"],
        {"type": "FeatureCollection", "features": [line(coordinates)]},
    ):
        route = load_route(write("route.geojson", content))
        assert route.waypoints[0] == GlobalWaypoint(47.398, 8.546, 50.0)
        assert route.waypoints[1] == GlobalWaypoint(47.399, 8.547, None)
        assert route.home is None


def test_a_multi_line_string_of_one_line_is_that_line(write) -> None:
    route = load_route(write("r.geojson", line([[[8.546, 47.398, 50.0], [8.547, 47.399]]], MULTI)))
    assert route.waypoints[0] == GlobalWaypoint(47.398, 8.546, 50.0)
    assert route.waypoints[1] == GlobalWaypoint(47.399, 8.547, None)


def test_points_are_flown_in_the_order_of_the_file(write) -> None:
    features = [line([lon, lat, h], "Point") for lat, lon, h in IN_ORDER]
    content = {"type": "FeatureCollection", "features": features}
    route = load_route(write("route.json", content))
    assert route.waypoints == tuple(GlobalWaypoint(*p) for p in IN_ORDER)


def test_json_may_be_a_plan_too(write) -> None:
    assert load_route(write("route.json", plan([item(16, IN_ORDER[0])]))).home is not None


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (line([]), "no waypoints"),
        (line([[47.398, 98.5]]), "not on the globe"),
        (line([[8.5]]), "lon, lat"),
        (line([[8.5, None]]), "latitude"),
        (line([[[8.5, 47.0]]], "Polygon"), "'Polygon' is no route"),
        (line([[[8.5, 47.0]], [[8.6, 47.0]]], MULTI), "a MultiLineString of 2 lines"),
        (line([[]], MULTI), "no waypoints"),
        (line([], MULTI), "'MultiLineString' is no route"),
        (line([8.5], MULTI), "'MultiLineString' is no route"),
        ({"type": "FeatureCollection"}, "without features"),
        ({"type": "Feature", "geometry": None}, "without geometry"),
        ({"type": "Topology"}, "'Topology' is no route"),
        ([1, 2], "neither"),
        ("3", "neither"),
        ('{"type": "Point", "coordinates": [NaN, 47.0]}', "longitude is nan"),
    ],
)
def test_senseless_geojson_is_refused_in_one_line(write, content: object, message: str) -> None:
    assert message in refused(write("route.geojson", content))


def test_thesis_text_is_north_east_height_or_latitude_longitude_height(write) -> None:
    path = write("route.txt", "1,10,-20.5,30\n\n 2 , 0, 1e1, 40\n")
    assert load_route(path).waypoints == (LocalWaypoint(10, -20.5, 30), LocalWaypoint(0, 10, 40))
    assert load_route(path, "global").waypoints[0] == GlobalWaypoint(10, -20.5, 30)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "no waypoints"),
        ("ID,X,Y,Z\n1,2,3,4\n", "line 1: X is 'X'"),
        ("1,2,3\n", "line 1: expected ID,X,Y,Z"),
        ("1,2,3,4\n1,5,6,7\n", "line 2: the ID '1' is there already"),
        ("1,2,nan,4\n", "Y is nan"),
        ("1,inf,3,4\n", "X is inf"),
        ("1,2,3,-4\n", "height -4"),
        ("1,2,3,99999\n", "height 99999"),
        ("1,2,3e9,50\n", "100 km"),
        (",2,3,4\n", "expected ID"),
        ("1,47.398,8.546,50\n2,47.411,8.541,50\n", "--route-frame global"),
    ],
)
def test_senseless_text_is_refused_in_one_line(write, content: str, message: str) -> None:
    assert message in refused(write("route.txt", content))


def test_a_ladder_above_one_point_is_no_route_in_degrees(write) -> None:
    assert len(load_route(write("route.txt", "1,5.5,3,10\n2,5.5,3,40\n")).waypoints) == 2


def test_latitude_out_of_range_in_text_is_refused(write) -> None:
    assert "not on the globe" in refused(write("route.txt", "1,95.0,8.5,50\n"), "global")


def test_other_kinds_missing_binary_and_huge_files_are_refused(write, tmp_path: Path) -> None:
    assert ".plan" in refused(write("route.kml", "<kml/>"))
    assert "cannot read" in refused(tmp_path / "none.plan")
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00\x80")
    assert "not a text file" in refused(tmp_path / "binary.txt")
    assert "10 MB" in refused(write("huge.txt", " " * 10_000_001))
    assert "10000 waypoints" in refused(
        write("many.txt", "".join(f"{i},1,2,3\n" for i in range(10_001)))
    )


@given(
    st.binary(max_size=200),
    st.sampled_from(["a.plan", "a.waypoints", "a.geojson", "a.json", "a.txt"]),
)
def test_any_bytes_give_a_route_or_one_clear_line(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, name: str
) -> None:
    path = tmp_path_factory.mktemp("route") / name
    path.write_bytes((b"QGC WPL 110\n" if name == "a.waypoints" else b"") + content)
    with contextlib.suppress(RouteError):
        assert load_route(path).waypoints


def test_routes_become_metres_north_east_down_of_home(write) -> None:
    frame = LocalFrame(*HOME)
    local = load_route(write("a.txt", "1,10,20,30\n")).to_ned(frame, 50.0, None)
    np.testing.assert_array_equal(local, [[10.0, 20.0, -30.0]])
    content = line([[HOME[1], HOME[0] + 0.001], [HOME[1], HOME[0], 70.0]])
    route = load_route(write("a.geojson", content)).to_ned(frame, 50.0, None)
    np.testing.assert_allclose(route, [[111.2, 0.0, -50.0], [0.0, 0.0, -70.0]], atol=0.1)
