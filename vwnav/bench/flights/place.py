"""Where flights in lockstep take place: the site, its map, the camera, the features."""

from dataclasses import dataclass
from pathlib import Path

from vwnav.geometry.camera import Camera
from vwnav.sim.site import Site
from vwnav.types import FeatureExtractor


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """What many flights may share.

    Attributes:
        pack: path of the map.
        primary, fallback: extractors, as `vwnav.assemble.choose_features` gives them.
    """

    site: Site
    pack: Path
    camera: Camera
    primary: FeatureExtractor
    fallback: FeatureExtractor | None
