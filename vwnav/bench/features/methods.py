"""The feature sets side by side, and the ways to match them."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.bench.features.macs import GraphCost, graph_cost
from vwnav.bench.features.xfeat import load_xfeat
from vwnav.errors import VwnavError
from vwnav.maps.codec import decode_features, encode_features
from vwnav.types import Features, Gray
from vwnav.vision.features.learned import LearnedFeatures, released_model
from vwnav.vision.features.opencv import SIFT_SIZE, OrbFeatures, SiftFeatures, no_features
from vwnav.vision.matching import match

LOWE_RATIO = 0.9
OPENCV_SIFT = "sift_turning"  # OpenCV's SIFT as its users call it: what times are compared with
XFEAT = "xfeat"
PACKED_SUFFIX = "_packed"
INT8_SUFFIX = "_int8"

Extract = Callable[[Gray, int], Features]
Match = Callable[[Features, Features], NDArray[np.int64]]


@dataclass(frozen=True, slots=True, eq=False)
class Method:
    """A feature set matched in one way; `name` is its column in every table."""

    name: str
    match: Match = match


@dataclass(frozen=True, slots=True, eq=False)
class FeatureSet:
    """Extracted once, matched by one method or more.

    Attributes:
        name: also that of its first method.
        extract: the strongest keypoints first; images have sides divisible by 32.
        methods: ways to match.
        cost: of the network, None where there is none.
    """

    name: str
    extract: Extract
    methods: list[Method]
    cost: GraphCost | None = field(default=None)


def feature_sets(models: list[Path]) -> tuple[list[FeatureSet], list[str]]:
    """All feature sets that are there, and one line for each thing that is not.

    Args:
        models: ONNX graphs to judge; all the released ones where empty.

    Raises:
        ModelError: a model is missing or damaged.
    """
    skipped: list[str] = []
    paths = models or sorted(released_model().parent.glob("vwnav_*.onnx"))
    sets = [_learned(path, skipped) for path in paths]
    sets += [
        FeatureSet("sift", SiftFeatures().extract, [Method("sift")]),
        FeatureSet(
            OPENCV_SIFT,
            _opencv_sift,
            [Method(OPENCV_SIFT), Method("sift_ratio", match_by_ratio)],
        ),
        FeatureSet("orb", OrbFeatures().extract, [Method("orb")]),
    ]
    try:
        xfeat = load_xfeat()
    except VwnavError as error:
        skipped.append(str(error))
    else:
        cost = _cost(xfeat.graph, skipped)
        sets.append(FeatureSet(XFEAT, xfeat.extract, [Method(XFEAT)], cost))
    return sets, skipped


def match_by_ratio(frame: Features, map_: Features) -> NDArray[np.int64]:
    """Nearest neighbours that are clearly nearer than the second one (Lowe 2004, section 7.1).

    Returns:
        (m, 2) indices into frame and map.
    """
    if len(frame) == 0 or len(map_) < 2:
        return np.zeros((0, 2), np.int64)
    cosine = frame.descriptors @ map_.descriptors.T
    rows = np.arange(len(frame))
    nearest = cosine.argmax(axis=1)
    first = cosine[rows, nearest]
    cosine[rows, nearest] = -np.inf
    # Of unit vectors: squared distance = 2 - 2 cosine.
    clear = 1.0 - first < LOWE_RATIO**2 * (1.0 - cosine.max(axis=1))
    return np.stack([np.flatnonzero(clear), nearest[clear]], axis=1)


def match_packed(frame: Features, map_: Features) -> NDArray[np.int64]:
    """Mutual nearest neighbours where the map's descriptors went through a map pack."""
    zeros = np.zeros_like(map_.uv)
    blob = encode_features(Features(zeros, map_.descriptors, map_.scores), "int8")
    stored = decode_features(blob, len(map_), map_.descriptors.shape[1], "int8")
    return match(frame, Features(map_.uv, stored.descriptors, map_.scores))


def _learned(path: Path, skipped: list[str]) -> FeatureSet:
    name, learned = path.stem, LearnedFeatures(path)
    methods = [Method(name)]
    if not name.endswith(INT8_SUFFIX):
        methods.append(Method(name + PACKED_SUFFIX, match_packed))
    return FeatureSet(name, learned.extract, methods, _cost(path.read_bytes(), skipped))


def _cost(graph: bytes, skipped: list[str]) -> GraphCost | None:
    try:
        return graph_cost(graph)
    except VwnavError as error:
        if str(error) not in skipped:
            skipped.append(str(error))
        return None


def _opencv_sift(gray: Gray, max_keypoints: int) -> Features:
    """SIFT with its own orientations in one call, as RootSIFT."""
    keypoints, descriptors = cv2.SIFT.create(nfeatures=max_keypoints).detectAndCompute(gray, None)
    if descriptors is None:
        return no_features(SIFT_SIZE, np.float32)
    total = np.abs(descriptors).sum(axis=1, keepdims=True)
    found = Features(
        np.array([point.pt for point in keypoints], np.float32),
        np.sqrt(descriptors / np.maximum(total, 1e-9)).astype(np.float32),
        np.array([point.response for point in keypoints], np.float32),
    )
    return found.take(np.argsort(-found.scores, kind="stable")[:max_keypoints])
