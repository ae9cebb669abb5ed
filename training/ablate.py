"""What each choice is worth: short equal trainings of the nano size, one choice changed in each.

python training/ablate.py [--steps 1500] [--only NAME ...] [--out runs/ablations]

Every row starts from random weights and sees the same images. The kept-aside pairs of two dates
are matched as they are, 60 views, 500 keypoints. A row that is there already is not run again; the
table is rewritten after each. Where rows differ by less than two base runs of different seeds,
the difference is chance.
"""

import argparse
import csv
import functools
import io
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import torch
from torch import Tensor, nn

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # to run it as a script

from models.network import DenseFeatures, FeatureNetwork, NetworkConfig, conv, normalise_contrast
from training import train, validate
from training.complaint import one_line
from training.config import PRESETS, changed
from training.data import OPEN_SOURCES, ROOT, Scene, data_folder, load_scenes
from training.journal import SCORES
from training.photometric import PhotometricConfig
from training.sampling import Sample, SampleConfig
from training.warps import WarpConfig
from training.whole import write_whole

VIEWS = 60
HEADER = ["choice", "parameters", *SCORES]
AS_THEY_ARE = PhotometricConfig(**dict.fromkeys(PhotometricConfig.__dataclass_fields__, 0.0))


class ConvolutionStem(FeatureNetwork):
    """Reaches the 1/4 level by strided convolutions from full resolution, as XFeat does."""

    def __init__(self, config: NetworkConfig) -> None:
        """Replace the first level."""
        super().__init__(config)
        c1 = config.stem_channels
        self.level4 = nn.Sequential(
            conv(1, 4), conv(4, 8, stride=2), conv(8, 8), conv(8, c1, stride=2), conv(c1, c1)
        )

    def see(self, image: Tensor) -> Tensor:
        """Normalise at full resolution."""
        return self.level4(nn.functional.pixel_shuffle(normalise_contrast(image), 4))


class FineOnly(FeatureNetwork):
    """Descriptors from the 1/8 level alone, without what is around."""

    def fuse(self, x8: Tensor) -> Tensor:
        """Leave out the coarser levels."""
        return self.fuse8(x8)


class PeaksWithoutContext(FeatureNetwork):
    """The keypoint head reads the 1/4 level alone."""

    def join_levels(self, x4: Tensor, x8: Tensor) -> Tensor:
        """Hide the 1/8 level."""
        return super().join_levels(x4, torch.zeros_like(x8))


class ScoresEqual(FeatureNetwork):
    """The score is the height of the peak: no head says what will be matched."""

    def forward(self, image: Tensor) -> DenseFeatures:
        """Put the peak's height in the place of the score."""
        dense = super().forward(image)
        height = dense.peak_logits.amax(dim=1, keepdim=True)
        return dense._replace(score_logits=height + 0.0 * dense.score_logits)


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One training."""

    changes: dict[str, str] = field(default_factory=dict)
    build: Callable[[NetworkConfig], FeatureNetwork] = FeatureNetwork
    sources: frozenset[str] | None = None  # only these, besides generated pairs


ROWS = {
    "base": Row(),
    "base, other seed": Row(changes={"seed": "2"}),
    "stem of strided convolutions": Row(build=ConvolutionStem),
    "half the width": Row(changes={"network.channels": "24", "network.stem_channels": "8"}),
    "twice the width": Row(changes={"network.channels": "96", "network.stem_channels": "32"}),
    "descriptors of 32": Row(changes={"network.descriptor_dim": "32"}),
    "descriptors of 128": Row(changes={"network.descriptor_dim": "128"}),
    "1/8 level alone": Row(build=FineOnly),
    "peaks without the 1/8 level": Row(build=PeaksWithoutContext),
    "labels as they are given": Row(changes={"registered": "runs/none"}),
    "crops of 320 px, 2 pairs": Row(changes={"samples.size_px": "320", "batch_pairs": "2"}),
    "no reprojection loss": Row(changes={"reprojection_weight": "0"}),
    "score = height of the peak": Row(build=ScoresEqual, changes={"score_weight": "0"}),
    "corners only, no agreement": Row(
        changes={"agreement_weight": "0", "corner_weight": "1", "corners_until": "1e9"}
    ),
    "labels never doubted": Row(changes={"doubt_from": "1e9"}),
    "no real pairs": Row(changes={"samples.shares.pair": "0", "samples.shares.overlap": "0"}),
    "no generated pairs": Row(changes={"samples.shares.site": "0"}),
    "open data only": Row(sources=frozenset(OPEN_SOURCES)),
}


@functools.cache
def scenes_with(registered: str) -> tuple[list[Scene], list[Scene]]:
    """Read the images once, with the labels of one folder of registrations."""
    return load_scenes(data_folder(), ROOT / PRESETS["nano"].sites, ROOT / registered)


def run(name: str, steps: int, out: Path) -> list[str]:
    """Train one row and return its line of the table."""
    row = ROWS[name]
    config = replace(
        PRESETS["nano"],
        out=str(out / name.replace(" ", "_").replace("/", "_")),
        samples=SampleConfig(size_px=224),  # half of the pixels, twice the steps
        minutes=0.0,
        max_steps=steps,
        threads=1,
        loader_processes=1,
        validate_every_minutes=1e9,
    )
    for path, value in row.changes.items():
        config = changed(config, path.split("."), value)
    training, _ = scenes_with(config.registered)
    _, kept = scenes_with(PRESETS["nano"].registered)  # every row is judged by the same truth
    if row.sources is not None:
        training = [s for s in training if s.source in row.sources or s.group == "site"]
    shares = config.samples.shares
    training = [s for s in training if shares[s.group] > 0]
    checkpoint = train.main(config, scenes=(training, kept), build=row.build)
    network = row.build(config.network)
    train.start_from(network, str(checkpoint))
    score = validate.score_matches(validate.learned(network), judged_views(kept))
    parameters = sum(p.numel() for p in network.parameters())
    return [name, str(parameters), *(f"{value:.3f}" for value in asdict(score).values())]


def judged_views(kept: list[Scene]) -> list[Sample]:
    """Views of the kept-aside pairs as they are, turned and scaled as rectification leaves them.

    The same for every row, whatever it draws for training.
    """
    warp = WarpConfig(rotation_sigma_deg=6.0, wide_rotation_share=0.0, scale_sigma=0.08)
    samples = SampleConfig(zoom_min=1.0, zoom_max=1.0, warp=warp, photo=AS_THEY_ARE)
    return validate.calm_views(kept, samples, VIEWS)


def rows_done(table: Path) -> dict[str, list[str]]:
    """The lines of a table that is there, by their row's name.

    Raises:
        SystemExit: it is no such table; one line says so.
    """
    if not table.exists():
        return {}
    try:
        header, *lines = [line for line in csv.reader(table.read_text().splitlines()) if line]
    except (ValueError, csv.Error):
        header, lines = [], []
    if header != HEADER:
        raise SystemExit(f"{table} is no table of ablations: move it away, or give another --out")
    return {line[0]: line for line in lines}


@one_line()
def main(arguments: list[str] | None = None) -> None:
    """Run the rows that are missing and print the table.

    Raises:
        SystemExit: it cannot be done, or was interrupted; one line says why.
    """
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--only", nargs="*", choices=list(ROWS), default=list(ROWS), metavar="NAME")
    parser.add_argument("--out", type=Path, default=ROOT / "runs/ablations")
    given = parser.parse_args(arguments)
    table = given.out / "table.csv"
    done = rows_done(table)
    given.out.mkdir(parents=True, exist_ok=True)
    for name in given.only:
        if name in done:
            continue
        done[name] = run(name, given.steps, given.out)
        text = io.StringIO()
        csv.writer(text).writerows([HEADER, *done.values()])
        write_whole(table, text.getvalue().encode())
    print(table.read_text())


if __name__ == "__main__":
    main()
