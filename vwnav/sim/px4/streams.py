"""Which messages PX4 sends on a link, and how often by default."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from vwnav.sim.mavlink.schedule import Schedule
from vwnav.sim.multirotor.simulated import STEP_S

_FASTEST_S = STEP_S
_DIVIDED_BELOW_S = 0.008  # shorter intervals are whole steps: 5 ms gives 125 Hz

# Hz, as recorded on the companion link of PX4 1.18 (DISTANCE_SENSOR only when asked for)
COMPANION_RATES: dict[int, float] = {
    0: 1.0,
    1: 5.0,
    2: 1.0,
    4: 1.0,
    24: 8.0,
    29: 1.0,
    30: 100.0,
    31: 50.0,
    32: 30.0,
    33: 50.0,
    36: 10.0,
    42: 1.0,
    65: 5.0,
    74: 10.0,
    83: 10.0,
    85: 10.0,
    105: 50.0,
    141: 10.0,
    147: 0.5,
    230: 1.0,
    241: 0.5,
    242: 0.5,
    245: 5.0,
    331: 30.0,
    436: 0.5,
}
# PX4's "normal" mode, for a ground station on a thin link
GROUND_RATES: dict[int, float] = {
    0: 1.0,
    1: 1.0,
    2: 1.0,
    4: 0.1,
    24: 1.0,
    30: 15.0,
    32: 1.0,
    33: 5.0,
    42: 1.0,
    65: 5.0,
    74: 4.0,
    85: 1.5,
    141: 1.0,
    147: 0.5,
    230: 0.5,
    241: 0.1,
    242: 0.5,
    245: 1.0,
    436: 0.5,
}


def truth_rates(rate_hz: float) -> dict[int, float]:
    """The truth link carries a heartbeat and HIL_STATE_QUATERNION only."""
    return {0: 1.0, 115: rate_hz}


def schedule_of(
    rates_hz: dict[int, float], builders: Mapping[int, Callable[[Any], Any]]
) -> Schedule:
    """A link's schedule of the messages that there are; PX4 divides fast rates from its own."""
    return Schedule(rates_hz, builders, _reachable)


def _reachable(interval_s: float) -> float:
    if interval_s >= _DIVIDED_BELOW_S:
        return interval_s
    return max(1, math.ceil(interval_s / _FASTEST_S - 1e-6)) * _FASTEST_S
