"""What came of short flights, each image by itself and joined through odometry."""

import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import cv2

from vwnav.bench.localizer.board_map import open_board
from vwnav.bench.localizer.looks import (
    CAMERA,
    ORIGIN_LAT_DEG,
    ORIGIN_LON_DEG,
    Board,
)
from vwnav.bench.localizer.scoring import ShortFlightOutcome, judge
from vwnav.bench.localizer.short_flights import FlownBoard, ShortFlight
from vwnav.estimation.beginning.sequences import Sequences
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler
from vwnav.types import (
    Attitude,
    FeatureExtractor,
    MapFix,
    Rejected,
)
from vwnav.vision.config import LocalizerConfig
from vwnav.vision.localizer import Localizer


def bench_sequences(
    boards: Iterable[FlownBoard],
    extractors: dict[str, FeatureExtractor],
    progress: Callable[[str], None],
) -> dict[str, list[ShortFlightOutcome]]:
    """Fly with every feature set; `progress` is told how far it is."""
    cv2.setNumThreads(1)
    outcomes: dict[str, list[ShortFlightOutcome]] = {name: [] for name in extractors}
    for board, flown in boards:
        for name, extractor in extractors.items():
            for flight, said in looked_at(board, flown, extractor):
                outcomes[name].append(outcome_of(flight, said))
        progress(f"{len(next(iter(outcomes.values())))} flights of each feature set")
    return outcomes


def looked_at(
    board: Board, flown: list[ShortFlight], extractor: FeatureExtractor
) -> Iterator[tuple[ShortFlight, list[MapFix | Rejected]]]:
    """What the localizer says of each image alone."""
    with tempfile.TemporaryDirectory() as folder, open_board(board, extractor, folder) as pack:
        localizer = Localizer(pack, extractor, CAMERA, LocalizerConfig(sigma_tilt_rad=0.0))
        for flight in flown:
            looks = flight.looks
            yield flight, [localizer.localize(e.frame(), e.prior, e.seed) for e in looks]


def outcome_of(flight: ShortFlight, said: list[MapFix | Rejected]) -> ShortFlightOutcome:
    """Join what was said of the images, and hold both against the truth."""
    together = joined(flight, said)
    judged = [
        [judge(look, each, 0.0) for look, each in zip(flight.looks, outcomes, strict=True)]
        for outcomes in (said, together)
    ]
    firsts = [
        next((n for n, each in enumerate(outcomes, 1) if each.located), None) for outcomes in judged
    ]
    false = [sum(each.false for each in outcomes) for outcomes in judged]
    first = flight.looks[0]
    return ShortFlightOutcome(
        group=first.group,
        name=first.name,
        kind=first.kind,
        alone=firsts[0],
        joined=firsts[1],
        alone_false=false[0],
        joined_false=false[1],
    )


def joined(flight: ShortFlight, said: list[MapFix | Rejected]) -> list[MapFix | Rejected]:
    """The same with weak places joined as the pipeline does."""
    sequences = Sequences(LocalFrame(ORIGIN_LAT_DEG, ORIGIN_LON_DEG, 0.0))
    found: list[MapFix | Rejected] = []
    for number, (each, motion) in enumerate(zip(said, flight.motions, strict=True)):
        R_ned_body, t_s = rotation_from_euler(0.0, 0.0, flight.yaws_rad[number]), float(number)
        sequences.follow(motion, Attitude(t_s, quat_from_rotation(R_ned_body)))
        if isinstance(each, Rejected):
            each = sequences.join(replace(each, t_s=t_s))
        found.append(each)
    return found
