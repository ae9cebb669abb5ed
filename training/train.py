"""Train the feature network. One linear script; read it from top to bottom.

Two minutes, to see that everything works:
    python training/train.py --preset smoke
The released model (on two CPU cores, or a GPU if there is one):
    python training/train.py --preset default --minutes 180
Go on after an interruption, with the same images, optimizer and learning rate:
    python training/train.py --resume runs/default/last.pt
On several GPUs or machines, or here on two processor cores, sharing each batch:
    torchrun --nproc-per-node 2 training/train.py --preset nano

Images come from --data, else VWNAV_DATA, else ../shared/data (only its train/), and from
generated pairs in runs/site_pairs. A run leaves config.json, log.csv, TensorBoard events, last.pt.
"""

import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import cv2
import torch
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.data import DataLoader

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # to run it as a script

from models.network import FeatureNetwork, NetworkConfig
from training import validate
from training.complaint import one_line
from training.config import TrainConfig, check, load_checkpoint, parse
from training.data import ROOT, Scene, data_folder, load_scenes
from training.journal import Every, Journal, StopWatch, progress_of, save_checkpoint
from training.objective import compute_losses
from training.photometric import batch_augmentation
from training.sampling import ViewPairs
from training.team import Team


def learning_rate(progress: float, config: TrainConfig) -> float:
    """Linear warm-up, then a cosine to a hundredth; `progress` is 0 to 1, so a run ends cooled."""
    if progress < config.warm_up:
        return config.learning_rate * (progress + 1e-3) / (config.warm_up + 1e-3)
    return config.learning_rate * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))


def start_from(network: FeatureNetwork, checkpoint: str) -> None:
    """Take over the weights of another run wherever name and shape fit."""
    average = load_checkpoint(checkpoint)["average"]
    own = network.state_dict()
    fitting = {
        name: value
        for name, value in own.items()
        if (given := average.get(f"module.{name}")) is not None and given.shape == value.shape
    }
    network.load_state_dict(own | {name: average[f"module.{name}"] for name in fitting})
    print(f"{len(fitting)} of {len(own)} tensors from {checkpoint}")


def read_network(checkpoint: str, device: torch.device) -> FeatureNetwork:
    """Build the network of a checkpoint, with its averaged weights, to be asked and not trained."""
    network = FeatureNetwork(NetworkConfig(**load_checkpoint(checkpoint)["config"]["network"]))
    start_from(network, checkpoint)
    return network.to(device, memory_format=torch.channels_last).eval().requires_grad_(False)


def main(
    config: TrainConfig,
    resume: str = "",
    scenes: tuple[list[Scene], list[Scene]] | None = None,
    build: Callable[[NetworkConfig], FeatureNetwork] = FeatureNetwork,
) -> Path:
    """Train, and return the path of the last checkpoint.

    Args:
        config: Every choice; on resume that of the checkpoint, with the caller's changes.
        resume: Checkpoint to go on from.
        scenes: To train and to validate on; read from the folders when not given.
        build: Makes the network; ablations build variants.

    Raises:
        SystemExit: a choice, a checkpoint or the images will not do; one line says so.
        OSError: the run cannot be kept.
    """
    check(config)
    torch.set_num_threads(config.threads)
    cv2.setNumThreads(1)  # the loader's processes are the parallelism
    team = Team.join(config.batch_pairs)
    torch.manual_seed(config.seed + team.rank)
    device = team.device
    out = ROOT / config.out

    # network, optimizer, and where we are
    network = build(config.network).to(device, memory_format=torch.channels_last)
    if config.init and not resume:
        start_from(network, config.init)
    teacher = read_network(config.distil_from, device) if config.distil_from else None
    average_fn = get_ema_multi_avg_fn(config.average_decay)
    average = AveragedModel(network, multi_avg_fn=average_fn, use_buffers=True)
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=config.weight_decay)
    step, watch = 0, StopWatch(0.0)
    if resume:
        state = load_checkpoint(resume, device)
        if "optimizer" not in state:
            raise SystemExit(f"{resume} holds weights alone: start a new run with --init")
        try:
            network.load_state_dict(state["network"])
        except RuntimeError as error:
            raise SystemExit(f"{resume} holds a network of other widths than are asked") from error
        average.load_state_dict(state["average"])
        optimizer.load_state_dict(state["optimizer"])
        if team.rank == 0:
            torch.set_rng_state(state["rng"].cpu())
        step, watch = state["step"], StopWatch(state["elapsed_s"])

    # images, and what SIFT makes of the kept-aside ones
    started = time.monotonic()
    with one_line():
        training, kept = scenes or load_scenes(
            data_folder(config.data),
            ROOT / config.sites,
            ROOT / config.registered,
            config.terms,
        )
        if not training:
            raise SystemExit("no training pictures: give --data, or make pairs (docs/training.md)")
        out.mkdir(parents=True, exist_ok=True)
        (out / "config.json").write_text(json.dumps(asdict(config), indent=2))
    groups = {g: sum(s.group == g for s in training) for g in config.samples.shares}
    took_s = time.monotonic() - started
    team.say(f"{len(training)} scenes {groups}, {len(kept)} kept aside, read in {took_s:.0f} s")
    views = validate.calm_views(kept or training, config.samples, config.validation_pairs)
    sift = validate.score_matches(validate.upright_sift, views)
    team.say(f"upright SIFT on the kept-aside views: {sift}")

    # the loop's parts
    shared = team.share(network)
    augment = batch_augmentation().to(device)
    size = sum(p.numel() for p in network.parameters())
    workers = f"{team.size} process{'es' if team.size > 1 else ''} on {device.type}"
    team.say(f"{config.network.name}, {size} parameters, {workers}, from step {step}")

    # Samples are numbered, and go on where the checkpoint stopped: none is seen twice or left out.
    loader = DataLoader(
        ViewPairs(training, config.samples, config.seed),
        config.batch_pairs // team.size,
        sampler=team.samples(step, config.batch_pairs),
        num_workers=config.loader_processes,
        prefetch_factor=6 if config.loader_processes else None,
        pin_memory=device.type == "cuda",
        worker_init_fn=lambda _: cv2.setNumThreads(1),
        generator=torch.Generator(),  # of its own: a resumed run must find the global one as it was
    )
    journal = Journal(out, step) if team.rank == 0 else None  # the first process writes for all
    time_to_save = Every(config.save_every_minutes, watch)
    time_to_validate = Every(config.validate_every_minutes, watch)

    def checkpoint() -> None:
        save_checkpoint(
            out / "last.pt",
            config=asdict(config),
            step=step,
            elapsed_s=watch.elapsed_s,
            network=network.state_dict(),
            average=average.state_dict(),
            optimizer=optimizer.state_dict(),
            rng=torch.get_rng_state(),
        )

    def report(journal: Journal) -> None:
        score = validate.score_matches(validate.learned(average.module), views)
        journal.validated(step, watch, score, sift)

    # the loop
    for batch in loader:
        watch.loaded()
        progress = team.agree(progress_of(step, watch.elapsed_s, config))
        if progress >= 1.0:
            break
        rate = learning_rate(progress, config)
        for group in optimizer.param_groups:
            group["lr"] = rate

        batch = {name: value.to(device, non_blocking=True) for name, value in batch.items()}
        for k in (0, 1):
            batch[f"image{k}"] = 255.0 * augment(batch[f"image{k}"].float() / 255.0)
        network.train()
        figures = compute_losses(shared, batch, config, progress, teacher)
        optimizer.zero_grad(set_to_none=True)
        figures["total"].backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), config.clip_norm)
        optimizer.step()
        average.update_parameters(network)
        step += 1
        watch.lap()

        if journal is None:
            continue
        journal.add(figures)
        if step % config.log_every_steps == 0:
            journal.tell(step, progress, rate, watch)
        if time_to_validate.due():
            report(journal)
            watch.skip()
        if time_to_save.due():
            checkpoint()

    team.leave()
    if journal is not None:
        images = [view[f"image{k}"][0].numpy() for view in views for k in (0, 1)]
        bias = average.module.peak_bias + torch.from_numpy(
            validate.peak_bias(average.module, images)
        ).to(average.module.peak_bias)
        average.module.peak_bias.copy_(bias)
        report(journal)
        journal.close()
        checkpoint()
    return out / "last.pt"


@one_line()
def run(arguments: Sequence[str] | None = None) -> Path:
    """Read the command line, and train; a run that is there is gone on with, not written over.

    Raises:
        SystemExit: it cannot be done, or was interrupted; one line says why.
    """
    config, resume = parse(__doc__ or "", arguments)
    last = ROOT / config.out / "last.pt"
    if last.exists() and not resume:
        raise SystemExit(f"{last} is there already: go on with --resume {last}, or give --out")
    return main(config, resume)


if __name__ == "__main__":
    run()
