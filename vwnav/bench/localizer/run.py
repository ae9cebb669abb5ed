"""`vwnav bench localizer`: maps and looks in, what the localizer made of them out."""

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Literal

import cv2

import vwnav
from vwnav.bench.localizer.board_map import open_board
from vwnav.bench.localizer.boards import boards
from vwnav.bench.localizer.flown import flown_boards
from vwnav.bench.localizer.looks import Board
from vwnav.bench.localizer.repeating import repeating_boards
from vwnav.bench.localizer.scoring import ALL, LocalizerReport, Outcome, judge
from vwnav.bench.localizer.short_flights import FlownBoard, drawn_boards, flight_boards
from vwnav.errors import ConfigError
from vwnav.geometry.camera import Camera
from vwnav.types import FEATURE_NAMES, FeatureExtractor
from vwnav.vision.config import LocalizerConfig
from vwnav.vision.features.load import load_features
from vwnav.vision.localizer import Localizer

SceneSet = Literal["own", "judge", "repeats"]
SCENE_SETS: tuple[SceneSet, ...] = ("own", "judge", "repeats")
Progress = Callable[[str], None]


def data_folder(given: Path | None) -> Path:
    """The data folder: the argument, else VWNAV_DATA, else ../shared/data.

    Raises:
        ConfigError: it holds no pairs.
    """
    named = given or (Path(os.environ["VWNAV_DATA"]) if os.environ.get("VWNAV_DATA") else None)
    folder = named or Path(vwnav.__file__).parents[2] / "shared" / "data"
    if not (folder / "pairs.json").is_file():
        raise ConfigError(f"no pairs.json in {folder}: give the data folder with --data")
    return folder


def extractor_of(name: str) -> FeatureExtractor:
    """SIFT or ORB by name, else learned features by released name or path.

    Raises:
        ModelError: there is no such model.
    """
    if name in FEATURE_NAMES:
        return load_features(name)
    return load_features("learned", Path(name))


def bench_localizer(
    scenes: SceneSet,
    folder: Path | None,
    features: list[str],
    looks: int,
    only: str | None,
    progress: Progress,
) -> LocalizerReport:
    """Look with every feature set, on one thread.

    Args:
        scenes: which.
        folder: of the data; drawn ground needs none.
        features: names, see `extractor_of`.
        looks: of each kind, for each group.
        only: this group alone.
        progress: told how far it is.

    Raises:
        VwnavError: of a model or an image, or there is nothing to look at.
    """
    cv2.setNumThreads(1)
    extractors = {name: extractor_of(name) for name in features}
    outcomes: dict[str, list[Outcome]] = {name: [] for name in features}
    done = 0
    for board in scene_boards(scenes, folder, looks, only):
        for name, extractor in extractors.items():
            outcomes[name] += look_at_board(board, extractor)
        done += len(board.looks)
        progress(f"{done} looks of each feature set, {board.looks[-1].name}")
    if not done:
        raise ConfigError(f"nothing to look at: the set {scenes} has no group {only or ALL!r}")
    return LocalizerReport(outcomes)


def scene_boards(
    scenes: SceneSet, folder: Path | None, looks: int, only: str | None
) -> Iterator[Board]:
    """The maps of a set that there are looks at."""
    match scenes:
        case "repeats":
            found = repeating_boards(looks, only)
        case "own":
            found = boards(data_folder(folder), "train", looks, only)
        case "judge":
            data = data_folder(folder)
            found = chain(boards(data, "eval", looks, only), flown_boards(data, looks, only))
    return (board for board in found if board.looks)


def sequence_boards(scenes: SceneSet, folder: Path | None, flights: int) -> Iterator[FlownBoard]:
    """The maps of a set with so many flights.

    Raises:
        ConfigError: the set is there to judge only, or there is no data folder.
    """
    match scenes:
        case "repeats":
            return drawn_boards(flights)
        case "own":
            return flight_boards(data_folder(folder), flights)
        case "judge":
            raise ConfigError("sequences of --set judge: vwnav bench features --sequence")


def look_at_board(board: Board, extractor: FeatureExtractor) -> Iterator[Outcome]:
    """Build the map with the features, and make its looks.

    The map's georeference and the tilt that is told are exact, so that the fit alone is judged.
    """
    with tempfile.TemporaryDirectory() as folder, open_board(board, extractor, folder) as pack:
        config = LocalizerConfig(sigma_tilt_rad=0.0)
        localizers: dict[Camera, Localizer] = {}
        for look in board.looks:
            if look.camera not in localizers:
                localizers[look.camera] = Localizer(pack, extractor, look.camera, config)
            start_s = time.process_time()
            said = localizers[look.camera].localize(look.frame(), look.prior, look.seed)
            yield judge(look, said, time.process_time() - start_s)
