"""Mutual nearest neighbours between two feature lists."""

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.types import Features

CHUNK = 8192  # map features compared at once: 1000 x 8192 float32 are 32 MB
BITS_PER_BYTE = 8
Descriptors = NDArray[np.float32] | NDArray[np.uint8]


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
    if 0 in (len(frame.descriptors), len(map_.descriptors)):
        return np.zeros((0, 2), np.int64)
    binary = frame.descriptors.dtype == np.uint8
    nearest = _nearest_bits if binary else _nearest_cosine
    chosen, similarity = nearest(frame.descriptors, map_.descriptors)
    # Back from the map's side: only the chosen map features have to be asked.
    back, _ = nearest(map_.descriptors[chosen], frame.descriptors)
    mutual = np.flatnonzero(back == np.arange(len(back)))
    mutual = mutual[similarity[mutual] >= min_similarity]
    best_first = mutual[np.argsort(-similarity[mutual], kind="stable")]
    return np.stack([best_first, chosen[best_first]], axis=1)


def similarities(queries: Descriptors, references: Descriptors) -> NDArray[np.float32]:
    """Similarity (n0, n1) of every descriptor with every other, as `match` has it."""
    if queries.dtype != np.uint8:
        return np.asarray(queries @ references.T, np.float32)
    signs0, signs1 = (
        2.0 * np.unpackbits(each.astype(np.uint8), axis=1).astype(np.float32) - 1.0
        for each in (queries, references)
    )
    return np.asarray(signs0 @ signs1.T / signs0.shape[1], np.float32)


def paired_similarity(queries: Descriptors, references: Descriptors) -> NDArray[np.float32]:
    """Similarity (n,) of each descriptor with the one in the same row, as `match` has it."""
    if queries.dtype != np.uint8:
        return np.asarray(np.einsum("nd,nd->n", queries, references), np.float32)
    differing = np.unpackbits(queries.astype(np.uint8) ^ references.astype(np.uint8), axis=1)
    return np.asarray(1.0 - 2.0 * differing.mean(axis=1), np.float32)


def _nearest_cosine(
    queries: Descriptors, references: Descriptors
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """The most similar reference of each query, and how similar it is."""
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
    return nearest, similarity


def _nearest_bits(
    queries: Descriptors, references: Descriptors
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """As `_nearest_cosine`, for binary descriptors."""
    found = cv2.BFMatcher(cv2.NORM_HAMMING).match(queries, references)
    nearest = np.array([pair.trainIdx for pair in found], np.int64)
    distance = np.array([pair.distance for pair in found], np.float32)
    return nearest, 1.0 - 2.0 * distance / np.float32(BITS_PER_BYTE * queries.shape[1])
