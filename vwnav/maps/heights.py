"""Terrain heights under a map."""

import hashlib
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MAX_SIDE = 4096


@dataclass(frozen=True, slots=True, eq=False)
class HeightGrid:
    """Heights of the ground above mean sea level at the nodes of an even grid in degrees.

    Attributes:
        bounds: south, west, north, east of the outermost nodes, degrees.
        heights_m: (rows, columns) float32, the first row is the northern one; NaN is a hole.
    """

    bounds: tuple[float, float, float, float]
    heights_m: NDArray[np.float32]

    def __post_init__(self) -> None:
        rows, columns = self.heights_m.shape
        if not (2 <= rows <= MAX_SIDE and 2 <= columns <= MAX_SIDE):
            raise ValueError(f"expected 2 to {MAX_SIDE} heights a side, got {rows} x {columns}")
        south, west, north, east = self.bounds
        if not (south < north and west < east):
            raise ValueError(f"expected south, west, north, east, got {self.bounds}")

    def at(self, lat_deg: float, lon_deg: float) -> float | None:
        """Height in metres above mean sea level, bilinear; None outside and next to holes."""
        south, west, north, east = self.bounds
        rows, columns = self.heights_m.shape
        row = (north - lat_deg) / (north - south) * (rows - 1)
        column = (lon_deg - west) / (east - west) * (columns - 1)
        if not (0.0 <= row <= rows - 1 and 0.0 <= column <= columns - 1):
            return None
        r, c = min(int(row), rows - 2), min(int(column), columns - 2)
        weights = np.outer([r + 1 - row, row - r], [c + 1 - column, column - c])
        height = float((weights * self.heights_m[r : r + 2, c : c + 2]).sum())
        return height if np.isfinite(height) else None

    @property
    def identity(self) -> str:
        """Equal for grids that give the same heights everywhere."""
        return hashlib.sha256(
            repr((self.bounds, self.heights_m.shape)).encode() + self.heights_m.tobytes()
        ).hexdigest()

    def encoded(self) -> bytes:
        """The heights, compressed."""
        return zlib.compress(self.heights_m.astype("<f4").tobytes())

    @classmethod
    def decoded(
        cls, data: bytes, shape: tuple[int, int], bounds: tuple[float, float, float, float]
    ) -> "HeightGrid":
        """The inverse of `encoded`.

        Raises:
            ValueError: not so many heights.
            zlib.error: damaged.
        """
        heights = np.frombuffer(zlib.decompress(data), "<f4").reshape(shape)
        return cls(bounds, heights.astype(np.float32))
