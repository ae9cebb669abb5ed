"""What the filter's steps are told besides the state: settings, attitudes, the ground."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from vwnav.estimation.config import EkfConfig
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.inertial.integrals import ImuIntegrals
from vwnav.estimation.states import FilterState, States

# Height of the ground in metres at (north, east) about the origin, None where it is not known.
# Only differences are used: the table may have another datum.
Ground = Callable[[float, float], float | None]

_NODE_M = 5.0  # the table is read at nodes so far apart, and is a smooth patch between them
_MOST_NODES = 10_000  # kept: some 15 km of the way, 2 MB


@dataclass(frozen=True, slots=True)
class TerrainPatch:
    """The ground at a place: its height, and by how much it rises per metre north and east."""

    height_m: float
    per_north: float
    per_east: float


class Felt(Protocol):
    """What the steps ask of the `ImuHistory`."""

    @property
    def heard(self) -> bool:
        """Whether a sample ever came."""
        ...

    def until(self, t_s: float) -> ImuIntegrals | None:
        """All that was felt until `t_s`; None before the first sample and in a silence."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """Handed to every step; attitudes and IMU samples grow, the rest stays."""

    config: EkfConfig
    attitudes: AttitudeHistory
    imu: Felt
    ground: Ground | None = None
    _nodes: dict[tuple[int, int], float | None] = field(default_factory=dict)

    def patch(self, north_m: float, east_m: float) -> TerrainPatch | None:
        """The ground at a place, as the table has it; bilinear between nodes.

        Nodes are kept: a table on disk or behind a map projection is slow.
        """
        if self.ground is None:
            return None
        row, column = math.floor(north_m / _NODE_M), math.floor(east_m / _NODE_M)
        sw, se = self._node(row, column), self._node(row, column + 1)
        nw, ne = self._node(row + 1, column), self._node(row + 1, column + 1)
        if sw is None or se is None or nw is None or ne is None:
            return None
        v, u = north_m / _NODE_M - row, east_m / _NODE_M - column
        south, north = sw + u * (se - sw), nw + u * (ne - nw)
        per_east = ((1.0 - v) * (se - sw) + v * (ne - nw)) / _NODE_M
        return TerrainPatch(south + v * (north - south), (north - south) / _NODE_M, per_east)

    def _node(self, row: int, column: int) -> float | None:
        key = (row, column)
        if key not in self._nodes:
            assert self.ground is not None
            if len(self._nodes) >= _MOST_NODES:
                self._nodes.clear()
            self._nodes[key] = self.ground(row * _NODE_M, column * _NODE_M)
        return self._nodes[key]


def patch_below(state: FilterState, context: Context) -> TerrainPatch | None:
    """The ground below a state, as the table has it; None where nobody knows where that is.

    A place that only stands for an unknown one has no ground: the slope there tilted the view of a
    level field by 17 degrees, and its height was 30 m off at the first fix.
    """
    if not state.position_known:
        return None
    return context.patch(*state.x[States.POSITION_NE].tolist())
