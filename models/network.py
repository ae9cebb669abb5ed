"""The feature network: one grey image in; descriptors, keypoint peaks and scores out.

Made for images that are already rectified (north-up, nadir, known resolution), so it can be
small: a pixel-unshuffle stem works at a quarter of the resolution at once, two coarser levels
add context, and everything is fused at one eighth. All layers are plain convolution + batch
norm + ReLU, which fold into one operation at export.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

CELL_PX = 8  # one descriptor and one keypoint cell per 8 x 8 pixels
SIZE_MULTIPLE_PX = 32  # the coarsest level is at 1/32
NOISE_FLOOR_GREY = 4.0  # contrast below about 4 of 255 grey levels is noise: do not amplify it

Size = Literal["nano", "default"]


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkConfig:
    """Widths of the network; saved in each checkpoint, so that a checkpoint alone rebuilds it."""

    name: str = "default"
    stem_channels: int = 32  # at 1/4
    channels: int = 128  # at 1/8 and coarser
    keypoint_channels: int = 128  # hidden width of the keypoint head
    score_channels: int = 32  # hidden width of the score head
    descriptor_dim: int = 64
    # Of the 3 x 3 convolutions: they give so many channels, which a 1 x 1 convolution spreads.
    # 0: whole, as in the first generation.
    stem_rank: int = 0  # at 1/4
    rank: int = 0  # at 1/8
    coarse_rank: int = 0  # at 1/16 and 1/32


NETWORK_SIZES: dict[Size, NetworkConfig] = {
    "nano": NetworkConfig(
        name="nano",
        stem_channels=16,
        channels=48,
        keypoint_channels=64,
        score_channels=16,
        stem_rank=8,
        rank=16,
        coarse_rank=16,
    ),
    "default": NetworkConfig(stem_rank=16, rank=48, coarse_rank=32),
}


class DenseFeatures(NamedTuple):
    """What the network says about every 8 x 8 cell; h = H / 8, w = W / 8."""

    descriptors: Tensor  # (B, D, h, w), not yet normalised: interpolate first, then normalise
    peak_logits: Tensor  # (B, 64, h, w): how much each pixel of the cell, row by row, is a peak
    score_logits: Tensor  # (B, 1, h, w): will the cell's keypoint be found again and matched?


def conv(
    inputs: int, outputs: int, kernel: int = 3, stride: int = 1, rank: int = 0
) -> nn.Sequential:
    """Convolution, batch norm, ReLU: the only building block.

    With a rank the convolution is two, one after the other: what a product of two thin matrices is
    to a matrix (Zhang et al. 2015, "Accelerating very deep convolutional networks").
    """
    thin = rank or outputs
    layers: list[nn.Module] = [
        nn.Conv2d(inputs, thin, kernel, stride, padding=kernel // 2, bias=False)
    ]
    if rank:
        layers.append(nn.Conv2d(rank, outputs, 1, bias=False))
    return nn.Sequential(*layers, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


def normalise_contrast(image: Tensor) -> Tensor:
    """Remove local brightness and contrast, and fold 4 x 4 pixels into channels.

    The statistics are taken over about 72 px (8 px blocks, averaged twice over 5 x 5), so a cloud's
    shadow or a darker map changes little, and dull grass speaks as loudly as a runway.

    Args:
        image: (B, 1, H, W) float32, grey levels 0 to 255.

    Returns:
        (B, 16, H / 4, W / 4), about zero mean and unit variance.
    """
    image = image - 128.0
    block_mean = F.avg_pool2d(image, CELL_PX)
    block_square = F.avg_pool2d(image * image, CELL_PX)
    moments = torch.cat([block_mean, block_square], dim=1)
    for _ in range(2):
        moments = F.avg_pool2d(moments, 5, stride=1, padding=2, count_include_pad=False)
    mean, square = moments[:, :1], moments[:, 1:]
    gain = torch.rsqrt((square - mean * mean).clamp_min(0.0) + NOISE_FLOOR_GREY**2)
    affine = torch.cat([gain, -mean * gain], dim=1)
    affine = F.interpolate(affine, scale_factor=2.0, mode="bilinear", align_corners=False)
    return fold4(image) * affine[:, :1] + affine[:, 1:]


def fold4(image: Tensor) -> Tensor:
    """Fold 4 x 4 pixels into channels, (B, 1, H, W) -> (B, 16, H / 4, W / 4).

    `F.pixel_unshuffle` as a convolution, which onnxruntime does five times faster.
    """
    pick = torch.eye(16, device=image.device, dtype=image.dtype).view(16, 1, 4, 4)
    return F.conv2d(image, pick, stride=4)


class FeatureNetwork(nn.Module):
    """Grey image -> `DenseFeatures`."""

    def __init__(self, config: NetworkConfig) -> None:
        """Build the layers; weights are random until a checkpoint is loaded."""
        super().__init__()
        self.config = config
        c1, c2 = config.stem_channels, config.channels
        fine, thin, coarse = config.stem_rank, config.rank, config.coarse_rank
        self.level4 = nn.Sequential(conv(16, c1, rank=fine), conv(c1, c1, rank=fine))
        self.level8 = nn.Sequential(conv(c1, c2, stride=2, rank=thin), conv(c2, c2, rank=thin))
        self.level16 = nn.Sequential(conv(c2, c2, stride=2, rank=coarse), conv(c2, c2, rank=coarse))
        self.level32 = nn.Sequential(
            conv(c2, c2, stride=2, rank=coarse),
            conv(c2, c2, rank=coarse),
            conv(c2, c2, kernel=1),
        )
        self.fuse16 = conv(c2, c2, kernel=1)
        self.fuse8 = conv(c2, c2, rank=thin)
        self.descriptors = nn.Conv2d(c2, config.descriptor_dim, 1)
        # The keypoint head reads the 1/4 level, 2 x 2 folded into channels, which stays sharp, and
        # the 1/8 level, which knows more of what is around.
        self.peaks = conv(4 * c1 + c2, config.keypoint_channels, kernel=1)
        self.peak_logits = nn.Conv2d(config.keypoint_channels, CELL_PX**2, 1)
        self.score = nn.Sequential(
            conv(c2 + config.keypoint_channels, config.score_channels, kernel=1),
            nn.Conv2d(config.score_channels, 1, 1),
        )

        # Where peaks lie beside what they mean, (u, v) in pixels: a shift common to both views,
        # which no loss between them can see. A half turn shows it, at the end of training.
        self.register_buffer("peak_bias", torch.zeros(2))

    def forward(self, image: Tensor) -> DenseFeatures:
        """Compute dense features.

        Args:
            image: (B, 1, H, W) float32, grey levels 0 to 255; H and W divisible by 32.
        """
        x4 = self.see(image)
        x8 = self.level8(x4)
        fused = self.fuse(x8)
        peaks = self.join_levels(x4, x8)
        return DenseFeatures(
            descriptors=self.descriptors(fused),
            peak_logits=self.peak_logits(peaks),
            score_logits=self.judge(fused, peaks),
        )

    def see(self, image: Tensor) -> Tensor:
        """(B, 1, H, W) grey levels -> the 1/4 level."""
        return self.level4(normalise_contrast(image))

    def fuse(self, x8: Tensor) -> Tensor:
        """The 1/8 level -> the same with what the two coarser ones know of the surroundings."""
        x16 = self.level16(x8)
        x16 = self.fuse16(x16 + upsample2(self.level32(x16)))
        return self.fuse8(x8 + upsample2(x16))

    def judge(self, fused: Tensor, peaks: Tensor) -> Tensor:
        """Apply `self.score` to descriptors' and keypoints' features side by side.

        Two convolutions, added, are one of both concatenated, and move no memory.
        """
        (joint, *rest), last = self.score
        channels = fused.shape[1]
        hidden = F.conv2d(fused, joint.weight[:, :channels], joint.bias)
        hidden = hidden + F.conv2d(peaks, joint.weight[:, channels:])
        for layer in rest:
            hidden = layer(hidden)
        return last(hidden)

    def join_levels(self, x4: Tensor, x8: Tensor) -> Tensor:
        """Apply `self.peaks` to the 1/4 level, folded 2 x 2, beside the 1/8 level.

        One convolution of stride 2 and one of 1 x 1 are the same as folding and concatenating, and
        move no memory.
        """
        joint, *rest = self.peaks
        fold = 4 * self.config.stem_channels
        fine = joint.weight[:, :fold].reshape(-1, self.config.stem_channels, 2, 2)
        peaks = F.conv2d(x4, fine, joint.bias, stride=2) + F.conv2d(x8, joint.weight[:, fold:])
        for layer in rest:
            peaks = layer(peaks)
        return peaks


def upsample2(features: Tensor) -> Tensor:
    """Double the resolution, (B, C, h, w) -> (B, C, 2 h, 2 w), by the half-pixel rule."""
    return F.interpolate(features, scale_factor=2.0, mode="bilinear", align_corners=False)


def sample_descriptors(descriptors: Tensor, uv: Tensor) -> Tensor:
    """Interpolate descriptors at pixel positions and normalise them.

    Args:
        descriptors: (B, D, h, w), one per 8 x 8 cell.
        uv: (B, n, 2) float32, pixels of the full image.

    Returns:
        (B, n, D), unit length.
    """
    batch, dim, h, w = descriptors.shape
    place = (uv - 0.5 * (CELL_PX - 1)) / CELL_PX  # in cells, centres at integers
    column = place[..., 0].clamp(0.0, w - 1.0)
    row = place[..., 1].clamp(0.0, h - 1.0)
    left, top = column.floor(), row.floor()
    right, bottom = (left + 1.0).clamp_max(w - 1.0), (top + 1.0).clamp_max(h - 1.0)
    along_u, along_v = column - left, row - top
    # Rows of a table: four look-ups are a tenth of grid_sample's time in onnxruntime.
    table = descriptors.flatten(2).transpose(1, 2).reshape(-1, dim)
    first = (torch.arange(batch, device=uv.device) * (h * w))[:, None]
    sampled = sum(
        table[(v * w + u).long() + first] * weight.unsqueeze(-1)
        for v, u, weight in (
            (top, left, (1.0 - along_v) * (1.0 - along_u)),
            (top, right, (1.0 - along_v) * along_u),
            (bottom, left, along_v * (1.0 - along_u)),
            (bottom, right, along_v * along_u),
        )
    )
    return F.normalize(sampled, dim=-1)
