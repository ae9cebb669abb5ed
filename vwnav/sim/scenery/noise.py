"""Smooth random fields of the plane that are the same in every window and at every resolution."""

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.types import Array

Field = NDArray[np.float32]
FINEST_CELL_M = 0.025
_PERIOD = 512  # cells after which an octave repeats
_COARSE = 4  # wide octaves are made at this fraction of the resolution
_CELLS_M = tuple(FINEST_CELL_M * 2.0**k for k in range(14))
# Standard deviation of uniform [-1, 1) lattice values under the bicubic B-spline.
_SPLINE_STD = float(np.sqrt(1.0 / 3.0) * 151.0 / 315.0)


@dataclass(frozen=True, slots=True)
class NedWindow:
    """A north-up rectangle of the local NED plane and its pixels.

    Attributes:
        north0_m, east0_m: the outer upper-left corner (edge of pixel (0, 0), not its centre).
        width, height: pixels.
    """

    north0_m: float
    east0_m: float
    width: int
    height: int
    m_per_px: float

    def uv(self, points_ne: Array) -> Array:
        """Pixels (n, 2), centres at integers, of points (n, 2) north, east in metres."""
        u = (points_ne[..., 1] - self.east0_m) / self.m_per_px - 0.5
        v = (self.north0_m - points_ne[..., 0]) / self.m_per_px - 0.5
        return np.stack([u, v], axis=-1)

    def east_m(self) -> Array:
        """East (width,) of the pixel centres."""
        return np.asarray(self.east0_m + (np.arange(self.width) + 0.5) * self.m_per_px, np.float64)

    def north_m(self) -> Array:
        """North (height,) of the pixel centres."""
        v = np.arange(self.height) + 0.5
        return np.asarray(self.north0_m - v * self.m_per_px, np.float64)

    def bounds(self) -> tuple[float, float, float, float]:
        """South, west, north, east edges in metres."""
        south = self.north0_m - self.height * self.m_per_px
        return south, self.east0_m, self.north0_m, self.east0_m + self.width * self.m_per_px

    def grown(self, margin_px: int) -> "NedWindow":
        """The same pixels with a margin on every side."""
        margin_m = margin_px * self.m_per_px
        return NedWindow(
            self.north0_m + margin_m,
            self.east0_m - margin_m,
            self.width + 2 * margin_px,
            self.height + 2 * margin_px,
            self.m_per_px,
        )


def hashed(*keys: int) -> int:
    """A well-mixed 32 bit number of a few integers.

    The mixer is lowbias32 of C. Wellons, "Prospecting for hash functions" (2018).
    """
    h = 0x9E3779B9
    for key in keys:
        h = (h ^ (key & 0xFFFFFFFF)) * 0x7FEB352D & 0xFFFFFFFF
        h = (h ^ (h >> 15)) * 0x846CA68B & 0xFFFFFFFF
        h ^= h >> 16
    return h


@lru_cache(maxsize=1)
def _lattice() -> Field:
    """One periodic lattice (512, 512) of unit-variance spline coefficients for all octaves."""
    values = np.random.default_rng(0x1A77).uniform(-1.0, 1.0, (_PERIOD, _PERIOD))
    return (values / _SPLINE_STD).astype(np.float32)


@lru_cache(maxsize=1)
def _surface() -> Field:
    """The spline of the lattice at every half cell (2048, 2048): two periods each way."""
    spots = np.arange(4 * _PERIOD) / 2.0
    rows = _spline_sum(_lattice(), spots)
    return np.ascontiguousarray(_spline_sum(np.ascontiguousarray(rows.T), spots).T)


@dataclass(slots=True)
class NoiseBank:
    """Octaves of noise over one window, each computed once and shared by all materials."""

    window: NedWindow
    seed: int
    _octaves: dict[tuple[int, int], Field] = field(default_factory=dict)
    _coarse: "NoiseBank | None" = None
    _sums: dict[tuple[float, float, float, int], Field] = field(default_factory=dict)

    def fractal(self, coarsest_m: float, finest_m: float, persistence: float, salt: int) -> Field:
        """Sum of octaves of unit variance in all (h, w); cells below the pixel fade out."""
        key = (coarsest_m, finest_m, persistence, salt)
        if key not in self._sums:
            self._sums[key] = self._sum(*key)
        return self._sums[key]

    def _sum(self, coarsest_m: float, finest_m: float, persistence: float, salt: int) -> Field:
        chosen = [k for k, c in enumerate(_CELLS_M) if finest_m <= c * 1.001 <= coarsest_m * 1.01]
        amplitudes = persistence ** np.arange(len(chosen))[::-1]
        amplitudes /= np.sqrt(np.sum(amplitudes**2))
        visible = np.clip(np.array(_CELLS_M)[chosen] / self.window.m_per_px / 1.3 - 1.0, 0.0, 1.0)
        return self.combine(dict(zip(chosen, amplitudes * visible, strict=True)), salt)

    def combine(self, amplitudes: dict[int, float], salt: int) -> Field:
        """Sum of octaves (h, w) by number; wide ones are made at a fraction of the resolution."""
        total = np.zeros((self.window.height, self.window.width), np.float32)
        wide = {k: a for k, a in amplitudes.items() if _CELLS_M[k] >= 16.0 * self.window.m_per_px}
        if wide:
            # The coarse grid lies on the ground, not in the window, so that all windows agree.
            left, top = self._offset()
            small = self._coarse_bank().combine(wide, salt)
            large = cv2.resize(small, None, fx=_COARSE, fy=_COARSE, interpolation=cv2.INTER_CUBIC)
            total += large[top : top + self.window.height, left : left + self.window.width]
        for k, amplitude in amplitudes.items():
            if k not in wide and amplitude > 0.0:
                cv2.scaleAdd(self._sampled(k, salt), float(amplitude), total, total)
        return total

    def _offset(self) -> tuple[int, int]:
        """Columns and rows of the coarse bank, in own pixels, before the window begins."""
        w = self.window
        left = round(w.east0_m / w.m_per_px) % _COARSE + 2 * _COARSE
        return left, round(-w.north0_m / w.m_per_px) % _COARSE + 2 * _COARSE

    def _coarse_bank(self) -> "NoiseBank":
        if self._coarse is None:
            w, (left, top) = self.window, self._offset()
            self._coarse = NoiseBank(
                NedWindow(
                    w.north0_m + top * w.m_per_px,
                    w.east0_m - left * w.m_per_px,
                    -(-(w.width + left) // _COARSE) + 2,
                    -(-(w.height + top) // _COARSE) + 2,
                    w.m_per_px * _COARSE,
                ),
                self.seed,
            )
        return self._coarse

    def _sampled(self, k: int, salt: int) -> Field:
        """One octave, bilinear from the half-cell surface: exact enough at a few pixels a cell."""
        if (k, salt) not in self._octaves:
            h = hashed(self.seed, salt, k)
            cell_m = _CELLS_M[k]
            x = (float(self.window.east_m()[0]) / cell_m + h % _PERIOD) % _PERIOD
            y = (-float(self.window.north_m()[0]) / cell_m + (h >> 12) % _PERIOD) % _PERIOD
            step = 2.0 * self.window.m_per_px / cell_m
            matrix = np.array([[step, 0.0, 2.0 * x], [0.0, step, 2.0 * y]])
            size = (self.window.width, self.window.height)
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            self._octaves[k, salt] = np.asarray(
                cv2.warpAffine(_surface(), matrix, size, flags=flags), np.float32
            )
        return self._octaves[k, salt]


def _spline_sum(values: Field, positions: Array) -> Field:
    """Cubic B-spline along the first axis of periodic values (m, k) at positions (n,): (n, k)."""
    cell = np.floor(positions).astype(np.int64)
    f = (positions - cell).astype(np.float32)[:, None]
    weights = (
        (1.0 - f) ** 3 / 6.0,
        (3.0 * f**3 - 6.0 * f**2 + 4.0) / 6.0,
        (-3.0 * f**3 + 3.0 * f**2 + 3.0 * f + 1.0) / 6.0,
        f**3 / 6.0,
    )
    parts = (w * values.take(cell - 1 + k, axis=0, mode="wrap") for k, w in enumerate(weights))
    return np.asarray(sum(parts), np.float32)


def noise_1d(t: Array, cell_m: float, salt: int) -> Array:
    """Unit-variance cubic noise (n,) along a line, t in metres."""
    values = np.random.default_rng(salt).uniform(-1.0, 1.0, (4096, 1)).astype(np.float32)
    scale = np.sqrt(_SPLINE_STD * np.sqrt(1.0 / 3.0))
    return np.asarray(_spline_sum(values, t / cell_m)[:, 0] / scale, np.float64)
