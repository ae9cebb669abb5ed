"""The pilot's radio as ArduCopter hears it: sticks and the mode switch of channel FLTMODE_CH."""

from collections.abc import Sequence

from vwnav.sim.copter.modes import Mode
from vwnav.sim.copter.parameters import CopterParameters
from vwnav.sim.scripted_pilot import Sticks

CHANNELS = 8
_LOST_S = 1.0  # RC_FS_TIMEOUT
_DEBOUNCE_S = 0.2
_SLOT_ENDS_US = (1230, 1360, 1490, 1620, 1749)  # of the six positions of the switch
SWITCH_US = (1650, 1200)  # GUIDED, LOITER
# As in the recording of a pilot's mode switch.
SETUP: tuple[tuple[str, float], ...] = (
    ("FLTMODE1", 5),
    ("FLTMODE2", 5),
    ("FLTMODE3", 5),
    ("FLTMODE4", 4),
    ("FLTMODE5", 4),
    ("FLTMODE6", 9),
)


class Radio:
    """What arrives from the pilot's transmitter, by the air or by RC_CHANNELS_OVERRIDE.

    Attributes:
        sticks: as last heard.
        channels_us: () before the first.
    """

    def __init__(self, parameters: CopterParameters) -> None:
        self._parameters = parameters
        self.sticks = Sticks()
        self.channels_us: tuple[int, ...] = ()
        self._heard_s: float | None = None
        self._override_s: float | None = None
        self._slot: int | None = None
        self._moved: tuple[int, float] | None = None  # to a slot, when

    def available(self, t_s: float) -> bool:
        """It was heard lately."""
        return self._heard_s is not None and t_s - self._heard_s < _LOST_S

    def lost(self, t_s: float) -> bool:
        """It was heard once, and is not any more."""
        return self._heard_s is not None and not self.available(t_s)

    def handle_override(self, channels_us: Sequence[int], t_s: float) -> None:
        """RC_CHANNELS_OVERRIDE: the receiver is not listened to for RC_OVERRIDE_TIME."""
        self._override_s = t_s
        self._take(channels_us, t_s)

    def handle_radio(self, channels_us: Sequence[int], t_s: float) -> None:
        """The receiver's channels in microseconds."""
        if self._overridden(t_s):
            return
        self._take(channels_us, t_s)

    def hold_override(self, t_s: float) -> None:
        """An override that has stopped counts on until its time is over."""
        if self._overridden(t_s):
            self._heard_s = t_s

    def _overridden(self, t_s: float) -> bool:
        since_s = self._override_s
        return since_s is not None and t_s - since_s < self._parameters["RC_OVERRIDE_TIME"]

    def _take(self, channels_us: Sequence[int], t_s: float) -> None:
        values = tuple(us if 800 <= us <= 2200 else 1500 for us in channels_us[:CHANNELS])
        if len(values) < CHANNELS:
            return
        self.channels_us, self._heard_s = values, t_s
        roll, pitch, throttle, yaw = (_stick(us) for us in values[:4])
        # forward is a low pulse on ArduPilot's pitch channel
        self.sticks = Sticks(roll, -pitch, yaw, 0.5 + 0.5 * throttle)

    def switched(self, t_s: float) -> Mode | None:
        """The mode that the switch was just turned to; None while it stays, or moves."""
        channel = int(self._parameters["FLTMODE_CH"])
        if not 1 <= channel <= len(self.channels_us) or not self.available(t_s):
            return None
        pulse_us = self.channels_us[channel - 1]
        slot = 1 + sum(pulse_us > end_us for end_us in _SLOT_ENDS_US)
        if slot == self._slot:
            self._moved = None
            return None
        if self._moved is None or self._moved[0] != slot:
            self._moved = (slot, t_s)
        if t_s - self._moved[1] < _DEBOUNCE_S:
            return None
        self._slot, self._moved = slot, None
        number = int(self._parameters[f"FLTMODE{slot}"])
        return next((mode for mode in Mode if mode == number), None)


def _stick(pulse_us: int) -> float:
    return min(1.0, max(-1.0, (pulse_us - 1500) / 500.0))
