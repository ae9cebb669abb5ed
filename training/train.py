"""Train the feature network. One linear script; read it from top to bottom.

Two minutes, to see that everything works:
    python training/train.py --preset smoke
The released model (on two CPU cores, or a GPU if there is one):
    python training/train.py --preset default --minutes 80
Go on after an interruption, with the same pictures, optimizer and learning rate:
    python training/train.py --resume runs/default/last.pt

Pictures come from --data, else VWNAV_DATA, else ../shared/data (only its train/), and from
generated pairs in runs/site_pairs. A run leaves config.json, log.csv, TensorBoard events, last.pt.
"""

import json
import math
import sys
import time
from dataclasses import asdict
from pathlib import Path

import cv2
import torch
from torch import Tensor
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.data import DataLoader

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # to run it as a script

from models.network import FeatureNetwork, sample_descriptors
from training import losses, validate
from training.config import TrainConfig, load_checkpoint, parse
from training.data import ROOT, Scene, data_folder, load_scenes
from training.journal import Every, Journal, StopWatch, progress_of, save_checkpoint
from training.photometric import batch_augmentation
from training.sampling import ViewPairs


def learning_rate(progress: float, config: TrainConfig) -> float:
    """Linear warm-up, then a cosine to a hundredth; `progress` is 0 to 1, so a run ends cooled."""
    if progress < config.warm_up:
        return config.learning_rate * (progress + 1e-3) / (config.warm_up + 1e-3)
    return config.learning_rate * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))


def compute_losses(
    network: FeatureNetwork, batch: dict[str, Tensor], config: TrainConfig, progress: float
) -> dict[str, Tensor]:
    """Run both views through the network and compare.

    Returns:
        Every loss and figure by name; "total" is the one to descend.
    """
    pairs = len(batch["uv0"])
    images = torch.cat([batch["image0"], batch["image1"]]).to(memory_format=torch.channels_last)
    with torch.autocast(images.device.type, torch.bfloat16, enabled=config.bfloat16):
        dense = network(images)
    descriptors, logits, reliability = (x.float() for x in dense)

    # descriptors: each point must find its own partner among all points of the other view
    uv = torch.cat([batch["uv0"], batch["uv1"]])
    sampled = sample_descriptors(descriptors, uv)
    log_probability, mutual = losses.match_log_probability(
        sampled[:pairs], sampled[pairs:], batch["uv1"], config.temperature
    )
    matching = losses.matching_loss(log_probability, batch["robustness"])

    # keypoints: corners that both clean views have; later also what the network itself sees in both
    corners = (batch["corners0"], batch["corners1"], batch["present"])
    if progress >= config.agreement_start and torch.rand(()) < config.agreement_share:
        corners = losses.agreed_corners(
            logits[:pairs], logits[pairs:], batch["H_1_0"], batch["valid0"], batch["present"]
        )
    corners0, corners1, present = corners
    targets = losses.keypoint_targets(
        torch.cat([corners0, corners1]), present.repeat(2, 1), (logits.shape[2], logits.shape[3])
    )
    valid = torch.cat([batch["valid0"], batch["valid1"]])
    keypoint = losses.keypoint_loss(logits, targets, valid)

    # reliability: how well the descriptor at a place really matched
    success = (log_probability.exp() * mutual).repeat(2, 1)
    reliable = losses.reliability_loss(losses.sample_map(reliability, uv), success)
    return {
        "total": matching
        + config.keypoint_weight * keypoint
        + config.reliability_weight * reliable,
        "matching": matching,
        "keypoint": keypoint,
        "reliability": reliable,
        "matched": mutual.mean(),
    }


def main(
    config: TrainConfig, resume: str = "", scenes: tuple[list[Scene], list[Scene]] | None = None
) -> Path:
    """Train, and return the path of the last checkpoint.

    Args:
        config: Every choice; on resume that of the checkpoint, with the caller's changes.
        resume: Checkpoint to go on from.
        scenes: To train and to validate on; read from the folders when not given.
    """
    torch.manual_seed(config.seed)
    torch.set_num_threads(config.threads)
    cv2.setNumThreads(1)  # the loader's processes are the parallelism
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    out = ROOT / config.out
    out.mkdir(parents=True, exist_ok=True)
    (out / "config.json").write_text(json.dumps(asdict(config), indent=2))

    # pictures, and what SIFT makes of the kept-aside ones
    started = time.monotonic()
    training, kept = scenes or load_scenes(data_folder(config.data), ROOT / config.sites)
    if not training:
        raise SystemExit("no training pictures: give --data, or generate pairs (docs/training.md)")
    groups = {g: sum(s.group == g for s in training) for g in config.samples.shares}
    took_s = time.monotonic() - started
    print(f"{len(training)} scenes {groups}, {len(kept)} kept aside, read in {took_s:.0f} s")
    views = validate.calm_views(kept or training, config.samples, config.validation_pairs)
    sift = validate.score_matches(validate.root_sift, views)
    print(f"upright SIFT on the kept-aside views: {sift}")

    # network, optimizer, and where we are
    network = FeatureNetwork(config.network).to(device, memory_format=torch.channels_last)
    average_fn = get_ema_multi_avg_fn(config.average_decay)
    average = AveragedModel(network, multi_avg_fn=average_fn, use_buffers=True)
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=config.weight_decay)
    step, watch = 0, StopWatch(0.0)
    if resume:
        state = load_checkpoint(resume, device)
        network.load_state_dict(state["network"])
        average.load_state_dict(state["average"])
        optimizer.load_state_dict(state["optimizer"])
        torch.set_rng_state(state["rng"].cpu())
        step, watch = state["step"], StopWatch(state["elapsed_s"])
    augment = batch_augmentation().to(device)
    size = sum(p.numel() for p in network.parameters())
    print(f"{config.network.name}, {size} parameters, {device}, from step {step}", flush=True)

    # Samples are numbered, and go on where the checkpoint stopped: none is seen twice or left out.
    loader = DataLoader(
        ViewPairs(training, config.samples, config.seed),
        config.batch_pairs,
        sampler=range(step * config.batch_pairs, 10**9),
        num_workers=config.loader_processes,
        prefetch_factor=6 if config.loader_processes else None,
        worker_init_fn=lambda _: cv2.setNumThreads(1),
        generator=torch.Generator(),  # of its own: a resumed run must find the global one as it was
    )
    journal = Journal(out, step)
    time_to_save = Every(config.save_every_minutes, watch)
    time_to_validate = Every(config.validate_every_minutes, watch)

    def checkpoint() -> Path:
        return save_checkpoint(
            out / "last.pt",
            config=asdict(config),
            step=step,
            elapsed_s=watch.elapsed_s,
            network=network.state_dict(),
            average=average.state_dict(),
            optimizer=optimizer.state_dict(),
            rng=torch.get_rng_state(),
        )

    def report() -> None:
        score = validate.score_matches(validate.learned(average.module), views)
        journal.validated(step, watch, score, sift)

    # the loop
    for batch in loader:
        progress = progress_of(step, watch.elapsed_s, config)
        if progress >= 1.0:
            break
        rate = learning_rate(progress, config)
        for group in optimizer.param_groups:
            group["lr"] = rate

        batch = {name: value.to(device, non_blocking=True) for name, value in batch.items()}
        for k in (0, 1):
            batch[f"image{k}"] = 255.0 * augment(batch[f"image{k}"].float() / 255.0)
        network.train()
        figures = compute_losses(network, batch, config, progress)
        optimizer.zero_grad(set_to_none=True)
        figures["total"].backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), config.clip_norm)
        optimizer.step()
        average.update_parameters(network)
        step += 1
        watch.lap()

        journal.add(figures)
        if step % config.log_every_steps == 0:
            journal.tell(step, progress, rate, watch)
        if time_to_validate.due():
            report()
            watch.skip()
        if time_to_save.due():
            checkpoint()

    report()
    journal.close()
    return checkpoint()


if __name__ == "__main__":
    print(f"wrote {main(*parse(__doc__ or ''))}")
