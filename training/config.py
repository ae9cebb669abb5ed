"""Every choice of a training run, the presets, and the command line."""

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch

from models.network import NETWORK_SIZES, SIZE_MULTIPLE_PX, NetworkConfig
from training.data import Terms
from training.photometric import PhotometricConfig
from training.sampling import SampleConfig
from training.warps import WarpConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainConfig:
    """Written to config.json and into each checkpoint."""

    out: str = "runs/default"
    data: str = ""  # empty: VWNAV_DATA, else ../shared/data
    sites: str = "runs/site_pairs"  # generated pairs, mixed in where there are any
    registered: str = "runs/registered"  # real pairs' labels made exact by training/register.py
    terms: Terms = "all"  # "open": only images that anybody may use for anything
    init: str = ""  # checkpoint whose weights a new run starts from, where they fit
    seed: int = 1
    network: NetworkConfig = field(default_factory=lambda: NETWORK_SIZES["default"])
    samples: SampleConfig = field(default_factory=SampleConfig)
    # length: whichever is given ends the run and shapes the learning rate
    minutes: float = 80.0  # of the iterations' own time: a stopped process does not age
    max_steps: int = 0  # 0: by time only
    # optimisation
    batch_pairs: int = 4
    learning_rate: float = 1e-3
    warm_up: float = 0.01  # share of the run
    weight_decay: float = 1e-3
    clip_norm: float = 2.0
    average_decay: float = 0.999  # exported is a running mean of about the last 1000 steps
    # losses
    temperature: float = 0.07
    doubt_from: float = 0.3  # share of the run after which a network may doubt labels fully
    matches: int = 288  # points per pair whose descriptors are compared
    rivals: float = 0.5  # share of the other view's cells, drawn anew each time, that compete
    windows: int = 48  # per pair in which peaks are compared
    near_px: float = 6.0  # descriptors so near to each other need not differ
    sharpness_px: float = 0.6  # how exactly the peaks of two views shall agree
    sharp_from: float = 0.3  # share of the run; before, two pixels less exactly at first
    label_error_px: float = 3.0  # more, times a pair's label noise
    same_px: float = 2.5  # keypoints of two views that are nearer mean the same place
    right_px: float = 2.0  # a match nearer to the truth is right
    agreement_weight: float = 1.0
    repeat_weight: float = 2.0
    reach_px: float = 1.0  # a keypoint this near to another counts 0.6 as its repetition
    corner_weight: float = 0.3  # of Shi-Tomasi corners as peaks, at the start
    corners_until: float = 0.25  # share of the run over which they cease to count
    reprojection_weight: float = 0.2
    distil_from: str = ""  # checkpoint of a larger network, whose descriptors are imitated
    distil_weight: float = 2.0
    score_weight: float = 0.5
    # machine
    threads: int = 2
    loader_processes: int = 2
    bfloat16: bool = True  # convolutions only, and where processor or GPU has it: twice as fast
    # talk
    log_every_steps: int = 50
    validate_every_minutes: float = 5.0
    save_every_minutes: float = 2.0
    validation_pairs: int = 40


# Of the numbers that end a run, or break it off, where they are smaller.
LEAST = {
    "seed": 0,
    "minutes": 0,
    "max_steps": 0,
    "batch_pairs": 1,
    "samples.size_px": SIZE_MULTIPLE_PX,
    "matches": 1,
    "windows": 1,
    "threads": 1,
    "loader_processes": 0,
    "log_every_steps": 1,
    "validation_pairs": 1,
}

PRESETS = {
    "default": TrainConfig(),
    "nano": TrainConfig(out="runs/nano", network=NETWORK_SIZES["nano"], minutes=60.0),
    # For a camera whose heading and height are hardly known.
    "wide": TrainConfig(
        out="runs/wide",
        samples=SampleConfig(
            warp=WarpConfig(
                rotation_sigma_deg=20.0,
                wide_rotation_share=0.3,
                wide_rotation_deg=45.0,
                scale_sigma=0.3,
                scale_min=0.5,
                scale_max=2.0,
            )
        ),
    ),
    # Two minutes: shows that everything works, and that matching beats the untrained network.
    "smoke": TrainConfig(
        out="runs/smoke",
        network=NETWORK_SIZES["nano"],
        minutes=2.0,
        samples=SampleConfig(size_px=224),
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
    """Read a checkpoint; tensors and plain values only, so a foreign file cannot run code.

    Raises:
        SystemExit: there is none, or it is damaged; one line says so.
    """
    try:
        state: dict[str, Any] = torch.load(path, map_location=device, weights_only=True)
        if "network" not in state["config"] or not state["average"]:
            raise ValueError("it holds no network")
    except FileNotFoundError:
        raise SystemExit(f"no checkpoint at {path}: give the last.pt of a run") from None
    except Exception as error:  # torch raises whatever a damaged file makes it stumble over
        raise SystemExit(f"{path} is not a whole checkpoint: give the last.pt of a run") from error
    return state


def check(config: TrainConfig) -> None:
    """Refuse what no run can be made with, before minutes of reading images.

    Raises:
        SystemExit: a number is none or out of range, or the run would never end; one line says so.
    """
    for name, value in numbers_of(asdict(config)):
        least = LEAST.get(name, -math.inf)
        if not math.isfinite(value) or value < least:
            raise SystemExit(f"{name} = {value:g}: expected a number, {least:g} at least")
    if not config.minutes and not config.max_steps:
        raise SystemExit("the run would never end: give --minutes or --max-steps")
    if config.samples.size_px % SIZE_MULTIPLE_PX:
        raise SystemExit(
            f"samples.size_px = {config.samples.size_px}: expected a multiple of {SIZE_MULTIPLE_PX}"
        )


def numbers_of(choices: dict[str, Any], within: str = "") -> Iterator[tuple[str, float]]:
    """Every number of a configuration as plain values, by its name as `--set` takes it."""
    for name, value in choices.items():
        if isinstance(value, dict):
            yield from numbers_of(value, f"{within}{name}.")
        elif isinstance(value, int | float):
            yield f"{within}{name}", value


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
    add("--init", metavar="CHECKPOINT", help="start a new run from its weights")
    add("--seed", type=int, help="of weights and of samples")
    add("--data", help="folder that holds train/ and pairs.json")
    add("--terms", choices=["all", "open"], help="which pictures, by their licence")
    add("--out", help="folder of the run, from the repository root")
    add(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="any other choice, for example samples.matches=512",
    )
    given = {k: v for k, v in vars(parser.parse_args(arguments)).items() if v is not None}
    preset, resume, changes = given.pop("preset"), given.pop("resume"), given.pop("set")
    config = PRESETS[preset]
    if resume:
        saved = load_checkpoint(resume)["config"]
        try:
            config = config_from_saved(saved)
        except (KeyError, TypeError) as error:
            raise SystemExit(f"{resume}: not of this program's choices ({error})") from error
    try:
        for change in changes:
            name, _, value = change.partition("=")
            config = changed(config, name.split("."), value)
    except (AttributeError, KeyError, ValueError) as error:
        parser.error(f"--set {change}: {error}")
    return replace(config, **given), resume


def changed(config: Any, path: list[str], text: str) -> Any:
    """Copy a configuration with the value at `path` replaced by one read from `text`.

    Raises:
        AttributeError: there is no such choice.
        KeyError: there is no such share.
        ValueError: the text is not a value of its kind.
    """
    name, *deeper = path
    old = config[name] if isinstance(config, dict) else getattr(config, name)
    if deeper:
        new = changed(old, deeper, text)
    elif isinstance(old, str):
        new = text
    elif isinstance(old, bool):
        new = {"true": True, "false": False}[text.lower()]
    else:
        new = type(old)(text)
    return config | {name: new} if isinstance(config, dict) else replace(config, **{name: new})
