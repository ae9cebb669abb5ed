"""Writes what was measured of a model into the model's own file."""

import os
from pathlib import Path

from vwnav.errors import ConfigError
from vwnav.vision.features.learned import LOG10_PER_DECADE


def write_log10_per_decade(path: Path, value: float) -> None:
    """Put the value into the metadata of an ONNX file; the graph stays as it is.

    Raises:
        ConfigError: the onnx package is not installed, or the file cannot be written.
    """
    try:
        import onnx
    except ImportError as error:
        raise ConfigError("--write needs the onnx package: pip install 'vwnav[bench]'") from error
    model = onnx.load(path)
    kept = [each for each in model.metadata_props if each.key != LOG10_PER_DECADE]
    kept.append(onnx.StringStringEntryProto(key=LOG10_PER_DECADE, value=f"{value:.1f}"))
    del model.metadata_props[:]
    model.metadata_props.extend(kept)
    partial = path.with_suffix(".partial")
    try:
        partial.write_bytes(model.SerializeToString())
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise ConfigError(f"cannot write {path}: {error.strerror}") from error
