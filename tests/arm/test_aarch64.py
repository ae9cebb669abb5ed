"""The program on an emulated Raspberry Pi 4 (Cortex-A72) and 5 (A76), held against x86.

`make test-arm` runs all of it, `make test` what is not marked, where `deploy/aarch64.sh` has set
the tree up. Floating point is not the same to the last bit: another order of sums.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from large_map import spread
from link_peer import Peer, free_port
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.geometry.calibration import save_camera
from vwnav.geometry.camera import Camera
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.maps.build.builder import BuildOptions, build_pack
from vwnav.maps.build.raster import array_source, local_georeference
from vwnav.sim.lens import RenderConfig
from vwnav.sim.named_sites import parse_site
from vwnav.sim.renderer import CameraRenderer
from vwnav.types import Features
from vwnav.vision.features.learned import LearnedFeatures
from vwnav.vision.matching import match

ABOARD = Path(__file__).with_name("aboard.py")
MODELS = ("default", "default_open", "default_int8", "nano", "nano_int8")
CPUS = ("cortex-a72", "cortex-a76")
PI4 = CPUS[0]
SAME_PX = 0.05
MOST_MB = 350.0
AGL_M, SPEED_M_S, FPS, FRAMES, HEADING_RAD = 55.0, 8.0, 10.0, 60, 0.4
START_M = -25.0  # along the way, home at 0
NORTH0_M, EAST0_M, MAP_PX, M_PER_PX = 500.0, -500.0, 3334, 0.3
COPIES = 10  # of that square kilometre, each way


def ground(look: str, size_wh: tuple[int, int]) -> np.ndarray:
    """A piece of the embedded site from above, (h, w) uint8."""
    bgr = parse_site("sim:default").render(look, 40.0, -60.0, size_wh, M_PER_PX)
    return cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)


def inliers(query: Features, reference: Features) -> int:
    """Of the matches of two images of one place."""
    pairs = match(query, reference)
    if len(pairs) < 4:
        return 0
    _, mask = cv2.findHomography(
        query.uv[pairs[:, 0]], reference.uv[pairs[:, 1]], cv2.USAC_MAGSAC, 3.0, maxIters=5000
    )
    return 0 if mask is None else int(mask.sum())


def agreement(here: Features, there: Features) -> tuple[float, float]:
    """Share of the keypoints that both found, and the lowest cosine of their descriptors."""
    gaps = np.linalg.norm(here.uv[:, None] - there.uv[None], axis=2)
    nearest = gaps.argmin(1)
    same = gaps.min(1) < SAME_PX
    cosines = np.sum(here.descriptors * there.descriptors[nearest], axis=1)[same]
    share = float(same.sum()) / max(len(here), len(there))
    return share, float(cosines.min())


def check_models(aarch64, cpu: str, size_wh: tuple[int, int], models, folder: Path) -> None:
    """One image by each model, there and here, and matched with the map's features."""
    image, map_image = ground("flight", size_wh), ground("map", size_wh)
    np.save(folder / "picture.npy", image)
    run = aarch64(cpu, ABOARD, "features", folder / "picture.npy", folder / "there", *models)
    print(f"{cpu} {size_wh} {run.said} peak {run.peak_mb:.0f} MB")
    for model in models:
        extractor = LearnedFeatures(Path(model))
        here, mapped = (extractor.extract(each, 1000) for each in (image, map_image))
        loaded = np.load(folder / f"there-{model}.npz")
        uv, descriptors = loaded["uv"], loaded["descriptors"]
        there = Features(uv, descriptors, np.ones(len(uv), np.float32))
        share, cosine = agreement(here, there)
        found = [inliers(each, mapped) for each in (here, there)]
        print(f"{cpu} {model}: {100 * share:.2f} % of {len(here)} keypoints, cosine {cosine:.6f}, "
              f"inliers {found[0]} here, {found[1]} there")  # fmt: skip
        if "int8" in model:
            assert share >= 0.97, model
            assert abs(found[1] - found[0]) <= 0.02 * found[0], model
        else:
            assert share >= 0.995, model
            assert cosine >= 0.999, model
        assert found[0] > 30  # there is something to compare
    assert run.peak_mb <= MOST_MB


def test_everything_that_flies_is_imported(aarch64):
    run = aarch64(PI4, ABOARD, "imports")
    assert run.said["machine"] == "aarch64"
    assert run.peak_mb <= MOST_MB


def test_every_released_model_gives_the_features_of_x86(aarch64, tmp_path):
    check_models(aarch64, PI4, (256, 192), MODELS, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("cpu", CPUS)
def test_every_released_model_at_the_cameras_size(aarch64, tmp_path, cpu):
    check_models(aarch64, cpu, (640, 480), MODELS, tmp_path)


@pytest.mark.long
def test_everything_is_imported_on_a_pi_5(aarch64):
    assert aarch64("cortex-a76", ABOARD, "imports").said["machine"] == "aarch64"


@pytest.mark.long
@pytest.mark.parametrize("cpu", CPUS)
def test_a_recording_is_written_and_read_back(aarch64, tmp_path, cpu):
    said = aarch64(cpu, ABOARD, "recorder", tmp_path).said
    assert (said["events"], said["whole"]) == (True, True)
    assert said["pictures"] >= 4


@pytest.mark.long
@pytest.mark.parametrize("cpu", CPUS)
def test_the_watchdogs_process_answers(aarch64, cpu):
    port = free_port()
    with Peer(port):
        run = aarch64(cpu, ABOARD, "watchdog", f"udpin://127.0.0.1:{port}")
    assert run.said == {"state": "RELAY"}


@pytest.mark.long
@pytest.mark.parametrize("cpu", CPUS)
def test_doctor_finds_the_autopilot_on_the_link(aarch64, cpu):
    port = free_port()
    with Peer(port) as peer:
        peer.params = {"COM_OF_LOSS_T": (5.0, mavlink.MAV_PARAM_TYPE_REAL32)}
        run = aarch64(cpu, "-m", "vwnav", "doctor", "--json", "--connection",
                      f"udpin://127.0.0.1:{port}")  # fmt: skip
    checks = {each["name"]: each for each in json.loads(run.out)["checks"]}
    assert checks["autopilot"]["detail"].startswith("PX4 on udpin://")
    assert checks["COM_OF_LOSS_T"]["detail"].startswith("is 5, should be 1 s or less")
    assert checks["learned features"]["detail"]
    assert run.peak_mb <= MOST_MB


@pytest.fixture(scope="session")
def flight(tmp_path_factory) -> Iterator[Path]:
    """Map of 100 km2 (2.4 GB), calibration, telemetry and 60 images of a flight, drawn once."""
    folder = tmp_path_factory.mktemp("flight")
    site = parse_site("sim:default")
    frame = LocalFrame(site.home_lat_deg, site.home_lon_deg, 0.0)
    bgr = site.render("map", NORTH0_M, EAST0_M, (MAP_PX, MAP_PX), M_PER_PX)
    source = array_source(bgr, local_georeference(frame, (NORTH0_M, EAST0_M), M_PER_PX), name="x")
    options = BuildOptions(name="x")
    build_pack([source], folder / "map.mbtiles", [LearnedFeatures()], options)
    spread(folder / "map.mbtiles", COPIES)
    camera = Camera.from_hfov(320, 240, 75.0)
    save_camera(camera, folder / "camera.toml")
    renderer = CameraRenderer(
        site, camera, RenderConfig(background=False), np.random.default_rng(5)
    )
    lossless = cv2.VideoWriter.fourcc(*"FFV1")  # other decoders may differ by a grey value
    video = cv2.VideoWriter(str(folder / "flight.mkv"), lossless, FPS, (320, 240))
    direction = np.array([np.cos(HEADING_RAD), np.sin(HEADING_RAD), 0.0])
    R_ned_body = rotation_from_euler(0.0, 0.0, HEADING_RAD)
    for i in range(FRAMES):
        at = direction * (i / FPS * SPEED_M_S + START_M) + [0.0, 0.0, -AGL_M]
        image = renderer.render(at, R_ned_body, i / FPS, SPEED_M_S * direction, np.zeros(3))
        video.write(image)
    video.release()
    renderer.close()
    rows = [f"{i / FPS},0,0,{np.degrees(HEADING_RAD)},{AGL_M}" for i in range(FRAMES + 1)]
    header = "t_s,roll_deg,pitch_deg,yaw_deg,agl_m"
    (folder / "telemetry.csv").write_text("\n".join([header, *rows]) + "\n")
    begin = [*(direction[:2] * START_M + 1.0), -AGL_M]  # a metre off
    known = {
        "position_ned_m": begin, "agl_m": AGL_M, "sigma_agl_m": 2.0, "sigma_velocity_m_s": SPEED_M_S
    }  # fmt: skip
    start = {"origin": [site.home_lat_deg, site.home_lon_deg, 0.0], "known": known}
    (folder / "start.json").write_text(json.dumps(start))
    yield folder
    (folder / "map.mbtiles").unlink()  # pytest keeps its folders


@pytest.mark.long
@pytest.mark.parametrize("cpu", CPUS)
@pytest.mark.parametrize(("model", "most_m"), [("default", 0.02), ("default_int8", 0.1)])
def test_the_whole_pipeline_flies_the_same_way(aarch64, here, flight, cpu, model, most_m):
    done = here(ABOARD, "flight", flight, model)
    assert done.returncode == 0, done.stderr
    ours = json.loads(done.stdout.splitlines()[-1])["rows"]
    run = aarch64(cpu, ABOARD, "flight", flight, model)
    theirs = run.said["rows"]
    assert len(ours) == len(theirs) == FRAMES
    assert [status for *_, status, _ in theirs] == [status for *_, status, _ in ours]
    assert sum(status == "fix" for *_, status, _ in ours) >= 20
    gaps_m = [float(np.hypot(a[0] - b[0], a[1] - b[1])) for a, b in zip(ours, theirs, strict=True)]
    print(f"{cpu} {model}: {len(gaps_m)} rows, {max(gaps_m):.4f} m, {run.peak_mb:.0f} MB, "
          f"{run.said['cpu_s']:.0f} s")  # fmt: skip
    assert max(gaps_m) <= most_m
    assert run.peak_mb <= MOST_MB
