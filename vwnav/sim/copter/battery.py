"""A three-cell battery, and when ArduCopter finds it low or critical."""

from vwnav.sim.copter.parameters import CopterParameters

_FULL_V, _EMPTY_V = 12.6, 9.9
LOW, CRITICAL = 1, 2


class CopterBattery:
    """Charge 0..1.

    Attributes:
        level: 0 good, 1 low, 2 critical; a level once reached stays until reboot.
        text: what there was to say at the last change of the level.
    """

    def __init__(self, start: float, drain_s: float, parameters: CopterParameters) -> None:
        self._parameters = parameters
        self._drain_s = drain_s
        self.remaining = start
        self.consumed_mah = 0.0
        self.level = 0
        self.text = ""
        self._below_s = {LOW: 0.0, CRITICAL: 0.0}

    def step(self, armed: bool, dt_s: float) -> bool:
        """Drain for `dt_s` when armed; True when the level has just become worse."""
        if armed:
            used = min(self.remaining, dt_s / self._drain_s)
            self.remaining -= used
            self.consumed_mah += used * self._parameters["BATT_CAPACITY"]
        for level, name in ((CRITICAL, "BATT_CRT_VOLT"), (LOW, "BATT_LOW_VOLT")):
            is_below = self.voltage_v < self._parameters[name]
            self._below_s[level] = self._below_s[level] + dt_s if is_below else 0.0
            if level > self.level and self._below_s[level] > self._parameters["BATT_LOW_TIMER"]:
                self.level = level
                word = "critical" if level == CRITICAL else "low"
                used_mah = round(self.consumed_mah)
                self.text = f"Battery 1 is {word} {self.voltage_v:.2f}V used {used_mah} mAh"
                return True
        return False

    @property
    def voltage_v(self) -> float:
        """Of the whole pack."""
        return _EMPTY_V + (_FULL_V - _EMPTY_V) * self.remaining

    @property
    def charge_state(self) -> int:
        """MAV_BATTERY_CHARGE_STATE: OK 1, LOW 2, CRITICAL 3."""
        return 1 + self.level
