"""The settings that are measured: features, model, threads, resolution and keypoints."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from vwnav.errors import ConfigError
from vwnav.types import FEATURE_NAMES, FeatureExtractor
from vwnav.vision.config import FeaturesConfig, LocalizerConfig
from vwnav.vision.features.learned import released_model
from vwnav.vision.features.load import load_chosen, load_features

# Of the ground that an image shows, on the map: `max_view_area_px` chooses the level.
SIZES_WH = ((640, 480), (416, 320), (320, 240))
KEYPOINTS = (1000, 500)
MOST_THREADS = 3
CAMERA_HZ = 30.0
_LEAVES_ROOM = 1.02  # a height that is a little more than thought still gives that level


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """One way to look at images.

    Attributes:
        features: feature set, model, threads.
        size_wh: width and height on the map of the ground that an image shows, pixels.
        keypoints: of a view, at most.
    """

    features: FeaturesConfig
    size_wh: tuple[int, int]
    keypoints: int

    @property
    def label(self) -> str:
        """The model's name, or the feature set's where there is no model."""
        if self.features.name != "learned":
            return self.features.name
        return Path(self.features.model).stem.removeprefix("vwnav_")

    @property
    def size(self) -> str:
        """Such as "640x480"."""
        return f"{self.size_wh[0]}x{self.size_wh[1]}"

    @property
    def is_int8(self) -> bool:
        """Whether the model is a quantised one."""
        return self.label.endswith("_int8")

    @property
    def localizer(self) -> LocalizerConfig:
        """With which the localizer looks so."""
        area_px = float(round(_LEAVES_ROOM * self.size_wh[0] * self.size_wh[1]))
        return LocalizerConfig(max_keypoints=self.keypoints, max_view_area_px=area_px)

    def load(self) -> FeatureExtractor:
        """The extractor.

        Raises:
            ModelError: the model is missing or damaged.
        """
        return load_chosen(self.features)

    def as_config(self, target_hz: float) -> dict[str, dict[str, Any]]:
        """The tables of a settings file that flies so.

        An image is matched when the interval is over: with half an image less of it the camera's
        jitter does not make it wait for the next one.
        """
        features, localizer = self.features, self.localizer
        model = {"model": features.model} if features.name == "learned" else {}
        return {
            "features": {"name": features.name, **model, "threads": features.threads},
            "localizer": {
                "max_keypoints": localizer.max_keypoints,
                "max_view_area_px": localizer.max_view_area_px,
            },
            "pipeline": {"fix_interval_s": round((images_apart(target_hz) - 0.5) / CAMERA_HZ, 4)},
        }


def images_apart(target_hz: float) -> int:
    """Of the camera's images each how manyth is matched to the map, not to fall behind."""
    return max(1, math.floor(CAMERA_HZ / target_hz))


def feature_choices(asked: list[str]) -> list[FeaturesConfig]:
    """The feature sets by name: sift, orb, a released model or a model's file; all when none is.

    Raises:
        ModelError: there is no such model, or it is damaged.
    """
    if asked:
        return [_choice(name) for name in dict.fromkeys(asked)]
    released = sorted(released_model().parent.glob("vwnav_*.onnx"))
    models = [path.stem.removeprefix("vwnav_") for path in released]
    learned = [FeaturesConfig(model=model) for model in models]
    return [*learned, FeaturesConfig(name="sift"), FeaturesConfig(name="orb")]


def _choice(name: str) -> FeaturesConfig:
    for known in FEATURE_NAMES:
        if known == name:
            return FeaturesConfig(name=known)
    load_features("learned", Path(name))  # it is there, and it runs
    return FeaturesConfig(model=name)


def thread_counts(cores: int, most: int | None) -> range:
    """How many threads an extraction may have: a core is left for the link and the control loop.

    Raises:
        ConfigError: more were asked for than there are.
    """
    if most is not None and most > cores:
        raise ConfigError(f"--threads {most}: this board has {cores} cores")
    return range(1, (most or min(max(1, cores - 1), MOST_THREADS)) + 1)


def settings(choices: list[FeaturesConfig], threads: range) -> Iterator[Setting]:
    """All of them, those of one extractor together; OpenCV's have one thread in flight."""
    for choice in choices:
        for count in threads if choice.name == "learned" else (1,):
            features = FeaturesConfig(name=choice.name, model=choice.model, threads=count)
            for size_wh, keypoints in product(SIZES_WH, KEYPOINTS):
                yield Setting(features=features, size_wh=size_wh, keypoints=keypoints)
