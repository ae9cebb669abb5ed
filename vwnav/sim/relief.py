"""The shape of the simulated ground: a plane that rises, hills, and woods that stand on it."""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vwnav.sim.smooth_noise import HALF_M, smooth_noise

_HILLS_NODE_M, _WOODS_NODE_M = 50, 12  # hills are some 150 m apart, woods some 40 m
_WOODED = 0.3  # sigmas of the noise from where on there is wood, over ...
_EDGE = 0.25  # ... so many of which it grows to its height: 2 or 3 m
_LEVEL_M, _SHAPED_M = 12.0, 30.0  # from home: it stands on level ground, and the relief is whole


@dataclass(frozen=True, slots=True, kw_only=True)
class Relief:
    """Heights over the origin, where it is level at height zero.

    Attributes:
        slope_ne: rise per metre north and east.
        hills_m: one sigma of their height.
        woods_m: height of the trees that stand on a third of the ground.
        seed: of where hills and woods are.
    """

    slope_ne: tuple[float, float] = (0.0, 0.0)
    hills_m: float = 0.0
    woods_m: float = 0.0
    seed: int = 1

    @property
    def plane(self) -> bool:
        """Whether nothing stands on the slope."""
        return self.hills_m == 0.0 and self.woods_m == 0.0

    def height_m(self, north_m: float, east_m: float) -> float:
        """Of the ground or of what stands on it."""
        slope_m = self.slope_ne[0] * north_m + self.slope_ne[1] * east_m
        if self.plane:
            return slope_m
        heights = _heights(self.hills_m, self.woods_m, self.seed)
        row = min(max(north_m + HALF_M, 0.0), 2.0 * HALF_M - 1.001)
        column = min(max(east_m + HALF_M, 0.0), 2.0 * HALF_M - 1.001)
        i, j = int(row), int(column)
        v, u = row - i, column - j
        south = (1.0 - u) * float(heights[i, j]) + u * float(heights[i, j + 1])
        north = (1.0 - u) * float(heights[i + 1, j]) + u * float(heights[i + 1, j + 1])
        return slope_m + (1.0 - v) * south + v * north

    def on_slope_m(
        self, north_m: NDArray[np.float32], east_m: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Height (h, w) of hills and woods over the slope, at places (h, w)."""
        import cv2  # the command line names a relief, and does without OpenCV

        heights = _heights(self.hills_m, self.woods_m, self.seed)
        where = east_m + np.float32(HALF_M), north_m + np.float32(HALF_M)
        return np.asarray(
            cv2.remap(heights, *where, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
            np.float32,
        )


@functools.lru_cache(maxsize=4)
def _heights(hills_m: float, woods_m: float, seed: int) -> NDArray[np.float32]:
    """(n, n) over the slope, a metre apart: row by row north, column by column east."""
    rng = np.random.default_rng([seed, 11])
    hills = hills_m * smooth_noise(rng, _HILLS_NODE_M)
    wooded = np.clip((smooth_noise(rng, _WOODS_NODE_M) - _WOODED) / _EDGE, 0.0, 1.0)
    axis = np.arange(2 * HALF_M, dtype=np.float32) - HALF_M
    far = np.clip((np.hypot(*np.meshgrid(axis, axis)) - _LEVEL_M) / (_SHAPED_M - _LEVEL_M), 0, 1)
    heights = hills - hills[HALF_M, HALF_M] + np.float32(woods_m) * wooded
    return np.asarray(far**2 * (3.0 - 2.0 * far) * heights, np.float32)
