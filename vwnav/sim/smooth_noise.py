"""Smooth random fields over the ground."""

import math

import numpy as np
from numpy.typing import NDArray

HALF_M = 512  # of the square about the origin that has values, at a metre; its rim goes on for ever


def smooth_noise(rng: np.random.Generator, node_m: int) -> NDArray[np.float32]:
    """(2 HALF_M, 2 HALF_M) of unit variance: cubic between random nodes that far apart."""
    import cv2  # the command line names a relief, and does without OpenCV

    side_m = 2 * HALF_M
    nodes = rng.standard_normal((math.ceil(side_m / node_m) + 3,) * 2).astype(np.float32)
    side = len(nodes) * node_m
    smooth = np.asarray(cv2.resize(nodes, (side, side), interpolation=cv2.INTER_CUBIC))
    part = smooth[node_m : node_m + side_m, node_m : node_m + side_m]
    return np.asarray(part / part.std(), np.float32)
