"""Export a checkpoint to the one graph that flies: image in; keypoints, descriptors out.

python export/export_onnx.py runs/default/last.pt -o models/vwnav_default.onnx
python export/export_onnx.py runs/default/last.pt -o models/vwnav_default.onnx --checkpoint
models/vwnav_default.ckpt

Inputs: `image` uint8 (1, 1, H, W), H and W divisible by 32; `max_keypoints` int64 (1,).
Outputs: `keypoints` float32 (n, 2) as (u, v), pixel centres at integers; `scores` float32 (n,),
    descending;
`descriptors` float32 (n, D), unit length; n <= max_keypoints.
The graph is compared with PyTorch first; if they differ, nothing is written.
"""

import argparse
import hashlib
import io
import os
import sys
from pathlib import Path

import onnx
import torch
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # so that `python export/...` works

import vwnav
from export import parity
from models.extractor import Extractor
from models.network import SIZE_MULTIPLE_PX, FeatureNetwork, NetworkConfig
from training.complaint import one_line
from training.whole import write_whole

OPSET = 18


class ExportError(Exception):
    """A model could not be exported; the message says why."""


def load_network(checkpoint: Path) -> FeatureNetwork:
    """Rebuild the averaged network of a checkpoint, in evaluation mode.

    Raises:
        ExportError: The file is missing, damaged, or holds something else.
    """
    try:
        state = torch.load(checkpoint, map_location="cpu", weights_only=True)
        network = FeatureNetwork(NetworkConfig(**state["config"]["network"]))
        prefix = "module."
        average = {
            k.removeprefix(prefix): v for k, v in state["average"].items() if k.startswith(prefix)
        }
        network.load_state_dict(average)
    except FileNotFoundError as error:
        raise ExportError(
            f"no checkpoint at {checkpoint}; train one with `python training/train.py`"
        ) from error
    except Exception as error:  # torch.load raises whatever a damaged file makes it stumble over
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise ExportError(f"{checkpoint} is not a whole vwnav checkpoint ({reason})") from error
    if not all(torch.isfinite(p).all() for p in network.state_dict().values()):
        raise ExportError(
            f"{checkpoint} holds weights that are not finite; the training has diverged"
        )
    return network.eval()


def feature_set_id(network: FeatureNetwork) -> str:
    """Name the features by their weights; a map pack made by others is refused by this name."""
    digest = hashlib.sha256()
    for name, value in sorted(network.state_dict().items()):
        digest.update(name.encode())
        digest.update(value.to(torch.float32).contiguous().numpy().tobytes())
    return f"vwnav-learned-{network.config.name}-{digest.hexdigest()[:8]}"


def fold_batch_norm(module: nn.Module) -> None:
    """Merge every batch norm into the convolution before it, in place."""
    for name, child in module.named_children():
        norms = [i for i, layer in enumerate(child.children()) if isinstance(layer, nn.BatchNorm2d)]
        if not norms:
            fold_batch_norm(child)
            continue
        [i] = norms  # one a block
        layers = list(child.children())
        layers[i - 1 : i + 1] = [fuse_conv_bn_eval(layers[i - 1], layers[i])]
        setattr(module, name, nn.Sequential(*layers))


def to_onnx(network: FeatureNetwork) -> onnx.ModelProto:
    """Trace the whole extraction into one graph for images of any multiple of 32 pixels."""
    identity = feature_set_id(network)
    folded = FeatureNetwork(network.config).eval()
    folded.load_state_dict(network.state_dict())
    fold_batch_norm(folded)
    height, width = (
        SIZE_MULTIPLE_PX * torch.export.Dim(name, min=1, max=512) for name in ("rows", "columns")
    )
    program = torch.onnx.export(
        Extractor(folded).eval(),
        (torch.from_numpy(parity.drawn_images(1)[0])[None, None], torch.tensor([300])),
        input_names=["image", "max_keypoints"],
        output_names=["keypoints", "scores", "descriptors"],
        dynamic_shapes={"image": {2: height, 3: width}, "max_keypoints": None},
        opset_version=OPSET,
        dynamo=True,
        verbose=False,
    )
    assert program is not None
    model = program.model_proto
    metadata = {
        "feature_set_id": identity,
        "model_name": f"vwnav_{network.config.name}",
        "descriptor_dim": str(network.config.descriptor_dim),
        "vwnav_version": vwnav.__version__,
    }
    del model.metadata_props[:]
    for key, value in metadata.items():
        model.metadata_props.add(key=key, value=value)
    for node in model.graph.node:
        # The exporter notes its sources, with the paths of this machine: they have no place in a
        # release.
        del node.metadata_props[:]
        node.doc_string = ""
    onnx.checker.check_model(model)
    return model


def check(model: onnx.ModelProto, network: FeatureNetwork) -> None:
    """Compare graph and network on drawn images of five sizes and several budgets.

    Raises:
        ExportError: They differ.
    """
    session = parity.open_session(model.SerializeToString())
    extractor = Extractor(network)
    for index, image in enumerate(parity.drawn_images(10)):
        result = parity.compare(
            session, extractor, image, max_keypoints=(1, 100, 1000, 5000)[index % 4]
        )
        if not result.ok:
            raise ExportError(
                f"the exported graph differs from PyTorch on drawn picture {index}: {result}"
            )


def export(checkpoint: Path, output: Path) -> str:
    """Export, check and write; returns the feature set id.

    Raises:
        ExportError: Nothing was written.
        OSError: It cannot be.
    """
    network = load_network(checkpoint)
    model = to_onnx(network)
    check(model, network)
    write_whole(output, model.SerializeToString())
    return feature_set_id(network)


def slim_checkpoint(checkpoint: Path, output: Path) -> None:
    """Keep of a checkpoint what `train.py --init` needs: the averaged weights, and their recipe."""
    whole = torch.load(checkpoint, map_location="cpu", weights_only=True)
    state = {name: whole[name] for name in ("config", "step", "average") if name in whole}
    state["config"] |= {"data": "", "init": ""}
    buffer = io.BytesIO()
    torch.save(state, buffer)
    write_whole(output, buffer.getvalue())


def check_outputs(source: Path, *outputs: Path | None) -> None:
    """Say at once, not after minutes of work, that a file cannot be written.

    Args:
        source: what is read, and not to be written over.
        outputs: models as `.onnx`, weights as `.ckpt` or `.pt`.

    Raises:
        ExportError: it is of another kind, a folder or in none, in one that may not be written, or
            it is the source.
    """
    for output in filter(None, outputs):
        if output.is_dir() or not output.parent.is_dir():
            raise ExportError(f"{output} is a folder, or its own is not there")
        if output.suffix not in (".onnx", ".ckpt", ".pt"):
            raise ExportError(f"{output}: a model is written as .onnx, weights as .ckpt")
        if not os.access(output.parent, os.W_OK):
            raise ExportError(f"{output}: its folder may not be written")
        if output.exists() and source.exists() and output.samefile(source):
            raise ExportError(f"{output} is what is read: it would be lost; give another file")


def main(arguments: list[str] | None = None) -> int:
    """Run the command; 0 done, 1 refused with one line on stderr."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True, help="the .onnx file")
    parser.add_argument(
        "--checkpoint",
        dest="release",
        type=Path,
        help="also leave the weights for `train.py --init` here",
    )
    given = parser.parse_args(arguments)
    try:
        check_outputs(given.checkpoint, given.output, given.release)
        identity = export(given.checkpoint, given.output)
        if given.release:
            slim_checkpoint(given.checkpoint, given.release)
    except (ExportError, OSError) as error:
        print(f"export: {error}", file=sys.stderr)
        return 1
    print(f"wrote {given.output}: {identity}, {given.output.stat().st_size / 1e6:.2f} MB")
    return 0


if __name__ == "__main__":
    with one_line():
        sys.exit(main())
