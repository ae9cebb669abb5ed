"""Anti-aliased polygons and ribbons on a window of the plane."""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.sim.scenery.noise import Field, NedWindow, NoiseBank
from vwnav.types import Array

_SUB = 4  # sub-pixels per pixel and axis in masks
_SHIFT = 4  # fractional bits of OpenCV's polygon corners
_MAX_SIGMA_PX = 40.0
_EDGE_SALT = 5
Box = tuple[int, int, int, int]
Colour = NDArray[np.float32] | NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """A part of a canvas and the coverage (h, w) of a shape in it, 0 to 1."""

    rows: slice
    cols: slice
    alpha: Field

    def cut(self, field_hw: NDArray[np.float32]) -> NDArray[np.float32]:
        """The part of a whole-canvas field (h, w, ...) under this patch."""
        return field_hw[self.rows, self.cols]


@dataclass(slots=True, eq=False)
class Canvas:
    """An image being drawn: bgr (h, w, 3) float32, 0 to 255, in a window of the plane."""

    window: NedWindow
    seed: int
    bgr: NDArray[np.float32] = field(init=False)
    noise: NoiseBank = field(init=False)

    def __post_init__(self) -> None:
        self.bgr = np.zeros((self.window.height, self.window.width, 3), np.float32)
        self.noise = NoiseBank(self.window, self.seed)

    def polygon(self, points_ne: Array, ragged_m: float = 0.0) -> Patch | None:
        """Coverage of a simple polygon (n, 2), None outside the window or without area.

        Args:
            points_ne: corners, north and east.
            ragged_m: by how much a natural edge wanders, 0 for a sharp one.
        """
        margin = self._margin(ragged_m)
        box = self._box(points_ne, 0.0, margin) if len(points_ne) > 2 else None
        if box is None:
            return None
        mask, corners = self._sub_mask(box, points_ne)
        cv2.fillPoly(mask, [corners], 255, cv2.LINE_8, _SHIFT)
        return self._finish(box, mask, ragged_m)

    def ribbon(self, points_ne: Array, width_m: float, ragged_m: float = 0.0) -> Patch | None:
        """Coverage of a line (n, 2) of constant width; lines under half a pixel turn faint."""
        drawn_m = max(width_m, 0.6 * self.window.m_per_px)
        margin = self._margin(ragged_m)
        near = self._near(points_ne, drawn_m + margin * self.window.m_per_px)
        box = self._box(points_ne[near], drawn_m, margin) if near.any() else None
        if box is None:
            return None
        # OpenCV fills the outline too, half a sub-pixel on each side.
        left, right = ribbon_sides(points_ne, drawn_m - self.window.m_per_px / _SUB)
        mask, left_px = self._sub_mask(box, left)
        right_px = self._sub_corners(box, right)
        for i in np.flatnonzero(near[:-1] & near[1:]):
            quad = np.array([left_px[i], left_px[i + 1], right_px[i + 1], right_px[i]])
            cv2.fillConvexPoly(mask, quad, 255, cv2.LINE_8, _SHIFT)
        patch = self._finish(box, mask, ragged_m)
        if patch is not None:
            patch.alpha[...] *= width_m / drawn_m
        return patch

    def box(self, points_ne: Array, margin_m: float) -> Box | None:
        """Pixel box u0, v0, u1, v1 (half open) around points, cut to the window."""
        return self._box(points_ne, margin_m, 0)

    def _box(self, points_ne: Array, margin_m: float, outside_px: int) -> Box | None:
        """The same, cut to the window with so many pixels around it."""
        uv = self.window.uv(points_ne)
        margin = margin_m / self.window.m_per_px + 1.0
        low, high = -outside_px, np.array([self.window.width, self.window.height]) + outside_px
        u0, v0 = np.maximum(np.floor(uv.min(axis=0) - margin), low).astype(int).tolist()
        u1, v1 = np.minimum(np.ceil(uv.max(axis=0) + margin) + 1, high).astype(int).tolist()
        return (u0, v0, u1, v1) if u1 > u0 and v1 > v0 else None

    def blend(self, patch: Patch | None, colour: Colour, opacity: float = 1.0) -> None:
        """Lay a colour (3,) or image (h, w, 3) over the patch."""
        if patch is not None:
            below = self.bgr[patch.rows, patch.cols]
            paint = np.asarray(colour, np.float32)
            below += (patch.alpha * np.float32(opacity))[..., None] * (paint - below)

    def scale(self, patch: Patch | None, gain: float) -> None:
        """Multiply what lies under the patch (1 leaves it, 0.5 halves it)."""
        if patch is not None:
            factor = 1.0 + patch.alpha * np.float32(gain - 1.0)
            self.bgr[patch.rows, patch.cols] *= factor[..., None]

    def _margin(self, ragged_m: float) -> int:
        """Pixels around the window that a ragged edge must know, or windows would not agree."""
        return int(np.ceil(3.0 * min(ragged_m / self.window.m_per_px, _MAX_SIGMA_PX)))

    def _finish(self, box: Box, mask: NDArray[np.uint8], ragged_m: float) -> Patch | None:
        """Coverage from a mask of sub-pixels, its edge made ragged, cut to the window."""
        u0, v0, u1, v1 = box
        small = cv2.resize(mask, (u1 - u0, v1 - v0), interpolation=cv2.INTER_AREA)
        alpha = np.asarray(small.astype(np.float32) / np.float32(255.0), np.float32)
        rows = slice(max(v0, 0), min(v1, self.window.height))
        cols = slice(max(u0, 0), min(u1, self.window.width))
        if rows.stop <= rows.start or cols.stop <= cols.start:
            return None
        sigma = min(ragged_m / self.window.m_per_px, _MAX_SIGMA_PX)
        if sigma >= 0.3:
            alpha = np.asarray(cv2.GaussianBlur(alpha, (0, 0), sigma), np.float32)
        alpha = alpha[rows.start - v0 : rows.stop - v0, cols.start - u0 : cols.stop - u0]
        if sigma >= 0.3:
            alpha = self._wandering(alpha, (rows, cols), ragged_m, sigma)
        return Patch(rows, cols, np.ascontiguousarray(alpha))

    def _wandering(
        self, soft: Field, part: tuple[slice, slice], ragged_m: float, sigma_px: float
    ) -> Field:
        """A blurred coverage cut sharp again along a line that noise moves to and fro."""
        wander = self.noise.fractal(ragged_m * 4.0, ragged_m * 0.25, 0.8, _EDGE_SALT)[part]
        wander = np.clip(wander, -1.9, 1.9)  # rare extremes would punch holes far from the edge
        slope = np.float32(max(1.0, 2.5 * min(sigma_px, 4.0)))
        edge = np.clip((soft + np.float32(0.22) * wander - 0.5) * slope + 0.5, 0.0, 1.0)
        return np.asarray(edge * (soft > 0.02), np.float32)

    def _near(self, points_ne: Array, margin_m: float) -> NDArray[np.bool_]:
        """Points (n,) that belong to a segment that may touch the window."""
        south, west, north, east = self.window.bounds()
        low = np.minimum(points_ne[:-1], points_ne[1:]) - margin_m
        high = np.maximum(points_ne[:-1], points_ne[1:]) + margin_m
        hit = (low[:, 0] < north) & (high[:, 0] > south) & (low[:, 1] < east) & (high[:, 1] > west)
        near = np.zeros(len(points_ne), bool)
        near[:-1] |= hit
        near[1:] |= hit
        return near

    def _sub_mask(self, box: Box, points_ne: Array) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
        u0, v0, u1, v1 = box
        mask = np.zeros(((v1 - v0) * _SUB, (u1 - u0) * _SUB), np.uint8)
        return mask, self._sub_corners(box, points_ne)

    def _sub_corners(self, box: Box, points_ne: Array) -> NDArray[np.int32]:
        uv = self.window.uv(points_ne) - np.array(box[:2], np.float64)
        return np.asarray(np.round(((uv + 0.5) * _SUB - 0.5) * 2**_SHIFT), np.int32)


def ribbon_sides(points_ne: Array, width_m: float) -> tuple[Array, Array]:
    """Left and right edge (n, 2) of a line of constant width, mitred at its bends."""
    return offset_line(points_ne, -width_m / 2.0), offset_line(points_ne, width_m / 2.0)


def offset_line(points_ne: Array, right_m: float) -> Array:
    """The line moved to its right by `right_m` (seen from above, along the line)."""
    step = np.diff(points_ne, axis=0)
    step /= np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9)
    normal = np.stack([-step[:, 1], step[:, 0]], axis=1)
    ends = np.vstack([normal[:1], normal, normal[-1:]])
    mean = ends[:-1] + ends[1:]
    # |n0 + n1|^2 / 2 is the cosine that lengthens a mitre; capped so that spikes stay short.
    mitre = 2.0 * mean / np.maximum(np.sum(mean**2, axis=1, keepdims=True), 1.0)
    return np.asarray(points_ne + right_m * mitre, np.float64)
