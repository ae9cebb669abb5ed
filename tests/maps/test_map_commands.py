import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from geotiff_samples import marked_rgb, texture_rgb, write_tiff
from map_samples import ORIGIN_PX, ZOOM
from typer.testing import CliRunner

from vwnav.cli.map import app, route_and_home
from vwnav.errors import ConfigError, MapError, PreflightError, RouteError
from vwnav.geometry.geodesy import lat_lon_from_mercator_px

ROOT = Path(__file__).resolve().parents[2]


def run(*words: str | Path):
    result = CliRunner().invoke(app, [str(word) for word in words])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def text_route(folder: Path, *uv: tuple[float, float]) -> Path:
    lines = []
    for number, (u, v) in enumerate(uv):
        lat, lon = lat_lon_from_mercator_px(ORIGIN_PX[0] + u, ORIGIN_PX[1] + v, ZOOM)
        lines.append(f"{number},{lat:.8f},{lon:.8f},50")
    (folder / "route.txt").write_text("\n".join(lines))
    return folder / "route.txt"


def test_build_makes_a_pack_and_says_what_is_in_it(tmp_path: Path):
    source = write_tiff(tmp_path / "field.tif", texture_rgb())
    words = "--features sift --attribution survey --georeference-sigma-m 0.5 --levels 18,17"
    result = run("build", source, "-o", tmp_path / "f.mbtiles", *words.split())
    assert result.exit_code == 0
    for part in ("level 18", "level 17", "survey", "keypoints", "0.5 m"):
        assert part in result.stdout


def test_info_prints_one_json_object_and_nothing_else(sift_pack_file: Path):
    values = json.loads(run("info", sift_pack_file, "--json").stdout)
    assert values["name"] == "field"
    assert [level["zoom"] for level in values["levels"]] == [ZOOM, ZOOM - 1, ZOOM - 2]
    assert values["features"][0]["keypoints"] > 1000
    assert values["south_deg"] < values["north_deg"]


def test_info_tells_a_person_the_same(sift_pack_file: Path):
    text = run("info", sift_pack_file).stdout
    assert f"level {ZOOM}" in text
    assert "sift" in text


def test_check_passes_a_route_on_the_map(sift_pack_file: Path, tmp_path: Path):
    route = text_route(tmp_path, (200, 200), (500, 400))
    words = (
        "check",
        sift_pack_file,
        "--route",
        route,
        "--route-frame",
        "global",
        "--margin-m",
        "30",
    )
    assert "covers all" in run(*words).stdout
    assert json.loads(run(*words, "--json").stdout)["ok"] is True


def test_check_fails_a_route_beyond_the_map_and_says_where(sift_pack_file: Path, tmp_path: Path):
    route = text_route(tmp_path, (200, 200), (1500, 400))
    words = ("check", sift_pack_file, "--route", route, "--route-frame", "global", "--json")
    with pytest.raises(PreflightError, match="does not cover"):
        run(*words)
    values = json.loads(CliRunner().invoke(app, [str(word) for word in words]).stdout)
    assert values["ok"] is False
    assert values["uncovered"][0]["end_m"] == pytest.approx(values["length_m"])


def test_a_local_route_needs_a_home(sift_pack_file: Path, tmp_path: Path):
    (tmp_path / "r.txt").write_text("1,0,0,50\n2,111,0,50\n")
    words = ("check", sift_pack_file, "--route", tmp_path / "r.txt", "--json")
    with pytest.raises(RouteError, match=r"r\.txt: counts in metres .* --home LAT,LON"):
        run(*words)
    away = [str(word) for word in (*words, "--home", "60.0,22.0")]
    values = json.loads(CliRunner().invoke(app, away).stdout)
    assert values["length_m"] == pytest.approx(222.0, abs=0.2)  # there and back
    assert values["uncovered"][0]["start_lat_deg"] == pytest.approx(60.0)


@pytest.mark.parametrize(
    ("frame", "home"), [("moon", None), ("local", "x"), ("local", "99,2,3"), ("local", "99,2")]
)
def test_arguments_that_make_no_sense_are_refused(tmp_path: Path, frame: str, home: str | None):
    (tmp_path / "r.txt").write_text("1,0,0,50\n")
    with pytest.raises(ConfigError):
        route_and_home(tmp_path / "r.txt", frame, home)


def test_levels_that_are_no_numbers_are_a_usage_error(tmp_path: Path):
    result = CliRunner().invoke(app, ["build", "x.tif", "-o", "y.mbtiles", "--levels", "fine"])
    assert result.exit_code == 2


def test_a_pack_without_features_is_a_usage_error(tmp_path: Path):
    done = run("build", tmp_path / "a.tif", "-o", tmp_path / "a.mbtiles", "--features", " ,")
    assert done.exit_code == 2
    assert "no feature set" in done.stderr


def test_a_missing_source_is_a_map_error(tmp_path: Path):
    with pytest.raises(MapError, match="no such file"):
        run("build", tmp_path / "x.tif", "-o", tmp_path / "y.mbtiles", "--features", "sift")


@pytest.mark.parametrize(
    ("name", "says"), [("no/y.mbtiles", "no folder"), ("x.tif", "no map pack")]
)
def test_the_output_is_looked_at_before_any_source(tmp_path: Path, name: str, says: str):
    (tmp_path / "x.tif").write_bytes(b"II*\0 a raster that cannot be read")
    with pytest.raises(MapError, match=says):
        run("build", tmp_path / "x.tif", "-o", tmp_path / name, "--features", "sift")


def test_heights_are_taken_along(tmp_path: Path):
    source = write_tiff(tmp_path / "field.tif", texture_rgb())
    dem = write_tiff(tmp_path / "dem.tif", marked_rgb()[:1].astype("float32"))
    pack = tmp_path / "f.mbtiles"
    run("build", source, "-o", pack, "--features", "sift", "--levels", "17", "--heights", dem)
    assert json.loads(run("info", pack, "--json").stdout)["heights"] is True


def test_a_terminated_build_leaves_nothing(tmp_path: Path):
    source = write_tiff(tmp_path / "field.tif", texture_rgb(1200, 1200))
    script = "from vwnav.__main__ import main; main()"
    words = ["map", "build", str(source), "-o", str(tmp_path / "f.mbtiles"), "--features", "sift"]
    quiet = {"stderr": subprocess.DEVNULL, "stdout": subprocess.DEVNULL}
    with subprocess.Popen([sys.executable, "-c", script, *words], cwd=ROOT, **quiet) as build:
        while build.poll() is None and not list(tmp_path.glob(".f.mbtiles.*.tmp")):
            time.sleep(0.005)
        os.kill(build.pid, signal.SIGTERM)
    assert build.returncode != 0
    assert [file.name for file in tmp_path.iterdir()] == ["field.tif"]
