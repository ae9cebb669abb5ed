import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from vwnav.geometry.camera import R_BODY_CAMERA_DOWN, Camera

SIZE_WH = (640, 480)
# Lenses whose distortion still grows outwards all over the image.
lenses = st.builds(
    lambda f, cx, cy, k: Camera(
        width_px=640,
        height_px=480,
        K=np.array([[f, 0.0, cx], [0.0, f * 1.01, cy], [0.0, 0.0, 1.0]]),
        distortion=k,
    ),
    st.floats(450.0, 900.0),
    st.floats(300.0, 340.0),
    st.floats(220.0, 260.0),
    st.tuples(
        st.floats(-0.15, 0.2),
        st.floats(-0.02, 0.02),
        st.floats(-0.003, 0.003),
        st.floats(-0.003, 0.003),
        st.floats(-0.01, 0.01),
    ),
)
small = st.floats(-0.02, 0.02)
fisheyes = st.builds(
    lambda f, k: Camera(
        width_px=640,
        height_px=480,
        K=np.array([[f, 0.0, 320.0], [0.0, f, 240.0], [0.0, 0.0, 1.0]]),
        distortion=k,
        model="fisheye",
    ),
    st.floats(330.0, 500.0),
    st.tuples(small, small, small.map(lambda k: k / 10), small.map(lambda k: k / 10)),
)
pixels = arrays(np.float64, (20, 2), elements=st.floats(0.0, 479.0))


@given(st.one_of(lenses, fisheyes), pixels)
def test_pixels_come_back_through_their_bearings(camera: Camera, uv: np.ndarray) -> None:
    bearings = camera.bearings(uv)
    np.testing.assert_allclose(np.linalg.norm(bearings, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(camera.project(bearings * 7.0), uv, atol=1e-5)


@given(lenses, pixels)
def test_distorted_pixels_agree_with_the_formula_of_brown(camera: Camera, uv: np.ndarray) -> None:
    x, y = ((uv - [320, 240]) / 600.0).T
    k1, k2, p1, p2, k3 = camera.distortion
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    expected = np.column_stack([xd, yd, np.ones_like(x)]) @ camera.K.T
    points = np.column_stack([x, y, np.ones_like(x)])
    np.testing.assert_allclose(camera.project(points), expected[:, :2], atol=1e-9)


@given(fisheyes, st.floats(0.01, 1.3), st.floats(-3.0, 3.0))
def test_fisheye_radius_grows_with_the_angle(camera: Camera, theta: float, side: float) -> None:
    ray = [np.sin(theta) * np.cos(side), np.sin(theta) * np.sin(side), np.cos(theta)]
    k1, k2, k3, k4 = camera.distortion
    bent = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
    uv = camera.project(np.array([ray]))[0]
    assert np.hypot(*(uv - [320, 240])) == pytest.approx(bent * camera.K[0, 0], abs=1e-8)


@given(lenses, st.integers(20, 2000), st.integers(20, 2000), pixels)
def test_scaling_moves_pixels_by_the_half_pixel_rule(
    camera: Camera, width_px: int, height_px: int, uv: np.ndarray
) -> None:
    points = camera.bearings(uv)
    scale = np.array([width_px / 640, height_px / 480])
    expected = (camera.project(points) + 0.5) * scale - 0.5
    np.testing.assert_allclose(
        camera.scaled(width_px, height_px).project(points), expected, atol=1e-9 * scale.max() * 1e3
    )


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
def test_undistorted_image_is_that_of_the_undistorted_camera(model: str) -> None:
    K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    camera = Camera(width_px=640, height_px=480, K=K, distortion=(-0.1, 0.02, 0, 0), model=model)
    # An image that holds its own coordinates, so that a look-up shows where a pixel came from.
    image = np.dstack(np.meshgrid(np.arange(640.0), np.arange(480.0))).astype(np.float32)
    make = cv2.fisheye if model == "fisheye" else cv2
    maps = make.initUndistortRectifyMap(
        K, np.array(camera.distortion), np.eye(3), K, (640, 480), cv2.CV_32FC1
    )
    image = cv2.remap(image, *maps, cv2.INTER_LINEAR)
    uv = np.array([[100, 50], [500, 400], [320, 240]])
    expected = camera.project(camera.undistorted().bearings(uv))
    np.testing.assert_allclose(image[uv[:, 1], uv[:, 0]], expected, atol=0.05)


@pytest.mark.parametrize("hfov_deg", [20.0, 60.0, 120.0])
def test_field_of_view_reaches_the_edges_of_the_image(hfov_deg: float) -> None:
    camera = Camera.from_hfov(640, 480, hfov_deg)
    left, right = camera.bearings(np.array([[-0.5, 239.5], [639.5, 239.5]]))
    assert np.degrees(np.arccos(left @ right)) == pytest.approx(hfov_deg)


def test_default_mount_looks_down_with_the_nose_at_the_upper_edge() -> None:
    camera = Camera.from_hfov(640, 480, 60.0)
    forward_body, down_body = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    R_camera_body = R_BODY_CAMERA_DOWN.T
    ahead_uv = camera.project((R_camera_body @ (down_body + 0.1 * forward_body))[None])[0]
    assert ahead_uv[0] == pytest.approx(319.5)
    assert ahead_uv[1] < 239.5


def test_points_behind_the_camera_have_no_pixel() -> None:
    uv = Camera.from_hfov(640, 480, 60.0).project(np.array([[0, 0, -1.0], [0, 0, 1.0], [1, 0, 0]]))
    assert np.isnan(uv[[0, 2]]).all()
    assert np.isfinite(uv[1]).all()


def test_no_pixels_give_no_bearings() -> None:
    camera = Camera.from_hfov(640, 480, 60.0)
    assert camera.bearings(np.zeros((0, 2))).shape == (0, 3)
    assert camera.project(np.zeros((0, 3))).shape == (0, 2)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("K", np.diag([-500.0, 500.0, 1.0]), "positive focal"),
        ("K", np.full((3, 3), np.nan), "finite"),
        ("K", np.eye(2), r"expected K \(3, 3\)"),
        ("distortion", (0.1,), "coefficients"),
        ("distortion", (np.inf, 0, 0, 0), "finite"),
        ("model", "omnidirectional", "pinhole or fisheye"),
        ("R_body_camera", np.diag([1.0, 1.0, -1.0]), "rotation"),
        ("width_px", 0, "picture size"),
    ],
)
def test_what_is_no_camera_is_refused(field: str, value: object, message: str) -> None:
    values = {"width_px": 640, "height_px": 480, "K": np.diag([500.0, 500.0, 1.0]), field: value}
    with pytest.raises(ValueError, match=message):
        Camera(**values)
