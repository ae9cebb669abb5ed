"""Train the feature network. One linear script; read it from top to bottom.

Two minutes, to see that everything works:
    python training/train.py --preset smoke
The released model (on two CPU cores, or a GPU if there is one):
    python training/train.py --preset default --minutes 180
Go on after an interruption, with the same pictures, optimizer and learning rate:
    python training/train.py --resume runs/default/last.pt
On several GPUs or machines, or here on two processor cores, sharing each batch:
    torchrun --nproc-per-node 2 training/train.py --preset nano

Pictures come from --data, else VWNAV_DATA, else ../shared/data (only its train/), and from
generated pairs in runs/site_pairs. A run leaves config.json, log.csv, TensorBoard events, last.pt.
"""

import json
import math
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import cv2
import torch
from torch import Tensor
from torch.nn import functional as F
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.data import DataLoader

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # to run it as a script

from models.extractor import cell_peaks
from models.network import CELL_PX, FeatureNetwork, NetworkConfig, sample_descriptors
from training import losses, validate
from training.config import TrainConfig, load_checkpoint, parse
from training.data import ROOT, Scene, data_folder, load_scenes
from training.journal import Every, Journal, StopWatch, progress_of, save_checkpoint
from training.photometric import batch_augmentation
from training.sampling import ViewPairs
from training.team import Team


def learning_rate(progress: float, config: TrainConfig) -> float:
    """Linear warm-up, then a cosine to a hundredth; `progress` is 0 to 1, so a run ends cooled."""
    if progress < config.warm_up:
        return config.learning_rate * (progress + 1e-3) / (config.warm_up + 1e-3)
    return config.learning_rate * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))


def compute_losses(
    network: torch.nn.Module, batch: dict[str, Tensor], config: TrainConfig, progress: float
) -> dict[str, Tensor]:
    """Run both views through the network and compare.

    Returns:
        Every loss and figure by name; "total" is the one to descend.
    """
    pairs, noise = len(batch["uv0"]), batch["label_noise"]
    ground = losses.Ground(batch["H_1_0"], batch["relief"])
    robustness = noise * min(1.0, progress / config.doubt_from)
    images = torch.cat([batch["image0"], batch["image1"]]).to(memory_format=torch.channels_last)
    with torch.autocast(images.device.type, torch.bfloat16, enabled=config.bfloat16):
        dense = network(images)
    cells, peak_logits, score_logits = (x.float().split(pairs) for x in dense)
    found = [cell_peaks(logits) for logits in peak_logits]
    uv, kept = [x[0] for x in found], [x[1] for x in found]
    seen = [kept[k] * batch[f"valid{k}"].flatten(1) for k in (0, 1)]

    # peaks: both views put them at the same place; at first also where a teacher sees corners
    few = torch.randperm(batch["uv0"].shape[1], device=images.device)[: config.windows]
    jitter = 12.0 * torch.rand(pairs, len(few), 2, device=images.device) - 6.0
    surfaces = [F.pixel_shuffle(logits, CELL_PX) for logits in peak_logits]
    blur = max(0.0, 1.0 - progress / config.sharp_from)
    sigma_px = config.sharpness_px + 2.0 * blur + config.label_error_px * noise
    agreed = losses.agreement_log_probability(
        surfaces, batch["uv0"][:, few] + jitter, ground, sigma_px
    )
    agreement = losses.robust_loss(agreed, robustness)
    reach_px = config.reach_px + config.label_error_px * noise
    expected, chance = losses.repeat_probability(peak_logits, ground, reach_px)
    shared_cells = batch["valid0"].flatten(1)
    repeating = (expected * shared_cells).sum() / shared_cells.sum().clamp_min(1.0)
    by_chance = (chance * shared_cells).sum() / shared_cells.sum().clamp_min(1.0)
    corner_weight = config.corner_weight * max(0.0, 1.0 - progress / config.corners_until)
    corner = peak_logits[0].new_zeros(())
    if corner_weight > 0.0:
        for k in (0, 1):
            corner += losses.corner_loss(peak_logits[k], batch[f"corners{k}"], batch["present"])

    # descriptors: each point must find its own partner among all points and cells of the other
    # view; half of the points are drawn, half are what the detector itself finds
    half = config.matches // 2
    own = torch.multinomial(seen[0] + 1e-6, half)
    own0 = torch.gather(uv[0].detach(), 1, own[..., None].expand(-1, -1, 2))
    points0 = torch.cat([batch["uv0"][:, torch.randperm(batch["uv0"].shape[1])[:half]], own0], 1)
    size_px = images.shape[-1]
    points1 = losses.carry(ground, points0, size_px)
    log_probability = losses.match_log_probability(
        [sample_descriptors(cells[0], points0), sample_descriptors(cells[1], points1)],
        [points0, points1],
        cells,
        rivals=config.rivals,
        temperature=config.temperature,
        near_px=config.near_px,
    )
    trusted = torch.cat([torch.ones_like(own0[..., 0]), torch.gather(seen[0], 1, own)], dim=1)
    matching = losses.robust_loss(log_probability * trusted, robustness)

    # A quarter of the pairs are matched as in flight, for the losses that look at every keypoint:
    # all keypoints against all cost more than the network.
    part = slice(0, -(-pairs // 4))
    uv, kept, seen = [x[part] for x in uv], [x[part] for x in kept], [x[part] for x in seen]
    noise = noise[part]
    carried0 = losses.carry(ground.part(part), uv[0], size_px)
    fixed, fixed_carried0 = [x.detach() for x in uv], carried0.detach()

    # positions: keypoints that mean the same place are at the same place, to a fraction of a pixel
    meeting = losses.meet(fixed, fixed_carried0, seen)
    same = (meeting.mutual & (meeting.distance_px < config.same_px)).float()
    weight = same / (1.0 + 10.0 * noise[:, None])
    reprojection = losses.reprojection_loss(carried0, uv[1], meeting, weight)

    # scores: what became of the keypoints
    right_px = config.right_px + config.label_error_px * noise
    described = [sample_descriptors(cells[k][part].detach(), fixed[k]) for k in (0, 1)]
    success = losses.rightly_matched(described, fixed[1], fixed_carried0, kept, right_px)
    score = 0.5 * sum(
        losses.score_loss(score_logits[k][part].flatten(1), success[k], seen[k]) for k in (0, 1)
    )
    return {
        "total": matching
        + config.agreement_weight * agreement
        + config.repeat_weight * (1.0 - repeating)
        + corner_weight * corner
        + config.reprojection_weight * reprojection
        + config.score_weight * score,
        "matching": matching,
        "agreement": agreement,
        "reprojection": reprojection,
        "score": score,
        "repeats": repeating - by_chance,
        "repeated": same.sum() / seen[0].sum().clamp_min(1.0),
        "matched": success[0].sum() / seen[0].sum().clamp_min(1.0),
    }


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
    """
    torch.set_num_threads(config.threads)
    cv2.setNumThreads(1)  # the loader's processes are the parallelism
    team = Team.join(config.batch_pairs)
    torch.manual_seed(config.seed + team.rank)
    device = team.device
    out = ROOT / config.out
    out.mkdir(parents=True, exist_ok=True)
    (out / "config.json").write_text(json.dumps(asdict(config), indent=2))

    # pictures, and what SIFT makes of the kept-aside ones
    started = time.monotonic()
    training, kept = scenes or load_scenes(
        data_folder(config.data),
        ROOT / config.sites,
        ROOT / config.registered,
        config.terms,
    )
    if not training:
        raise SystemExit("no training pictures: give --data, or generate pairs (docs/training.md)")
    groups = {g: sum(s.group == g for s in training) for g in config.samples.shares}
    took_s = time.monotonic() - started
    team.say(f"{len(training)} scenes {groups}, {len(kept)} kept aside, read in {took_s:.0f} s")
    views = validate.calm_views(kept or training, config.samples, config.validation_pairs)
    sift = validate.score_matches(validate.upright_sift, views)
    team.say(f"upright SIFT on the kept-aside views: {sift}")

    # network, optimizer, and where we are
    network = build(config.network).to(device, memory_format=torch.channels_last)
    if config.init and not resume:
        start_from(network, config.init)
    average_fn = get_ema_multi_avg_fn(config.average_decay)
    average = AveragedModel(network, multi_avg_fn=average_fn, use_buffers=True)
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=config.weight_decay)
    step, watch = 0, StopWatch(0.0)
    if resume:
        state = load_checkpoint(resume, device)
        if "optimizer" not in state:
            raise SystemExit(f"{resume} holds weights alone: start a new run with --init")
        network.load_state_dict(state["network"])
        average.load_state_dict(state["average"])
        optimizer.load_state_dict(state["optimizer"])
        if team.rank == 0:
            torch.set_rng_state(state["rng"].cpu())
        step, watch = state["step"], StopWatch(state["elapsed_s"])
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
        figures = compute_losses(shared, batch, config, progress)
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
        pictures = [view[f"image{k}"][0].numpy() for view in views for k in (0, 1)]
        bias = average.module.peak_bias + torch.from_numpy(
            validate.peak_bias(average.module, pictures)
        ).to(average.module.peak_bias)
        average.module.peak_bias.copy_(bias)
        report(journal)
        journal.close()
        checkpoint()
    return out / "last.pt"


if __name__ == "__main__":
    main(*parse(__doc__ or ""))
