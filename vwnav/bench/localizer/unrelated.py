"""What unrelated images agree on: how little chance the best wrong agreement of a model shows.

`vwnav/vision/matching.py` takes matches for independent, which they are not; by how much it
overrates them differs from model to model, so it is measured on images of different places.
"""

import math
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vwnav.bench.features.scenes import generator
from vwnav.bench.localizer.board_map import open_board
from vwnav.bench.localizer.boards import cut_of
from vwnav.bench.localizer.images import (
    LEAST_SIDE_PX,
    Photo,
    apart,
    other_photos,
    read_gray,
    registered_pairs,
)
from vwnav.bench.localizer.looks import (
    CAMERA,
    ORIGIN_LAT_DEG,
    ORIGIN_LON_DEG,
    ZOOM,
    Board,
    TruePose,
    map_pixel,
    rough_prior,
)
from vwnav.cameras.image_folder import read_image
from vwnav.errors import ConfigError
from vwnav.geometry.geodesy import ground_resolution_m_per_px
from vwnav.machine.extras import how_to_install
from vwnav.maps.build.raster import array_source, level_georeference
from vwnav.types import FeatureExtractor, Features, Frame, Prior
from vwnav.vision.candidates import hypotheses
from vwnav.vision.config import LocalizerConfig
from vwnav.vision.consensus import SimilarityBounds, vote
from vwnav.vision.features.learned import LOG10_PER_DECADE
from vwnav.vision.matching import log10_nfa, match
from vwnav.vision.query import Query, View
from vwnav.vision.registration import MIN_KEYPOINTS, MIN_MATCHES

IMAGES = 90  # views, and as many pieces of map: each view is held against many of them
UNSURE = 0.6
_GUESSED_AGL_M = (20.0, 600.0)

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """What unrelated looks showed.

    Attributes:
        looks: how many.
        log10_1, log10_01: of false alarms; 1 and 0.1 % of the looks were below.
        log10_least: the least.
        log10_per_decade: what that makes of the model: see `per_decade`.
    """

    looks: int
    log10_1: float
    log10_01: float
    log10_least: float
    log10_per_decade: float


def calibrate(
    folder: Path, extractor: FeatureExtractor, looks: int, progress: Progress
) -> Calibration:
    """Hold views of training images against pieces of map that show other places.

    Raises:
        ConfigError: the training data show one place only.
    """
    views = _views(folder, extractor)
    pieces = _pieces(folder, extractor)
    couples = [
        (i, j)
        for i, (place_i, _) in enumerate(views)
        for j, (place_j, _) in enumerate(pieces)
        if apart(place_i, place_j)
    ]
    if not couples:
        raise ConfigError(f"the training pictures in {folder} show one place only")
    rng = generator("couples", 0)
    chosen = rng.permutation(len(couples))[:looks]
    bounds = _bounds()
    found = []
    for done, index in enumerate(chosen):
        i, j = couples[int(index)]
        found.append(_agreement(views[i][1], pieces[j][1], bounds, done))
        progress(f"{done} of {len(chosen)} unrelated looks")
    return _summary(found)


def _summary(found: Sequence[float]) -> Calibration:
    """From log10 of the false alarms of every look; 0 where matches agree on nothing."""
    log10_1, log10_01 = (float(np.quantile(found, share)) for share in (0.01, 0.001))
    return Calibration(
        looks=len(found),
        log10_1=log10_1,
        log10_01=log10_01,
        log10_least=float(np.min(found)),
        log10_per_decade=per_decade(log10_1, log10_01),
    )


def per_decade(log10_1: float, log10_01: float) -> float:
    """How many powers of ten of the test are worth a true one, from what 1 and 0.1 % are below.

    The largest of three: 1 % of unrelated looks reach two decades at most, 0.1 % three; and the
    line through both, continued to where the localizer decides, meets as many there. The worst
    three of 3000 looks make the 0.1 %: two measurements differ by some 0.6, which is added.
    """
    decides = LocalizerConfig().min_decades
    there = log10_01 + (decides - 3.0) * (log10_01 - log10_1)
    steepest = max(-log10_1 / 2.0, -log10_01 / 3.0, -there / decides)
    return max(1.0, math.ceil(10.0 * (steepest + UNSURE) - 1e-9) / 10.0)


def _photos(folder: Path, name: str) -> list[Photo]:
    """Images to take, one place after the other."""
    pairs = registered_pairs(folder, "train")
    photos = [photo for pair in pairs for photo in (pair.frame, pair.map_)]
    photos = [*dict.fromkeys(photos), *other_photos(folder, "train")]
    rng = generator(name, 0)
    by_place: dict[str, list[Photo]] = {}
    for index in rng.permutation(len(photos)):
        by_place.setdefault(photos[index].place, []).append(photos[index])
    rounds = max(map(len, by_place.values()), default=0)
    return [
        of_place[k] for k in range(rounds) for of_place in by_place.values() if k < len(of_place)
    ]


def _views(folder: Path, extractor: FeatureExtractor) -> list[tuple[str, View]]:
    keypoints = LocalizerConfig().max_keypoints
    m_per_px = ground_resolution_m_per_px(ORIGIN_LAT_DEG, ZOOM)
    found: list[tuple[str, View]] = []
    for number, photo in enumerate(_photos(folder, "views")):
        cut = cut_of(photo, generator("view", number))
        if cut is None:
            continue
        roll_rad, pitch_rad, yaw_rad = cut.rpy_rad
        prior = Prior(roll_rad=roll_rad, pitch_rad=pitch_rad)
        frame = Frame(0.0, cut.image, number)
        query = Query(CAMERA, extractor, frame, prior, number, time.perf_counter)
        made = query.rectify(yaw_rad, cut.agl_px * m_per_px, m_per_px)
        if made is not None:
            found.append((photo.place, query.view(yaw_rad, made, keypoints)))
        if len(found) == IMAGES:
            break
    return found


def _pieces(folder: Path, extractor: FeatureExtractor) -> list[tuple[str, Features]]:
    """Features of whole images, as a map pack holds them."""
    found: list[tuple[str, Features]] = []
    for photo in _photos(folder, "pieces"):
        image, (gray, mask) = read_image(photo.path), read_gray(photo)
        if min(gray.shape) < LEAST_SIDE_PX:
            continue
        x0, y0 = map_pixel((0, 0))
        source = array_source(
            image, level_georeference(ZOOM, x0, y0), name=photo.path.stem, mask=mask
        )
        h, w = gray.shape
        board = Board([source], (ZOOM,), [])
        with (
            tempfile.TemporaryDirectory() as place_on_disk,
            open_board(board, extractor, place_on_disk) as pack,
        ):
            piece = pack.features_in(ZOOM, x0, y0, x0 + w, y0 + h, extractor)
        found.append((photo.place, piece.features))
        if len(found) == IMAGES:
            break
    return found


def _agreement(view: View, piece: Features, bounds: SimilarityBounds, seed: int) -> float:
    """log10 of the false alarms of what most matches agree on; 0 where they agree on nothing."""
    if min(len(view.features), len(piece)) < MIN_KEYPOINTS:
        return 0.0
    pairs = match(view.features, piece)
    if len(pairs) < MIN_MATCHES:
        return 0.0
    uv_view = view.features.uv[pairs[:, 0]].astype(np.float64)
    uv_map = piece.uv[pairs[:, 1]].astype(np.float64)
    middle = (np.array(view.rectification.size_wh) - 1.0) / 2.0
    threshold_px = LocalizerConfig().threshold_px
    places = vote(uv_view, uv_map, middle, bounds, threshold_px, seed)
    if not places:
        return 0.0
    H, near = places[0].H_map_view, places[0].near
    return min(0.0, log10_nfa(H, uv_view, uv_map, near, threshold_px))


def _bounds() -> SimilarityBounds:
    """What a rough prior leaves open."""
    somewhere = TruePose(ORIGIN_LAT_DEG, ORIGIN_LON_DEG, 0.0, 60.0)
    prior = rough_prior(somewhere, (0.0, 0.0), 10.0, generator("bounds", 0))
    return hypotheses(prior, _GUESSED_AGL_M)[0].bounds


def write_log10_per_decade(path: Path, value: float) -> None:
    """Put the value into the metadata of an ONNX file; the graph stays as it is.

    Raises:
        ConfigError: the onnx package is not installed, or the file cannot be written.
    """
    try:
        import onnx
    except ImportError as error:
        raise ConfigError(f"--write needs the onnx package: {how_to_install('bench')}") from error
    model = onnx.load(path)
    kept = [each for each in model.metadata_props if each.key != LOG10_PER_DECADE]
    kept.append(onnx.StringStringEntryProto(key=LOG10_PER_DECADE, value=f"{value:.1f}"))
    del model.metadata_props[:]
    model.metadata_props.extend(kept)
    partial = path.with_suffix(".partial")
    try:
        partial.write_bytes(model.SerializeToString())
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise ConfigError(f"cannot write {path}: {error.strerror}") from error
