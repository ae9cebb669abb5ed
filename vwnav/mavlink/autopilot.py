"""The autopilot on a MAVLink link: PX4 and ArduCopter behind one face (`vehicle.Autopilot`)."""

import logging
import threading
from collections.abc import Callable, Generator
from dataclasses import replace

from vwnav.geometry.geodesy import LocalFrame
from vwnav.mavlink.commands import CommandSender, CurrentRequest, Procedure
from vwnav.mavlink.ground_commands import GroundCommands
from vwnav.mavlink.link_budget import LinkBudget, plan_link
from vwnav.mavlink.modes import AutopilotKind
from vwnav.mavlink.outputs.autopilot_north import AutopilotNorth
from vwnav.mavlink.outputs.steady import Outputs
from vwnav.mavlink.parameters import ParameterReview, ParameterTable
from vwnav.mavlink.ports.port import Fields, Port
from vwnav.mavlink.procedures import NOT_HEARD, Procedures
from vwnav.mavlink.telemetry.telemetry_state import TelemetryState
from vwnav.mavlink.upkeep import OriginAgreement, StreamKeeper, Timesync
from vwnav.types import Estimate, Telemetry
from vwnav.vehicle import Finding, FlightMode, Order, Request, VehicleState, VelocitySetpoint

_log = logging.getLogger(__name__)
_CHUNK = 50  # bytes of a STATUSTEXT
_WARNING, _NOTICE = 4, 5  # severities: Mission Planner shows the first on its HUD
_LONGEST_ROUND_TRIP_S = 1.0  # before take-off
_LEAST_ATTITUDE_HZ = 18.0  # of 20 that are asked for at least
_PATIENCE_S = (0.25, 2.0)  # for an answer, at least and at most
_PATIENCE_UNKNOWN_S = 0.6  # before a round trip has been seen


class LinkedAutopilot:
    """A `vehicle.Autopilot` on any port. All methods may be called from any thread; none waits.

    Times are those of `clock`; use the same one for images. What is sent is sent once: a control
    loop that stops calling `send_velocity` lets the autopilot's own failsafe see it.

    Args:
        port: the connection.
        clock: monotonic clock, in seconds.
        capacity_bytes_s: what the narrowest part of the way carries, None when it is wide.
        ground_station_ids: of those that may command the navigator; nobody may when empty.
    """

    def __init__(
        self,
        port: Port,
        clock: Callable[[], float],
        capacity_bytes_s: float | None = None,
        ground_station_ids: tuple[int, ...] = (),
    ) -> None:
        self._port = port
        self._clock = clock
        self._capacity_bytes_s = capacity_bytes_s
        self._lock = threading.RLock()
        self._telemetry = TelemetryState()
        self._timesync = Timesync(port.send, clock, self._telemetry.clock)
        self._commands = CommandSender(port.send, self.system_id, clock, self._patience_s)
        self._parameters = ParameterTable(
            port.send, self.system_id, self._is_px4, clock, self._patience_s
        )
        self._review = ParameterReview(self._parameters)
        self._outputs = Outputs(port, self._telemetry, clock)
        self._procedures = Procedures(
            self._commands, self._parameters, self._telemetry, self._outputs.setpoint, clock
        )
        self._budget: LinkBudget | None = None
        self._streams: StreamKeeper | None = None
        self._request = CurrentRequest()
        self._origin: Generator[None, None, None] | None = None
        self._frame: LocalFrame | None = None
        self._restarts = 0
        self._texts = 0
        self._ground = GroundCommands(port, ground_station_ids, clock)
        for name in self._telemetry.messages:
            port.subscribe(name, self._handle_telemetry)
        port.subscribe("COMMAND_ACK", self._handle_ack)
        port.subscribe("PARAM_VALUE", self._handle_parameter)
        port.subscribe("TIMESYNC", self._handle_timesync)

    # ---- what is known

    @property
    def kind(self) -> AutopilotKind | None:
        """Firmware family; None until it has been heard."""
        return self._telemetry.kind

    def state(self) -> VehicleState:
        """The newest snapshot."""
        with self._lock:
            state = self._telemetry.state(self._clock())
            own = state.own_position_ned_m
            return replace(
                state,
                ground_station=self._ground.is_heard,
                own_position_ned_m=None if own is None else self.north.true_ned_m(own),
            )

    @property
    def north(self) -> AutopilotNorth:
        """In which the autopilot is told what it is told."""
        return self._outputs.north

    def take_measurements(self) -> tuple[Telemetry, ...]:
        """What was measured since the last call, in order of arrival, each once."""
        with self._lock:
            return self._telemetry.take_measurements()

    @property
    def findings(self) -> tuple[Finding, ...] | None:
        """Parameters that are not as flight on vision wants them, worst first; None until read."""
        return self._review.findings

    @property
    def link_refusal(self) -> str | None:
        """Why the link is none to fly on: whose it is, or what it carries; None when it is one."""
        if strangers := self._port.strangers:
            heard = " and ".join(map(str, sorted((self.system_id(), *strangers))))
            return f"autopilots of systems {heard} are on it: say which in [flight] autopilot_id"
        if self._budget is None:
            return None
        if not self._budget.is_tight:
            return self._held_up()
        return self._budget.refusal or self._slow_attitude() or self._held_up()

    def warnings(self, within_s: float = 10.0) -> list[str]:
        """The autopilot's warnings of the last while (PX4 sends them to ground stations only)."""
        with self._lock:
            return self._telemetry.texts.warnings_since(self._clock() - within_s)

    # ---- what keeps it going

    def step(self, t_s: float) -> None:
        """Keep the link up and carry on what was asked for; call it at 20 Hz or more."""
        with self._lock:
            if self._telemetry.kind is None:
                return
            if self._restarts != self._telemetry.clock.restarts:
                self._begin_anew()
            self._timesync.step(t_s)
            if self._streams is None:
                self._budget = plan_link(self._telemetry.kind, self._capacity_bytes_s)
                self._streams = StreamKeeper(self._commands, self._budget)
            self._streams.step(t_s)
            self._request.resume()
            self._procedures.step()
            if self._origin is not None:
                next(self._origin)
            if not self._telemetry.armed:
                self._review.step(self._telemetry.kind, t_s)

    def set_origin(self, lat_deg: float, lon_deg: float, alt_amsl_m: float) -> None:
        """Agree upon an origin with the autopilot; estimates are held back until then.

        PX4 1.18 must have the origin before the first vision message, or its position jumps by
        thousands of kilometres. An autopilot that has an origin gets estimates about that one.
        """
        with self._lock:
            self._frame = LocalFrame(lat_deg, lon_deg, alt_amsl_m)
            self._agree_upon(self._frame)

    def send_estimate(self, estimate: Estimate) -> None:
        """Send the filter's output; call it at 20 to 50 Hz without gaps of 0.2 s.

        A narrow link takes only as many as it carries, and the rest is dropped here.

        Raises:
            ValueError: `set_origin` was never called.
        """
        with self._lock:
            if self._frame is None:
                raise ValueError("set_origin has to be called before the first estimate is sent")
            if self._budget is not None:
                self._outputs.estimate(estimate, self._budget)

    def send_velocity(self, setpoint: VelocitySetpoint) -> None:
        """Ask for a velocity, in Offboard or GUIDED; call it at 10 Hz or more."""
        with self._lock:
            self._procedures.steered(setpoint, self._clock())
            self._outputs.setpoint(setpoint)

    def send_text(self, text: str, warns: bool = True) -> None:
        """Tell the ground stations (STATUSTEXT, ASCII); a long text goes in chunks of 50."""
        severity = _WARNING if warns else _NOTICE
        text = text.encode("ascii", "replace").decode()
        chunks = [text[i : i + _CHUNK] for i in range(0, len(text), _CHUNK)]
        with self._lock:
            self._texts = self._texts % 0xFFFF + 1
            number = self._texts if len(chunks) > 1 else 0
            for sequence, words in enumerate(chunks):
                self._port.send("STATUSTEXT", {
                    "severity": severity, "text": words, "id": number, "chunk_seq": sequence,
                })  # fmt: skip

    def take_orders(self) -> tuple[tuple[Order, ...], tuple[str, ...]]:
        """What ground stations ordered since the last call; what was refused, and is noticed."""
        with self._lock:
            orders, refused = self._ground.take()
            return orders, (*refused, *self._outputs.take_notices())

    # ---- what is asked for, and carried on by `step`

    def arm(self) -> Request:
        """Arm; on ArduCopter in GUIDED."""
        return self._begin(self._procedures.arm())

    def takeoff(self, height_m: float) -> Request:
        """Climb to `height_m` above the ground and hold there; the autopilot flies it."""
        return self._begin(self._procedures.takeoff(height_m))

    def start_offboard(self) -> Request:
        """Take control: velocity setpoints are followed from then on."""
        self._outputs.release_heading()
        return self._begin(self._procedures.start_offboard())

    def hold(self) -> Request:
        """Stop and stay: PX4 Hold, ArduCopter Brake."""
        return self._begin(self._procedures.set_mode(FlightMode.HOLD))

    def land(self) -> Request:
        """Land here."""
        return self._begin(self._procedures.set_mode(FlightMode.LAND))

    def stand_by(self) -> Request:
        """On the ground: PX4 into Hold; ArduCopter arms in GUIDED."""
        return self._begin(self._procedures.stand_by())

    def disarm(self) -> Request:
        """Stop the motors; refused in the air."""
        return self._begin(self._procedures.disarm())

    def withdraw(self) -> None:
        """Ask no more for what is under way: somebody else has the aircraft."""
        with self._lock:
            self._request.end("withdrawn")

    def close(self) -> None:
        """Give the link back, and the owner's parameters."""
        with self._lock:
            self._request.end("the link was closed")
            self._procedures.close()
        self._port.close()

    # ---- inside

    def _slow_attitude(self) -> str | None:
        """What the plan says is one thing, what comes another: PX4 has limits of its own."""
        if self._streams is None or not self._streams.rates_hz:
            return None
        rate_hz = self._streams.rates_hz["ATTITUDE"]
        if rate_hz >= _LEAST_ATTITUDE_HZ:
            return None
        return (
            f"the autopilot sends its attitude {rate_hz:.0f} times a second on this link, 20 are "
            "needed: look at its own limit of the port (PX4: MAV_0_RATE, MAV_1_RATE)"
        )

    def _held_up(self) -> str | None:
        """A line that is fuller than anybody told holds everything up."""
        round_trip_s = self._telemetry.clock.round_trip_s
        if round_trip_s is None or round_trip_s <= _LONGEST_ROUND_TRIP_S:
            return None
        return (
            f"the autopilot's answers take {round_trip_s:.1f} s: the link is asked to carry more "
            "than it can; take a faster one, or give its baud rate"
        )

    def _begin(self, procedure: Procedure) -> Request:
        with self._lock:
            if self._telemetry.kind is None:
                self._request.end("replaced by a newer command")
                return Request(done=True, refused=NOT_HEARD)
            return self._request.begin(procedure)

    def _begin_anew(self) -> None:
        """The autopilot has restarted: it has forgotten rates and origin."""
        self._restarts = self._telemetry.clock.restarts
        if self._streams is not None:
            self._streams.restart()
        if self._frame is not None:
            self._agree_upon(self._frame)

    def _agree_upon(self, frame: LocalFrame) -> None:
        self._telemetry.origin_offset_ned_m = None
        agreement = OriginAgreement(
            self._port.send, self.system_id, self._commands, self._telemetry,
            self._clock, self._patience_s,
        )  # fmt: skip
        self._origin = agreement.keep(frame)

    def _handle_telemetry(self, name: str, fields: Fields, received_s: float) -> None:
        with self._lock:
            self._telemetry.handle(name, fields, received_s)
            if self._streams is not None:
                self._streams.count(name)
        if name == "STATUSTEXT":
            _log.info("autopilot: %s", fields["text"])

    def _handle_ack(self, _: str, fields: Fields, received_s: float) -> None:
        if self._port.is_for_us(fields):
            with self._lock:
                self._commands.handle_ack(fields, received_s)

    def _handle_parameter(self, _: str, fields: Fields, __: float) -> None:
        with self._lock:
            self._review.handle_value(self._telemetry.kind, fields)

    def _handle_timesync(self, _: str, fields: Fields, received_s: float) -> None:
        with self._lock:
            self._timesync.handle(fields, received_s)

    def system_id(self) -> int:
        """Of the autopilot that is followed; 0 while none has been heard."""
        return self._port.system_id

    def _is_px4(self) -> bool:
        return self._telemetry.kind is AutopilotKind.PX4

    def _patience_s(self) -> float:
        round_trip_s = self._telemetry.clock.round_trip_s
        if round_trip_s is None:
            return _PATIENCE_UNKNOWN_S
        return min(max(_PATIENCE_S[0], 1.5 * round_trip_s + 0.1), _PATIENCE_S[1])
