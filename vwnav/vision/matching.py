"""Mutual nearest neighbours between two feature lists."""

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.types import Features

CHUNK = 8192  # map features compared at once: 1000 x 8192 float32 are 32 MB
BITS_PER_BYTE = 8


def match(frame: Features, map_: Features, *, min_similarity: float = -1.0) -> NDArray[np.int64]:
    """Pairs of features that are each other's nearest.

    Similarity is the cosine of descriptors of unit length, or for binary ones
    1 - 2 * (share of differing bits); both are 1 for equal ones and about 0 for unrelated ones.

    Args:
        frame: n0 features.
        map_: n1 features of the same kind; memory stays bounded however many there are.
        min_similarity: pairs that are less similar are dropped.

    Returns:
        (m, 2) indices into frame and map, the most similar pair first.

    Raises:
        ValueError: the descriptors are of different kinds.
    """
    if frame.descriptors.dtype != map_.descriptors.dtype or (
        frame.descriptors.shape[1] != map_.descriptors.shape[1]
    ):
        raise ValueError(
            f"expected descriptors of one kind, got {frame.descriptors.dtype} x "
            f"{frame.descriptors.shape[1]} and {map_.descriptors.dtype} x "
            f"{map_.descriptors.shape[1]}"
        )
    if len(frame) == 0 or len(map_) == 0:
        return np.zeros((0, 2), np.int64)
    binary = frame.descriptors.dtype == np.uint8
    pairs, similarity = (_match_bits if binary else _match_cosine)(frame, map_)
    best_first = np.argsort(-similarity, kind="stable")
    return pairs[best_first[similarity[best_first] >= min_similarity]]


def _match_cosine(frame: Features, map_: Features) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    queries, references = frame.descriptors, map_.descriptors
    rows = np.arange(len(queries))
    nearest = np.zeros(len(queries), np.int64)
    similarity = np.full(len(queries), -np.inf, np.float32)
    for start in range(0, len(references), CHUNK):
        table = queries @ references[start : start + CHUNK].T
        candidate = np.argmax(table, axis=1)
        value = table[rows, candidate]
        better = value > similarity
        nearest[better] = candidate[better] + start
        similarity[better] = value[better]
    # Back from the map's side: only the chosen map features have to be asked.
    back = np.argmax(queries @ references[nearest].T, axis=0)
    mutual = np.flatnonzero(back == rows)
    return np.stack([mutual, nearest[mutual]], axis=1), similarity[mutual]


def _match_bits(frame: Features, map_: Features) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    found = matcher.match(frame.descriptors, map_.descriptors)
    pairs = np.array([(m.queryIdx, m.trainIdx) for m in found], np.int64).reshape(-1, 2)
    bits = frame.descriptors.shape[1] * BITS_PER_BYTE
    distance = np.array([m.distance for m in found], np.float32)
    return pairs, (1.0 - 2.0 * distance / bits).astype(np.float32)
