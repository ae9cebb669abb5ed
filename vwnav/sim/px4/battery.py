"""A four-cell battery that drains with time in flight, as PX4's battery simulator does."""

from vwnav.sim.px4.parameters import Px4Parameters

CELLS = 4
_FULL_V, _EMPTY_V = 4.05, 3.6  # per cell, PX4's simulator: 16.2 V full


class Px4Battery:
    """Charge 0..1; `warning` is 0 none, 1 low, 2 critical, 3 emergency (battery_status.warning)."""

    def __init__(self, start: float, parameters: Px4Parameters) -> None:
        self._parameters = parameters
        self.remaining = start
        self.consumed_mah = 0.0
        self.warning = 0

    def step(self, armed: bool, dt_s: float) -> None:
        """Drain for `dt_s` when armed, full to empty in SIM_BAT_DRAIN, and set the warning."""
        get = self._parameters
        left = self.remaining - 0.01 * get["SIM_BAT_MIN_PCT"]
        if armed and left > 0.0:
            used = min(left, dt_s / max(get["SIM_BAT_DRAIN"], 1.0))
            self.remaining -= used
            self.consumed_mah += 5000.0 * used
        thresholds = ((3, "BAT_EMERGEN_THR"), (2, "BAT_CRIT_THR"), (1, "BAT_LOW_THR"))
        self.warning = next((level for level, name in thresholds if self.remaining < get[name]), 0)

    @property
    def voltage_v(self) -> float:
        """Of the whole pack."""
        return CELLS * (_EMPTY_V + (_FULL_V - _EMPTY_V) * self.remaining)

    @property
    def charge_state(self) -> int:
        """MAV_BATTERY_CHARGE_STATE: OK 1, LOW 2, CRITICAL 3, EMERGENCY 4."""
        return 1 + self.warning
