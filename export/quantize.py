"""Make the int8 form of an exported graph: the same features, of the same name, in less time.

python export/quantize.py models/vwnav_default.onnx -o models/vwnav_default_int8.onnx
python export/quantize.py models/vwnav_default.onnx -o ... --data FOLDER --pictures 48

Static quantisation (QDQ): weights per channel, activations by what training images show. Weights
take seven of the eight bits: x86 processors without VNNI add two products in sixteen bits, which
saturates (onnxruntime's documentation of quantisation, "When to use reduce range"). Only
convolutions are quantised, and of those not the last one of each head: keypoints are ranked by what
it says. All that comes after the network stays float.
"""

import argparse
import logging
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnxruntime.quantization import (
    CalibrationDataReader,
    CalibrationMethod,
    QuantFormat,
    QuantType,
    quantize_static,
)

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # so that `python export/...` works

from export.export_onnx import ExportError, check_outputs
from export.images import Image, read_grey, training_images
from training.complaint import one_line
from training.whole import write_whole

IMAGES = 48
IMAGE_PX = 320  # the calibration keeps the activations of all images in memory


class _Images(CalibrationDataReader):
    """Hands the images to the calibration, one by one."""

    def __init__(self, images: list[Image]) -> None:
        self._feeds: Iterator[dict[str, Any]] = iter(
            {"image": image[None, None], "max_keypoints": np.array([500], np.int64)}
            for image in images
        )

    def get_next(self) -> dict[str, Any] | None:
        return next(self._feeds, None)


def quantise(model: onnx.ModelProto, images: list[Image]) -> onnx.ModelProto:
    """Quantise a graph; metadata, inputs and outputs stay as they are.

    Args:
        model: as `export_onnx` makes it.
        images: (H, W) uint8, H and W divisible by 32, such as the drone will see.

    Raises:
        ExportError: there is no image.
    """
    if not images:
        raise ExportError("no pictures to calibrate with: give --data, a folder that holds train/")
    root = logging.getLogger()
    level = root.level
    root.setLevel(logging.ERROR)  # it advises a preparation that batch norm folding has done
    try:
        with tempfile.TemporaryDirectory() as folder:
            source, output = (Path(folder) / name for name in ("float.onnx", "int8.onnx"))
            onnx.save(model, source)  # a model in memory would be changed in place
            quantize_static(
                source,
                output,
                _Images(images),
                quant_format=QuantFormat.QDQ,
                per_channel=True,
                activation_type=QuantType.QUInt8,
                weight_type=QuantType.QInt8,
                reduce_range=True,
                op_types_to_quantize=["Conv", "Relu"],
                nodes_to_exclude=[node.name for node in last_convolutions(model)],
                calibrate_method=CalibrationMethod.MinMax,
            )
            quantised = onnx.load(output)
    finally:
        root.setLevel(level)
    del quantised.metadata_props[:]
    quantised.metadata_props.extend(model.metadata_props)
    quantised.metadata_props.add(key="precision", value="int8")
    onnx.checker.check_model(quantised)
    return quantised


def last_convolutions(model: onnx.ModelProto) -> list[onnx.NodeProto]:
    """The convolutions after which no other one follows: the ends of the heads."""
    read_by: dict[str, list[onnx.NodeProto]] = {}
    for node in model.graph.node:
        for name in node.input:
            read_by.setdefault(name, []).append(node)

    def leads_to_another(node: onnx.NodeProto) -> bool:
        waiting, seen = list(node.output), set(node.output)
        while waiting:
            for reader in read_by.get(waiting.pop(), []):
                if reader.op_type == "Conv":
                    return True
                waiting += [name for name in reader.output if name not in seen]
                seen.update(reader.output)
        return False

    convolutions = [node for node in model.graph.node if node.op_type == "Conv"]
    return [node for node in convolutions if not leads_to_another(node)]


def load_model(path: Path) -> onnx.ModelProto:
    """Read an exported float graph.

    Raises:
        ExportError: it is missing, damaged, or quantised already.
    """
    try:
        model = onnx.load(path)
        onnx.checker.check_model(model)
    except Exception as error:  # onnx and protobuf raise errors of their own kinds
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ExportError(f"{path} is not a whole ONNX model ({reason})") from error
    metadata = {each.key: each.value for each in model.metadata_props}
    if "feature_set_id" not in metadata or "precision" in metadata:
        raise ExportError(f"{path} is not a float model of vwnav: make one with export_onnx.py")
    return model


def main(arguments: list[str] | None = None) -> int:
    """Run the command; 0 done, 1 refused with one line on stderr."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True, help="the int8 .onnx file")
    parser.add_argument("--data", default="", help="folder that holds train/")
    parser.add_argument("--pictures", type=int, default=IMAGES, help="to calibrate with")
    given = parser.parse_args(arguments)
    try:
        check_outputs(given.model, given.output)
        paths = training_images(given.data, given.pictures)
        images = [read_grey(path, IMAGE_PX) for path in paths]
        quantised = quantise(load_model(given.model), images)
        write_whole(given.output, quantised.SerializeToString())
    except (ExportError, OSError) as error:
        print(f"quantize: {error}", file=sys.stderr)
        return 1
    size_mb = given.output.stat().st_size / 1e6
    print(f"wrote {given.output}: calibrated on {len(images)} pictures, {size_mb:.2f} MB")
    return 0


if __name__ == "__main__":
    with one_line():
        sys.exit(main())
