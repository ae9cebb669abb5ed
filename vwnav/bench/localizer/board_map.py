"""The map of a board, as the localizer reads it."""

from pathlib import Path

from vwnav.bench.localizer.looks import Board
from vwnav.maps.build.builder import BuildOptions, build_pack
from vwnav.maps.pack import MapPack
from vwnav.types import FeatureExtractor


def open_board(board: Board, extractor: FeatureExtractor, folder: str) -> MapPack:
    """The map of a board as a pack in a folder."""
    path = Path(folder) / "board.mbtiles"
    options = BuildOptions(levels=board.levels, georeference_sigma_m=0.0)
    build_pack(board.sources, path, [extractor], options)
    return MapPack.open(path)
