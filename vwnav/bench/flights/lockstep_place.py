"""The place of flights in lockstep: the embedded site with its map, learned features, camera."""

import fcntl
import tempfile
from functools import cache
from pathlib import Path

import cv2

from vwnav.bench.flights.world import Place
from vwnav.onboard.simulation import DEFAULT_SITE, map_pack_of
from vwnav.sim.named_sites import parse_site
from vwnav.sim.renderer import default_camera
from vwnav.types import FeatureExtractor
from vwnav.vision.features.load import load_features


@cache
def lockstep_place() -> Place:
    """One for each process."""
    cv2.setNumThreads(1)
    learned, sift = load_features("learned"), load_features("sift")
    pack = _pack_once([learned, sift])
    return Place(parse_site(DEFAULT_SITE), pack, default_camera(), learned, sift)


def _pack_once(extractors: list[FeatureExtractor]) -> Path:
    """Drawn by one of the processes; the others wait for it."""
    lock = Path(tempfile.gettempdir()) / "vwnav_scenarios_map.lock"
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        return map_pack_of(DEFAULT_SITE, extractors)
