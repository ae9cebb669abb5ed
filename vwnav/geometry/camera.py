"""The camera: what pixel a direction falls on, and the way back, and how it is mounted.

Camera axes are right, down (in the image), forward along the optical axis. Pixel centres are at
integers. Images look down by default, their upper edge towards the nose. The nadir view is one
warp that removes tilt, heading and height from an image.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.errors import OtherSizeError
from vwnav.geometry.sensor_mode import SensorMode
from vwnav.types import Array, Gray

CameraModel = Literal["pinhole", "fisheye"]
# Columns are the camera's axes in the body: u is right, v is back, the optical axis is down.
R_BODY_CAMERA_DOWN: Array = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_DISTORTION_LENGTHS: dict[str, tuple[int, ...]] = {"pinhole": (0, 4, 5), "fisheye": (4,)}
MAX_TIME_OFFSET_S = 2.0
UNMEASURED_OFFSET_S = 0.08  # one sigma: a driver's queue, a stream's coder
MAX_READOUT_S = 0.2
MAX_MOUNT_SIGMA_RAD = math.radians(30.0)
UNMEASURED_MOUNT_RAD = math.radians(2.0)  # one sigma of a camera that was put on by hand
MAX_FOCAL_SIGMA_RATIO = 0.5
UNMEASURED_FOCAL_RATIO = 0.015  # one sigma of a lens by its data sheet, or calibrated elsewhere
MAX_ARM_M = 1.5
_ITERATIONS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 1000, 1e-12)
MAX_OFF_NADIR_RAD = math.radians(60.0)
_MIN_SHARE = 0.4  # of the image that must lie within that
_GRID = 33
_CUT_CELLS = 24
_WORTH_SHARE = 0.5  # of a strip of a view that must show the image


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Camera:
    """A calibrated camera.

    Attributes:
        width_px, height_px: size of the images the calibration is for.
        K: (3, 3) focal lengths and principal point in pixels, centres at integers, no skew.
        distortion: k1 k2 p1 p2 [k3] of "pinhole" (empty for none), k1 k2 k3 k4 of "fisheye"
            (equidistant), both as OpenCV defines them.
        R_body_camera: (3, 3) mount. t_body_camera_m: (3,) place of the camera in the body.
        readout_s: from the first row's exposure to the last row's (rolling shutter), 0 for a
            global one; None where it is not known.
        time_offset_s: what to add to the time that the source says for an image, so that it is
            that of the centre row's exposure on the autopilot's clock.
        sigma_time_offset_s: one sigma of that.
        sigma_mount_rad: one sigma of the mount's roll and pitch, each.
        sigma_focal_ratio: one sigma of the focal length, as a share of it.
        sensor_mode: in which the images were that were calibrated; None is not told.

    Raises:
        ValueError: from the constructor, when a field makes no camera.
    """

    width_px: int
    height_px: int
    K: Array
    distortion: tuple[float, ...] = ()
    model: CameraModel = "pinhole"
    R_body_camera: Array = field(default_factory=R_BODY_CAMERA_DOWN.copy)
    t_body_camera_m: Array = field(default_factory=lambda: np.zeros(3))
    readout_s: float | None = None
    time_offset_s: float = 0.0
    sigma_time_offset_s: float = UNMEASURED_OFFSET_S
    sigma_mount_rad: float = UNMEASURED_MOUNT_RAD
    sigma_focal_ratio: float = UNMEASURED_FOCAL_RATIO
    sensor_mode: SensorMode | None = None

    def __post_init__(self) -> None:
        for name, shape in (("K", (3, 3)), ("R_body_camera", (3, 3)), ("t_body_camera_m", (3,))):
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.shape != shape or not np.all(np.isfinite(value)):
                raise ValueError(f"expected {name} {shape} of finite numbers, got {value.tolist()}")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        object.__setattr__(self, "distortion", tuple(float(k) for k in self.distortion))
        self._check()

    def _check(self) -> None:
        if self.width_px < 1 or self.height_px < 1:
            raise ValueError(f"expected a picture size, got {self.width_px} x {self.height_px}")
        if self.K[0, 0] <= 0.0 or self.K[1, 1] <= 0.0:
            raise ValueError(
                f"expected positive focal lengths, got {self.K[0, 0]:g} and {self.K[1, 1]:g} px"
            )
        if self.model not in _DISTORTION_LENGTHS:
            raise ValueError(f"expected model pinhole or fisheye, got {self.model!r}")
        if len(self.distortion) not in _DISTORTION_LENGTHS[self.model]:
            raise ValueError(
                f"expected {' or '.join(map(str, _DISTORTION_LENGTHS[self.model]))} distortion "
                f"coefficients for {self.model}, got {len(self.distortion)}"
            )
        if not all(math.isfinite(k) for k in self.distortion):
            raise ValueError(f"expected finite distortion coefficients, got {self.distortion}")
        offset_s, sigma_s = self.time_offset_s, self.sigma_time_offset_s
        if not (abs(offset_s) <= MAX_TIME_OFFSET_S and 0.0 < sigma_s <= MAX_TIME_OFFSET_S):
            raise ValueError(f"expected a time offset within 2 s, got {offset_s} +- {sigma_s}")
        if not 0.0 < self.sigma_mount_rad < MAX_MOUNT_SIGMA_RAD:
            raise ValueError(
                f"expected a sigma of the mount of 0 to 30 degrees, got {self.sigma_mount_rad} rad"
            )
        if not 0.0 < self.sigma_focal_ratio < MAX_FOCAL_SIGMA_RATIO:
            raise ValueError(
                f"expected a sigma of the focal length of 0 to 0.5, got {self.sigma_focal_ratio:g}"
            )
        if self.readout_s is not None and not 0.0 <= self.readout_s <= MAX_READOUT_S:
            raise ValueError(f"expected a read-out of 0 to 0.2 s, got {self.readout_s}")
        if np.linalg.norm(self.t_body_camera_m) > MAX_ARM_M:
            raise ValueError(
                f"expected a lever arm within 1.5 m, got {self.t_body_camera_m.tolist()}: is it in "
                "metres?"
            )
        R = self.R_body_camera
        if not np.allclose(R @ R.T, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0.0:
            raise ValueError(f"expected R_body_camera to be a rotation, got {R.tolist()}")

    @staticmethod
    def from_hfov(width_px: int, height_px: int, hfov_deg: float) -> "Camera":
        """A down-looking pinhole camera with square pixels and no distortion.

        Raises:
            ValueError: the field of view is not between 0 and 180 degrees.
        """
        if not 0.0 < hfov_deg < 180.0:
            raise ValueError(f"expected a field of view of 0 to 180 degrees, got {hfov_deg}")
        f_px = width_px / 2.0 / math.tan(math.radians(hfov_deg) / 2.0)
        K = [[f_px, 0.0, (width_px - 1) / 2.0], [0.0, f_px, (height_px - 1) / 2.0], [0.0, 0.0, 1.0]]
        return Camera(width_px=width_px, height_px=height_px, K=np.array(K))

    def scaled(self, width_px: int, height_px: int) -> "Camera":
        """The same camera with its images resized: `(uv + 0.5) * scale - 0.5`."""
        scale_u, scale_v = width_px / self.width_px, height_px / self.height_px
        K = self.K.copy()
        K[0] *= scale_u
        K[1] *= scale_v
        K[0, 2] += 0.5 * scale_u - 0.5
        K[1, 2] += 0.5 * scale_v - 0.5
        return replace(self, width_px=width_px, height_px=height_px, K=K)

    def undistorted(self) -> "Camera":
        """The pinhole camera without distortion of the same K."""
        return replace(self, distortion=(), model="pinhole")

    def without_arm(self) -> "Camera":
        """The same camera for itself: places by it are its own, not the body's."""
        return replace(self, t_body_camera_m=np.zeros(3))

    def project(self, points_camera: Array) -> Array:
        """Pixels (n, 2) of points (n, 3) in camera axes; NaN for points not in front of it."""
        points = np.asarray(points_camera, dtype=np.float64).reshape(-1, 3)
        depth = np.where(points[:, 2] > 0.0, points[:, 2], np.nan)
        x, y = points[:, 0] / depth, points[:, 1] / depth
        if self.model == "fisheye":
            k1, k2, k3, k4 = self.distortion
            r = np.maximum(np.hypot(x, y), 1e-12)
            angle, angle2 = np.arctan(r), np.arctan(r) ** 2
            bent = 1.0 + angle2 * (k1 + angle2 * (k2 + angle2 * (k3 + angle2 * k4)))
            x, y = x * angle * bent / r, y * angle * bent / r
        elif self.distortion:
            # In place of OpenCV's own, which takes ten times as long for a view's grid.
            k1, k2, p1, p2, k3 = (*self.distortion, 0.0)[:5]
            xy, r2 = x * y, x**2 + y**2
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            x, y = (
                x * radial + 2.0 * p1 * xy + p2 * (r2 + 2.0 * x**2),
                y * radial + p1 * (r2 + 2.0 * y**2) + 2.0 * p2 * xy,
            )
        return np.stack([self.K[0, 0] * x + self.K[0, 2], self.K[1, 1] * y + self.K[1, 2]], axis=-1)

    def bearings(self, uv: Array) -> Array:
        """Directions (n, 3) of unit length in camera axes of pixels (n, 2), distortion removed."""
        points = np.asarray(uv, dtype=np.float64).reshape(-1, 1, 2)
        if len(points) == 0:
            return np.zeros((0, 3))
        K, coefficients = self.K, np.array(self.distortion or (0.0,) * 4)
        if self.model == "fisheye":
            flat = cv2.fisheye.undistortPoints(points, K, coefficients, criteria=_ITERATIONS)
        else:
            flat = cv2.undistortPoints(points, K, coefficients, criteria=_ITERATIONS)
        rays = np.column_stack([flat.reshape(-1, 2), np.ones(len(points))])
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def check_fits(camera: Camera, width_px: int, height_px: int) -> None:
    """Make sure that a calibration is for images of this size.

    Raises:
        CalibrationError: it is not.
    """
    if (camera.width_px, camera.height_px) != (width_px, height_px):
        raise OtherSizeError((camera.width_px, camera.height_px), (width_px, height_px))


@dataclass(frozen=True, slots=True, eq=False)
class Rectification:
    """A north-up view straight down onto level ground.

    Attributes:
        H_rect_frame: (3, 3) from undistorted image pixels to view pixels (u east, v south).
        size_wh: (width, height) of the view in pixels.
        m_per_px: ground resolution of the view.
        nadir_uv: (2,) view pixel of the ground point below the camera, maybe outside the view.
        agl_m: height above ground it was made for.
    """

    H_rect_frame: Array
    size_wh: tuple[int, int]
    m_per_px: float
    nadir_uv: Array
    agl_m: float


def rectification(
    K: Array,
    frame_size_wh: tuple[int, int],
    R_ned_camera: Array,
    agl_m: float,
    m_per_px: float,
    max_size_px: int = 1024,
) -> Rectification | None:
    """The nadir view of an undistorted image.

    What lies more than 60 degrees off the nadir is cut off. A view larger than `max_size_px` is
    cut about the ground that fills the middle of the image.

    Args:
        K: (3, 3) of the undistorted camera.
        frame_size_wh: (width, height) of the image.
        R_ned_camera: (3, 3) attitude of the camera; where the ground rises, sheared along down.
        agl_m: height of the camera above the ground.
        m_per_px: wanted ground resolution.
        max_size_px: largest width and height of the view.

    Returns:
        None when the camera does not look down enough, or the numbers make no view.
    """
    numbers = np.array([agl_m, m_per_px])
    if not (np.all(numbers > 0.0) and np.all(np.isfinite(numbers))):
        return None
    if not np.all(np.isfinite(R_ned_camera)):
        return None
    scale = agl_m / m_per_px
    # Where all corners of the image are near enough they are its outline on the ground; else, or
    # where it is cut, it takes a grid to tell what is seen of it.
    ground_px = scale * _ground_east_north(K, frame_size_wh, R_ned_camera, 2)
    if len(ground_px) < 4 or np.ptp(ground_px, axis=0).max() > max_size_px:
        ground_px = scale * _ground_east_north(K, frame_size_wh, R_ned_camera, _GRID)
        if len(ground_px) < _MIN_SHARE * _GRID**2:
            return None
    size_wh, corner_px = _window(ground_px, max_size_px)
    # Pixel centres at integers: the corner of the view is at -0.5, -0.5.
    nadir_uv = np.array([-corner_px[0] - 0.5, corner_px[1] - 0.5])
    H_rect_ned = np.array([[0.0, scale, nadir_uv[0]], [-scale, 0.0, nadir_uv[1]], [0.0, 0.0, 1.0]])
    H_rect_frame = H_rect_ned @ R_ned_camera @ np.linalg.inv(K)
    return Rectification(H_rect_frame, size_wh, m_per_px, nadir_uv, agl_m)


def _ground_east_north(
    K: Array, size_wh: tuple[int, int], R_ned_camera: Array, points: int
) -> Array:
    """Ground points (k, 2) of a grid over the image, in units of AGL, those near enough."""
    u = np.linspace(-0.5, size_wh[0] - 0.5, points)
    v = np.linspace(-0.5, size_wh[1] - 0.5, points)
    uv1 = np.stack([*np.meshgrid(u, v), np.ones((points, points))], axis=-1).reshape(-1, 3)
    rays_ned = uv1 @ (R_ned_camera @ np.linalg.inv(K)).T
    off_nadir = np.arctan2(np.hypot(rays_ned[:, 0], rays_ned[:, 1]), rays_ned[:, 2])
    seen = rays_ned[off_nadir <= MAX_OFF_NADIR_RAD]
    return np.asarray(seen[:, 1::-1] / seen[:, 2:])


def _window(ground_en_px: Array, max_size_px: int) -> tuple[tuple[int, int], Array]:
    """Size (w, h) of the view and its north-west corner (east, north), in pixels from the nadir."""
    low, high = ground_en_px.min(axis=0), ground_en_px.max(axis=0)
    size = np.clip(np.ceil(high - low), 1, max_size_px)
    half = size / 2.0
    # The median leans to where the image has most pixels per metre of ground.
    is_cut = max(high - low) > max_size_px
    middle = np.median(ground_en_px, axis=0) if is_cut else (low + high) / 2.0
    middle = np.clip(
        middle, np.minimum(low + half, high - half), np.maximum(low + half, high - half)
    )
    corner = np.array([middle[0] - half[0], middle[1] + half[1]])
    return (int(size[0]), int(size[1])), corner


def cut_to_image(
    view: Rectification, frame_size_wh: tuple[int, int], multiple_px: int
) -> Rectification:
    """The part of a view that is worth its pixels.

    An image that is turned fills half of a north-up view. Of all rectangles the one is taken whose
    pixels that show the image, less `_WORTH_SHARE` of all its pixels, are the most; what is lost
    are corners of the image, about which the view shows little else of it.

    Args:
        view: of the whole image.
        frame_size_wh: (width, height) of the image.
        multiple_px: the sides are made the nearest multiple of it, and may reach past the view.
    """
    top, bottom = np.triu_indices(_CUT_CELLS + 1, 1)
    filled = np.zeros((_CUT_CELLS + 1, _CUT_CELLS))
    np.cumsum(_shown(view, frame_size_wh), axis=0, out=filled[1:])
    worth = filled[bottom] - filled[top] - _WORTH_SHARE * (bottom - top)[:, None]
    # Of each band of rows the best run of columns: the largest rise of the sums.
    sums = np.zeros((len(top), _CUT_CELLS + 1))
    np.cumsum(worth, axis=1, out=sums[:, 1:])
    rise = sums[:, 1:] - np.minimum.accumulate(sums[:, :-1], axis=1)
    band, last = np.unravel_index(int(np.argmax(rise)), rise.shape)
    first = int(np.argmin(sums[band, : last + 1]))
    corners = np.array([[first, top[band]], [last + 1, bottom[band]]])
    low_px, high_px = corners * np.array(view.size_wh) / _CUT_CELLS
    size_px = np.maximum(np.round((high_px - low_px) / multiple_px), 1.0) * multiple_px
    corner_px = np.round((low_px + high_px - size_px) / 2.0)
    shift = np.eye(3)
    shift[:2, 2] = -corner_px
    return replace(
        view,
        H_rect_frame=shift @ view.H_rect_frame,
        size_wh=(int(size_px[0]), int(size_px[1])),
        nadir_uv=view.nadir_uv - corner_px,
    )


def _shown(view: Rectification, frame_size_wh: tuple[int, int]) -> NDArray[np.bool_]:
    """Which cells (rows, columns) of a view show the image in their middle."""
    u, v = ((np.arange(_CUT_CELLS) + 0.5)[:, None] * view.size_wh / _CUT_CELLS - 0.5).T
    H_frame_view = np.linalg.inv(view.H_rect_frame)
    rows = H_frame_view[:, 1:2] * v + H_frame_view[:, 2:]
    x, y, depth = rows[:, :, None] + (H_frame_view[:, :1] * u)[:, None, :]
    w, h = frame_size_wh
    # Positive where the image's middle is; what is behind the horizon fits between no edges.
    sign = np.sign(view.H_rect_frame[2] @ [(w - 1) / 2.0, (h - 1) / 2.0, 1.0])
    x, y, depth = sign * x, sign * y, sign * depth
    across = (-0.5 * depth <= x) & (x <= (w - 0.5) * depth)
    return np.asarray(across & (-0.5 * depth <= y) & (y <= (h - 0.5) * depth))


def to_gray(image: NDArray[np.uint8]) -> Gray:
    """(h, w) of a gray or BGR image."""
    if image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
