"""A pilot at the radio who does what a plan says."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from vwnav.sim.config import PilotPlan

_RAMP_S, _PUSH_S, _PUSH = 0.4, 3.0, 0.4


@dataclass(frozen=True, slots=True)
class Sticks:
    """The pilot's sticks: roll, pitch (forward positive), yaw -1..1, throttle 0..1."""

    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    throttle: float = 0.5


class Receiver(Protocol):
    """Takes what the transmitter sends."""

    def handle_radio(self, channels_us: Sequence[int], t_s: float) -> None:
        """The channels in microseconds: roll, pitch, throttle, yaw, mode switch, three more."""
        ...


class ScriptedPilot:
    """Plays a PilotPlan into a receiver at 50 Hz; `plan` may be changed meanwhile.

    Args:
        switch_us: the mode switch before and after it is flipped.
    """

    def __init__(self, plan: PilotPlan, receiver: Receiver, switch_us: tuple[int, int]) -> None:
        self.plan = plan
        self._receiver = receiver
        self._switch_us = switch_us

    def step(self, t_s: float) -> None:
        """Send the channels of `t_s`, nothing while the radio is off."""
        plan = self.plan
        if not plan.rc_on or self._off(t_s):
            return
        push = _push(t_s, plan.takes_over_at_s)
        switched = plan.switch_at_s is not None and t_s >= plan.switch_at_s
        pitch_us = 1500 + round(500 * push)
        channels = (1500, pitch_us, 1500, 1500, self._switch_us[switched], 1000, 1500, 1500)
        self._receiver.handle_radio(channels, t_s)

    def _off(self, t_s: float) -> bool:
        lost, back = self.plan.rc_lost_at_s, self.plan.rc_back_at_s
        return lost is not None and t_s >= lost and (back is None or t_s < back)


def _push(t_s: float, start_s: float | None) -> float:
    """The pitch stick of a pilot who pushes it forward for a while."""
    if start_s is None or not start_s <= t_s < start_s + _PUSH_S:
        return 0.0
    return _PUSH * min(1.0, (t_s - start_s) / _RAMP_S)
