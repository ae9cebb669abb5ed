"""The vehicle's end of its companion link; what passes it is noted for the rules."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from vwnav.bench.flights.track import FlightTrace
from vwnav.mavlink.outputs.autopilot_north import AutopilotNorth
from vwnav.recording.flight_recorder import FlightRecorder
from vwnav.rules.flight_log import (
    CommandAck,
    Heartbeat,
    LoggedCommand,
    LoggedSetpoint,
    ParameterSet,
    Sent,
    Vector,
)
from vwnav.seams import StepResult
from vwnav.sim.mavlink.link import ByteLink
from vwnav.sim.processor import SimulatedClock
from vwnav.types import Array, Estimate, Frame
from vwnav.vehicle import VehicleState, VelocitySetpoint

_STATION = 255  # system id of the ground stations that scenarios play
_IN_PROGRESS = 5  # MAV_RESULT: the answer proper is still to come


class NotedLink(ByteLink):
    """A link that notes what arrives, and the answers to it.

    Args:
        track: gets it.
        north: in which estimates are told; they are noted in true NED.
    """

    def __init__(
        self,
        end: Any,
        clock: SimulatedClock,
        track: FlightTrace,
        north: Callable[[], AutopilotNorth],
    ) -> None:
        super().__init__(end, 1)
        self._clock = clock
        self._north = north
        self._track = track

    def receive(self, t_s: float) -> list[Any]:
        """Every valid message that has arrived."""
        messages = super().receive(t_s)
        for message in messages:
            self._note(message, self._clock())
        return messages

    def send(self, message: Any) -> None:
        """Send to the peer."""
        if message.get_type() == "COMMAND_ACK" and message.result != _IN_PROGRESS:
            answer = CommandAck(self._clock(), message.command, message.result == 0)
            self._track.heard.answers.append(answer)
        super().send(message)

    def _note(self, m: Any, t_s: float) -> None:
        if m.get_srcSystem() == _STATION:
            return  # not ours
        heard, component = self._track.heard, m.get_srcComponent()
        match m.get_type():
            case "VISION_POSITION_ESTIMATE":
                place, covariance = self._true_place(m, m.covariance)
                sent = Sent(t_s, m.usec * 1e-6, place, covariance, m.reset_counter)
                heard.estimates.append(sent)
            case "ODOMETRY":
                place, covariance = self._true_place(m, m.pose_covariance)
                stamp_s = m.time_usec * 1e-6
                velocity = _vector(self._north().true_velocity(np.array([m.vx, m.vy, m.vz])))
                sigma_m_s = math.sqrt(max(m.velocity_covariance[0], m.velocity_covariance[6]))
                sent = Sent(t_s, stamp_s, place, covariance, m.reset_counter, velocity, sigma_m_s)
                heard.estimates.append(sent)
            case "SET_POSITION_TARGET_LOCAL_NED":
                heard.setpoints.append(LoggedSetpoint(t_s, (m.vx, m.vy, m.vz), component))
            case "COMMAND_LONG" | "COMMAND_INT":
                parameters = (m.param1, m.param2, m.param3)
                heard.commands.append(LoggedCommand(t_s, m.command, parameters, component))
            case "PARAM_SET":
                heard.parameters_set.append(ParameterSet(t_s, m.param_id, m.param_value))
            case "HEARTBEAT":
                heard.beats.append(Heartbeat(t_s, component, m.type))

    def _true_place(self, m: Any, c: list[float]) -> tuple[Vector, Vector]:
        north = self._north()
        u, v = (north.true_velocity(np.array(axis)) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
        C = np.column_stack([u, v])[:2] @ np.array([[c[0], c[1]], [c[1], c[6]]])
        C = C @ np.column_stack([u, v])[:2].T
        place = _vector(north.true_ned_m(np.array([m.x, m.y, m.z])))
        return place, (float(C[0, 0]), float(C[0, 1]), float(C[1, 1]))


def _vector(ned: Array) -> Vector:
    north, east, down = ned.tolist()
    return north, east, down


class LockstepWatcher:
    """A `vwnav.seams.Watcher`; a full disk makes it raise.

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
        self.recorder: FlightRecorder | None = None
        self.setpoint: Callable[[], VelocitySetpoint | None] = lambda: None

    def event(self, text: str) -> None:
        """A line."""
        self._note(text)
        self._write()
        if self.recorder is not None:
            self.recorder.event(self._clock(), text)

    def saw_frame(self, frame: Frame, step: StepResult) -> None:
        """An image went through the pipeline."""
        self.steps.append(step)
        self._write()
        if self.recorder is not None:
            self.recorder.image(step, self.setpoint())

    def saw_tick(self, t_s: float, estimate: Estimate | None, vehicle: VehicleState) -> None:
        """The mission ticked."""
        self._write()
        if self.recorder is not None:
            self.recorder.tick(t_s, estimate, vehicle, self.setpoint())

    def _write(self) -> None:
        if self.disk_full:
            raise OSError(28, "No space left on device")
