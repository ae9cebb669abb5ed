"""How far a map is off from place to place, as the fixes of a flight show it.

The filter has an estimate m of the map's error e here, of variance P, out of a prior of variance
s^2. As of a single measurement y = e + n, n of variance v, that is m = f y, where f = 1 - P / s^2
and v = P / f. So y is of variance sigma^2 + v, whatever s was: the likelihood of every size sigma
of the error (a variance component; Mehra 1972, section V, calls it covariance matching). Places a
correlation length apart are independent, so a look counts for as much of it as was flown; the
noise of all looks is much the same (the place itself), so it counts for the f that it knows, too.

A shift of the whole map is not among it: who sees nothing but the map cannot tell.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

_SIZES = np.geomspace(1.0, 20.0, 48)  # that are thought of, in settings
LOOK_M = 5.0  # of the way, from look to look
_TELLS = 0.01  # f of a look that is heard
_TOLD_M = (1.0, 2.0, 4.0)  # sizes that the operator is told of


@dataclass(frozen=True, slots=True, eq=False)
class LearnedMapError:
    """What is known of the size of `States.MAP`.

    Attributes:
        sigma_m: per axis, as it is taken now: never less than the setting.
        stated_m: what it was taken for before anything was seen.
        seen_ne_m: (2,) where it was looked at last; infinitely far away before.
        log_likelihood: (n,) of each of the sizes, by all looks.
        opened_m: the largest that it was ever taken for.
        told_m: what the operator knows that it is at least.
        least_m: never less, since two pieces of the map were off from each other by that.
    """

    sigma_m: float = 0.0
    stated_m: float = 0.0
    seen_ne_m: tuple[float, float] = (math.inf, math.inf)
    log_likelihood: NDArray[np.float64] | None = None
    opened_m: float = 0.0
    told_m: float = 0.0
    least_m: float = 0.0

    def seen(
        self,
        place_ne_m: NDArray[np.float64],
        error_m: NDArray[np.float64],
        variance_m2: NDArray[np.float64],
        setting_m: float,
        length_m: float,
    ) -> "LearnedMapError":
        """What is known once a fix was fused, `LOOK_M` and more from the last look.

        Args:
            place_ne_m: (2,) where.
            error_m: (2,) of the map there, as the filter has it now.
            variance_m2: (2,) of that.
            setting_m: the size that the settings say.
            length_m: over which errors of places are alike.
        """
        place = float(place_ne_m[0]), float(place_ne_m[1])
        if self.log_likelihood is None:
            return replace(self, seen_ne_m=place, log_likelihood=np.zeros(len(_SIZES)))
        share = min(math.dist(place, self.seen_ne_m) / length_m, 1.0)
        sizes_m, told = setting_m * _SIZES, np.zeros(len(_SIZES))
        for m, P in zip(error_m.tolist(), variance_m2.tolist(), strict=True):
            f = 1.0 - P / self.sigma_m**2
            if f > _TELLS:
                variances = sizes_m**2 + P / f
                told -= 0.5 * f * share * (np.log(variances) + (m / f) ** 2 / variances)
        log_likelihood = self.log_likelihood + told
        prior = -0.5 * np.log(sizes_m / self.stated_m) ** 2  # a factor of e is one sigma
        sigma_m = max(float(sizes_m[np.argmax(prior + log_likelihood)]), self.least_m)
        return replace(self._of(sigma_m), seen_ne_m=place, log_likelihood=log_likelihood)

    def stepped(self, sigma_m: float) -> "LearnedMapError":
        """Two pieces were found to be off by so much each: neither shows it by itself."""
        size_m = max(self.sigma_m, sigma_m)
        return replace(self._of(size_m), least_m=size_m)

    def _of(self, sigma_m: float) -> "LearnedMapError":
        told_m = max([self.told_m, *(size for size in _TOLD_M if size <= sigma_m)])
        opened_m = max(self.opened_m, sigma_m)
        return replace(self, sigma_m=sigma_m, opened_m=opened_m, told_m=told_m)

    @classmethod
    def stated(cls, sigma_m: float) -> "LearnedMapError":
        """Of a map over which nothing has flown yet."""
        return cls(sigma_m, stated_m=sigma_m, opened_m=sigma_m, told_m=sigma_m)

    @property
    def words(self) -> str:
        """What the operator reads once it has grown so that he should."""
        return f"the map is off by {self.sigma_m:.1f} m (1 sigma) from place to place"
