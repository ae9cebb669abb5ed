import csv
import json
import math
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from vwnav.cli.localize import localize
from vwnav.errors import ConfigError, MapError, ModelError, SourceError

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "vision"))
from vision_scenes import CAMERA, HOME, frame_at, ground_pack, texture

FIELDS = {
    "image", "status", "reason", "lat_deg", "lon_deg", "sigma_m", "yaw_deg", "agl_m", "keypoints",
    "matches", "inliers", "features", "time_ms", "point",
}  # fmt: skip
PLACE = ("--lat", "47.0", "--lon", "8.0", "--sigma-m", "30", "--yaw-deg", "0", "--agl-m", "60")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a map and images of it: two good ones and a black one."""
    from vwnav.vision.features.load import load_features

    folder = tmp_path_factory.mktemp("localize")
    ground = texture(0, 700)
    ground_pack(folder / "map.mbtiles", ground, (load_features("orb"),))
    (folder / "pictures").mkdir()
    for name, north_m, east_m in (("a.png", 10.0, -8.0), ("b.png", -6.0, 4.0)):
        image = frame_at(ground, north_m, east_m, 60.0).image
        cv2.imwrite(str(folder / "pictures" / name), image)
    cv2.imwrite(str(folder / "pictures" / "dark.png"), np.zeros((360, 480), np.uint8))
    return folder


def run(scene: Path, *arguments: str):
    app = typer.Typer()
    app.command()(localize)
    common = ["--map", str(scene / "map.mbtiles"), "--features", "orb"]
    return CliRunner().invoke(app, [*map(str, arguments), *common])


def lines(result) -> list[dict]:
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines()]


def test_each_image_gives_one_json_object(scene: Path):
    found = lines(run(scene, scene / "pictures", "--hfov-deg", "70", *PLACE, "--json"))
    assert [Path(line["image"]).name for line in found] == ["a.png", "b.png", "dark.png"]
    assert [line["status"] for line in found] == ["fix", "fix", "rejected"]
    assert all(set(line) >= FIELDS for line in found)
    assert set(found[0]["time_ms"]) == {"rectify", "extract", "match", "verify", "total"}
    ned = HOME.to_ned(found[0]["lat_deg"], found[0]["lon_deg"], HOME.alt_amsl_m)
    assert ned[:2] == pytest.approx([10.0, -8.0], abs=0.5)


def test_a_rejected_image_is_a_result_with_its_reason(scene: Path):
    (line,) = lines(run(scene, scene / "pictures/dark.png", "--hfov-deg", "70", "--json"))
    assert line["status"] == "rejected"
    assert line["reason"] == "picture without contrast"
    assert line["lat_deg"] is line["yaw_deg"] is line["point"] is None


def test_without_a_prior_the_map_is_searched(scene: Path):
    (line,) = lines(run(scene, scene / "pictures/b.png", "--hfov-deg", "70", "--json"))
    assert (line["status"], line["point"]) == ("fix", "center")
    assert line["agl_m"] == pytest.approx(60.0, rel=0.03)
    assert min(line["yaw_deg"], 360 - line["yaw_deg"]) < 1.0


def test_a_table_tells_what_is_known_of_each_image(scene: Path, tmp_path: Path):
    known = {"lat_deg": 47.0, "lon_deg": 8.0, "sigma_m": 30, "agl_m": 60, "yaw_deg": 0}
    with (tmp_path / "table.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, ["image", *known, "roll_deg", "pitch_deg"])
        writer.writeheader()
        writer.writerow({"image": "a.png", **known, "roll_deg": 0, "pitch_deg": 0})
    table = ("--metadata", tmp_path / "table.csv")
    (line,) = lines(run(scene, scene / "pictures/a.png", "--hfov-deg", "70", *table, "--json"))
    assert (line["status"], line["point"]) == ("fix", "nadir")


def test_a_camera_file_stands_for_the_field_of_view(scene: Path, tmp_path: Path):
    from vwnav.geometry.calibration import save_camera

    save_camera(CAMERA, tmp_path / "camera.json")
    camera = ("--camera", tmp_path / "camera.json")
    (line,) = lines(run(scene, scene / "pictures/a.png", *camera, *PLACE, "--json"))
    assert line["status"] == "fix"


def test_for_people_there_is_a_line_per_image(scene: Path):
    result = run(scene, scene / "pictures", "--hfov-deg", "70", *PLACE)
    assert result.exit_code == 0
    first, _, last = result.stdout.splitlines()
    assert first.startswith("a.png: center at 47.000")
    assert last.startswith("dark.png: no fix, picture without contrast")


def test_hidden_files_and_folders_are_no_pictures_of_a_folder(scene: Path, tmp_path: Path):
    (tmp_path / "a.png").write_bytes((scene / "pictures/dark.png").read_bytes())
    (tmp_path / "._a.png").write_bytes(b"\0\5\x16\7")
    (tmp_path / "dir.png").mkdir()
    result = run(scene, tmp_path, "--hfov-deg", "70", *PLACE)
    assert result.exit_code == 0
    assert [line.split(":")[0] for line in result.stdout.splitlines()] == ["a.png"]


def test_exif_gives_place_heading_height_and_lens(scene: Path, tmp_path: Path):
    Image = pytest.importorskip("PIL.Image")
    exif = Image.Exif()
    focal_35mm = 43.27 / math.hypot(1.0, 0.75) / (2.0 * math.tan(math.radians(35.0)))
    exif.get_ifd(0x8769)[0xA405] = round(focal_35mm)
    exif.get_ifd(0x8825).update({1: "N", 2: (47.0, 0.0, 0.0), 3: "E", 4: (8.0, 0.0, 0.0)})
    names = {"RelativeAltitude": 60, "GimbalYawDegree": 0, "GimbalPitchDegree": -90}
    xmp = "".join(f'drone-dji:{n}="{v}" ' for n, v in {**names, "GimbalRollDegree": 0}.items())
    with Image.open(scene / "pictures/a.png") as image:
        image.save(tmp_path / "a.jpg", exif=exif, xmp=f"<a {xmp}/>".encode(), quality=95)
    (line,) = lines(run(scene, tmp_path / "a.jpg", "--prior", "exif", "--json"))
    assert (line["status"], line["point"]) == ("fix", "nadir")


def test_an_image_that_was_turned_after_it_was_taken_is_found(scene: Path, tmp_path: Path):
    Image = pytest.importorskip("PIL.Image")
    names = {"RelativeAltitude": 60, "GimbalYawDegree": 0, "GimbalPitchDegree": -90}
    xmp = "".join(f'drone-dji:{n}="{v}" ' for n, v in {**names, "GimbalRollDegree": 0}.items())
    exif = Image.Exif()
    exif.get_ifd(0x8825).update({1: "N", 2: (47.0, 0.0, 0.0), 3: "E", 4: (8.0, 0.0, 0.0)})
    with Image.open(scene / "pictures/a.png") as image:
        turned = image.rotate(180)
        turned.save(tmp_path / "a.jpg", exif=exif, xmp=f"<a {xmp}/>".encode(), quality=95)
    exif_prior = ("--prior", "exif", "--hfov-deg", "70", "--json")
    (line,) = lines(run(scene, tmp_path / "a.jpg", *exif_prior))
    assert line["status"] == "fix"
    assert line["yaw_deg"] == pytest.approx(180.0, abs=1.0)


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("none.png", "--hfov-deg", "70"), SourceError),
        (("pictures/a.png", "--hfov-deg", "70", "--metadata", "none.csv"), SourceError),
        (("pictures/a.png", "--hfov-deg", "70", "--features", "surf"), ConfigError),
        (
            ("pictures/a.png", "--hfov-deg", "70", "--features", "learned", "--model", "no.onnx"),
            ModelError,
        ),
    ],
)
def test_bad_input_is_one_error(scene: Path, monkeypatch, arguments, error):
    monkeypatch.chdir(scene)
    app = typer.Typer()
    app.command()(localize)
    common = ["--map", "map.mbtiles", "--features", "orb"]
    result = CliRunner().invoke(app, [*common, *arguments])
    assert isinstance(result.exception, error)
    assert "\n" not in str(result.exception)


def test_a_missing_map_is_one_error(tmp_path: Path, scene: Path):
    app = typer.Typer()
    app.command()(localize)
    arguments = [
        str(scene / "pictures/a.png"),
        "--map",
        str(tmp_path / "none"),
        "--features",
        "orb",
    ]
    assert isinstance(CliRunner().invoke(app, arguments).exception, MapError)


def test_a_damaged_image_is_named_after_the_others_are_done(scene: Path, tmp_path: Path):
    (tmp_path / "cut.png").write_bytes((scene / "pictures/a.png").read_bytes()[:500])
    images = (tmp_path / "cut.png", scene / "pictures/b.png")
    result = run(scene, *images, "--hfov-deg", "70", *PLACE, "--json")
    assert json.loads(result.stdout.splitlines()[-1])["status"] == "fix"
    assert isinstance(result.exception, SourceError)
    assert "1 of 2" in str(result.exception)


def test_a_picture_without_a_lens_is_named_after_the_others_are_done(scene: Path, tmp_path: Path):
    Image = pytest.importorskip("PIL.Image")
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 30
    with Image.open(scene / "pictures/dark.png") as image:
        image.save(tmp_path / "told.jpg", exif=exif)
    untold = scene / "pictures/dark.png"
    result = run(scene, untold, tmp_path / "told.jpg", "--json")
    (line,) = (json.loads(each) for each in result.stdout.splitlines())
    assert Path(line["image"]).name == "told.jpg"
    assert result.exit_code == 1
    told = str(result.exception)
    assert told.startswith(f"1 of 2 pictures were left out: {untold} does not say its lens")
    assert "give --camera FILE or --hfov-deg X" in told


def test_a_picture_of_another_size_than_the_cameras_is_named_after_the_others_are_done(
    scene: Path, tmp_path: Path
):
    from vwnav.geometry.calibration import save_camera

    save_camera(CAMERA, tmp_path / "camera.json")
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((180, 240), np.uint8))
    images = (tmp_path / "small.png", scene / "pictures/dark.png")
    result = run(scene, *images, "--camera", tmp_path / "camera.json", "--json")
    (line,) = (json.loads(each) for each in result.stdout.splitlines())
    assert Path(line["image"]).name == "dark.png"
    assert result.exit_code == 1
    assert f"1 of 2 pictures were left out: {images[0]}: the calibration" in str(result.exception)


def test_where_no_picture_says_its_lens_the_line_says_what_to_give(scene: Path, tmp_path: Path):
    (tmp_path / "cut.png").write_bytes((scene / "pictures/a.png").read_bytes()[:500])
    result = run(scene, tmp_path / "cut.png", scene / "pictures")
    assert isinstance(result.exception, SourceError)
    told = str(result.exception)
    assert told.startswith("4 of 4 pictures were left out: ")
    assert "cut.png" in told
    assert "a.png does not say its lens: give --camera FILE or --hfov-deg X" in told
    assert "\n" not in told


@pytest.mark.parametrize(
    "wrong", [("--lat", "47.0"), ("--prior", "gps"), ("--lat", "99", "--lon", "0")]
)
def test_wrong_usage_is_exit_code_2(scene: Path, wrong):
    assert run(scene, scene / "pictures/a.png", *wrong).exit_code == 2
