"""ArduCopter's failsafes and its battery: what has gone wrong just now, what it does about it."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from vwnav.sim.copter.modes import Mode
from vwnav.sim.copter.parameters import CopterParameters
from vwnav.sim.mavlink.command import Severity

_EKF_PERIOD_S = 0.1
_EKF_COUNT = 10  # checks in a row, to raise it and to clear it
_BATTERY_ACTIONS = {1: Mode.LAND, 2: Mode.RTL}  # BATT_FS_LOW_ACT, BATT_FS_CRT_ACT
_GCS_ACTIONS = {1: Mode.RTL, 5: Mode.LAND}  # FS_GCS_ENABLE
_RADIO_ACTIONS = {1: Mode.RTL, 3: Mode.LAND}  # FS_THR_ENABLE

Say = Callable[[Severity, str], None]

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


@dataclass(frozen=True, slots=True, kw_only=True)
class CopterHealth:
    """What is looked at, fifty times a second.

    Attributes:
        may_hold: there is a position, and no failsafe says that there is none.
        settled: it has stood with an origin for long enough to arm.
        gcs_silent_s: since a ground station was heard; infinity when none ever was.
        radio_lost: there was a radio, and it is not heard any more.
    """

    position_ok: bool
    may_hold: bool
    attitude_ok: bool
    vision_ok: bool
    settled: bool
    gcs_silent_s: float
    radio_lost: bool
    battery_level: int
    landed: bool


class Failsafes:
    """Each raises once, and lasts until its cause is gone; the battery's until reboot.

    Attributes:
        ekf: the position is lost.
    """

    def __init__(self, parameters: CopterParameters, battery: CopterBattery, say: Say) -> None:
        self._parameters = parameters
        self._battery = battery
        self._say = say
        self._ekf_count = 0
        self._ekf_looked_s = -math.inf
        self.ekf = self._gcs = self._radio = False

    @property
    def active(self) -> bool:
        """For the system status."""
        return self.ekf or self._gcs or self._radio or self._battery.level > 0

    def step(self, health: CopterHealth, armed: bool, dt_s: float) -> list[Mode]:
        """Look; the modes to change to now, the most urgent last."""
        wanted = [
            self._look_at_gcs(health),
            self._look_at_radio(health),
            self._look_at_battery(armed, dt_s),
        ]
        flies = armed and not health.landed
        return [mode for mode in wanted if mode is not None and flies]

    def _look_at_battery(self, armed: bool, dt_s: float) -> Mode | None:
        battery = self._battery
        if not battery.step(armed, dt_s):
            return None
        self._say(Severity.WARNING, battery.text)
        self._say(Severity.WARNING, "Battery Failsafe")
        name = "BATT_FS_CRT_ACT" if battery.level == CRITICAL else "BATT_FS_LOW_ACT"
        return _BATTERY_ACTIONS.get(int(self._parameters[name]))

    def _look_at_gcs(self, health: CopterHealth) -> Mode | None:
        action = _GCS_ACTIONS.get(int(self._parameters["FS_GCS_ENABLE"]))
        was, silent_s = self._gcs, health.gcs_silent_s
        ever = silent_s < math.inf
        self._gcs = bool(action and ever and silent_s > self._parameters["FS_GCS_TIMEOUT"])
        return self._changed("GCS Failsafe", was, self._gcs, action)

    def _look_at_radio(self, health: CopterHealth) -> Mode | None:
        action = _RADIO_ACTIONS.get(int(self._parameters["FS_THR_ENABLE"]))
        was, self._radio = self._radio, action is not None and health.radio_lost
        return self._changed("Radio Failsafe", was, self._radio, action)

    def _changed(self, text: str, was: bool, now: bool, action: Mode | None) -> Mode | None:
        if was != now:
            self._say(Severity.WARNING, text if now else f"{text} Cleared")
        return action if now and not was else None

    def has_lost_position(self, health: CopterHealth, armed: bool, t_s: float) -> bool:
        """Just now; ten checks without a position in a row raise it, ten with one clear it."""
        if not armed:
            self._ekf_count, self.ekf = 0, False
            return False
        if t_s - self._ekf_looked_s < _EKF_PERIOD_S - 1e-6:
            return False
        self._ekf_looked_s = t_s
        change = -1 if health.position_ok else 1
        self._ekf_count = min(max(self._ekf_count + change, 0), _EKF_COUNT)
        if self.ekf and self._ekf_count == 0:
            self.ekf = False
            self._say(Severity.CRITICAL, "EKF Failsafe Cleared")
        elif not self.ekf and self._ekf_count == _EKF_COUNT:
            self.ekf = True
            self._say(Severity.CRITICAL, "EKF variance")
            return int(self._parameters["FS_EKF_ACTION"]) > 0
        return False
