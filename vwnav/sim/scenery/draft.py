"""A landscape in the making, which planting and building add to."""

from dataclasses import dataclass, field

import numpy as np

from vwnav.sim.scenery.landscape import (
    Bend,
    Building,
    Cell,
    Ground,
    Land,
    ParkedVehicle,
    Plant,
    Strip,
)
from vwnav.types import Array

HALF_NORTH_M = 600.0
HALF_EAST_M = 800.0
MARGIN_M = 150.0  # drawn beyond the nominal site, so that windows at its rim are not bare


@dataclass(slots=True)
class Draft:
    """A landscape in the making."""

    seed: int
    rng: np.random.Generator
    ground: Ground = field(
        default_factory=lambda: Ground(HALF_NORTH_M + MARGIN_M, HALF_EAST_M + MARGIN_M)
    )
    bend: Bend = field(init=False)
    plots: list[tuple[Land, Array]] = field(default_factory=list)  # before bending
    cells: list[Cell] = field(default_factory=list)
    strips: list[Strip] = field(default_factory=list)
    plants: list[Plant] = field(default_factory=list)
    buildings: list[Building] = field(default_factory=list)
    vehicles: list[ParkedVehicle] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.bend = Bend.random(self.rng)
