"""Terrain heights under a map."""

import hashlib
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vwnav.types import Array

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
        height_m = float(self.at_each(np.array([lat_deg]), np.array([lon_deg]))[0])
        return height_m if np.isfinite(height_m) else None

    def at_each(self, lat_deg: Array, lon_deg: Array) -> Array:
        """The same of places (n,), (n,): (n,), NaN where it is not known."""
        south, west, north, east = self.bounds
        rows, columns = self.heights_m.shape
        row = (north - lat_deg) / (north - south) * (rows - 1)
        column = (lon_deg - west) / (east - west) * (columns - 1)
        inside = (row >= 0.0) & (row <= rows - 1) & (column >= 0.0) & (column <= columns - 1)
        row, column = np.where(inside, row, 0.0), np.where(inside, column, 0.0)
        r = np.minimum(row.astype(int), rows - 2)
        c = np.minimum(column.astype(int), columns - 2)
        down, right = row - r, column - c
        upper = (1.0 - right) * self.heights_m[r, c] + right * self.heights_m[r, c + 1]
        lower = (1.0 - right) * self.heights_m[r + 1, c] + right * self.heights_m[r + 1, c + 1]
        return np.where(inside, (1.0 - down) * upper + down * lower, np.nan)

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
