"""Choosing a feature extractor by its name."""

from pathlib import Path

from vwnav.errors import ConfigError
from vwnav.types import FEATURE_NAMES, FeatureExtractor
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
