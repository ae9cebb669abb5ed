"""Which parts of a flight go into its recording, and how often."""

from vwnav.recording.input_log import About, InputLog
from vwnav.recording.recorder import Recorder
from vwnav.seams import StepResult
from vwnav.types import Estimate, Frame, MapFix, Rejected, RejectReason
from vwnav.vehicle import VehicleState, VelocitySetpoint

TICK_PERIOD_S = 0.2


class FlightRecorder:
    """The recording of a flight: everything that the filter is told, and the rest now and then.

    Attributes:
        input_log: what the filter is told, from before its start: `Ekf.record(input_log.input)`.
    """

    def __init__(self, recorder: Recorder, about: About) -> None:
        self._recorder = recorder
        self.input_log = InputLog(self._recorder, about)
        self._next_tick_s = 0.0

    def event(self, t_s: float, text: str) -> None:
        """A change of phase, a decision, a warning."""
        self._recorder.event(t_s, text)

    def image(self, step: StepResult, setpoint: VelocitySetpoint | None) -> None:
        """What an image brought; to be called close behind its step."""
        self.input_log.image(step, setpoint.yaw_rad if setpoint else None)
        if was_tried(step.outcome):
            self._recorder.outcome(step.outcome)

    def frame(self, frame: Frame) -> None:
        """The image itself, if one is due."""
        self._recorder.frame(frame)

    def tick(
        self,
        t_s: float,
        estimate: Estimate | None,
        vehicle: VehicleState,
        setpoint: VelocitySetpoint | None,
    ) -> bool:
        """The mission ticked; whether this tick is kept."""
        if t_s < self._next_tick_s:
            return False
        self._next_tick_s = t_s + TICK_PERIOD_S
        self._recorder.vehicle(vehicle)
        if setpoint is not None:
            self._recorder.setpoint(t_s, setpoint)
        if estimate is not None:
            self._recorder.estimate(estimate)
        return True

    def close(self) -> None:
        """Write what is queued and finish the file."""
        self._recorder.close()


def was_tried(outcome: MapFix | Rejected) -> bool:
    """Whether an image was matched, with whatever result."""
    return isinstance(outcome, MapFix) or outcome.reason is not RejectReason.NOT_TRIED
