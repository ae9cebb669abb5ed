"""A small generated place, its map pack and a video of a flight over it."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from vwnav.geometry.calibration import save_camera
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.maps.build.builder import BuildOptions, build_pack
from vwnav.maps.build.raster import array_source, local_georeference
from vwnav.sim.lens import RenderConfig
from vwnav.sim.named_sites import parse_site
from vwnav.sim.renderer import CameraRenderer, default_camera
from vwnav.vision.features.load import load_features

ROOT = Path(__file__).resolve().parents[2]
AGL_M, SPEED_M_S, FPS, FRAMES, HEADING_RAD = 60.0, 8.0, 10.0, 40, 0.4
NORTH0_M, EAST0_M, MAP_PX, M_PER_PX = 180.0, -180.0, 1200, 0.3
BLOCKED = ("torch", "kornia", "rasterio", "scipy", "pyproj", "matplotlib")


@dataclass(frozen=True)
class Run:
    """What a command said and left."""

    code: int
    out: str
    err: str

    @property
    def complaint(self) -> str:
        """The one line of a failure."""
        lines = [line for line in self.err.splitlines() if line.startswith("vwnav: ")]
        assert len(lines) == 1, self.err
        assert "Traceback" not in self.err
        return lines[0]


@dataclass(frozen=True)
class Place:
    """Files of the small place, and where the video's camera truly was: (n, 2) lat, lon."""

    pack: Path
    video: Path
    camera: Path
    telemetry: Path
    image: Path
    truth_lat_lon_deg: np.ndarray
    frame: LocalFrame


@pytest.fixture(scope="session")
def vwnav(tmp_path_factory):
    """Runs the real command as the drone has it: no workstation library can be imported."""
    folder = tmp_path_factory.mktemp("onboard")
    (folder / "sitecustomize.py").write_text(
        f"import sys\nfor name in {BLOCKED!r}:\n    sys.modules[name] = None\n"
    )

    def run(*arguments, blocked=True, timeout_s=300.0, cwd=ROOT):
        paths = [str(folder)] * blocked + [str(ROOT)]
        env = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "COLUMNS": "200"}
        command = [sys.executable, "-m", "vwnav", *map(str, arguments)]
        done = subprocess.run(
            command, capture_output=True, text=True, env=env, cwd=cwd, timeout=timeout_s
        )
        return Run(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture(scope="session")
def place(tmp_path_factory) -> Place:
    folder = tmp_path_factory.mktemp("place")
    site = parse_site("sim:default")
    frame = LocalFrame(site.home_lat_deg, site.home_lon_deg, 0.0)
    bgr = site.render("map", NORTH0_M, EAST0_M, (MAP_PX, MAP_PX), M_PER_PX)
    georeference = local_georeference(frame, (NORTH0_M, EAST0_M), M_PER_PX)
    extractors = [load_features("learned"), load_features("sift")]
    pack = folder / "place.mbtiles"
    build_pack(
        [array_source(bgr, georeference, name="place")],
        pack,
        extractors,
        BuildOptions(name="place", georeference_sigma_m=1.0),
    )
    camera = default_camera()
    save_camera(camera, folder / "camera.toml")
    path_ned_m = _path()
    images = _render(site, camera, path_ned_m)
    writer = cv2.VideoWriter(
        str(folder / "flight.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), FPS, (640, 480)
    )
    for image in images:
        writer.write(image)
    writer.release()
    cv2.imwrite(str(folder / "picture.png"), images[0])
    rows = [f"{i / FPS},0,0,{np.degrees(HEADING_RAD)},{AGL_M}" for i in range(FRAMES + 1)]
    header = "t_s,roll_deg,pitch_deg,yaw_deg,agl_m"
    (folder / "telemetry.csv").write_text("\n".join([header, *rows]) + "\n")
    lat_deg, lon_deg, _ = frame.to_geodetic(path_ned_m)
    return Place(
        pack,
        folder / "flight.mp4",
        folder / "camera.toml",
        folder / "telemetry.csv",
        folder / "picture.png",
        np.stack([lat_deg, lon_deg], axis=-1),
        frame,
    )


def _path() -> np.ndarray:
    along_m = np.arange(FRAMES) / FPS * SPEED_M_S - 20.0
    north, east = np.cos(HEADING_RAD) * along_m, np.sin(HEADING_RAD) * along_m
    return np.stack([north, east, np.full(FRAMES, -AGL_M)], axis=-1)


def _render(site, camera, path_ned_m) -> list[np.ndarray]:
    config = RenderConfig(background=False)
    renderer = CameraRenderer(site, camera, config, np.random.default_rng(5))
    R_ned_body = rotation_from_euler(0.0, 0.0, HEADING_RAD)
    velocity = SPEED_M_S * np.array([np.cos(HEADING_RAD), np.sin(HEADING_RAD), 0.0])
    images = [
        renderer.render(at, R_ned_body, i / FPS, velocity, np.zeros(3))
        for i, at in enumerate(path_ned_m)
    ]
    renderer.close()
    return images


def read_run(folder: Path) -> dict:
    return json.loads((folder / "run.json").read_text())
