"""Does the exported graph say what PyTorch says? For the export, verify.py and the tests."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import onnxruntime
import torch
from numpy.typing import NDArray

from models.extractor import Extractor

Image = NDArray[np.uint8]
SAME_PX = 0.05  # keypoints nearer than this are the same


@dataclass(frozen=True, slots=True, kw_only=True)
class Parity:
    """How well two extractions of one image agree."""

    keypoints: int  # of the exported graph
    found_share: float  # of them, also found by PyTorch within `SAME_PX`
    cosine_min: float  # of the descriptors of those
    score_difference_max: float

    @property
    def ok(self) -> bool:
        """Rounding may swap two keypoints of equal score at the cut-off; no more is allowed."""
        return (
            self.found_share >= 0.99
            and self.cosine_min >= 0.999
            and self.score_difference_max <= 1e-3
        )

    def __str__(self) -> str:
        """One line of a table."""
        return (
            f"{self.keypoints} keypoints, {100 * self.found_share:.2f} % the same, "
            f"cosine >= {self.cosine_min:.6f}, scores within {self.score_difference_max:.1e}"
        )


def open_session(model: Path | bytes, threads: int = 1) -> onnxruntime.InferenceSession:
    """Open a graph on the CPU, as the drone does."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    source = model if isinstance(model, bytes) else str(model)
    return onnxruntime.InferenceSession(source, options, providers=["CPUExecutionProvider"])


def compare(
    session: onnxruntime.InferenceSession, extractor: Extractor, image: Image, max_keypoints: int
) -> Parity:
    """Extract features of one grey image (H, W) by both and compare."""
    feed = {"image": image[None, None], "max_keypoints": np.array([max_keypoints], np.int64)}
    uv, scores, descriptors = session.run(None, feed)
    with torch.inference_mode():
        expected = extractor(torch.from_numpy(image)[None, None], torch.tensor([max_keypoints]))
    uv_torch, scores_torch, descriptors_torch = (x.numpy() for x in expected)
    if len(uv) == 0 or len(uv_torch) == 0:
        same = float(len(uv) == len(uv_torch))
        return Parity(keypoints=len(uv), found_share=same, cosine_min=1.0, score_difference_max=0.0)
    distance = np.linalg.norm(uv[:, None] - uv_torch[None], axis=2)
    nearest = distance.argmin(axis=1)
    found = distance.min(axis=1) < SAME_PX
    cosine = (descriptors * descriptors_torch[nearest]).sum(axis=1)[found]
    difference = np.abs(scores - scores_torch[nearest])[found]
    return Parity(
        keypoints=len(uv),
        found_share=float(found.mean()),
        cosine_min=float(cosine.min(initial=1.0)),
        score_difference_max=float(difference.max(initial=0.0)),
    )


def drawn_images(count: int, seed: int = 0) -> list[Image]:
    """Draw images of several sizes with boxes, lines and grain, so that a check needs no data."""
    rng = np.random.default_rng(seed)
    sizes = [(256, 320), (480, 640), (224, 224), (256, 448), (96, 544)]
    images = []
    for index in range(count):
        height, width = sizes[index % len(sizes)]
        image = np.full((height, width), 110, np.uint8)
        for _ in range(40):
            corners = rng.integers(0, (width, height), (4, 2)).astype(np.int32)
            if rng.random() < 0.5:
                corners = corners[0] + (corners - corners.mean(axis=0).astype(np.int32)) // 4
            cv2.fillConvexPoly(
                image,
                cv2.convexHull(corners.astype(np.int32)),
                int(rng.integers(256)),
                cv2.LINE_AA,
            )
        noise = rng.normal(0, 6, image.shape)
        images.append(np.clip(image + noise, 0, 255).astype(np.uint8))
    return images
