import math
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest
from vision_scenes import CAMERA, M_PER_PX, frame_at, texture

from vwnav.errors import CalibrationError
from vwnav.geometry.camera import cut_to_image
from vwnav.geometry.homography import transform_points
from vwnav.types import Frame, Prior
from vwnav.vision.query import Query, Taken
from vwnav.vision.shutter import seen_by_rows

GROUND = texture(8)


def query_of(extractor, image, rpy_deg=(0.0, 0.0, 0.0), camera=CAMERA):
    roll_rad, pitch_rad, _ = map(math.radians, rpy_deg)
    prior = Prior(roll_rad=roll_rad, pitch_rad=pitch_rad)
    return Query(camera, extractor, Frame(0.0, image, 0), prior, 0, time.perf_counter)


def view_of(extractor, rpy_deg=(0.0, 0.0, 0.0)):
    yaw_rad = math.radians(rpy_deg[2])
    image = frame_at(GROUND, 10.0, -5.0, 60.0, rpy_deg=rpy_deg).image
    query = query_of(extractor, image, rpy_deg)
    made = query.rectify(yaw_rad, 60.0, M_PER_PX)
    return query, query.view(yaw_rad, made, 500)


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
    half, H_frame_half = Taken(ramp, np.eye(3)).at_scale(0.4)
    uv = transform_points(H_frame_half, np.array([[10.0, 5.0], [20.0, 30.0]]))
    assert half.shape == (45, 60)
    assert half[5, 10] == pytest.approx(2.0 * uv[0, 0], abs=1.0)
    assert uv.tolist() == [[20.5, 10.5], [40.5, 60.5]]


def test_an_image_shrunk_a_lot_does_not_alias(orb):
    stripes = np.zeros((360, 480), np.uint8)
    stripes[:, ::2] = 255
    query = query_of(orb, stripes)
    assert query.warp(query.rectify(0.0, 60.0, 4 * M_PER_PX)).std() < 3.0


BENT = replace(CAMERA, distortion=(-0.2, 0.03, 0.001, -0.001))


def test_distortion_is_removed(orb):
    grid = np.stack(np.meshgrid(np.arange(480), np.arange(360)), axis=-1).reshape(-1, 2)
    bearings = BENT.bearings(grid.astype(np.float64))
    line = np.abs(bearings[:, 0] / bearings[:, 2] - 0.3).reshape(360, 480) < 0.004
    query = query_of(orb, np.where(line, 255, 0).astype(np.uint8), camera=BENT)
    made = query.rectify(0.0, 60.0, M_PER_PX)
    view = query.warp(made)
    middle = view[20:-20]
    columns = middle @ np.arange(view.shape[1]) / middle.sum(axis=1)
    assert np.abs(columns - (made.nadir_uv[0] + 0.3 * 60.0 / M_PER_PX)).max() < 0.5


@pytest.mark.parametrize("flow", [None, np.array([[0, 1, 0.3], [-1, 0, 0.2], [0.1, 0, 0]])])
@pytest.mark.parametrize("rpy_deg", [(0, 0, 30), (20, -15, 200)])
def test_between_its_grid_points_a_view_is_fetched_from_the_right_places(orb, rpy_deg, flow):
    camera = replace(BENT, readout_s=0.02)
    query = query_of(orb, np.zeros((360, 480), np.uint8), rpy_deg, camera)
    query.flow = flow
    made = query.rectify(math.radians(rpy_deg[2]), 60.0, M_PER_PX)
    w, h = made.size_wh
    uv = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).reshape(-1, 2)
    straight = transform_points(np.linalg.inv(made.H_rect_frame), uv)
    inside = np.all((straight >= 0.0) & (straight <= (479.0, 359.0)), axis=1)
    rays = camera.undistorted().bearings(straight[inside])
    exact = camera.project(rays) if flow is None else seen_by_rows(rays, camera, flow)
    places = query.places(made, 1.0).reshape(-1, 2)[inside]
    assert np.count_nonzero(inside) > 5000
    px_per_view_px = CAMERA.K[0, 0] * M_PER_PX / 60.0
    assert np.abs(places - exact).max() < 0.15 * px_per_view_px


def test_an_image_of_another_size_is_an_error_of_calibration(orb):
    with pytest.raises(CalibrationError, match="480 x 360"):
        query_of(orb, np.zeros((480, 640), np.uint8))


def test_colour_and_gray_images_give_the_same_view(orb):
    gray = frame_at(GROUND, 0.0, 0.0, 60.0).image
    from_colour = query_of(orb, cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)).image.at_scale(1.0)[0]
    assert np.array_equal(from_colour, gray)


class Counted:
    """Features that count how often they were looked for."""

    def __init__(self, extractor) -> None:
        self.name, self._extractor, self.times = extractor.name, extractor, 0

    def extract(self, gray, max_keypoints):
        self.times += 1
        return self._extractor.extract(gray, max_keypoints)


def moved(made, by_px: float):
    """A view of the same size that begins elsewhere, as a cut one does."""
    shift = np.eye(3)
    shift[0, 2] = by_px
    nadir_uv = made.nadir_uv + np.array([by_px, 0.0])
    return replace(made, H_rect_frame=shift @ made.H_rect_frame, nadir_uv=nadir_uv)


def test_a_view_is_made_once_and_levels_of_twice_the_size_share_it(orb):
    counted = Counted(orb)
    query = query_of(counted, frame_at(GROUND, 0.0, 0.0, 60.0).image)
    for agl_m, m_per_px in [(60.0, M_PER_PX), (60.0, M_PER_PX), (120.0, 2 * M_PER_PX)]:
        made = query.rectify(0.5, agl_m, m_per_px)
        view = query.view(0.5, made, 500)
        assert (view.rectification.agl_m, view.rectification.m_per_px) == (agl_m, m_per_px)
    assert counted.times == 1


@pytest.mark.parametrize("other", ["yaw", "height", "cut", "moved"])
def test_another_view_is_not_taken_for_one_that_was_made(orb, other):
    counted = Counted(orb)
    query = query_of(counted, frame_at(GROUND, 0.0, 0.0, 60.0).image)
    made = query.rectify(0.5, 60.0, M_PER_PX)
    query.view(0.5, made, 500)
    yaw_rad, changed = 0.5, made
    if other == "yaw":
        yaw_rad, changed = 0.5 + math.pi, query.rectify(0.5 + math.pi, 60.0, M_PER_PX)
    elif other == "height":
        changed = replace(query.rectify(0.5, 61.0, M_PER_PX), size_wh=made.size_wh)
    elif other == "cut":
        changed = cut_to_image(made, query.image.size_wh, 32)
    else:
        changed = moved(made, 5.0)
    view = query.view(yaw_rad, changed, 500)
    assert counted.times == 2
    assert view.gray.shape == changed.size_wh[::-1]
