import math
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest
from vision_scenes import CAMERA, M_PER_PX, frame_at, texture

from vwnav.errors import CalibrationError
from vwnav.geometry.homography import transform_points
from vwnav.types import Frame, Prior
from vwnav.vision.query import QueryMaker, Undistorted

GROUND = texture(8)


def maker_of(extractor, camera=CAMERA):
    return QueryMaker(camera, extractor, time.perf_counter)


def query_of(maker, image, rpy_deg=(0.0, 0.0, 0.0)):
    roll_rad, pitch_rad, _ = map(math.radians, rpy_deg)
    return maker.query(Frame(0.0, image, 0), Prior(roll_rad=roll_rad, pitch_rad=pitch_rad), 0)


def view_of(extractor, rpy_deg=(0.0, 0.0, 0.0)):
    maker, yaw_rad = maker_of(extractor), math.radians(rpy_deg[2])
    query = query_of(maker, frame_at(GROUND, 10.0, -5.0, 60.0, rpy_deg=rpy_deg).image, rpy_deg)
    made = maker.rectify(query, yaw_rad, 60.0, M_PER_PX)
    return query, maker.view(query, yaw_rad, made, 500)


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
def test_keypoints_lie_inside_the_image(extractor, yaw_deg):
    query, view = view_of(extractor, (0.0, 0.0, yaw_deg))
    H_frame_rect = np.linalg.inv(view.rectification.H_rect_frame)
    uv = transform_points(H_frame_rect, view.features.uv.astype(np.float64))
    assert len(uv) > 150
    assert np.all(uv >= 0.0)
    assert np.all(uv <= np.array(query.image.size_wh) - 1.0)


def test_halving_keeps_the_centre_convention():
    ramp = np.tile(np.arange(0, 240, 2, dtype=np.uint8), (90, 1))
    half, H_frame_half = Undistorted(ramp, np.eye(3)).at_scale(0.4)
    uv = transform_points(H_frame_half, np.array([[10.0, 5.0], [20.0, 30.0]]))
    assert half.shape == (45, 60)
    assert half[5, 10] == pytest.approx(2.0 * uv[0, 0], abs=1.0)
    assert uv.tolist() == [[20.5, 10.5], [40.5, 60.5]]


def test_an_image_shrunk_a_lot_does_not_alias(orb):
    stripes = np.zeros((360, 480), np.uint8)
    stripes[:, ::2] = 255
    maker = maker_of(orb)
    query = query_of(maker, stripes)
    assert maker.warp(query, maker.rectify(query, 0.0, 60.0, 4 * M_PER_PX)).std() < 3.0


def test_distortion_is_removed_first(orb):
    camera = replace(CAMERA, distortion=(-0.2, 0.03, 0.0, 0.0))
    maker = maker_of(orb, camera)
    rays = query_of(maker, np.zeros((360, 480), np.uint8)).image.K
    grid = np.stack(np.meshgrid(np.arange(480), np.arange(360)), axis=-1).reshape(-1, 2)
    bearings = camera.bearings(grid.astype(np.float64))
    line = np.abs(bearings[:, 0] / bearings[:, 2] - 0.3).reshape(360, 480) < 0.004
    found = query_of(maker, np.where(line, 255, 0).astype(np.uint8)).image.at_scale(1.0)[0]
    columns = np.array([np.average(np.arange(480), weights=row) for row in found[20:340] + 1e-9])
    assert np.abs(columns - (0.3 * rays[0, 0] + rays[0, 2])).max() < 1.0


def test_an_image_of_another_size_is_an_error_of_calibration(orb):
    with pytest.raises(CalibrationError, match="480 x 360"):
        query_of(maker_of(orb), np.zeros((480, 640), np.uint8))


def test_colour_and_gray_images_give_the_same_view(orb):
    gray = frame_at(GROUND, 0.0, 0.0, 60.0).image
    from_colour = query_of(maker_of(orb), cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)).image.at_scale(
        1.0
    )[0]
    assert np.array_equal(from_colour, gray)
