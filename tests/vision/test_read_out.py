"""A rolling shutter's read-out, which nobody has told or somebody measured."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from vwnav.geometry.camera import Camera
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.types import Frame, OdometryMotion
from vwnav.vision.config import OdometryConfig
from vwnav.vision.odometry.odometry import Odometry

WIDTH, HEIGHT, AGL_M = 320, 240, 50.0
CAMERA = Camera.from_hfov(WIDTH, HEIGHT, 60.0)


def swung(t_s: float) -> np.ndarray:
    """R_ned_body of a body that pitches to and fro on the spot, up to 0.75 rad/s, and turns."""
    return rotation_from_euler(0.0, 0.15 * math.sin(5.0 * t_s), 0.25 * t_s)


def rates_rad_s(t_s: float) -> np.ndarray:
    """Of that, about the body's axes."""
    pitch_rad = 0.15 * math.sin(5.0 * t_s)
    turning = 0.25 * np.array([-math.sin(pitch_rad), 0.0, math.cos(pitch_rad)])
    return turning + np.array([0.0, 0.75 * math.cos(5.0 * t_s), 0.0])


def read_in_rows(t_s: float, readout_s: float) -> np.ndarray:
    """What `CAMERA` sees from `AGL_M` on that body, each row at its own time."""
    uv = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1).reshape(-1, 2)
    rays = CAMERA.bearings(uv.astype(np.float64)).reshape(HEIGHT, WIDTH, 3)
    rows_s = t_s + ((np.arange(HEIGHT) + 0.5) / HEIGHT - 0.5) * readout_s
    ground = np.stack(
        [ray @ (swung(s) @ CAMERA.R_body_camera).T for ray, s in zip(rays, rows_s, strict=True)]
    )
    at = ground[..., :2] / ground[..., 2:] * float(CAMERA.K[0, 0])
    maps = (250.0 + at[..., 1]).astype(np.float32), (250.0 - at[..., 0]).astype(np.float32)
    return cv2.remap(TEXTURE, *maps, cv2.INTER_CUBIC)


NOISE = np.random.default_rng(4).integers(0, 255, (500, 500), dtype=np.uint8)
TEXTURE = cv2.GaussianBlur(NOISE, (0, 0), 2.0) * 3


@pytest.mark.parametrize(
    ("readout_s", "calibrated_s"), [(0.02, None), (0.02, 0.02), (0.0, None), (0.0, 0.0)]
)
def test_it_is_learned_in_swings_and_a_hover_stays_one(readout_s, calibrated_s):
    camera = replace(CAMERA, readout_s=calibrated_s)
    odometry = Odometry(camera, OdometryConfig())
    for i in range(30):
        t_s = 0.1 * i
        frame = Frame(
            t_s, read_in_rows(t_s, readout_s), i,
            rates_rad_s=rates_rad_s(t_s), velocity_body_m_s=np.zeros(3),
        )  # fmt: skip
        look = odometry.step(frame, swung(t_s), AGL_M)
        if i > 0:
            assert isinstance(look, OdometryMotion)
            assert np.abs(look.displacement_ned_m).max() < 0.3
    value_s, sigma_s = odometry.readout_s
    assert abs(value_s - readout_s) < 3.0 * sigma_s
    assert sigma_s < 0.003
