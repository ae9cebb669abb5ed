"""The pilot: sticks by MANUAL_CONTROL or by radio, and the mode switch."""

from collections.abc import Sequence

from vwnav.sim.px4.modes import NavState
from vwnav.sim.px4.parameters import Px4Parameters
from vwnav.sim.scripted_pilot import Sticks

RC_CHANNELS = 8
_MOVING_SAMPLES = 3  # a step within one frame does not take over, a 0.4 s ramp does
_JOYSTICK_MODES, _RADIO_MODES = (1, 2, 3), (0, 2, 3)  # COM_RC_IN_MODE
SWITCH_US = (2000, 1000)  # the sixth slot has no mode, the first is Position
# COM_FLTMODE1..6
_FLIGHT_MODES = {
    0: NavState.MANUAL,
    1: NavState.ALTITUDE,
    2: NavState.POSITION,
    4: NavState.HOLD,
    5: NavState.RETURN,
    7: NavState.OFFBOARD,
    8: NavState.STABILIZED,
    10: NavState.TAKEOFF,
    11: NavState.LAND,
}
# What a pilot with a bound radio has set up (as in the recording px4-1.18_pilot_rcswitch).
RADIO_SETUP: tuple[tuple[str, float], ...] = (
    ("RC_MAP_ROLL", 1),
    ("RC_MAP_PITCH", 2),
    ("RC_MAP_THROTTLE", 3),
    ("RC_MAP_YAW", 4),
    ("RC_MAP_FLTMODE", 5),
    ("COM_FLTMODE1", 2),
    ("COM_FLTMODE2", 2),
    ("COM_FLTMODE3", 2),
    ("COM_FLTMODE4", 7),
    ("COM_FLTMODE5", 7),
)


class ManualInput:
    """What arrives from the pilot, and what it means.

    Args:
        old: as the 1.16 era: a stick that is far out takes over, moving or not.

    Attributes:
        sticks: as last heard.
        channels: microseconds of the radio, () without one.
        took_over: the sticks moved on purpose since `clear`.
        wanted: state the mode switch was turned to since `clear`, None when untouched.
    """

    def __init__(self, parameters: Px4Parameters, old: bool = False) -> None:
        self._parameters = parameters
        self._old = old
        self.sticks = Sticks()
        self.channels: tuple[int, ...] = ()
        self.took_over = False
        self.wanted: NavState | None = None
        self._heard_s: float | None = None
        self._rc_heard_s: float | None = None
        self._slot: int | None = None
        self._moving = 0

    def clear(self) -> None:
        """The commander has seen what the pilot wanted."""
        self.took_over, self.wanted = False, None

    def available(self, t_s: float) -> bool:
        """Sticks were heard within COM_RC_LOSS_T."""
        return self._fresh(self._heard_s, t_s)

    def radio_available(self, t_s: float) -> bool:
        """The radio was heard within COM_RC_LOSS_T."""
        return self._fresh(self._rc_heard_s, t_s)

    def _fresh(self, heard_s: float | None, t_s: float) -> bool:
        return heard_s is not None and t_s - heard_s < self._parameters["COM_RC_LOSS_T"]

    def handle_joystick(self, x: int, y: int, z: int, r: int, t_s: float) -> None:
        """MANUAL_CONTROL: x pitch, y roll, r yaw in -1000..1000, z throttle in 0..1000."""
        if int(self._parameters["COM_RC_IN_MODE"]) in _JOYSTICK_MODES:
            self._take(Sticks(y / 1000.0, x / 1000.0, r / 1000.0, z / 1000.0), t_s)

    def handle_radio(self, channels_us: Sequence[int], t_s: float) -> None:
        """The receiver's channels in microseconds; 0 and 65535 are not driven."""
        if int(self._parameters["COM_RC_IN_MODE"]) not in _RADIO_MODES:
            return
        values = tuple(us if 800 <= us <= 2200 else 1500 for us in channels_us[:RC_CHANNELS])
        if len(values) < RC_CHANNELS:
            return
        self.channels, self._rc_heard_s = values, t_s
        roll, pitch = self._stick("RC_MAP_ROLL"), self._stick("RC_MAP_PITCH")
        throttle, yaw = self._stick("RC_MAP_THROTTLE"), self._stick("RC_MAP_YAW")
        self._take(Sticks(roll, pitch, yaw, 0.5 + 0.5 * throttle), t_s)
        self._read_switch()

    def _stick(self, name: str) -> float:
        channel = int(self._parameters[name])
        if not 1 <= channel <= RC_CHANNELS:
            return 0.0
        return min(1.0, max(-1.0, (self.channels[channel - 1] - 1500) / 500.0))

    def _read_switch(self) -> None:
        if not 1 <= int(self._parameters["RC_MAP_FLTMODE"]) <= RC_CHANNELS:
            return
        # PX4's rc_update: six slots over a range widened by 0.05 at each end
        value = self._stick("RC_MAP_FLTMODE") + 1.05
        slot = int((value * 6.0 + 1.0 / 6.0) / 2.1 + 1.0 / 6.0 + 1.0)
        if slot != self._slot:
            self._slot = slot
            self.wanted = _FLIGHT_MODES.get(int(self._parameters[f"COM_FLTMODE{min(slot, 6)}"]))

    def _take(self, sticks: Sticks, t_s: float) -> None:
        """Note the sticks; several samples that move faster than MAN_OVERRIDE_SPD take over."""
        threshold = self._parameters["MAN_OVERRIDE_SPD"]
        dt_s = t_s - (self._heard_s if self._heard_s is not None else t_s)
        old, self.sticks, self._heard_s = self.sticks, sticks, t_s
        if self._old:
            out = 100.0 * max(abs(sticks.roll), abs(sticks.pitch), abs(sticks.yaw))
            self.took_over = self.took_over or out > self._parameters["COM_RC_STICK_OV"]
            return
        if dt_s == 0.0:  # two samples within one step
            return
        if threshold <= 0.0 or not 0.0 < dt_s < 0.5:
            self._moving = 0
            return
        moved = max(
            abs(sticks.roll - old.roll),
            abs(sticks.pitch - old.pitch),
            abs(sticks.yaw - old.yaw),
            2.0 * abs(sticks.throttle - old.throttle),
        )
        self._moving = self._moving + 1 if moved / dt_s > threshold else 0
        if self._moving >= _MOVING_SAMPLES:
            self.took_over = True
