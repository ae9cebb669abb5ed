"""ArduCopter's failsafes: what has gone wrong just now, and what it does about it."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from vwnav.sim.copter.battery import CRITICAL, CopterBattery
from vwnav.sim.copter.modes import Mode
from vwnav.sim.copter.parameters import CopterParameters
from vwnav.sim.mavlink.enums import Severity

_EKF_PERIOD_S = 0.1
_EKF_COUNT = 10  # checks in a row, to raise it and to clear it
_BATTERY_ACTIONS = {1: Mode.LAND, 2: Mode.RTL}  # BATT_FS_LOW_ACT, BATT_FS_CRT_ACT
_GCS_ACTIONS = {1: Mode.RTL, 5: Mode.LAND}  # FS_GCS_ENABLE
_RADIO_ACTIONS = {1: Mode.RTL, 3: Mode.LAND}  # FS_THR_ENABLE

Say = Callable[[Severity, str], None]


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
