"""What a navigator in lockstep keeps of its flight."""

from collections.abc import Callable
from typing import Protocol

from vwnav.seams import StepResult
from vwnav.sim.clock import SimulatedClock
from vwnav.types import Estimate, Frame
from vwnav.vehicle import VehicleState, VelocitySetpoint


class Recording(Protocol):
    """What is written while it flies: `vwnav.recording.flight_recorder.FlightRecorder`."""

    def event(self, t_s: float, text: str) -> None:
        """A line."""
        ...

    def picture(self, step: StepResult, setpoint: VelocitySetpoint | None) -> None:
        """What a picture brought."""
        ...

    def tick(
        self,
        t_s: float,
        estimate: Estimate | None,
        vehicle: VehicleState,
        setpoint: VelocitySetpoint | None,
    ) -> bool:
        """The mission ticked."""
        ...

    def close(self) -> None:
        """Finish the file."""
        ...


class LockstepWatcher:
    """A `vwnav.runtime.Watcher`; a full disk makes it raise.

    Args:
        note: takes every line said.

    Attributes:
        recorder: the recording on disk, where one is kept.
        setpoint: asks for what the mission steers by.
    """

    def __init__(self, note: Callable[[str], None], clock: SimulatedClock) -> None:
        self._note = note
        self._clock = clock
        self.disk_full = False
        self.steps: list[StepResult] = []
        self.recorder: Recording | None = None
        self.setpoint: Callable[[], VelocitySetpoint | None] = lambda: None

    def event(self, text: str) -> None:
        """A line."""
        self._note(text)
        self._write()
        if self.recorder is not None:
            self.recorder.event(self._clock(), text)

    def saw_frame(self, frame: Frame, step: StepResult) -> None:
        """A picture went through the pipeline."""
        self.steps.append(step)
        self._write()
        if self.recorder is not None:
            self.recorder.picture(step, self.setpoint())

    def saw_tick(self, t_s: float, estimate: Estimate | None, vehicle: VehicleState) -> None:
        """The mission ticked."""
        self._write()
        if self.recorder is not None:
            self.recorder.tick(t_s, estimate, vehicle, self.setpoint())

    def _write(self) -> None:
        if self.disk_full:
            raise OSError(28, "No space left on device")
