"""`vwnav calibrate board` and `camera` by the real commands, on images of our own projection."""

import re
import struct
from functools import cache
from io import BytesIO

import cv2
import numpy as np
import pytest
from board_scenes import Lens, Studio, rotation
from PIL import Image

from vwnav.calibration.board import BoardFinder
from vwnav.geometry.calibration import load_camera, load_findings

PINHOLE = Lens(640, 480, 490.0, 492.0, 325.3, 236.2, (-0.21, 0.06, 0.0008, -0.0005, 0.01))
FISHEYE = Lens(640, 480, 264.0, 264.5, 322.3, 245.2, (-0.03, 0.01, -0.004, 0.001), True)
VIEWS = 24
SHEETS = {"a4": (210.0, 297.0, 25.0), "a3": (297.0, 420.0, 36.0)}


@cache
def studio_of(lens: Lens) -> Studio:
    """Its rays are worked out once."""
    return Studio(lens)


@pytest.fixture(scope="module", params=[PINHOLE, FISHEYE], ids=["pinhole", "fisheye"])
def studio(request) -> Studio:
    return studio_of(request.param)


def image_in(pdf: bytes) -> Image.Image:
    """The page's only image: its CCITT data in the envelope of a TIFF."""
    columns, rows = (int(re.search(rb"/%s (\d+)" % name, pdf)[1]) for name in (b"Columns", b"Rows"))
    data = re.search(rb"CCITTFaxDecode.*?stream\r?\n(.*?)\r?\nendstream", pdf, re.S)[1]
    tags = [
        (256, columns), (257, rows), (258, 1), (259, 4), (262, 1), (273, 8),
        (277, 1), (278, rows), (279, len(data)),
    ]  # fmt: skip
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags)
    ifd = struct.pack("<H", len(tags)) + entries + struct.pack("<I", 0)
    return Image.open(BytesIO(b"II*\0" + struct.pack("<I", 8 + len(data)) + data + ifd))


@pytest.mark.parametrize("paper", SHEETS)
def test_the_board_is_drawn_to_scale(vwnav, tmp_path, paper):
    width_mm, height_mm, square_mm = SHEETS[paper]
    done = vwnav("calibrate", "board", "-o", tmp_path / "board.pdf", "--paper", paper)
    assert done.code == 0, done.err
    pdf = (tmp_path / "board.pdf").read_bytes()
    page = [float(x) for x in re.search(rb"MediaBox \[ ([\d. ]+) ?\]", pdf)[1].split()]
    assert np.allclose(np.array(page[2:]) / 72 * 25.4, [width_mm, height_mm], atol=0.01)
    drawn = np.asarray(image_in(pdf).convert("L"))
    px_per_mm = drawn.shape[1] / width_mm
    small = cv2.resize(drawn, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    view = BoardFinder().find(small)
    assert len(view.ids) == 54
    corners_mm = ((view.uv + 0.5) * 4 - 0.5) / px_per_mm
    apart = corners_mm - corners_mm[0] - (view.places - view.places[0])[:, :2] * square_mm
    assert np.abs(apart).max() < 0.05


def test_the_lens_is_found_from_a_folder_of_images(vwnav, tmp_path, studio):
    for number in range(VIEWS):
        cv2.imwrite(str(tmp_path / f"{number}.png"), studio.view(number))
    done = vwnav("calibrate", "camera", tmp_path, "-o", tmp_path / "camera.toml")
    assert done.code == 0, done.err
    camera, found = load_camera(tmp_path / "camera.toml"), load_findings(tmp_path / "camera.toml")
    lens = studio.lens
    assert camera.model == ("fisheye" if lens.fisheye else "pinhole")
    assert abs(camera.K[0, 0] / lens.fx - 1) < 1e-3
    assert abs(camera.K[1, 1] / lens.fy - 1) < 1e-3
    assert np.abs(camera.K[:2, 2] - [lens.cx, lens.cy]).max() < 0.5
    errors = {
        "fx_px": camera.K[0, 0] - lens.fx, "fy_px": camera.K[1, 1] - lens.fy,
        "cx_px": camera.K[0, 2] - lens.cx, "cy_px": camera.K[1, 2] - lens.cy,
    }  # fmt: skip
    for name, error in errors.items():
        assert abs(error) < 3.0 * found[f"sigma_{name}"], name
        assert found[f"sigma_{name}"] < 1.0
    assert 0.02 < found["held_out_px"] < 0.2
    assert found["verdict"] == "good"
    assert "good" in done.out


@pytest.mark.long
def test_a_video_of_the_board_serves_too(vwnav, tmp_path):
    """Each pose is held for three frames: those that show nothing new are left out."""
    studio, path = studio_of(PINHOLE), tmp_path / "board.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 15.0, (640, 480))
    for number in range(VIEWS):
        image = cv2.cvtColor(studio.view(number), cv2.COLOR_GRAY2BGR)
        for _ in range(3):
            writer.write(image)
    writer.release()
    done = vwnav("calibrate", "camera", path, "-o", tmp_path / "camera.json")
    assert done.code == 0, done.err
    found = load_findings(tmp_path / "camera.json")
    assert found["views"] == VIEWS
    assert abs(load_camera(tmp_path / "camera.json").K[0, 0] / PINHOLE.fx - 1) < 1e-3


def test_what_fixes_no_lens_is_refused_in_one_line(vwnav, tmp_path):
    studio = studio_of(PINHOLE)
    flat, few, none = (tmp_path / name for name in ("flat", "few", "none"))
    for folder in (flat, few, none):
        folder.mkdir()
    for number in range(12):
        cv2.imwrite(str(flat / f"{number}.png"), studio.view(number, tilt_deg=0.0))
    for number in range(3):
        cv2.imwrite(str(few / f"{number}.png"), studio.view(number))
    cv2.imwrite(str(none / "0.png"), np.full((480, 640), 90, np.uint8))
    complaints = {}
    for folder in (flat, few, none):
        done = vwnav("calibrate", "camera", folder, "-o", folder / "camera.toml")
        assert done.code == 1, done.out
        complaints[folder.name] = done.complaint
        assert not (folder / "camera.toml").exists()
    assert "tells no focal length" in complaints["flat"]
    assert "found in 3 different pictures; 8 are needed" in complaints["few"]
    assert "the board is in none of 1 pictures" in complaints["none"]


def test_a_half_shown_board_is_told_what_is_missing(vwnav, tmp_path):
    """Only the middle of the image, leaning one way: usable at best, and it says why."""
    studio = studio_of(PINHOLE)
    rng = np.random.default_rng(4)
    for number in range(14):
        lean = rotation(
            np.radians(rng.uniform(18, 40)) * np.array([1.0, rng.uniform(-1, 1) * 0.2, 0])
        )
        R = lean @ rotation(np.array([0, 0, rng.uniform(-0.6, 0.6)]))
        at = np.array([rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(16, 26)])
        cv2.imwrite(str(tmp_path / f"{number}.png"), studio.photograph(R, at - R @ [3.5, 5.0, 0]))
    done = vwnav("calibrate", "camera", tmp_path, "-o", tmp_path / "camera.toml")
    words = done.err
    assert "edge nearer" in words
    assert "of the picture" in words
    assert done.code == 1 or load_findings(tmp_path / "camera.toml")["verdict"] == "usable"


def test_a_calibration_is_never_written_over(vwnav, tmp_path):
    (tmp_path / "camera.toml").write_text("mine")
    done = vwnav("calibrate", "camera", tmp_path, "-o", tmp_path / "camera.toml")
    assert done.code == 1
    assert "is there already" in done.complaint
    assert (tmp_path / "camera.toml").read_text() == "mine"
