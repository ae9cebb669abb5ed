"""What the network is asked for: matching descriptors, repeatable keypoints, honest reliability."""

import torch
from torch import Tensor
from torch.nn import functional as F

from models.extractor import cell_peaks
from models.network import CELL_PX, heat_cells, sampling_grid

NEAR_PX = 10.0  # points nearer than this may have nearly equal descriptors: not counted as wrong


def match_log_probability(
    descriptors0: Tensor, descriptors1: Tensor, uv1: Tensor, temperature: float
) -> tuple[Tensor, Tensor]:
    """Dual softmax over each pair: point i of picture 0 belongs to point i of picture 1.

    Args:
        descriptors0: (B, n, D) of unit length.
        descriptors1: (B, n, D) of unit length.
        uv1: (B, n, 2), pixels in picture 1; neighbours nearer than `NEAR_PX` are left out of the
            denominators.
        temperature: Divides the cosine similarities.

    Returns:
        log p (B, n) of the right match, mean of both directions; and 1 where it is the mutual
        nearest neighbour (B, n).
    """
    similarity = descriptors0 @ descriptors1.transpose(1, 2) / temperature
    near = torch.cdist(uv1, uv1) < NEAR_PX
    own = torch.eye(uv1.shape[1], dtype=torch.bool, device=uv1.device)
    similarity = similarity.masked_fill(near & ~own, -30.0 / temperature)
    forward = similarity.log_softmax(dim=2).diagonal(dim1=1, dim2=2)
    backward = similarity.log_softmax(dim=1).diagonal(dim1=1, dim2=2)
    right = similarity.diagonal(dim1=1, dim2=2)
    mutual = (right >= similarity.amax(dim=2)) & (right >= similarity.amax(dim=1))
    return 0.5 * (forward + backward), mutual.float()


def matching_loss(log_probability: Tensor, robustness: Tensor) -> Tensor:
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


def keypoint_targets(points_uv: Tensor, present: Tensor, cells_hw: tuple[int, int]) -> Tensor:
    """Spread sub-pixel points over the four pixels around them, a distribution per cell.

    The centre of mass of the trained heat is then the sub-pixel position.

    Args:
        points_uv: (B, n, 2), pixels; best first where two share a cell does not matter: they share
            it.
        present: (B, n), weight of each point, 0 for padding.
        cells_hw: Cells in height and width.

    Returns:
        (B, 65, h, w), sums to 1 over the classes; cells without a point are all "no keypoint".
    """
    h, w = cells_hw
    batch = points_uv.shape[0]
    heat = torch.zeros(batch, h * CELL_PX * w * CELL_PX, device=points_uv.device)
    corner = points_uv.floor()
    fraction = points_uv - corner
    for du in (0, 1):
        for dv in (0, 1):
            u, v = corner[..., 0] + du, corner[..., 1] + dv
            weight = (
                (fraction[..., 0] - (1 - du)).abs() * (fraction[..., 1] - (1 - dv)).abs() * present
            )
            inside = (u >= 0) & (v >= 0) & (u < w * CELL_PX) & (v < h * CELL_PX)
            index = torch.where(inside, v * (w * CELL_PX) + u, torch.zeros_like(u)).long()
            heat.scatter_add_(1, index, weight * inside)
    cells = F.pixel_unshuffle(heat.view(batch, 1, h * CELL_PX, w * CELL_PX), CELL_PX)
    total = cells.sum(dim=1, keepdim=True)
    occupied = total > 0.3  # a sliver of a neighbour's point is no keypoint of this cell
    cells = torch.where(occupied, cells / total.clamp_min(1e-6), torch.zeros_like(cells))
    return torch.cat([cells, 1.0 - occupied.float()], dim=1)


def keypoint_loss(keypoint_logits: Tensor, targets: Tensor, valid: Tensor) -> Tensor:
    """Cross-entropy per cell against `keypoint_targets`, over the cells that see ground.

    Args:
        keypoint_logits: (B, 65, h, w).
        targets: (B, 65, h, w).
        valid: (B, h, w), 1 for cells inside both pictures.

    Returns:
        Scalar.
    """
    entropy = -(targets * keypoint_logits.log_softmax(dim=1)).sum(dim=1)
    return (entropy * valid).sum() / valid.sum().clamp_min(1.0)


def reliability_loss(logits: Tensor, matched_probability: Tensor) -> Tensor:
    """Binary cross-entropy of the reliability head against how well descriptors really matched.

    Args:
        logits: (B, n).
        matched_probability: (B, n) in 0 to 1.
    """
    return F.binary_cross_entropy_with_logits(logits, matched_probability.detach())


def sample_map(values: Tensor, uv: Tensor) -> Tensor:
    """Interpolate a one-channel map of cells at pixels: (B, 1, h, w) and (B, n, 2) -> (B, n)."""
    grid = sampling_grid(uv, values).unsqueeze(1)
    return F.grid_sample(values, grid, padding_mode="border", align_corners=False)[:, 0, 0]


def carry(H_1_0: Tensor, uv0: Tensor) -> Tensor:
    """Carry points (B, n, 2) of picture 0 to picture 1 by (B, 3, 3)."""
    carried = uv0 @ H_1_0[:, :, :2].transpose(1, 2) + H_1_0[:, None, :, 2]
    return carried[..., :2] / carried[..., 2:]


@torch.no_grad()
def agreed_corners(
    logits0: Tensor, logits1: Tensor, H_1_0: Tensor, valid0: Tensor, present: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Find keypoints that the network itself sees in both views: what it should say more often.

    The geometric mean of both heat maps, the second carried into the first; as many of the best as
    the corner teacher found, so that the density stays. A habit of the cell grid cannot reinforce
    itself this way, because the grids of the two views do not coincide.

    Args:
        logits0: (B, 65, h, w), keypoint logits of picture 0.
        logits1: (B, 65, h, w), of picture 1.
        H_1_0: (B, 3, 3).
        valid0: (B, h, w), 1 for cells of picture 0 that both pictures see.
        present: (B, n), 1 for each corner that the teacher found.

    Returns:
        Positions in picture 0 and in picture 1 (B, n, 2), and their presence (B, n).
    """
    heat0, heat1 = (
        F.avg_pool2d(F.pixel_shuffle(heat_cells(x), CELL_PX), 3, stride=1, padding=1)
        for x in (logits0, logits1)
    )
    batch, _, height, width = heat0.shape
    v, u = torch.meshgrid(
        torch.arange(height, device=heat0.device),
        torch.arange(width, device=heat0.device),
        indexing="ij",
    )
    pixels = torch.stack([u, v], dim=-1).view(1, -1, 2).float().expand(batch, -1, -1)
    grid = sampling_grid(carry(H_1_0, pixels), logits1).view(batch, height, width, 2)
    carried = F.grid_sample(heat1, grid, align_corners=False)
    cells = F.pixel_unshuffle((heat0 * carried).sqrt(), CELL_PX) * valid0[:, None]
    uv, strength, keep = cell_peaks(cells)
    count = present.shape[1]
    best, index = torch.topk(strength * keep, min(count, strength.shape[1]))
    uv0 = torch.gather(uv, 1, index[..., None].expand(-1, -1, 2))
    rank = torch.arange(best.shape[1], device=best.device)[None]
    chosen = (rank < present.sum(dim=1, keepdim=True)) & (best > 1e-3)
    uv0 = torch.where(chosen[..., None], uv0, torch.full_like(uv0, -100.0))
    return uv0, carry(H_1_0, uv0), chosen.float()
