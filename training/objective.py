"""What a batch is worth: both views through the network, and every loss between them."""

from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.extractor import cell_peaks
from models.network import CELL_PX, sample_descriptors
from training import losses
from training.config import TrainConfig

JITTER_PX = 6.0  # windows in which peaks are compared lie so far beside the points drawn


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Looks:
    """What the network says about both views of B pairs; lists hold view 0 and view 1.

    Attributes:
        batch: samples, as `training/sampling.py` makes them.
        ground: where view 0 lies in view 1.
        robustness: (B,), q of the generalised cross-entropy.
        size_px: side of the views.
        cells: (B, D, h, w) dense descriptors.
        peak_logits: (B, 64, h, w).
        score_logits: (B, 1, h, w).
        uv: (B, h w, 2) refined keypoints, one of each cell.
        kept: (B, h w), 0 where the extractor drops the keypoint.
        seen: (B, h w), 1 for kept keypoints on ground that both views see.
    """

    batch: dict[str, Tensor]
    ground: losses.Ground
    robustness: Tensor
    size_px: int
    cells: list[Tensor]
    peak_logits: list[Tensor]
    score_logits: list[Tensor]
    uv: list[Tensor]
    kept: list[Tensor]
    seen: list[Tensor]


@cache
def multiplies_bfloat16(device_type: str) -> bool:
    """Is bfloat16 faster there? A processor that must convert it takes three times as long."""
    able = torch.cpu.get_capabilities()
    return device_type != "cpu" or able.get("avx512_bf16", False) or able.get("amx_bf16", False)


def precision(device_type: str, config: TrainConfig) -> torch.autocast:
    """Convolutions in bfloat16 where that was asked for and is faster."""
    enabled = config.bfloat16 and multiplies_bfloat16(device_type)
    return torch.autocast(device_type, torch.bfloat16, enabled=enabled)


def look(
    network: nn.Module, batch: dict[str, Tensor], config: TrainConfig, progress: float
) -> Looks:
    """Run both views through the network at once."""
    pairs = len(batch["uv0"])
    images = torch.cat([batch["image0"], batch["image1"]]).to(memory_format=torch.channels_last)
    with precision(images.device.type, config):
        dense = network(images)
    cells, peak_logits, score_logits = (list(x.float().split(pairs)) for x in dense)
    found = [cell_peaks(logits) for logits in peak_logits]
    kept = [keep for _, keep in found]
    return Looks(
        batch=batch,
        ground=losses.Ground(batch["H_1_0"], batch["relief"]),
        robustness=batch["label_noise"] * min(1.0, progress / config.doubt_from),
        size_px=images.shape[-1],
        cells=cells,
        peak_logits=peak_logits,
        score_logits=score_logits,
        uv=[uv for uv, _ in found],
        kept=kept,
        seen=[kept[k] * batch[f"valid{k}"].flatten(1) for k in (0, 1)],
    )


def agreement_loss(looks: Looks, config: TrainConfig, progress: float) -> Tensor:
    """Both views put the peak of a small window at the same place."""
    points0, noise = looks.batch["uv0"], looks.batch["label_noise"]
    few = torch.randperm(points0.shape[1], device=points0.device)[: config.windows]
    jitter = torch.rand(len(points0), len(few), 2, device=points0.device)
    centres = points0[:, few] + JITTER_PX * (2.0 * jitter - 1.0)
    surfaces = [F.pixel_shuffle(logits, CELL_PX) for logits in looks.peak_logits]
    blur = max(0.0, 1.0 - progress / config.sharp_from)
    sigma_px = config.sharpness_px + 2.0 * blur + config.label_error_px * noise
    agreed = losses.agreement_log_probability(surfaces, centres, looks.ground, sigma_px)
    return losses.robust_loss(agreed, looks.robustness)


def repetition(looks: Looks, config: TrainConfig) -> tuple[Tensor, Tensor]:
    """Expected share of keypoints with another beside them in view 1, and the same by chance."""
    reach_px = config.reach_px + config.label_error_px * looks.batch["label_noise"]
    expected, chance = losses.repeat_probability(looks.peak_logits, looks.ground, reach_px)
    shared = looks.batch["valid0"].flatten(1)
    count = shared.sum().clamp_min(1.0)
    return (expected * shared).sum() / count, (chance * shared).sum() / count


def corner_loss(looks: Looks) -> Tensor:
    """Peaks are where Shi and Tomasi's measure sees corners: to start from."""
    loss = looks.peak_logits[0].new_zeros(())
    for k, logits in enumerate(looks.peak_logits):
        loss = loss + losses.corner_loss(logits, looks.batch[f"corners{k}"], looks.batch["present"])
    return loss


def descriptor_loss(looks: Looks, config: TrainConfig) -> Tensor:
    """Each point finds its own partner among all points and cells of the other view.

    Half of the points are drawn, half are what the detector itself finds.
    """
    half, drawn0 = config.matches // 2, looks.batch["uv0"]
    own = torch.multinomial(looks.seen[0] + 1e-6, half)
    own0 = torch.gather(looks.uv[0].detach(), 1, own[..., None].expand(-1, -1, 2))
    points0 = torch.cat([drawn0[:, torch.randperm(drawn0.shape[1])[:half]], own0], dim=1)
    points = [points0, losses.carry(looks.ground, points0, looks.size_px)]
    log_probability = losses.match_log_probability(
        [sample_descriptors(cells, uv) for cells, uv in zip(looks.cells, points, strict=True)],
        points,
        looks.cells,
        rivals=config.rivals,
        temperature=config.temperature,
        near_px=config.near_px,
    )
    own_seen = torch.gather(looks.seen[0], 1, own)
    trusted = torch.cat([torch.ones_like(own_seen), own_seen], dim=1)
    return losses.robust_loss(log_probability * trusted, looks.robustness)


def distilled(looks: Looks, teacher: nn.Module, config: TrainConfig) -> Tensor:
    """Descriptors are like those that a larger network has of the same view, either of the two."""
    k = int(torch.randint(2, ()))
    images = looks.batch[f"image{k}"].to(memory_format=torch.channels_last)
    with torch.no_grad(), precision(images.device.type, config):
        aim = teacher(images).descriptors.float()
    return losses.distillation_loss(looks.cells[k], aim)


def keypoint_losses(looks: Looks, config: TrainConfig) -> dict[str, Tensor]:
    """Match a quarter of the pairs as in flight, and look at what became of every keypoint.

    No more than a quarter: all keypoints against all cost more than the network.

    Returns:
        reprojection: keypoints that mean the same place are at the same place; score: how well
        the scores foretell it; repeated, matched: shares of the keypoints.
    """
    part = slice(0, -(-len(looks.ground.H_1_0) // 4))
    uv, kept, seen = ([x[part] for x in of] for of in (looks.uv, looks.kept, looks.seen))
    noise = looks.batch["label_noise"][part]
    carried0 = losses.carry(looks.ground.part(part), uv[0], looks.size_px)
    fixed, fixed_carried0 = [x.detach() for x in uv], carried0.detach()

    meeting = losses.meet(fixed, fixed_carried0, seen)
    same = (meeting.mutual & (meeting.distance_px < config.same_px)).float()
    weight = same / (1.0 + 10.0 * noise[:, None])
    right_px = config.right_px + config.label_error_px * noise
    described = [sample_descriptors(looks.cells[k][part].detach(), fixed[k]) for k in (0, 1)]
    success = losses.rightly_matched(described, fixed[1], fixed_carried0, kept, right_px)
    logits = [x[part].flatten(1) for x in looks.score_logits]
    count = seen[0].sum().clamp_min(1.0)
    return {
        "reprojection": losses.reprojection_loss(carried0, uv[1], meeting, weight),
        "score": 0.5 * sum(losses.score_loss(logits[k], success[k], seen[k]) for k in (0, 1)),
        "repeated": same.sum() / count,
        "matched": success[0].sum() / count,
    }


def compute_losses(
    network: nn.Module,
    batch: dict[str, Tensor],
    config: TrainConfig,
    progress: float,
    teacher: nn.Module | None = None,
) -> dict[str, Tensor]:
    """Run both views through the network and compare.

    Args:
        network: what is trained.
        batch: samples, as `training/sampling.py` makes them.
        config: of the run.
        progress: 0 to 1, share of the run.
        teacher: a larger network, in evaluation mode, to imitate; None where there is none.

    Returns:
        Every loss and figure by name; "total" is the one to descend.
    """
    looks = look(network, batch, config, progress)
    agreement = agreement_loss(looks, config, progress)
    repeating, by_chance = repetition(looks, config)
    matching = descriptor_loss(looks, config)
    of_keypoints = keypoint_losses(looks, config)
    total = (
        matching
        + config.agreement_weight * agreement
        + config.repeat_weight * (1.0 - repeating)
        + config.reprojection_weight * of_keypoints["reprojection"]
        + config.score_weight * of_keypoints["score"]
    )
    corner_weight = config.corner_weight * max(0.0, 1.0 - progress / config.corners_until)
    if corner_weight > 0.0:
        total = total + corner_weight * corner_loss(looks)
    unlike = matching.new_zeros(())
    if teacher is not None:
        unlike = distilled(looks, teacher, config)
        total = total + config.distil_weight * unlike
    return {
        "total": total,
        "unlike": unlike,
        "matching": matching,
        "agreement": agreement,
        "repeats": repeating - by_chance,
        **of_keypoints,
    }
