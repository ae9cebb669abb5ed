"""Choosing a feature extractor by its name."""

import math
from pathlib import Path

import numpy as np

from vwnav.errors import ConfigError
from vwnav.types import FEATURE_NAMES, FeatureExtractor, Gray
from vwnav.vision.config import FeaturesConfig, LocalizerConfig
from vwnav.vision.features.opencv import OrbFeatures, SiftFeatures


def load_features(
    name: str, model_path: Path | None = None, *, threads: int = 1
) -> FeatureExtractor:
    """Make the extractor of that name.

    Args:
        name: "learned", "sift" or "orb".
        model_path: ONNX file of the learned features; the released one when not given.
        threads: cores that one extraction of the learned features may use.

    Raises:
        ModelError: the model is missing, damaged or foreign.
        ConfigError: there is no such name.
    """
    match name:
        case "learned":
            # Here, so that SIFT flies on where onnxruntime itself is broken.
            from vwnav.vision.features.learned import LearnedFeatures

            return LearnedFeatures(model_path, threads=threads)
        case "sift":
            return SiftFeatures()
        case "orb":
            return OrbFeatures()
        case _:
            raise ConfigError(f"no features {name!r}: choose one of {', '.join(FEATURE_NAMES)}")


def load_chosen(config: FeaturesConfig) -> FeatureExtractor:
    """The extractor that settings name.

    Raises:
        ModelError: the model is missing, damaged or foreign.
    """
    return load_features(config.name, Path(config.model), threads=config.threads)


def largest_view(config: LocalizerConfig) -> Gray:
    """(h, w) of nothing, of 4:3, as large as the views that are extracted, whatever the camera."""
    width_px = math.sqrt(config.max_view_area_px * 4.0 / 3.0)
    shape = round(0.75 * width_px), round(width_px)
    return np.random.default_rng(0).integers(0, 255, shape, dtype=np.uint8)
