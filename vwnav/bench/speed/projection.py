"""What a network would take on a Raspberry Pi: a projection from its operations, nothing measured.

Two floating-point (or integer) operations each multiply-accumulate, at the rate that onnxruntime
attains there on convolutional networks, as published.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from vwnav.bench.features.macs import graph_cost
from vwnav.bench.speed.results import Projection
from vwnav.bench.speed.settings import SIZES_WH, Setting
from vwnav.vision.config import FeaturesConfig
from vwnav.vision.features.learned import SIZE_MULTIPLE_PX, find_model


@dataclass(frozen=True, slots=True)
class Attained:
    """Attained by onnxruntime: thousand millions of operations a second."""

    name: str
    float_gflop_s: float
    int8_gflop_s: float


BOARDS = (Attained("Pi 4", 14.0, 30.0), Attained("Pi 5", 43.0, 100.0))


def projections(choices: list[FeaturesConfig]) -> Iterator[Projection]:
    """For each model at each resolution.

    Raises:
        ConfigError: the onnx package, which reads a graph, is not installed.
    """
    for choice in (each for each in choices if each.name == "learned"):
        graph = find_model(Path(choice.model)).read_bytes()
        for size_wh in SIZES_WH:
            setting = Setting(features=choice, size_wh=size_wh, keypoints=0)
            macs = graph_cost(graph, _padded(size_wh)).macs
            yield Projection(
                model=setting.label,
                size=setting.size,
                is_int8=setting.is_int8,
                gmac=macs / 1e9,
                ms={board.name: _ms(macs, board, setting.is_int8) for board in BOARDS},
            )


def _padded(size_wh: tuple[int, int]) -> tuple[int, int]:
    """As `LearnedFeatures` continues an image, for the graph halves it five times."""
    w, h = (side + -side % SIZE_MULTIPLE_PX for side in size_wh)
    return w, h


def _ms(macs: int, board: Attained, is_int8: bool) -> float:
    gflop_s = board.int8_gflop_s if is_int8 else board.float_gflop_s
    return 2.0 * macs / gflop_s / 1e6
