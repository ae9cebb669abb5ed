import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.geometry.camera import Camera, cut_to_image, rectification
from vwnav.geometry.homography import transform_points
from vwnav.geometry.rotations import rotation_from_euler

CAMERA = Camera.from_hfov(640, 480, 70.0)
SIZE_WH = (640, 480)
tilts = st.floats(-0.35, 0.35)
yaws = st.floats(-3.14, 3.14)


def attitude(roll: float, pitch: float, yaw: float) -> np.ndarray:
    return rotation_from_euler(roll, pitch, yaw) @ CAMERA.R_body_camera


@given(tilts, tilts, yaws, st.floats(10.0, 300.0), st.floats(0.05, 1.0))
def test_view_pixels_are_metres_east_and_south_of_the_nadir(
    roll: float, pitch: float, yaw: float, agl_m: float, m_per_px: float
) -> None:
    R_ned_camera = attitude(roll, pitch, yaw)
    view = rectification(CAMERA.K, SIZE_WH, R_ned_camera, agl_m, m_per_px)
    uv = np.array([[320.0, 240.0], [250.0, 200.0]])
    ray = CAMERA.bearings(uv) @ R_ned_camera.T
    east_south_m = ray[:, :2][:, ::-1] / ray[:, 2:] * agl_m * [1.0, -1.0]
    expected = view.nadir_uv + east_south_m / m_per_px
    np.testing.assert_allclose(transform_points(view.H_rect_frame, uv), expected, atol=1e-6)


@given(tilts, tilts, yaws)
def test_view_holds_the_image(roll: float, pitch: float, yaw: float) -> None:
    view = rectification(CAMERA.K, SIZE_WH, attitude(roll, pitch, yaw), 50.0, 0.25, 4096)
    corners = np.array([[0.0, 0.0], [639.0, 0.0], [0.0, 479.0], [639.0, 479.0], [320.0, 240.0]])
    rays_down = np.column_stack([corners, np.ones(5)]) @ view.H_rect_frame[2]
    seen = transform_points(view.H_rect_frame, corners)
    near = np.hypot(*(seen - view.nadir_uv).T) * 0.25 < 50.0 * np.tan(np.radians(58.0))
    inside = (seen > -1.0) & (seen < np.array(view.size_wh))
    assert inside[near & (rays_down > 0.0)].all()
    assert inside[4].all()


@given(tilts, tilts, yaws, st.floats(5.0, 500.0))
def test_large_views_are_cut_about_the_middle_of_the_image(
    roll: float, pitch: float, yaw: float, agl_m: float
) -> None:
    view = rectification(CAMERA.K, SIZE_WH, attitude(roll, pitch, yaw), agl_m, 0.1, 512)
    assert max(view.size_wh) <= 512
    middle = transform_points(view.H_rect_frame, np.array([319.5, 239.5]))[0]
    assert (middle > 0).all()
    assert (middle < np.array(view.size_wh)).all()


def test_level_camera_has_its_nadir_in_the_middle_of_the_view() -> None:
    view = rectification(CAMERA.K, SIZE_WH, attitude(0.0, 0.0, 0.0), 50.0, 0.25)
    assert view.nadir_uv == pytest.approx((np.array(view.size_wh) - 1) / 2, abs=0.51)
    width_m = 2 * 50.0 * np.tan(np.radians(35.0))
    assert view.size_wh[0] == pytest.approx(width_m / 0.25, abs=1.0)


def test_nose_to_the_east_puts_the_upper_edge_to_the_right() -> None:
    view = rectification(CAMERA.K, SIZE_WH, attitude(0.0, 0.0, np.pi / 2), 50.0, 0.25)
    ahead = transform_points(view.H_rect_frame, np.array([319.5, 0.0]))[0]
    assert ahead[0] > view.nadir_uv[0] + 50
    assert ahead[1] == pytest.approx(view.nadir_uv[1], abs=1e-6)


def test_nose_up_puts_the_nadir_below_the_middle_of_the_image() -> None:
    # Nose up and heading north: the camera looks ahead, to the north of the nadir.
    view = rectification(CAMERA.K, SIZE_WH, attitude(0.0, 0.2, 0.0), 50.0, 0.25)
    middle = transform_points(view.H_rect_frame, np.array([319.5, 239.5]))[0]
    assert (view.nadir_uv - middle)[1] * 0.25 == pytest.approx(50.0 * np.tan(0.2))


@pytest.mark.parametrize("pitch_deg", [75.0, 90.0, 180.0])
def test_camera_that_does_not_look_down_has_no_view(pitch_deg: float) -> None:
    R_ned_camera = attitude(0.0, np.radians(pitch_deg), 0.0)
    assert rectification(CAMERA.K, SIZE_WH, R_ned_camera, 50.0, 0.25) is None


@pytest.mark.parametrize(
    ("agl_m", "m_per_px"), [(0.0, 0.2), (-5.0, 0.2), (np.nan, 0.2), (5.0, 0.0)]
)
def test_numbers_without_sense_have_no_view(agl_m: float, m_per_px: float) -> None:
    assert rectification(CAMERA.K, SIZE_WH, attitude(0, 0, 0), agl_m, m_per_px) is None


def share_shown(view, area_px: float) -> float:
    """Share of the view's pixels that show the image, and of so large an image's that it shows."""
    H, everywhere = view.H_rect_frame, np.ones(SIZE_WH[::-1], np.uint8)
    shown = cv2.warpPerspective(everywhere, H, view.size_wh, flags=cv2.INTER_NEAREST)
    return shown.mean(), shown.sum() / area_px


@given(tilts, tilts, yaws)
def test_a_cut_view_is_the_same_view_of_a_part(roll: float, pitch: float, yaw: float) -> None:
    whole = rectification(CAMERA.K, SIZE_WH, attitude(roll, pitch, yaw), 50.0, 0.25)
    cut = cut_to_image(whole, SIZE_WH, 32)
    uv = np.array([[320.0, 240.0], [250.0, 200.0]])
    seen, seen_whole = (transform_points(each.H_rect_frame, uv) for each in (cut, whole))
    np.testing.assert_allclose(seen - cut.nadir_uv, seen_whole - whole.nadir_uv, atol=1e-6)
    assert all(side % 32 == 0 for side in cut.size_wh)
    assert ((seen > 0.0) & (seen < np.array(cut.size_wh))).all()


@pytest.mark.parametrize(("yaw_deg", "kept"), [(0, 0.9), (20, 0.8), (45, 0.7), (90, 0.9)])
def test_a_cut_view_shows_little_but_the_image_and_most_of_it(yaw_deg: int, kept: float) -> None:
    whole = rectification(CAMERA.K, SIZE_WH, attitude(0.05, -0.1, np.radians(yaw_deg)), 50.0, 0.2)
    _, area_px = share_shown(whole, 1.0)
    cut = cut_to_image(whole, SIZE_WH, 32)
    filled, shown = share_shown(cut, area_px)
    assert filled > 0.8
    assert shown > kept
    assert np.prod(cut.size_wh) < 1.05 * np.prod(whole.size_wh)
