import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from vision_scenes import CAMERA, M_PER_PX, picture, texture

from vwnav.errors import CalibrationError
from vwnav.geometry.homography import transform_points
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.vision.view import Undistorted, ViewMaker

GROUND = texture(8)


def view_of(extractor, rpy_deg=(0.0, 0.0, 0.0), m_per_px=M_PER_PX, camera=CAMERA):
    maker = ViewMaker(camera, extractor)
    frame = picture(GROUND, 10.0, -5.0, 60.0, rpy_deg=rpy_deg)
    undistorted = maker.picture(frame.image)
    R_ned_body = rotation_from_euler(*map(math.radians, rpy_deg))
    rectification = maker.rectify(undistorted, R_ned_body, 60.0, m_per_px)
    gray = maker.warp(undistorted, rectification)
    return undistorted, maker.extract(undistorted, rectification, gray, 500)


@pytest.mark.parametrize("rpy_deg", [(0, 0, 0), (0, 0, 117), (8, -6, 40)])
def test_the_view_is_the_ground_seen_from_above(orb, rpy_deg):
    _, view = view_of(orb, rpy_deg)
    half = GROUND.shape[0] / 2 - 0.5
    nadir_px = np.array([half - 5.0 / M_PER_PX, half - 10.0 / M_PER_PX])
    shift = np.eye(3)
    shift[:2, 2] = view.rectification.nadir_uv - nadir_px
    ground = cv2.warpPerspective(GROUND, shift, view.rectification.size_wh)
    h, w = ground.shape
    middle = np.s_[h // 2 - 40 : h // 2 + 40, w // 2 - 40 : w // 2 + 40]
    assert np.corrcoef(ground[middle].ravel(), view.gray[middle].ravel())[0, 1] > 0.97


@pytest.mark.parametrize("yaw_deg", [0.0, 30.0, 45.0])
def test_keypoints_lie_inside_the_picture(extractor, yaw_deg):
    undistorted, view = view_of(extractor, (0.0, 0.0, yaw_deg))
    H_frame_rect = np.linalg.inv(view.rectification.H_rect_frame)
    uv = transform_points(H_frame_rect, view.features.uv.astype(np.float64))
    assert len(uv) > 150
    assert np.all(uv >= 0.0)
    assert np.all(uv <= np.array(undistorted.size_wh) - 1.0)


def test_halving_keeps_the_centre_convention():
    ramp = np.tile(np.arange(0, 240, 2, dtype=np.uint8), (90, 1))
    half, H_frame_half = Undistorted(ramp, np.eye(3)).at_scale(0.4)
    uv = transform_points(H_frame_half, np.array([[10.0, 5.0], [20.0, 30.0]]))
    assert half.shape == (45, 60)
    assert half[5, 10] == pytest.approx(2.0 * uv[0, 0], abs=1.0)
    assert uv.tolist() == [[20.5, 10.5], [40.5, 60.5]]


def test_a_picture_shrunk_a_lot_does_not_alias(orb):
    stripes = np.zeros((360, 480), np.uint8)
    stripes[:, ::2] = 255
    maker = ViewMaker(CAMERA, orb)
    undistorted = maker.picture(stripes)
    rectification = maker.rectify(undistorted, np.eye(3), 60.0, 4 * M_PER_PX)
    assert maker.warp(undistorted, rectification).std() < 3.0


def test_distortion_is_removed_first(orb):
    camera = replace(CAMERA, distortion=(-0.2, 0.03, 0.0, 0.0))
    maker = ViewMaker(camera, orb)
    straight = np.zeros((360, 480), np.uint8)
    rays = maker.picture(straight).K
    grid = np.stack(np.meshgrid(np.arange(480), np.arange(360)), axis=-1).reshape(-1, 2)
    bearings = camera.bearings(grid.astype(np.float64))
    line = np.abs(bearings[:, 0] / bearings[:, 2] - 0.3).reshape(360, 480) < 0.004
    found = maker.picture(np.where(line, 255, 0).astype(np.uint8)).at_scale(1.0)[0]
    columns = np.array([np.average(np.arange(480), weights=row) for row in found[20:340] + 1e-9])
    assert np.abs(columns - (0.3 * rays[0, 0] + rays[0, 2])).max() < 1.0


def test_a_picture_of_another_size_is_an_error_of_calibration(orb):
    with pytest.raises(CalibrationError, match="480 x 360"):
        ViewMaker(CAMERA, orb).picture(np.zeros((480, 640), np.uint8))


def test_colour_and_gray_pictures_give_the_same_view(orb):
    maker = ViewMaker(CAMERA, orb)
    gray = picture(GROUND, 0.0, 0.0, 60.0).image
    from_colour = maker.picture(cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)).at_scale(1.0)[0]
    assert np.array_equal(from_colour, gray)
