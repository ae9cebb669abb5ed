"""A recorded flight over a generated site with a camera mounted wrongly, late, and rolling."""

import time
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vwnav.bench.estimator.attitude_errors import AttitudeErrors
from vwnav.bench.estimator.world import DT_S, FilterWorld, TrueTrajectory, fly
from vwnav.estimation.events import NedFix
from vwnav.geometry.camera import R_BODY_CAMERA_DOWN, Camera
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import (
    quat_from_vector,
    quat_multiply,
    rotation_from_euler,
    rotation_from_quat,
    rotation_from_vector,
    vector_from_rotation,
)
from vwnav.recording.input_log import About, InputLog
from vwnav.recording.recorder import Recorder
from vwnav.sim.lens import RenderConfig
from vwnav.sim.named_sites import tiles_folder
from vwnav.sim.renderer import CameraRenderer, default_camera
from vwnav.sim.site import Site
from vwnav.types import Array, Attitude, Frame, Range

SECONDS, START_S, IMAGE_HZ = 110.0, 14.0, 1.5
LEG_S, SPEED_M_S, HEIGHT_M = 8.0, 8.0, 45.0
TURNS_DEG = (90, 90, -180, -90, -90, 180)
BOARD_DEG, RANGE_ZERO_M = 1.9, 0.05  # one sigma: how crooked the autopilot sits; of a rangefinder
_ENCODING_S = 0.02


@dataclass(frozen=True, slots=True)
class Mounted:
    """How the camera truly is.

    Attributes:
        rpy_deg: of the mount, Z-Y-X, on top of looking down with its top ahead.
        offset_s: of an exposure, less its stamp. readout_s: of all rows.
        focal: its focal length over that of `default_camera`.
        rangefinder: whether the flight tells heights.
    """

    rpy_deg: tuple[float, float, float] = (2.5, -3.0, 4.0)
    offset_s: float = 0.07
    readout_s: float = 0.02
    focal: float = 1.0
    rangefinder: bool = True

    @property
    def camera(self) -> Camera:
        """That camera; a lens whose focus moved bends the same pixels alike."""
        camera = default_camera()
        R = rotation_from_euler(*np.radians(self.rpy_deg)) @ R_BODY_CAMERA_DOWN
        K = camera.K * [[self.focal, 1, 1], [1, self.focal, 1], [1, 1, 1]]
        bent = zip(camera.distortion, (2, 4, 1, 1, 6), strict=True)
        distortion = tuple(k * self.focal**power for k, power in bent)
        return replace(camera, R_body_camera=R, K=K, distortion=distortion)


def record(path: Path, mounted: Mounted, site: Site, seed: tuple[int, ...] = (0,)) -> Array:
    """Write the recording of a flight over a site as `vwnav fly` would.

    Returns:
        (3, 3) the true mount, R_body_camera, against what the autopilot called level on average.
    """
    truth, quats, headings_rad = _flown(seed)
    rng = np.random.default_rng([6, *seed])
    zero_m = rng.normal(0.0, RANGE_ZERO_M)
    frame = LocalFrame(site.home_lat_deg, site.home_lon_deg, 0.0)
    config = RenderConfig(color=False, background=False, readout_s=mounted.readout_s)
    renderer = CameraRenderer(site, mounted.camera, config, rng, tiles_folder(site))
    lean = []
    with closing(renderer), closing(Recorder(path, {}, image_rate_hz=10.0)) as recorder:
        log = InputLog(recorder, About("learned", "", "nadir", frame, None))
        for i in range(0, len(truth.t_s), 3):
            log.input(Attitude(float(truth.t_s[i]), quats[i]))
            if mounted.rangefinder and i % 9 == 0:
                log.input(_range(truth, quats, i, zero_m, rng))
        stamps = np.arange(START_S, SECONDS - 1.0, 1.0 / IMAGE_HZ)
        for number, stamp in enumerate(stamps):
            i = round((stamp + mounted.offset_s) / DT_S)
            R = rotation_from_quat(truth.quat_wxyz[i])
            # The rate at the image's own time: one of 5 ms later looks like 0.3 ms of lateness.
            before, after = (rotation_from_quat(truth.quat_wxyz[k]) for k in (i - 1, i + 1))
            image = renderer.render(
                truth.position_ned_m[i],
                R,
                float(truth.t_s[i]),
                truth.velocity_ned_m_s[i],
                vector_from_rotation(before.T @ after) / (2.0 * DT_S),
            )
            recorder.frame(Frame(truth.t_s[i] - mounted.offset_s, image, number))
            if number == 0:
                log.input(_about(stamp, truth.position_ned_m[i]))
            told = rotation_from_quat(quats[i])
            unturned = rotation_from_euler(0.0, 0.0, -headings_rad[i]) @ told
            lean.append(vector_from_rotation(unturned.T @ R))
            time.sleep(_ENCODING_S)  # the writer drops images that come faster than it encodes
    return rotation_from_vector(np.mean(lean, axis=0)) @ mounted.camera.R_body_camera


def _flown(seed: tuple[int, ...]) -> tuple[TrueTrajectory, Array, Array]:
    """The true way, the autopilot's attitude (n, 4) and its heading's errors (n,) of a flight."""
    rng = np.random.default_rng([5, *seed])
    heading, legs = float(rng.uniform(-180, 180)), []
    for number in range(int((SECONDS - START_S) / LEG_S) + 1):
        legs.append((START_S + number * LEG_S, heading))
        heading += TURNS_DEG[number % len(TURNS_DEG)]
    world = FilterWorld(
        seconds=SECONDS, height_m=HEIGHT_M, climb_s=12.0, relief_m=0.0, speed_m_s=SPEED_M_S,
        wind_m_s=4.0, tilt_bias_deg=0.0, headings_deg=((0.0, legs[0][1]), *legs),
    )  # fmt: skip
    truth = fly(world, [rng])[0]
    errors = AttitudeErrors(world, truth, rng)
    # The autopilot's board is not level in the aircraft: that belongs to the body.
    crooked = quat_from_vector(np.radians([*rng.normal(0.0, BOARD_DEG, 2), 0.0]))
    return truth, np.array([quat_multiply(quat, crooked) for quat in errors.quats]), errors.yaw


def _range(
    truth: TrueTrajectory, quats: Array, i: int, zero_m: float, rng: np.random.Generator
) -> Range:
    """Along the down axis of what the autopilot takes for the body."""
    down = rotation_from_quat(quats[i])[2, 2]
    metres = -truth.position_ned_m[i, 2] / down * (1 + 0.01 * rng.normal()) + zero_m
    return Range(float(truth.t_s[i]), max(float(metres), 0.1))


def _about(t_s: float, position_ned_m: Array) -> NedFix:
    """The one place that the flight tells, a few metres beside the true one."""
    return NedFix(
        t_s=t_s,
        position_ne_m=position_ned_m[:2] + np.array([4.0, -3.0]),
        covariance_ne_m2=np.eye(2),
        agl_m=HEIGHT_M,
        sigma_agl_m=1.0,
    )
