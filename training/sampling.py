"""Pairs of views cut from scenes, with everything the losses need to know about them.

A sample costs a few milliseconds of one core. Sample i depends on (seed, i) alone, so a resumed run
sees the same images as one that was never interrupted.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
import torch
from torch.utils.data import Dataset

from models.network import CELL_PX
from training import photometric, warps
from training.data import Scene
from training.warps import FloatArray, Image

Sample = dict[str, torch.Tensor]
BORDER_PX = 4  # no corner so near to the edge of a view
OUTSIDE_PX = -100.0  # where absent corners are put


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleConfig:
    """What is drawn, how often, and how far it is changed."""

    size_px: int = 320
    matches: int = 256  # points drawn per pair for the descriptors
    corner_share: float = 0.75  # of them at the teacher's corners, the rest anywhere
    corners: int = 400  # most corners per pair for the keypoint head
    zoom_min: float = 0.65  # source pixels per pixel of the crop
    zoom_max: float = 2.0
    least_overlap: float = 0.2
    shares: dict[str, float] = field(
        default_factory=lambda: {
            "pair": 0.43,
            "single": 0.25,
            "drone": 0.04,
            "overlap": 0.08,
            "series": 0.02,
            "site": 0.25,
        }
    )
    relief_share: float = 0.4  # of pairs see hills and houses from two places, not a plane
    relief_sigma_px: float = 2.5  # by how much what stands up is displaced
    warp: warps.WarpConfig = field(default_factory=warps.WarpConfig)
    photo: photometric.PhotometricConfig = field(default_factory=photometric.PhotometricConfig)


class ViewPairs(Dataset[Sample]):
    """Endless numbered samples: two views of one place."""

    def __init__(self, scenes: list[Scene], config: SampleConfig, seed: int) -> None:
        """Share the draws between the groups that are there."""
        self.scenes, self.config, self.seed = scenes, config, seed
        groups = {s.group for s in scenes}
        total = {g: sum(s.weight for s in scenes if s.group == g) for g in groups}
        chance = np.array([config.shares[s.group] * s.weight / total[s.group] for s in scenes])
        self._cumulative = np.cumsum(chance / chance.sum())

    def __getitem__(self, index: int) -> Sample:
        """Draw sample `index`; tries again where the two views hardly overlap."""
        for attempt in range(20):
            rng = np.random.default_rng([self.seed, index, attempt])
            chosen = self.scenes[int(np.searchsorted(self._cumulative, rng.random() * 0.999999))]
            sample = draw_sample(chosen, rng, self.config)
            if sample is not None:
                return sample
        raise RuntimeError(f"sample {index}: no two overlapping views; are the pictures blank?")


@dataclass(frozen=True, slots=True, eq=False)
class ViewPair:
    """Two clean views of one place."""

    views: tuple[Image, Image]  # (S, S, 3) BGR
    seen_by_both: tuple[Image, Image]  # (S, S), 255 where the other view sees the same ground
    H_1_0: FloatArray


def draw_views(scene: Scene, rng: np.random.Generator, config: SampleConfig) -> ViewPair:
    """Cut two views of a scene: of two dates where it has several, with a random homography."""
    size = config.size_px
    several = len(scene.images) > 1
    i, j = rng.choice(len(scene.images), 2, replace=False) if several else (0, 0)
    H_j_i = scene.H_i_0[j] @ np.linalg.inv(scene.H_i_0[i])
    height, width = scene.images[i].shape[:2]
    zoom_range = (config.zoom_min, config.zoom_max)
    H_i_view0 = warps.random_crop_frame(rng, (width, height), size, zoom_range)
    H_1_0 = warps.random_relative_view(rng, config.warp, size)
    H_0_1 = np.linalg.inv(H_1_0)
    H_j_view1 = H_j_i @ H_i_view0 @ H_0_1
    ground0 = warps.view(scene.masks[i], H_i_view0, size)
    ground1 = warps.view(scene.masks[j], H_j_view1, size)
    both0 = np.minimum(ground0, warps.view(ground1, H_1_0, size))
    both1 = np.minimum(ground1, warps.view(ground0, H_0_1, size))
    solid0, solid1 = (np.where(both == 255, 255, 0).astype(np.uint8) for both in (both0, both1))
    return ViewPair(
        views=(
            warps.view(scene.images[i], H_i_view0, size),
            warps.view(scene.images[j], H_j_view1, size),
        ),
        seen_by_both=(solid0, solid1),
        H_1_0=H_1_0,
    )


def draw_sample(scene: Scene, rng: np.random.Generator, config: SampleConfig) -> Sample | None:
    """Draw two views of a scene; None where they share too little.

    Returns:
        image0, image1 (1, S, S) uint8; uv0, uv1 (matches, 2); corners0, corners1 (corners, 2) and
        present (corners,); valid0, valid1 (S / 8, S / 8); H_1_0 (3, 3); relief (2, S / 4, S / 4),
        what is to be added to it, in pixels of view 1; label_noise ().
    """
    pair = draw_views(scene, rng, config)
    if min(seen.mean() for seen in pair.seen_by_both) < config.least_overlap * 255:
        return None
    corners0 = common_corners(pair, config.corners)
    uv0 = choose_matches(rng, corners0, pair.seen_by_both[0], config)
    happens = rng.random() < config.relief_share
    relief = warps.random_relief(rng, config.size_px, config.relief_sigma_px * happens)
    view1 = warps.bent(pair.views[1], pair.H_1_0, relief) if happens else pair.views[1]

    def carried(uv: FloatArray) -> FloatArray:
        raised = warps.relief_at(relief, uv[None], config.size_px)[0]
        return warps.warp_points(pair.H_1_0, uv) + raised

    sample = {
        "uv0": uv0,
        "uv1": carried(uv0),
        "corners0": padded(corners0, config.corners),
        "corners1": padded(carried(corners0), config.corners),
        "present": np.arange(config.corners) < len(corners0),
        "valid0": whole_cells(pair.seen_by_both[0]),
        "valid1": whole_cells(pair.seen_by_both[1]),
        "H_1_0": pair.H_1_0,
        "relief": relief.transpose(2, 0, 1),
        "label_noise": np.array(scene.label_noise),
    }
    tensors = {name: torch.from_numpy(value.astype(np.float32)) for name, value in sample.items()}
    for k, view in enumerate((pair.views[0], view1)):
        photo = photometric.photograph(view, rng, config.photo)
        tensors[f"image{k}"] = torch.from_numpy(photo)[None]
    return tensors


def corner_strength(grey: Image) -> FloatArray:
    """Shi-Tomasi's measure relative to its surroundings, so that a meadow has corners too."""
    smooth = cv2.GaussianBlur(grey, (0, 0), 0.8)
    response = np.sqrt(np.maximum(cv2.cornerMinEigenVal(smooth, 3, ksize=3), 0))
    relative: FloatArray = response / (cv2.blur(response, (61, 61)) + 0.002)
    return relative


def common_corners(pair: ViewPair, count: int) -> FloatArray:
    """Find corners that both clean views have: the teacher of the keypoint head.

    It takes the geometric mean of both measures, the second carried into the first. Between two
    dates a corner may be off by a pixel, so the second image's counts within 3 x 3.

    Returns:
        (n, 2) sub-pixel positions in view 0, strongest first.
    """
    strength0, strength1 = (corner_strength(photometric.to_grey(view)) for view in pair.views)
    size_wh = (strength0.shape[1], strength0.shape[0])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    carried = cv2.warpPerspective(strength1, pair.H_1_0, size_wh, flags=flags)
    common = np.sqrt(strength0 * cv2.dilate(carried, np.ones((3, 3))))
    common = cv2.GaussianBlur(common, (0, 0), 0.8)
    common[pair.seen_by_both[0] == 0] = 0
    peak = (common >= cv2.dilate(common, np.ones((7, 7)))) & (common > 1.1)
    inner = np.zeros_like(peak)
    inner[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    v, u = np.nonzero(peak & inner)
    best = np.argsort(-common[v, u])[:count]
    return parabola_vertices(common, u[best], v[best])


def parabola_vertices(surface: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """Refine integer peaks to the vertex of the parabola through three neighbours, per axis."""
    slope_u = surface[v, u + 1] - surface[v, u - 1]
    slope_v = surface[v + 1, u] - surface[v - 1, u]
    bend_u = surface[v, u + 1] + surface[v, u - 1] - 2 * surface[v, u] - 1e-9
    bend_v = surface[v + 1, u] + surface[v - 1, u] - 2 * surface[v, u] - 1e-9
    du = np.clip(-slope_u / (2 * bend_u), -0.5, 0.5)
    dv = np.clip(-slope_v / (2 * bend_v), -0.5, 0.5)
    return np.stack([u + du, v + dv], axis=1)


def choose_matches(
    rng: np.random.Generator, corners0: FloatArray, seen_by_both: Image, config: SampleConfig
) -> FloatArray:
    """Choose (matches, 2) positions in view 0: corners, and any places that both views see."""
    most = round(config.corner_share * config.matches)
    at_corners = corners0[rng.permutation(len(corners0))[:most]]
    v, u = np.nonzero(seen_by_both)
    chosen = rng.integers(0, len(u), config.matches - len(at_corners))
    anywhere = np.stack([u[chosen], v[chosen]], axis=1) + rng.uniform(-0.5, 0.5, (len(chosen), 2))
    return np.concatenate([at_corners, anywhere])


def padded(points: FloatArray, count: int) -> FloatArray:
    """(n, 2) -> (count, 2), filled up with points far outside."""
    filled = np.full((count, 2), OUTSIDE_PX)
    filled[: len(points)] = points
    return filled


def whole_cells(mask: Image) -> FloatArray:
    """(S, S) mask -> (S / 8, S / 8), 1 where the whole cell is set."""
    cells = mask.reshape(mask.shape[0] // CELL_PX, CELL_PX, -1, CELL_PX)
    return (cells.min(axis=(1, 3)) > 0).astype(np.float64)
