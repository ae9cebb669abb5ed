"""A quick look at how well kept-aside pairs are matched, beside SIFT, while training goes on."""

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from models.extractor import Extractor
from models.network import CELL_PX, FeatureNetwork
from training.data import Scene
from training.sampling import Sample, SampleConfig, ViewPairs
from training.warps import FloatArray, Image, warp_points
from vwnav.geometry.similarity import estimate_similarity
from vwnav.types import Features

Extract = Callable[[Image], Features]
RIGHT_PX = 3.0  # a match nearer than this to the truth counts as an inlier
PLACE_PX = 8.0  # a pair counts as located when its centre is found this near to the truth
KEYPOINTS = 500
SHIFTS_PX = (20.0, 30.0, 40.0)  # of keypoints, to see how many meet by chance
SAME_PX = 1.5  # keypoints of an image and of the turned one that are nearer are the same


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchScore:
    """Mean over the validation pairs."""

    inliers: float
    precision: float
    located: float  # share of pairs whose place a similarity through the matches finds
    error_px: float  # median distance of the inliers from the truth
    above_chance: float  # share of keypoints that are found again, less that by chance

    def __str__(self) -> str:
        """One line for the log."""
        right = f"{100 * self.precision:5.1f} % right"
        place = f"{100 * self.located:5.1f} % located"
        repeated = f"{100 * self.above_chance:.1f} % repeated above chance"
        return f"{self.inliers:6.1f} inliers, {right}, {place}, {self.error_px:.2f} px, {repeated}"


def calm_views(scenes: list[Scene], config: SampleConfig, count: int) -> list[Sample]:
    """Draw the same views every time: 320 px, turned less than in training."""
    warp = replace(config.warp, rotation_sigma_deg=8.0, wide_rotation_share=0.0)
    pairs = ViewPairs(scenes, replace(config, size_px=320, warp=warp, relief_share=0.0), seed=99)
    return [pairs[i] for i in range(count)]


def learned(network: FeatureNetwork, keypoints: int = KEYPOINTS) -> Extract:
    """Wrap a copy of a network as an extractor function, for sides that 32 divides."""
    extractor = Extractor(copy.deepcopy(network).cpu().eval())

    def extract(image: Image) -> Features:
        with torch.inference_mode():
            uv, scores, descriptors = extractor(
                torch.from_numpy(image)[None, None], torch.tensor([keypoints])
            )
        return Features(uv.numpy(), descriptors.numpy(), scores.numpy())

    return extract


def peak_bias(network: FeatureNetwork, images: list[Image]) -> NDArray[np.float64]:
    """Measure by how much keypoints lie beside what they mean: (u, v) in pixels.

    An image turned by half a turn has its keypoints at (W - 1 - u, H - 1 - v); half of what they
    are off on average is the bias of either.

    Args:
        network: as trained.
        images: (H, W) uint8, H and W divisible by 32.
    """
    extract = learned(network)
    offsets = []
    for image in images:
        uv = extract(image).uv
        turned = extract(np.ascontiguousarray(image[::-1, ::-1])).uv
        back = np.array(image.shape[::-1]) - 1.0 - turned
        apart = uv[:, None] - back[None]
        nearest = apart[np.arange(len(uv)), np.linalg.norm(apart, axis=2).argmin(axis=1)]
        offsets.append(0.5 * nearest[np.linalg.norm(nearest, axis=1) < SAME_PX])
    together = np.concatenate(offsets) if offsets else np.zeros((0, 2))
    return together.mean(axis=0) if len(together) else np.zeros(2)


def upright_sift(image: Image, keypoints: int = KEYPOINTS) -> Features:
    """RootSIFT (Arandjelovic and Zisserman 2012) without orientations, the classical rival."""
    sift = cv2.SIFT.create(keypoints, enable_precise_upscale=True)
    found = sift.detect(image, None)
    for keypoint in found:
        keypoint.angle = 0.0
    found, descriptors = sift.compute(image, found)
    if descriptors is None:
        descriptors = np.zeros((0, sift.descriptorSize()), np.float32)
    root = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9))
    uv = np.array([k.pt for k in found], np.float32).reshape(-1, 2)
    return Features(uv, root, np.array([k.response for k in found], np.float32))


def mutual_matches(found0: Features, found1: Features) -> tuple[FloatArray, FloatArray]:
    """Positions (n, 2) in both images of features that are each other's nearest."""
    if min(len(found0.uv), len(found1.uv)) == 0:
        return np.zeros((0, 2)), np.zeros((0, 2))
    similarity = found0.descriptors @ found1.descriptors.T
    best1, best0 = similarity.argmax(axis=1), similarity.argmax(axis=0)
    mutual = best0[best1] == np.arange(len(best1))
    return found0.uv[mutual].astype(np.float64), found1.uv[best1[mutual]].astype(np.float64)


def finds_its_place(uv0: FloatArray, uv1: FloatArray, H_1_0: FloatArray, size_px: int) -> bool:
    """Does a similarity through the matches put the image's centre where it belongs?"""
    fit = estimate_similarity(uv0, uv1, RIGHT_PX, seed=0)
    if fit is None:
        return False
    centre = np.full((1, 2), (size_px - 1) / 2)
    apart = warp_points(fit.H, centre) - warp_points(H_1_0, centre)
    return bool(np.linalg.norm(apart) < PLACE_PX)


def repeated_above_chance(uv0: FloatArray, uv1: FloatArray, view: Sample) -> float:
    """Share of keypoints found again within 3 px, less the share with one image's shifted.

    Args:
        uv0: (n, 2) keypoints of view 0; only those on ground that view 1 sees count.
        uv1: (m, 2) keypoints of view 1.
        view: the two views.
    """
    h, w = view["valid0"].shape
    cell = np.clip(uv0 / CELL_PX, 0, [w - 1, h - 1]).astype(int)
    shared = view["valid0"].numpy()[cell[:, 1], cell[:, 0]] > 0
    if not shared.any() or len(uv1) == 0:
        return 0.0
    carried = warp_points(view["H_1_0"].numpy().astype(np.float64), uv0[shared].astype(np.float64))

    def met(shift: FloatArray) -> float:
        there = carried + shift
        there = there[((there > 0) & (there < CELL_PX * np.array([w, h]))).all(axis=1)]
        apart = np.linalg.norm(there[:, None] - uv1[None], axis=2)
        return float((apart.min(axis=1) < RIGHT_PX).mean()) if len(there) else 0.0

    shifts = [px * np.array(way) for px in SHIFTS_PX for way in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    return met(np.zeros(2)) - float(np.mean([met(shift) for shift in shifts]))


def score_matches(extract: Extract, views: list[Sample]) -> MatchScore:
    """Match each pair and compare with the true homography."""
    inliers, precisions, places, repeated = [], [], [], []
    errors: list[float] = []
    for view in views:
        image0, image1 = (view[f"image{k}"][0].numpy() for k in (0, 1))
        found0, found1 = extract(image0), extract(image1)
        repeated.append(repeated_above_chance(found0.uv, found1.uv, view))
        uv0, uv1 = mutual_matches(found0, found1)
        H_1_0 = view["H_1_0"].numpy().astype(np.float64)
        distance = np.linalg.norm(warp_points(H_1_0, uv0) - uv1, axis=1)
        right = distance < RIGHT_PX
        inliers.append(right.sum())
        precisions.append(right.sum() / max(len(right), 1))
        places.append(finds_its_place(uv0, uv1, H_1_0, image0.shape[0]))
        errors.extend(distance[right])
    return MatchScore(
        inliers=float(np.mean(inliers)),
        precision=float(np.mean(precisions)),
        located=float(np.mean(places)),
        error_px=float(np.median(errors)) if errors else float("nan"),
        above_chance=float(np.mean(repeated)),
    )
