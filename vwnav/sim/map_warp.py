"""By how much a map shows the simulated ground beside where it is."""

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vwnav.sim.smooth_noise import HALF_M, smooth_noise

_NODE_M = 100
_EVERYWHERE = 0.5  # of the variance is a shift of the whole map, the rest waves some 300 m long


@dataclass(frozen=True, slots=True, kw_only=True)
class MapWarp:
    """What stands at a place is drawn on the map elsewhere, smoothly: a shift, and a warp.

    Attributes:
        sigma_m: of the displacement over all maps, per axis; 0: the map is right.
        seed: of which map.
    """

    sigma_m: float = 0.0
    seed: int = 1

    @property
    def shift_sigma_m(self) -> float:
        """Of the shift of the whole map, per axis: what nobody on it can tell."""
        return math.sqrt(_EVERYWHERE) * self.sigma_m

    def at_m(
        self, north_m: NDArray[np.float32], east_m: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """(h, w, 2) north and east, from places (h, w) to where the map shows them."""
        import cv2

        where = east_m + np.float32(HALF_M), north_m + np.float32(HALF_M)
        waves = _waves(self.seed)
        return np.float32(self.sigma_m) * np.asarray(
            cv2.remap(waves, *where, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32
        )


@functools.lru_cache(maxsize=2)
def _waves(seed: int) -> NDArray[np.float32]:
    """(n, n, 2) of unit variance over all seeds, a metre apart: row by row north."""
    rng = np.random.default_rng([seed, 12])
    shift = rng.standard_normal(2) * math.sqrt(_EVERYWHERE)
    share = np.float32(math.sqrt(1.0 - _EVERYWHERE))
    axes = [np.float32(each) + share * smooth_noise(rng, _NODE_M) for each in shift]
    return np.stack(axes, axis=-1)
