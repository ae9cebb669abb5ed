"""Random views of the ground: homographies, the images they give, and points carried along.

Everything maps pixels with centres at integers. `H_b_a` takes points of image a to image b.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[Any]
Relief = NDArray[np.float32]  # (S / 4, S / 4, 2): displacement in pixels, on an even grid
RELIEF_PX = 4  # pixels per node of a relief
Image = NDArray[Any]  # uint8


@dataclass(frozen=True, slots=True, kw_only=True)
class WarpConfig:
    """What rectification leaves uncorrected, per view pair."""

    rotation_sigma_deg: float = 12.0
    wide_rotation_share: float = 0.1  # of pairs turn by up to +-25 degrees instead
    wide_rotation_deg: float = 25.0
    scale_sigma: float = 0.17  # of its logarithm
    scale_min: float = 0.7
    scale_max: float = 1.4
    tilt_sigma: float = 0.06  # perspective: relative change of scale from the centre to an edge
    shift_sigma: float = 0.08  # of the image's width
    aspect_sigma: float = 0.03


def translation(u_px: float, v_px: float) -> FloatArray:
    """Homography (3, 3) that moves points by (u_px, v_px)."""
    return np.array([[1.0, 0.0, u_px], [0.0, 1.0, v_px], [0.0, 0.0, 1.0]])


def similarity(rotation_rad: float, scale: float) -> FloatArray:
    """Homography (3, 3) that rotates and scales about the origin."""
    c, s = scale * np.cos(rotation_rad), scale * np.sin(rotation_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def centred(H: FloatArray, centre_to: FloatArray, centre_from: FloatArray) -> FloatArray:
    """Apply `H` about `centre_from` and put that point at `centre_to`."""
    return translation(*centre_to) @ H @ translation(*-centre_from)


def warp_points(H_b_a: FloatArray, points_a_uv: FloatArray) -> FloatArray:
    """Carry points (n, 2) of image a to image b."""
    homogeneous = points_a_uv @ H_b_a[:, :2].T + H_b_a[:, 2]
    return homogeneous[:, :2] / homogeneous[:, 2:]


def local_scale(H: FloatArray, point_uv: FloatArray) -> float:
    """How many pixels one pixel becomes at a point (square root of the Jacobian's determinant)."""
    around = point_uv + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    p, pu, pv = warp_points(H, around)
    jacobian = np.stack([pu - p, pv - p])
    return float(np.sqrt(abs(np.linalg.det(jacobian))))


def random_relative_view(rng: np.random.Generator, config: WarpConfig, size_px: int) -> FloatArray:
    """Draw how the second view differs from the first: H_1_0 (3, 3), about the centre."""
    if rng.random() < config.wide_rotation_share:
        rotation_rad = np.deg2rad(rng.uniform(-config.wide_rotation_deg, config.wide_rotation_deg))
    else:
        rotation_rad = np.deg2rad(rng.normal(0.0, config.rotation_sigma_deg))
    scale = float(np.exp(rng.normal(0.0, config.scale_sigma)))
    scale = float(np.clip(scale, config.scale_min, config.scale_max))
    stretch = np.exp(rng.normal(0.0, config.aspect_sigma))
    H = similarity(rotation_rad, scale) @ np.diag([stretch, 1.0 / stretch, 1.0])
    H[2, :2] = rng.normal(0.0, config.tilt_sigma, 2) / (size_px / 2)
    centre = np.full(2, (size_px - 1) / 2)
    return centred(H, centre + rng.normal(0.0, config.shift_sigma * size_px, 2), centre)


def random_crop_frame(
    rng: np.random.Generator,
    source_wh: tuple[int, int],
    size_px: int,
    zoom_range: tuple[float, float],
) -> FloatArray:
    """Draw where in a source image the crop lies: any heading, mirrored half of the time.

    Args:
        rng: Random generator.
        source_wh: Size of the source image.
        size_px: Side of the square crop.
        zoom_range: Source pixels per crop pixel, least and most; less where the source is too
            small.

    Returns:
        H_source_crop (3, 3).
    """
    width, height = source_wh
    zoom = np.exp(rng.uniform(np.log(zoom_range[0]), np.log(zoom_range[1])))
    zoom = min(zoom, min(width, height) / size_px)
    margin = 0.5 * zoom * size_px
    centre = (
        np.array([rng.uniform(margin, width - margin), rng.uniform(margin, height - margin)]) - 0.5
    )
    # Quarter turns keep a crop inside of its image; a free angle would leave black corners.
    angle_rad = rng.integers(4) * np.pi / 2 + (
        rng.uniform(-0.8, 0.8) if min(width, height) > 1.3 * zoom * size_px else 0.0
    )
    mirror = np.diag([rng.choice([-1.0, 1.0]), 1.0, 1.0])
    return centred(similarity(angle_rad, zoom) @ mirror, centre, np.full(2, (size_px - 1) / 2))


def view(source: Image, H_source_view: FloatArray, size_px: int) -> Image:
    """Look at a source image through a homography, without aliasing; outside of it is zero.

    Args:
        source: (H, W) or (H, W, C) uint8.
        H_source_view: Takes pixels of the view to pixels of the source.
        size_px: Side of the square view.

    Returns:
        (size_px, size_px) or (size_px, size_px, C) uint8.
    """
    shrink = local_scale(H_source_view, np.full(2, (size_px - 1) / 2))
    if shrink > 1.3:
        source, corner = around_view(source, H_source_view, size_px)
        if min(source.shape[:2]) < shrink:
            return np.zeros((size_px, size_px, *source.shape[2:]), np.uint8)
        source, H_small_source = shrunk(source, shrink)
        H_source_view = H_small_source @ translation(*-corner) @ H_source_view
    return cv2.warpPerspective(
        source, H_source_view, (size_px, size_px), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    )


def shrunk(source: Image, factor: float) -> tuple[Image, FloatArray]:
    """Make an image smaller by about `factor`; returns it with H_small_source (3, 3)."""
    size = (round(source.shape[1] / factor), round(source.shape[0] / factor))
    sx, sy = size[0] / source.shape[1], size[1] / source.shape[0]
    # Half-pixel rule: (u + 0.5) s - 0.5.
    H = np.array([[sx, 0.0, 0.5 * sx - 0.5], [0.0, sy, 0.5 * sy - 0.5], [0.0, 0.0, 1.0]])
    return cv2.resize(source, size, interpolation=cv2.INTER_AREA), H


def around_view(source: Image, H_source_view: FloatArray, size_px: int) -> tuple[Image, FloatArray]:
    """Cut out what a view sees of a source image, and return it with its top left corner."""
    last = size_px - 1.0
    seen = warp_points(H_source_view, np.array([[0, 0], [last, 0], [last, last], [0, last]]))
    least = np.clip(np.floor(seen.min(axis=0)) - 8, 0, None).astype(int)
    most = np.ceil(seen.max(axis=0)).astype(int) + 9
    return source[least[1] : max(most[1], 0), least[0] : max(most[0], 0)], least.astype(np.float64)


def random_relief(rng: np.random.Generator, size_px: int, sigma_px: float) -> Relief:
    """Draw what relief does between two viewpoints: all that stands up moves along one direction.

    Hills are smooth, houses have edges as steep as the ground between them allows without folds.
    """
    nodes = size_px // RELIEF_PX
    hills = rng.normal(0.0, 0.5, (4, 4)).astype(np.float32)
    height = cv2.resize(hills, (nodes, nodes), interpolation=cv2.INTER_CUBIC)
    houses = np.zeros((nodes, nodes), np.float32)
    for _ in range(rng.integers(0, 9)):
        centre, sides = rng.uniform(0, nodes, 2).tolist(), rng.uniform(4.0, 20.0, 2).tolist()
        box = cv2.boxPoints((centre, sides, rng.uniform(0.0, 90.0)))
        corners = box.round().astype(np.int32)
        cv2.fillConvexPoly(houses, corners, float(rng.uniform(0.5, 2.0)))
    height = height + cv2.GaussianBlur(houses, (0, 0), 1.5)
    angle, length_px = rng.uniform(0.0, 2 * np.pi), min(abs(rng.normal(0.0, sigma_px)), 5.0)
    along = length_px * np.array([np.cos(angle), np.sin(angle)])
    return (height[..., None] * along).astype(np.float32)


def relief_at(relief: Relief, points_uv: FloatArray, size_px: int) -> FloatArray:
    """Interpolate a relief over an image of `size_px` at points (h, w, 2)."""
    nodes = (points_uv + 0.5) * (relief.shape[0] / size_px) - 0.5  # half-pixel rule
    place = nodes.astype(np.float32)
    return _looked_up(relief, place).astype(np.float64)


def bent(view1: Image, H_1_0: FloatArray, relief: Relief) -> Image:
    """Show in view 1 what a plane's point `uv0` shows at H_1_0 uv0 + relief(uv0)."""
    size, nodes = view1.shape[0], relief.shape[0]
    v, u = (np.indices((nodes, nodes), np.float64) + 0.5) * (size / nodes) - 0.5  # half-pixel rule
    uv1 = np.stack([u, v], axis=-1)
    H_0_1, offset = np.linalg.inv(H_1_0), np.zeros_like(uv1)
    for _ in range(3):  # fixed point: relief is told where it is in view 0
        uv0 = warp_points(H_0_1, (uv1 - offset).reshape(-1, 2)).reshape(uv1.shape)
        offset = relief_at(relief, uv0, size)
    v, u = np.indices((size, size), np.float32)
    place = np.stack([u, v], axis=-1) - cv2.resize(offset.astype(np.float32), (size, size))
    return _looked_up(view1, place)


def _looked_up(source: NDArray[Any], place: Relief) -> NDArray[Any]:
    """What stands in `source` at each of the places (h, w, 2), in between and beyond the rim."""
    return cv2.remap(  # type: ignore[call-overload]  # its stubs do not know of a single map
        source, place, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
