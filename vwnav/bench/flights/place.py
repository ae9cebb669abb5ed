"""Where flights in lockstep take place: the site, its map, the camera, the features."""

from dataclasses import dataclass
from pathlib import Path

from vwnav.geometry.camera import Camera
from vwnav.sim.site import Site
from vwnav.types import FeatureExtractor, Features, Gray


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


class BreakableFeatures:
    """An extractor that can be made to raise, as a model does that runs out of memory."""

    def __init__(self, features: FeatureExtractor) -> None:
        self._features = features
        self.name = features.name
        self.feature_set_id = features.feature_set_id
        self.log10_per_decade = features.log10_per_decade
        self.broken = False

    def extract(self, gray: Gray, max_keypoints: int) -> Features:
        """As the extractor does, while it works."""
        if self.broken:
            raise RuntimeError("bad allocation in the inference session")
        return self._features.extract(gray, max_keypoints)
