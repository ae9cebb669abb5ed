"""Tables 6.1 and 6.2 of the thesis: 3000 keypoints, what is found, what is matched, how long."""

import time
from dataclasses import dataclass, replace
from statistics import fmean, median

import numpy as np

from vwnav.bench.features.methods import FeatureSet
from vwnav.bench.features.scenes import ReferenceMap, Scene, image_side
from vwnav.bench.features.scoring import FIT_PX, masked_features
from vwnav.geometry.similarity import estimate_similarity

KEYPOINTS = 3000
MAX_IMAGES = 50
_SEED = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class ThesisRow:
    """One feature set over all images.

    Attributes:
        points_per_image: table 6.1, mean.
        extract_ms: table 6.1, median time of the extraction of an image.
        matched_per_image: table 6.2, mean number of matches left after outlier rejection.
        match_ms: table 6.2, median time of extraction of image and map, matching and rejection.
        match_ratio: matched keypoints of those extracted.
    """

    points_per_image: float
    extract_ms: float
    matched_per_image: float
    match_ms: float
    match_ratio: float


def thesis_rows(sets: list[FeatureSet], scenes: list[Scene]) -> dict[str, ThesisRow]:
    """Extract, match and reject outliers as the thesis did, on images against their map.

    Args:
        sets: matched by their first method.
        scenes: at most 50 of them are used; the map is cut to the size of the image.
    """
    samples: dict[str, list[tuple[float, ...]]] = {each.name: [] for each in sets}
    for scene in (_with_near_map(scene) for scene in scenes[:MAX_IMAGES]):
        for each in sets:
            samples[each.name].append(_row(each, scene))
    rows = {}
    for name, values in samples.items():
        points, extract_ms, matched, match_ms = zip(*values, strict=True)
        rows[name] = ThesisRow(
            points_per_image=fmean(points),
            extract_ms=median(extract_ms),
            matched_per_image=fmean(matched),
            match_ms=median(match_ms),
            match_ratio=sum(matched) / max(sum(points), 1.0),
        )
    return rows


def _row(each: FeatureSet, scene: Scene) -> tuple[float, ...]:
    start_s = time.perf_counter()
    found = masked_features(each, scene.image, scene.mask, KEYPOINTS)
    extracted_s = time.perf_counter()
    reference = masked_features(each, scene.map_.gray, scene.map_.mask, KEYPOINTS)
    index = each.methods[0].match(found, reference)
    uv0, uv1 = found.uv[index[:, 0]], reference.uv[index[:, 1]]
    fit = estimate_similarity(uv0.astype(np.float64), uv1.astype(np.float64), FIT_PX, _SEED)
    matched = 0 if fit is None else fit.count
    end_s = time.perf_counter()
    return len(found), 1e3 * (extracted_s - start_s), matched, 1e3 * (end_s - start_s)


def _with_near_map(scene: Scene) -> Scene:
    """The scene on a cut of its map about the true place, as large as the image."""
    h, w = scene.map_.gray.shape
    size = np.minimum([image_side(side) for side in scene.image.shape[::-1]], (w, h))
    u0, v0 = np.clip(scene.point1_uv.round() - size // 2, 0, np.array([w, h]) - size).astype(int)
    part = (slice(v0, v0 + size[1]), slice(u0, u0 + size[0]))
    cut = ReferenceMap(
        np.ascontiguousarray(scene.map_.gray[part]),
        np.ascontiguousarray(scene.map_.mask[part]),
        KEYPOINTS,
        scene.map_.unit_per_px,
        scene.map_.unit,
    )
    return replace(scene, map_=cut)
