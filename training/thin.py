"""Make the 3 x 3 convolutions of trained weights thin, to go on training with half of the work.

python training/thin.py models/vwnav_default.ckpt --size default -o runs/thin/default.ckpt
python training/train.py --preset default --init runs/thin/default.ckpt

A convolution's responses to real images need fewer directions than it has channels. The strongest
directions are kept: the convolution computes those, and a 1 x 1 convolution leads back (Zhang et
al. 2015, "Accelerating very deep convolutional networks", eq. 7). What is lost at first, some
minutes of training bring back. Layers of another shape than before start anew.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor, nn

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # to run it as a script

from models.network import (
    NETWORK_SIZES,
    SIZE_MULTIPLE_PX,
    FeatureNetwork,
    NetworkConfig,
)
from training.complaint import one_line
from training.config import load_checkpoint
from training.data import IMAGE_SUFFIXES, data_folder
from training.journal import save_checkpoint
from training.train import start_from

IMAGES = 60
SIDE_PX = 320
THIN = 4  # layers of a thin block: two convolutions, batch norm, ReLU


class Responses:
    """Mean and covariance of what a convolution says, over images and places."""

    def __init__(self, channels: int) -> None:
        """Start with nothing seen."""
        self._count, self._sum = 0, torch.zeros(channels, dtype=torch.float64)
        self._squares = torch.zeros(channels, channels, dtype=torch.float64)

    def add(self, _module: nn.Module, _inputs: tuple[Tensor, ...], output: Tensor) -> None:
        """Take the responses (B, C, h, w) in; the signature of a forward hook."""
        each = output.detach().transpose(0, 1).flatten(1).double()
        self._count += each.shape[1]
        self._sum += each.sum(dim=1)
        self._squares += each @ each.T

    @property
    def mean(self) -> Tensor:
        """(C,)."""
        return self._sum / self._count

    def directions(self, rank: int) -> tuple[Tensor, float]:
        """The strongest directions (C, rank), orthonormal, and their share of the variance."""
        mean = self.mean
        covariance = self._squares / self._count - torch.outer(mean, mean)
        variances, directions = torch.linalg.eigh(covariance)  # ascending
        return directions[:, -rank:], float(variances[-rank:].sum() / variances.sum())


def thin_blocks(network: FeatureNetwork) -> Iterator[tuple[str, nn.Sequential]]:
    """Blocks of the thin network whose convolution is two."""
    for name, module in network.named_modules():
        is_block = isinstance(module, nn.Sequential) and len(module) == THIN
        if is_block and isinstance(module[2], nn.BatchNorm2d):
            yield name, module


def thinned(whole: FeatureNetwork, config: NetworkConfig, images: list[Tensor]) -> FeatureNetwork:
    """The network of a configuration with ranks, as near as it can be to a whole one.

    Args:
        whole: trained, of the same widths.
        config: of the thin network.
        images: (1, 1, H, W) grey levels, to see responses on.
    """
    thin = FeatureNetwork(config)
    fitting = {
        name: value
        for name, value in whole.state_dict().items()
        if name in thin.state_dict() and thin.state_dict()[name].shape == value.shape
    }
    thin.load_state_dict(thin.state_dict() | fitting)
    seen = {name: Responses(block[1].out_channels) for name, block in thin_blocks(thin)}
    hooks = [
        whole.get_submodule(f"{name}.0").register_forward_hook(r.add) for name, r in seen.items()
    ]
    whole.eval()
    with torch.inference_mode():
        for image in images:
            whole(image)
    for hook in hooks:
        hook.remove()
    for name, block in thin_blocks(thin):
        kept = replace_block(block, whole.get_submodule(name), seen[name])
        print(f"{name}: rank {block[0].out_channels} keeps {100 * kept:.1f} % of the variance")
    return thin


@torch.no_grad()
def replace_block(block: nn.Sequential, whole: nn.Sequential, seen: Responses) -> float:
    """Set a thin block from a whole one; returns the share of the responses' variance it keeps."""
    first, second, norm = block[0], block[1], block[2]
    directions, kept = seen.directions(first.out_channels)
    weight = whole[0].weight.double()
    first.weight.copy_(torch.einsum("or,oikl->rikl", directions, weight))
    second.weight.copy_(directions[:, :, None, None])
    norm.load_state_dict(whole[1].state_dict())
    # What the dropped directions say on average is a constant: the running mean takes it.
    dropped = seen.mean - directions @ (directions.T @ seen.mean)
    norm.running_mean -= dropped
    return kept


def training_images(folder: Path) -> list[Tensor]:
    """Images of the training set, evenly over its single and drone images."""
    paths = sorted(p for kind in ("single", "drone") for p in (folder / "train" / kind).glob("*/*"))
    paths = [p for p in paths if p.suffix.lower() in IMAGE_SUFFIXES]
    chosen = [paths[i] for i in np.linspace(0, len(paths) - 1, IMAGES).astype(int) if paths]
    read = (cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in chosen)
    images = [image[:SIDE_PX, :SIDE_PX] for image in read if image is not None]
    whole = [p[: p.shape[0] // SIZE_MULTIPLE_PX * SIZE_MULTIPLE_PX] for p in images]
    whole = [p[:, : p.shape[1] // SIZE_MULTIPLE_PX * SIZE_MULTIPLE_PX] for p in whole]
    return [torch.from_numpy(p.astype(np.float32))[None, None] for p in whole if p.size]


@one_line()
def main(arguments: list[str] | None = None) -> None:
    """Read weights, make them thin, write weights to start from.

    Raises:
        SystemExit: no data, no weights, those of another size; one line says so.
    """
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("weights", type=Path, help="checkpoint of whole convolutions")
    parser.add_argument("--size", choices=list(NETWORK_SIZES), default="default")
    parser.add_argument("--data", default="", help="folder that holds train/")
    parser.add_argument("-o", "--out", type=Path, required=True)
    given = parser.parse_args(arguments)
    folder = data_folder(given.data)
    if folder is None:
        raise SystemExit("no data folder: give --data, or set VWNAV_DATA")
    if given.out.exists() and given.out.samefile(given.weights):
        raise SystemExit(f"{given.out} is what is read: it would be lost; give another file")
    saved = load_checkpoint(given.weights)
    whole = FeatureNetwork(NetworkConfig(**saved["config"]["network"]))
    start_from(whole, str(given.weights))
    config = NETWORK_SIZES[given.size]
    if whole.config != replace(config, name=whole.config.name, stem_rank=0, rank=0, coarse_rank=0):
        raise SystemExit(f"{given.weights}: no whole convolutions of the size {given.size}")
    images = training_images(folder)
    if not images:
        raise SystemExit(f"no readable pictures in {folder / 'train'}")
    thin = thinned(whole, config, images)
    fields = {name: getattr(config, name) for name in config.__dataclass_fields__}
    given.out.parent.mkdir(parents=True, exist_ok=True)
    save_checkpoint(
        given.out,
        config=saved["config"] | {"network": fields},
        average={f"module.{name}": value for name, value in thin.state_dict().items()},
    )


if __name__ == "__main__":
    main()
