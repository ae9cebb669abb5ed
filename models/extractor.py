"""From dense features to keypoints: the part of the exported graph behind the network."""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from models.network import CELL_PX, FeatureNetwork, sample_descriptors

WINDOW_PX = 5  # non-maximum suppression and sub-pixel refinement look at 5 x 5 pixels
BORDER_PX = 4  # a keypoint nearer to the edge has half of its surroundings missing


def gather_windows(surface: Tensor, uv: Tensor) -> Tensor:
    """Cut 5 x 5 windows out of an image.

    Args:
        surface: (B, 1, H, W).
        uv: (B, n, 2) int64, pixels inside the image.

    Returns:
        (B, n, 25), row by row, zero outside of the image.
    """
    radius = WINDOW_PX // 2
    padded = F.pad(surface, (radius, radius, radius, radius))
    width = padded.shape[-1]
    rows, columns = torch.meshgrid(
        torch.arange(WINDOW_PX, device=surface.device),
        torch.arange(WINDOW_PX, device=surface.device),
        indexing="ij",
    )
    offsets = (rows * width + columns).flatten()
    index = (uv[..., 1] * width + uv[..., 0]).unsqueeze(-1) + offsets
    flat = padded.flatten(1)
    return torch.gather(flat, 1, index.flatten(1)).view(*uv.shape[:2], WINDOW_PX**2)


def refine(uv: Tensor, windows: Tensor) -> Tensor:
    """Move peaks to the centre of mass of exp(logit) around them: sub-pixel and differentiable.

    Args:
        uv: (..., n, 2) int64, pixels.
        windows: (..., n, 25), peak logits around each of them.

    Returns:
        (..., n, 2) float32, pixels, centres at integers.
    """
    weights = windows.softmax(dim=-1)
    steps = torch.arange(WINDOW_PX, device=windows.device) - WINDOW_PX // 2
    dv, du = torch.meshgrid(steps, steps, indexing="ij")
    offsets = torch.stack([du.flatten(), dv.flatten()], dim=-1).to(windows.dtype)
    return uv.to(windows.dtype) + weights @ offsets


class CellPeaks(NamedTuple):
    """The strongest pixel of every cell."""

    uv: Tensor  # (B, h w, 2) int64, pixels
    windows: Tensor  # (B, h w, 25), peak logits around each of them
    keep: Tensor  # (B, h w) float32: 1 where it is the strongest of its window, else 0


def strongest_pixels(cells: Tensor) -> CellPeaks:
    """Find the strongest pixel of every cell, and whether it is the strongest of its 5 x 5 window.

    One candidate per cell makes suppression cheap: it touches the full image only there.

    Args:
        cells: (B, 64, h, w), the peak logits of the 64 pixels of each cell, row by row.
    """
    h, w = cells.shape[-2:]
    index = cells.permute(0, 2, 3, 1).contiguous().argmax(dim=-1)  # faster along memory
    rows = torch.arange(h, device=index.device)[:, None] * CELL_PX + index // CELL_PX
    columns = torch.arange(w, device=index.device)[None, :] * CELL_PX + index % CELL_PX
    uv = torch.stack([columns.flatten(1), rows.flatten(1)], dim=-1)
    windows = gather_windows(F.pixel_shuffle(cells, CELL_PX), uv)
    peak = windows[..., WINDOW_PX**2 // 2]
    u, v = uv[..., 0], uv[..., 1]
    inside = (u >= BORDER_PX) & (u < w * CELL_PX - BORDER_PX)
    inside &= (v >= BORDER_PX) & (v < h * CELL_PX - BORDER_PX)
    keep = (peak >= windows.amax(dim=-1)) & inside
    return CellPeaks(uv, windows, keep.to(cells.dtype))


def cell_peaks(cells: Tensor) -> tuple[Tensor, Tensor]:
    """Refine the strongest pixel of every cell.

    Args:
        cells: (B, 64, h, w) peak logits.

    Returns:
        Refined positions (B, h w, 2) float32 in pixels, and 1 or 0 for peaks to keep or drop
        (B, h w) float32.
    """
    peaks = strongest_pixels(cells)
    return refine(peaks.uv, peaks.windows), peaks.keep


class Extractor(nn.Module):
    """Image -> keypoints, scores, descriptors, best first; the module that is exported."""

    def __init__(self, network: FeatureNetwork) -> None:
        """Wrap a trained network."""
        super().__init__()
        self.network = network

    def forward(self, image: Tensor, max_keypoints: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Extract features of one image.

        Args:
            image: (1, 1, H, W) uint8; H and W divisible by 32.
            max_keypoints: (1,) int64.

        Returns:
            keypoints (n, 2) float32 as (u, v) in pixels, centres at integers; scores (n,)
            descending, the probability of being found again and rightly matched; descriptors
            (n, D) of unit length; n <= max_keypoints.
        """
        dense = self.network(image.to(torch.float32))
        peaks = strongest_pixels(dense.peak_logits)
        scores = (dense.score_logits.flatten(1).sigmoid() * peaks.keep)[0]
        # k depends on the data: the exporter wants a number, and to be told its bounds.
        count = torch.minimum(max_keypoints[0], peaks.keep.sum().to(torch.int64)).item()
        torch._check(count >= 0)
        torch._check(count <= scores.shape[0])
        best_scores, best = torch.topk(scores, count)
        best_uv = refine(peaks.uv[0][best], peaks.windows[0][best]) - self.network.peak_bias
        descriptors = sample_descriptors(dense.descriptors, best_uv[None])[0]
        return best_uv, best_scores, descriptors
