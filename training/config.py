"""Every choice of a training run, the presets, and the command line."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch

from models.network import NETWORK_SIZES, NetworkConfig
from training.photometric import PhotometricConfig
from training.sampling import SampleConfig
from training.warps import WarpConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainConfig:
    """Written to config.json and into each checkpoint."""

    out: str = "runs/default"
    data: str = ""  # empty: VWNAV_DATA, else ../shared/data
    sites: str = "runs/site_pairs"  # generated pairs, mixed in where there are any
    seed: int = 1
    network: NetworkConfig = field(default_factory=NetworkConfig)
    samples: SampleConfig = field(default_factory=SampleConfig)
    # length: whichever is given ends the run and shapes the learning rate
    minutes: float = 80.0  # of the iterations' own time: a stopped process does not age
    max_steps: int = 0  # 0: by time only
    # optimisation
    batch_pairs: int = 8
    learning_rate: float = 1e-3
    warm_up: float = 0.01  # share of the run
    weight_decay: float = 1e-3
    clip_norm: float = 2.0
    average_decay: float = 0.999  # exported is a running mean of about the last 1000 steps
    # losses
    temperature: float = 0.07
    keypoint_weight: float = 0.5
    reliability_weight: float = 0.5
    agreement_start: float = 0.2  # share of the run; from then on keypoints also teach themselves
    agreement_share: float = 0.5  # of the batches from then on; the others stay with the corners
    # machine
    threads: int = 2
    loader_processes: int = 2
    bfloat16: bool = True  # convolutions only; twice as fast where processor or GPU has it
    # talk
    log_every_steps: int = 50
    validate_every_minutes: float = 5.0
    save_every_minutes: float = 2.0
    validation_pairs: int = 40


PRESETS = {
    "default": TrainConfig(),
    "nano": TrainConfig(out="runs/nano", network=NETWORK_SIZES["nano"], minutes=60.0),
    # Two minutes: shows that everything works, and that matching beats the untrained network.
    "smoke": TrainConfig(
        out="runs/smoke",
        network=NETWORK_SIZES["nano"],
        minutes=2.0,
        batch_pairs=4,
        average_decay=0.95,
        log_every_steps=20,
        validate_every_minutes=1.0,
        save_every_minutes=1.0,
        validation_pairs=12,
    ),
}


def config_from_saved(saved: dict[str, Any]) -> TrainConfig:
    """Rebuild the configuration that a checkpoint was made with."""
    samples = dict(saved["samples"])
    samples["warp"] = WarpConfig(**samples["warp"])
    samples["photo"] = PhotometricConfig(**samples["photo"])
    network = NetworkConfig(**saved["network"])
    return TrainConfig(**(saved | {"network": network, "samples": SampleConfig(**samples)}))


def load_checkpoint(path: str | Path, device: torch.device | str = "cpu") -> dict[str, Any]:
    """Read a checkpoint; tensors and plain values only, so a foreign file cannot run code."""
    state: dict[str, Any] = torch.load(path, map_location=device, weights_only=True)
    return state


def parse(description: str, arguments: Sequence[str] | None = None) -> tuple[TrainConfig, str]:
    """Command line -> configuration, and the checkpoint to resume from ("" for a new run)."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--preset", choices=list(PRESETS), default="default", help="size and length of the run")
    add("--resume", default="", metavar="CHECKPOINT", help="go on from this checkpoint")
    add("--minutes", type=float, help="length of the run; the learning rate is cooled to fit")
    add("--max-steps", type=int, help="length of the run in steps")
    add("--seed", type=int, help="of weights and of samples")
    add("--data", help="folder that holds train/ and pairs.json")
    add("--out", help="folder of the run, from the repository root")
    given = {k: v for k, v in vars(parser.parse_args(arguments)).items() if v is not None}
    preset, resume = given.pop("preset"), given.pop("resume")
    config = PRESETS[preset]
    if resume:
        config = config_from_saved(load_checkpoint(resume)["config"])
    return replace(config, **given), resume
