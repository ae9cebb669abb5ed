"""Rows that are exposed one after the other, put back to the middle one's moment."""

from dataclasses import replace

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from vwnav.geometry.camera import Camera
from vwnav.geometry.homography import continuous_homography, skew_per_s
from vwnav.geometry.rotations import rotation_from_euler, rotation_from_vector
from vwnav.types import Frame
from vwnav.vision.shutter import is_visible, seen_by_rows

READOUT_S, HEIGHT_M = 0.02, 50.0
STILL = Frame(0.0, np.zeros((480, 640), np.uint8), 0)
LENS = replace(
    Camera.from_hfov(640, 480, 80.0), distortion=(-0.11, 0.025, 0.0004, -0.0003),
    readout_s=READOUT_S,
)  # fmt: skip
rates = st.tuples(*[st.floats(-1.05, 1.05)] * 3)
speeds = st.tuples(*[st.floats(-12.0, 12.0)] * 2, st.floats(-4.0, 4.0))
tilts = st.tuples(*[st.floats(-0.3, 0.3)] * 2, st.floats(-3.0, 3.0))


def mount_of(camera: Camera):
    return camera.R_body_camera, camera.t_body_camera_m


def seen_and_at_once(camera: Camera, rate, velocity, tilt):
    """Ground points (n, 3): pixels as the rows see them, as a global shutter does, and the flow."""
    R, rate, velocity = rotation_from_euler(*tilt), np.array(rate), np.array(velocity)
    arm = camera.t_body_camera_m
    u, v = np.meshgrid(np.linspace(20, 620, 9), np.linspace(15, 465, 9))
    at_once = np.stack([u, v], axis=-1).reshape(-1, 2)
    rays = camera.bearings(at_once) @ (R @ camera.R_body_camera).T
    ground = R @ arm + rays * (HEIGHT_M / rays[:, 2:])
    seen = at_once.copy()
    for _ in range(6):
        for i, (_, row) in enumerate(seen.copy()):
            t_s = ((row + 0.5) / 480 - 0.5) * READOUT_S
            R_then = R @ rotation_from_vector(rate * t_s)
            away = ground[i] - t_s * (R @ velocity) - R_then @ arm
            seen[i] = camera.project(away @ (R_then @ camera.R_body_camera))[0]
    frame = replace(STILL, rates_rad_s=rate, velocity_body_m_s=velocity)
    down_camera = (R @ camera.R_body_camera)[2]
    return seen, at_once, continuous_homography(frame, mount_of(camera), down_camera, HEIGHT_M)


def px_apart(camera: Camera, rays: np.ndarray, uv: np.ndarray) -> float:
    pinhole = camera.undistorted()
    straight = pinhole.project(camera.bearings(uv))
    return float(np.abs(pinhole.project(rays) - straight).max())


@given(rate=rates, velocity=speeds, tilt=tilts)
@example(rate=(0.046875, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), tilt=(0.0, 0.0, 0.0))
@example(rate=(0.0, 0.03125, 0.0390625), velocity=(0.0, 0.0, 0.0), tilt=(0.0, 0.0, 0.0))
def test_points_are_put_back_to_the_middle_rows_moment(rate, velocity, tilt):
    arm_m = np.array([0.4, -0.2, 0.1])
    mount = rotation_from_euler(0.1, -0.05, 0.4) @ LENS.R_body_camera
    camera = replace(LENS, R_body_camera=mount, t_body_camera_m=arm_m)
    seen, at_once, flow = seen_and_at_once(camera, rate, velocity, tilt)
    rays = camera.bearings(seen)
    back = rays + READOUT_S * skew_per_s(rays, seen[:, 1], 480, flow)
    assert px_apart(camera, back, at_once) < 0.15
    if not is_visible(flow, camera):
        assert px_apart(camera, rays, at_once) < 0.3


def test_of_a_motion_that_nobody_told_nothing_is_put_back():
    flow = continuous_homography(STILL, mount_of(LENS), np.array([0.0, 0.0, 1.0]), HEIGHT_M)
    assert not flow.any()
    assert not is_visible(flow, LENS)


def test_a_heading_that_is_reset_is_no_turn_that_rows_show():
    """By 90 degrees between two attitudes: taken for one it told a read-out of nothing, surely."""
    reset = np.array([0.0, 0.0, 0.5 * np.pi / 0.02])
    told = replace(STILL, rates_rad_s=reset, velocity_body_m_s=np.zeros(3))
    down_camera = np.array([0.0, 0.0, 1.0])
    assert not continuous_homography(told, mount_of(LENS), down_camera, HEIGHT_M).any()


def test_an_image_is_put_back_too():
    """What is fetched from is where the rows saw it."""
    seen, at_once, flow = seen_and_at_once(LENS, (0.3, -0.5, 1.0), (12.0, 3.0, 1.0), (0.1, -0.1, 2))
    assert is_visible(flow, LENS)
    fetched = seen_by_rows(LENS.bearings(at_once), LENS, flow)
    assert np.abs(fetched - seen).max() < 0.2
