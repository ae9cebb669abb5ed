"""What the filter's steps are told besides the state: settings, attitudes, the ground."""

from collections.abc import Callable
from dataclasses import dataclass

from vwnav.estimation.attitudes import AttitudeHistory
from vwnav.estimation.states import EkfConfig

# Height of the ground in metres at (north, east) about the origin, None where it is not known.
# Only differences are used: the table may have another datum.
Ground = Callable[[float, float], float | None]


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """Handed to every step; the attitudes grow, the rest stays."""

    config: EkfConfig
    attitudes: AttitudeHistory
    ground: Ground | None = None

    def rise_m(self, from_ne: tuple[float, float], to_ne: tuple[float, float]) -> float | None:
        """By how much the ground rises between two places, as the table has it."""
        if self.ground is None:
            return None
        before_m, after_m = self.ground(*from_ne), self.ground(*to_ne)
        return None if before_m is None or after_m is None else after_m - before_m
