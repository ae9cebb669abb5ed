"""What the network is asked for: matching descriptors, peaks that repeat, honest scores."""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from models.network import CELL_PX

WINDOW_PX = 13  # peaks are compared in windows of this side
MASKED = -30.0  # a logit that means "not here"


def carry(H_1_0: Tensor, uv0: Tensor) -> Tensor:
    """Carry points (B, n, 2) of picture 0 to picture 1 by (B, 3, 3)."""
    carried = uv0 @ H_1_0[:, :, :2].transpose(1, 2) + H_1_0[:, None, :, 2]
    return carried[..., :2] / carried[..., 2:]


def robust_loss(log_probability: Tensor, robustness: Tensor) -> Tensor:
    """Generalised cross-entropy: (1 - p^q) / q.

    The surer the network is against a label, the less that label pulls: wrong ones lose.
    q = 0 is plain cross-entropy, q = 1 mean absolute error (Zhang and Sabuncu 2018, eq. 6).

    Args:
        log_probability: (B, n).
        robustness: (B,), q of each pair.

    Returns:
        Scalar.
    """
    q = robustness.clamp_min(1e-3)[:, None]
    return ((1.0 - torch.exp(q * log_probability)) / q).mean()


# --- descriptors -----------------------------------------------------------------------------


def match_log_probability(
    descriptors: list[Tensor],
    uv: list[Tensor],
    cells: list[Tensor],
    *,
    temperature: float,
    near_px: float,
) -> Tensor:
    """Dual softmax: point i of picture 0 belongs to point i of picture 1 and to nothing else.

    "Nothing else" is all other points of the pair and every cell of the other picture.

    Args:
        descriptors: (B, n, D) of unit length, of the points in either picture.
        uv: (B, n, 2), pixels of the points in either picture.
        cells: (B, D, h, w) dense descriptors of either picture.
        temperature: divides the cosine similarities.
        near_px: neighbours nearer than this may look the same: left out of the denominators.

    Returns:
        log p (B, n) of the right match, mean of both directions.
    """
    similarity = descriptors[0] @ descriptors[1].transpose(1, 2) / temperature
    right = similarity.diagonal(dim1=1, dim2=2)
    log_p = 0.0
    for here, there in ((0, 1), (1, 0)):
        others = similarity if here == 0 else similarity.transpose(1, 2)
        near = torch.cdist(uv[there], uv[there]) < near_px
        own = torch.eye(near.shape[1], dtype=torch.bool, device=near.device)
        others = others.masked_fill(near & ~own, MASKED / temperature)
        dense = F.normalize(cells[there].flatten(2), dim=1)
        rivals = descriptors[here] @ dense / temperature
        centres = cell_centres(cells[there])
        rivals = rivals.masked_fill(torch.cdist(uv[there], centres) < near_px, MASKED / temperature)
        log_p = log_p + 0.5 * (right - torch.cat([others, rivals], dim=2).logsumexp(dim=2))
    return log_p


def cell_centres(cells: Tensor) -> Tensor:
    """Pixels of the centres of all cells, row by row: (B, C, h, w) -> (B, h w, 2)."""
    h, w = cells.shape[-2:]
    v, u = torch.meshgrid(
        torch.arange(h, device=cells.device), torch.arange(w, device=cells.device), indexing="ij"
    )
    centres = torch.stack([u.flatten(), v.flatten()], dim=-1) * float(CELL_PX) + 0.5 * (CELL_PX - 1)
    return centres.expand(cells.shape[0], -1, -1)


# --- peaks -----------------------------------------------------------------------------------


def agreement_log_probability(
    surfaces: list[Tensor], centres_uv0: Tensor, H_1_0: Tensor, sigma_px: Tensor
) -> Tensor:
    """Do both views put the peak of a small window at the same place of the ground?

    The window, 13 x 13 pixels of picture 0, is carried to picture 1. In each view the logits in it
    are a distribution over the same 169 places; returned is the expected reward of drawing a place
    from each: 1 for the same place, falling off as a Gaussian with their distance. A habit of the
    cell grid earns nothing, because the grids of the two views do not coincide.

    Args:
        surfaces: (B, 1, H, W) peak logits of either picture.
        centres_uv0: (B, n, 2), centres of the windows in picture 0, any fraction of a pixel.
        H_1_0: (B, 3, 3).
        sigma_px: (B,), how exactly the two shall agree.

    Returns:
        (B, n).
    """
    batch, count = centres_uv0.shape[:2]
    steps = torch.arange(WINDOW_PX, device=centres_uv0.device) - float(WINDOW_PX // 2)
    dv, du = torch.meshgrid(steps, steps, indexing="ij")
    offsets = torch.stack([du.flatten(), dv.flatten()], dim=-1)
    uv0 = (centres_uv0.round()[:, :, None] + offsets).flatten(1, 2)
    probability = []
    for surface, uv in zip(surfaces, (uv0, carry(H_1_0, uv0)), strict=True):
        height, width = surface.shape[-2:]
        limit = torch.tensor([width - 1.0, height - 1.0], device=uv.device)
        inside = ((uv >= 0) & (uv <= limit)).all(dim=-1)
        grid = ((2.0 * uv + 1.0) / (limit + 1.0) - 1.0).unsqueeze(1)
        logits = F.grid_sample(surface, grid, padding_mode="border", align_corners=False)
        logits = logits[:, 0, 0].masked_fill(~inside, MASKED)
        probability.append(logits.view(batch, count, -1).softmax(dim=-1))
    # a Gaussian between all places of the window, for each pair of pictures
    distance2 = torch.cdist(offsets, offsets) ** 2
    kernel = torch.exp(-0.5 * distance2 / sigma_px[:, None, None] ** 2)
    met = (probability[0] * (probability[1] @ kernel)).sum(dim=-1)
    return met.clamp_min(1e-9).log()


def corner_loss(peak_logits: Tensor, corners_uv: Tensor, present: Tensor) -> Tensor:
    """Cross-entropy of a cell's pixels at a teacher's corners, to start from.

    Args:
        peak_logits: (B, 64, h, w).
        corners_uv: (B, n, 2), pixels.
        present: (B, n), 0 for padding.

    Returns:
        Scalar.
    """
    h, w = peak_logits.shape[-2:]
    uv = corners_uv.round().long()
    inside = (uv >= 0).all(dim=-1) & (uv[..., 0] < w * CELL_PX) & (uv[..., 1] < h * CELL_PX)
    uv = uv * inside[..., None]
    cell = uv[..., 1] // CELL_PX * w + uv[..., 0] // CELL_PX
    pixel = uv[..., 1] % CELL_PX * CELL_PX + uv[..., 0] % CELL_PX
    log_p = peak_logits.log_softmax(dim=1).flatten(2)
    index = cell[:, None].expand(-1, log_p.shape[1], -1)
    chosen = torch.gather(torch.gather(log_p, 2, index), 1, pixel[:, None])[:, 0]
    weight = present * inside
    return -(chosen * weight).sum() / weight.sum().clamp_min(1.0)


# --- what the detector finds in both views ---------------------------------------------------


class Meeting(NamedTuple):
    """Keypoints of two views, brought together by the true homography."""

    partner: Tensor  # (B, n0) int64: the keypoint of view 1 nearest to each one of view 0
    distance_px: Tensor  # (B, n0), in view 1
    mutual: Tensor  # (B, n0) bool: each is the other's nearest


@torch.no_grad()
def meet(uv: list[Tensor], seen: list[Tensor], H_1_0: Tensor) -> Meeting:
    """Bring the keypoints of both views together.

    Args:
        uv: (B, n0, 2) and (B, n1, 2), pixels.
        seen: (B, n0) and (B, n1), 1 for keypoints on ground that both views see.
        H_1_0: (B, 3, 3).
    """
    distance = torch.cdist(carry(H_1_0, uv[0]), uv[1])
    unseen = (seen[0][:, :, None] * seen[1][:, None, :]) == 0
    distance = distance.masked_fill(unseen, 1e4)
    nearest, partner = distance.min(dim=2)
    back = distance.argmin(dim=1)
    mutual = torch.gather(back, 1, partner) == torch.arange(uv[0].shape[1], device=back.device)
    return Meeting(partner, nearest, mutual & (nearest < 1e3))


@torch.no_grad()
def rightly_matched(
    descriptors: list[Tensor],
    uv: list[Tensor],
    kept: list[Tensor],
    H_1_0: Tensor,
    right_px: Tensor,
) -> tuple[Tensor, Tensor]:
    """Match all keypoints of two views as the localizer will, and say which matches are right.

    Args:
        descriptors: (B, n0, D) and (B, n1, D) of unit length.
        uv: (B, n0, 2) and (B, n1, 2), pixels.
        kept: (B, n0) and (B, n1), 0 for keypoints that the extractor drops.
        H_1_0: (B, 3, 3).
        right_px: (B,), a match nearer to the truth than this is right.

    Returns:
        (B, n0) and (B, n1), 1 where a keypoint has a right match.
    """
    similarity = descriptors[0] @ descriptors[1].transpose(1, 2)
    dropped = (kept[0][:, :, None] * kept[1][:, None, :]) == 0
    similarity = similarity.masked_fill(dropped, -2.0)
    best1, best0 = similarity.argmax(dim=2), similarity.argmax(dim=1)
    own = torch.arange(best1.shape[1], device=best1.device)
    mutual = (torch.gather(best0, 1, best1) == own) & (kept[0] > 0)
    matched = torch.gather(uv[1], 1, best1[..., None].expand(-1, -1, 2))
    distance = (carry(H_1_0, uv[0]) - matched).norm(dim=-1)
    right0 = (mutual & (distance < right_px[:, None])).float()
    right1 = torch.zeros_like(kept[1]).scatter_reduce_(1, best1, right0, "amax")
    return right0, right1


def reprojection_loss(uv: list[Tensor], meeting: Meeting, H_1_0: Tensor, weight: Tensor) -> Tensor:
    """Mean distance, in pixels, between keypoints of two views that mean the same place.

    Args:
        uv: (B, n0, 2) and (B, n1, 2), refined positions; the gradient reaches both.
        meeting: who belongs to whom.
        H_1_0: (B, 3, 3).
        weight: (B, n0).

    Returns:
        Scalar.
    """
    partner = meeting.partner[..., None].expand(-1, -1, 2)
    difference = carry(H_1_0, uv[0]) - torch.gather(uv[1], 1, partner)
    distance = (difference.square().sum(dim=-1) + 1e-4).sqrt()
    return (distance * weight).sum() / weight.sum().clamp_min(1.0)


def score_loss(logits: Tensor, success: Tensor, weight: Tensor) -> Tensor:
    """Binary cross-entropy of the score head against what matching made of the keypoints.

    Args:
        logits: (B, n).
        success: (B, n), 1 where the keypoint was found again and rightly matched.
        weight: (B, n), 0 for keypoints that do not count.
    """
    entropy = F.binary_cross_entropy_with_logits(logits, success, reduction="none")
    return (entropy * weight).sum() / weight.sum().clamp_min(1.0)
