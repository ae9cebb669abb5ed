"""The place that all scenarios share: the embedded site with its map, learned features, camera."""

from functools import cache

import cv2

from vwnav.bench.flights.place import Place
from vwnav.cli.simulation import DEFAULT_SITE, map_pack_of
from vwnav.sim.renderer import default_camera
from vwnav.sim.sites import parse_site
from vwnav.vision.features import load_features


@cache
def default_place() -> Place:
    """One for each process."""
    cv2.setNumThreads(1)
    learned, sift = load_features("learned"), load_features("sift")
    pack = map_pack_of(DEFAULT_SITE, [learned, sift])
    return Place(parse_site(DEFAULT_SITE), pack, default_camera(), learned, sift)
