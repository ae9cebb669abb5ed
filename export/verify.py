"""Does the exported graph say what PyTorch says, on real images; and is int8 worth it?

python export/verify.py models/vwnav_default.onnx runs/default/last.pt [IMAGE ...]
python export/verify.py models/vwnav_default.onnx runs/default/last.pt --int8
models/vwnav_default_int8.onnx

The float graph must agree with PyTorch. With --int8 each image is also matched with itself
turned, scaled and changed in tone, by both graphs: what int8 costs in inliers, and what it gains in
time. int8 wins where it loses at most 3 % of the inliers and takes at most 0.9 of the time.
"""

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import cv2
import numpy as np
import onnxruntime

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # so that `python export/...` works

from export import export_onnx, parity
from export.export_onnx import ExportError
from export.images import Image, read_grey, training_images
from models.extractor import Extractor
from training.complaint import one_line
from training.validate import mutual_matches
from training.warps import centred, similarity, warp_points
from vwnav.types import Features

IMAGES = 12
KEYPOINTS = 1000
REPEATS = 15
LARGEST_PX = 640
RIGHT_PX = 3.0
INLIERS_KEPT, TIME_TAKEN = 0.97, 0.9  # what int8 must reach


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """The float and the int8 graph on one image."""

    inliers: tuple[int, int]  # float, int8
    time_ms: tuple[float, float]  # of the processor, medians of calls in turn

    def __str__(self) -> str:
        """One line of a table."""
        (inliers0, inliers1), (ms0, ms1) = self.inliers, self.time_ms
        return f"inliers {inliers0} -> {inliers1}, {ms0:.1f} -> {ms1:.1f} ms"


def matched_again(session: onnxruntime.InferenceSession, image: Image, seed: int) -> int:
    """Match an image with a changed view of itself; returns how many matches are right."""
    rng = np.random.default_rng(seed)
    h, w = image.shape
    centre = (np.array([w, h]) - 1.0) / 2.0
    turn = similarity(np.deg2rad(rng.normal(0.0, 8.0)), float(np.exp(rng.normal(0.0, 0.12))))
    H_1_0 = centred(turn, centre, centre)
    warped = cv2.warpPerspective(image, H_1_0, (w, h), borderMode=cv2.BORDER_REFLECT)
    tone = 255.0 * (np.arange(256) / 255.0) ** np.exp(rng.normal(0.0, 0.4))
    changed = cv2.GaussianBlur(tone[warped], (0, 0), 0.7) + rng.normal(0.0, 4.0, (h, w))
    other = np.clip(changed, 0, 255).astype(np.uint8)
    features = []
    for view in (image, other):
        uv, scores, descriptors = session.run(None, _feed(view))
        features.append(Features(uv, descriptors, scores))
    uv0, uv1 = mutual_matches(*features)
    return int((np.linalg.norm(warp_points(H_1_0, uv0) - uv1, axis=1) < RIGHT_PX).sum())


def compare(
    sessions: tuple[onnxruntime.InferenceSession, onnxruntime.InferenceSession],
    image: Image,
    seed: int,
) -> Comparison:
    """Compare the float graph with the int8 one."""
    times_s: tuple[list[float], list[float]] = ([], [])
    for _ in range(REPEATS):
        for session, spent_s in zip(sessions, times_s, strict=True):
            start_s = time.process_time()
            session.run(None, _feed(image))
            spent_s.append(time.process_time() - start_s)
    first, second = (matched_again(session, image, seed) for session in sessions)
    return Comparison(
        inliers=(first, second), time_ms=(1e3 * median(times_s[0]), 1e3 * median(times_s[1]))
    )


def verdict(compared: list[Comparison]) -> str:
    """Over all images: what int8 costs, what it gains, and whether to ship it as the default."""
    inliers, times = (
        np.array([getattr(each, name) for each in compared]).sum(axis=0)
        for name in ("inliers", "time_ms")
    )
    kept, taken = inliers[1] / max(inliers[0], 1), times[1] / times[0]
    wins = kept >= INLIERS_KEPT and taken <= TIME_TAKEN
    return f"int8: {100 * kept:.1f} % of the inliers, {taken:.2f} of the time on this machine: " + (
        "it wins" if wins else "keep float as the default"
    )


def _feed(view: Image) -> dict[str, object]:
    return {"image": view[None, None], "max_keypoints": np.array([KEYPOINTS], np.int64)}


def _open(model: Path, expected: str) -> onnxruntime.InferenceSession:
    """A graph that names its features as the checkpoint does."""
    try:
        session = parity.open_session(model)
    except Exception as error:  # onnxruntime's own errors have no common base
        raise ExportError(f"{model} is not a graph that runs ({type(error).__name__})") from error
    found = session.get_modelmeta().custom_metadata_map.get("feature_set_id")
    if expected != found:
        raise ExportError(f"{model} is {found}, but the checkpoint makes {expected}")
    return session


def verify(model: Path, checkpoint: Path, int8: Path | None, pictures: list[Path]) -> bool:
    """Print a line for each image, and the verdict; false where float and PyTorch differ.

    Raises:
        ExportError: a file is missing, damaged, or of another model.
    """
    network = export_onnx.load_network(checkpoint)
    expected = export_onnx.feature_set_id(network)
    session = _open(model, expected)
    quantised = None if int8 is None else _open(int8, expected)
    named = [(f"{path.parent.name}/{path.name}", read_grey(path, LARGEST_PX)) for path in pictures]
    if not named:
        named = [(f"drawn {i}", drawn) for i, drawn in enumerate(parity.drawn_images(6))]
    extractor, agree, compared = Extractor(network), True, []
    for seed, (name, image) in enumerate(named):
        result = parity.compare(session, extractor, image, max_keypoints=KEYPOINTS)
        agree &= result.ok
        print(f"{'ok  ' if result.ok else 'FAIL'} {name:44s} {result}")
        if quantised is not None:
            compared.append(compare((session, quantised), image, seed))
            print(f"     {'':44s} {compared[-1]}")
    if compared:
        print(verdict(compared))
    return agree


def main(arguments: list[str] | None = None) -> int:
    """Run the command; 0 where all agree, 1 where one does not."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("pictures", type=Path, nargs="*", help="else a dozen training pictures")
    parser.add_argument("--int8", type=Path, help="its int8 form, to be compared too")
    given = parser.parse_args(arguments)
    try:
        pictures = given.pictures or training_images("", IMAGES)
        return 0 if verify(given.model, given.checkpoint, given.int8, pictures) else 1
    except ExportError as error:
        print(f"verify: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    with one_line():
        sys.exit(main())
