"""What the network is asked for: matching descriptors, peaks that repeat, honest scores."""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from models.network import CELL_PX

WINDOW_PX = 13  # peaks are compared in windows of this side
MASKED = -30.0  # a logit that means "not here"


class Ground(NamedTuple):
    """Where the ground of image 0 lies in image 1: a plane, and what relief adds to it."""

    H_1_0: Tensor  # (B, 3, 3)
    relief_px: Tensor  # (B, 2, h, w): (u, v) in image 1, on an even grid over image 0

    def part(self, pairs: slice) -> "Ground":
        """Some pairs of the batch."""
        return Ground(self.H_1_0[pairs], self.relief_px[pairs])


def carry(ground: Ground, uv0: Tensor, size_px: int) -> Tensor:
    """Carry points (B, n, 2) of image 0, `size_px` wide and high, to image 1."""
    H_1_0 = ground.H_1_0
    carried = uv0 @ H_1_0[:, :, :2].transpose(1, 2) + H_1_0[:, None, :, 2]
    planar = carried[..., :2] / carried[..., 2:]
    return planar + sample_surface(ground.relief_px, uv0, (size_px, size_px)).transpose(1, 2)


def sample_surface(surface: Tensor, uv: Tensor, size_hw: tuple[int, int]) -> Tensor:
    """Interpolate (B, C, h, w), spread over images of `size_hw`, at (B, n, 2): (B, C, n)."""
    size = torch.tensor([size_hw[1], size_hw[0]], device=uv.device)
    grid = ((2.0 * uv + 1.0) / size - 1.0).unsqueeze(1)
    return F.grid_sample(surface, grid, padding_mode="border", align_corners=False)[:, :, 0]


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
    rivals: float,
    temperature: float,
    near_px: float,
) -> Tensor:
    """Dual softmax: point i of image 0 belongs to point i of image 1 and to nothing else.

    "Nothing else" is all other points of the pair and the cells of the other image.

    Args:
        descriptors: (B, n, D) of unit length, of the points in either image.
        uv: (B, n, 2), pixels of the points in either image.
        cells: (B, D, h, w) dense descriptors of either image.
        rivals: share of the cells that are compared, drawn at random.
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
        count = cells[there].shape[-2] * cells[there].shape[-1]
        drawn = torch.randperm(count, device=near.device)[: max(1, round(rivals * count))]
        dense = F.normalize(cells[there].flatten(2)[:, :, drawn], dim=1)
        strangers = descriptors[here] @ dense / temperature
        apart = torch.cdist(uv[there], cell_centres(cells[there])[:, drawn])
        strangers = strangers.masked_fill(apart < near_px, MASKED / temperature)
        log_p = log_p + 0.5 * (right - torch.cat([others, strangers], dim=2).logsumexp(dim=2))
    return log_p


def cell_centres(cells: Tensor) -> Tensor:
    """Pixels of the centres of all cells, row by row: (B, C, h, w) -> (B, h w, 2)."""
    h, w = cells.shape[-2:]
    v, u = torch.meshgrid(
        torch.arange(h, device=cells.device), torch.arange(w, device=cells.device), indexing="ij"
    )
    centres = torch.stack([u.flatten(), v.flatten()], dim=-1) * float(CELL_PX) + 0.5 * (CELL_PX - 1)
    return centres.expand(cells.shape[0], -1, -1)


def distillation_loss(student: Tensor, teacher: Tensor) -> Tensor:
    """1 - mean cosine of two networks' dense descriptors, after the best turn of their axes.

    Matching asks for angles between descriptors alone, so the student may choose its axes: the
    cosines are those after orthogonal Procrustes (Schoenemann 1966), whose best value is the sum
    of the singular values of student^T teacher. EdgePoint2 (Yao et al. 2025) distils like this.

    Args:
        student: (B, D, h, w), D at most the teacher's.
        teacher: (B, E, h, w), of the same images.

    Returns:
        Scalar, 0 to 1.
    """
    own, aim = (F.normalize(x, dim=1).transpose(0, 1).flatten(1) for x in (student, teacher))
    return 1.0 - torch.linalg.svdvals(own @ aim.T).sum() / own.shape[1]


# --- peaks -----------------------------------------------------------------------------------


def agreement_log_probability(
    surfaces: list[Tensor], centres_uv0: Tensor, ground: Ground, sigma_px: Tensor
) -> Tensor:
    """Do both views put the peak of a small window at the same place of the ground?

    The window, 13 x 13 pixels of image 0, is carried to image 1. In each view the logits in it
    are a distribution over the same 169 places; returned is the expected reward of drawing a place
    from each: 1 for the same place, falling off as a Gaussian with their distance. A habit of the
    cell grid earns nothing, because the grids of the two views do not coincide.

    Args:
        surfaces: (B, 1, H, W) peak logits of either image.
        centres_uv0: (B, n, 2), centres of the windows in image 0, any fraction of a pixel.
        ground: of the two images.
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
    side = surfaces[0].shape[-1]
    for surface, uv in zip(surfaces, (uv0, carry(ground, uv0, side)), strict=True):
        inside = ((uv >= 0) & (uv <= side - 1.0)).all(dim=-1)
        logits = sample_surface(surface, uv, (side, side))[:, 0].masked_fill(~inside, MASKED)
        probability.append(logits.view(batch, count, -1).softmax(dim=-1))
    # a Gaussian between all places of the window, for each pair of images
    distance2 = torch.cdist(offsets, offsets) ** 2
    kernel = torch.exp(-0.5 * distance2 / sigma_px[:, None, None] ** 2)
    met = (probability[0] * (probability[1] @ kernel)).sum(dim=-1)
    return met.clamp_min(1e-9).log()


def repeat_probability(
    peak_logits: list[Tensor], ground: Ground, reach_px: Tensor
) -> tuple[Tensor, Tensor]:
    """Will the keypoint of a cell of image 0 have one of image 1 beside it?

    Each cell draws its keypoint from the softmax of its 64 logits. What image 1 draws is spread
    by a Gaussian and carried to image 0; a cell's expectation over it is the reward of DISK
    (Tyszkiewicz et al. 2020) without the matching, computed instead of sampled. Where nothing
    repeats the reward is small whatever is drawn, and so is its pull.

    Args:
        peak_logits: (B, 64, h, w) of either image.
        ground: of the two images.
        reach_px: (B,), standard deviation of the Gaussian, whose peak is 1.

    Returns:
        (B, h w), 0 to 1, and the same for a keypoint drawn anywhere in its cell: chance.
    """
    drawn = [F.pixel_shuffle(logits.softmax(dim=1), CELL_PX) for logits in peak_logits]
    side = drawn[0].shape[-1]
    near1 = spread(drawn[1], reach_px)
    v, u = torch.meshgrid(*(torch.arange(side, device=reach_px.device),) * 2, indexing="ij")
    uv0 = torch.stack([u.flatten(), v.flatten()], dim=-1).float().expand(len(near1), -1, -1)
    near0 = sample_surface(near1, carry(ground, uv0, side), (side, side)).view_as(drawn[0])
    expected = F.avg_pool2d(drawn[0] * near0.clamp_max(1.0), CELL_PX) * CELL_PX**2
    chance = F.avg_pool2d(near0.clamp_max(1.0), CELL_PX)
    return expected.flatten(1), chance.flatten(1)


def spread(density: Tensor, sigma_px: Tensor) -> Tensor:
    """Convolve (B, 1, H, W) with a Gaussian of its own for each image, 1 at its peak."""
    radius = int(3.0 * float(sigma_px.max()) + 1.0)
    steps = torch.arange(-radius, radius + 1, device=density.device)
    kernel = torch.exp(-0.5 * (steps / sigma_px[:, None]) ** 2)[:, None]
    images = density.transpose(0, 1)  # each image is a channel, with kernels of its own
    rows = F.conv2d(images, kernel[:, :, None], padding=(0, radius), groups=len(density))
    both = F.conv2d(rows, kernel[..., None], padding=(radius, 0), groups=len(density))
    return both.transpose(0, 1)


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
def meet(uv: list[Tensor], carried0: Tensor, seen: list[Tensor]) -> Meeting:
    """Bring the keypoints of both views together.

    Args:
        uv: (B, n0, 2) and (B, n1, 2), pixels.
        carried0: (B, n0, 2), where those of view 0 lie in view 1.
        seen: (B, n0) and (B, n1), 1 for keypoints on ground that both views see.
    """
    distance = torch.cdist(carried0, uv[1])
    unseen = (seen[0][:, :, None] * seen[1][:, None, :]) == 0
    distance = distance.masked_fill(unseen, 1e4)
    nearest, partner = distance.min(dim=2)
    back = distance.argmin(dim=1)
    mutual = torch.gather(back, 1, partner) == torch.arange(uv[0].shape[1], device=back.device)
    return Meeting(partner, nearest, mutual & (nearest < 1e3))


@torch.no_grad()
def rightly_matched(
    descriptors: list[Tensor],
    uv1: Tensor,
    carried0: Tensor,
    kept: list[Tensor],
    right_px: Tensor,
) -> tuple[Tensor, Tensor]:
    """Match all keypoints of two views as the localizer will, and say which matches are right.

    Args:
        descriptors: (B, n0, D) and (B, n1, D) of unit length.
        uv1: (B, n1, 2), pixels.
        carried0: (B, n0, 2), where the keypoints of view 0 lie in view 1.
        kept: (B, n0) and (B, n1), 0 for keypoints that the extractor drops.
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
    matched = torch.gather(uv1, 1, best1[..., None].expand(-1, -1, 2))
    distance = (carried0 - matched).norm(dim=-1)
    right0 = (mutual & (distance < right_px[:, None])).float()
    right1 = torch.zeros_like(kept[1]).scatter_reduce_(1, best1, right0, "amax")
    return right0, right1


def reprojection_loss(carried0: Tensor, uv1: Tensor, meeting: Meeting, weight: Tensor) -> Tensor:
    """Mean distance, in pixels, between keypoints of two views that mean the same place.

    Args:
        carried0: (B, n0, 2), where those of view 0 lie in view 1; the gradient reaches both.
        uv1: (B, n1, 2), refined positions.
        meeting: who belongs to whom.
        weight: (B, n0).

    Returns:
        Scalar.
    """
    partner = meeting.partner[..., None].expand(-1, -1, 2)
    difference = carried0 - torch.gather(uv1, 1, partner)
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
