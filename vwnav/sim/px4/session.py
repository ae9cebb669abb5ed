"""What the simulated PX4 hears and says on one link, and does when it is commanded."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from vwnav.sim.mavlink.command import Result, Severity, VehicleCommand, is_place, message_id
from vwnav.sim.mavlink.conversation import (
    COMMON_COMMANDS,
    CommandContext,
    Conversation,
    reboot,
    set_home,
)
from vwnav.sim.mavlink.link import MavlinkLink
from vwnav.sim.mavlink.schedule import Schedule
from vwnav.sim.mavlink.texts import text_messages
from vwnav.sim.mavlink.timesync import TimesyncFilter
from vwnav.sim.mavlink.velocity_target import setpoint_of
from vwnav.sim.px4 import vision_input
from vwnav.sim.px4.modes import NavState, state_of_custom_mode
from vwnav.sim.px4.parameters import HASH_CHECK
from vwnav.sim.px4.px4 import SimulatedPx4

_CUSTOM_MODE_ENABLED = 1
_GCS_SILENT_S = 5.0
# PX4 takes these for its own system id only (mavlink_receiver.cpp, mavlink_parameters.cpp).
_NEVER_BROADCAST = frozenset(
    {
        "COMMAND_LONG",
        "COMMAND_INT",
        "SET_MODE",
        "SET_GPS_GLOBAL_ORIGIN",
        "PARAM_REQUEST_LIST",
        "PARAM_REQUEST_READ",
        "PARAM_SET",
    }
)

_HEARTBEAT, _CURRENT_MODE = 0, 436
_STATUS_S = 0.5  # of vehicle_status (Commander.cpp)

Clock = Callable[[], float]


class Px4Session(Conversation[SimulatedPx4]):
    """A link's conversation with the simulated PX4.

    Args:
        clock: the vehicle's time now, finer than its steps, for TIMESYNC.
        asks_time: whether it sends TIMESYNC requests itself (PX4 does so to companions).
    """

    ACK_DELAY_S = 0.008
    TIMESYNC_EVERY_S = 0.1
    DEGE7_COMMANDS = frozenset({179, 611})
    UNKNOWN_MESSAGE = Result.DENIED

    def __init__(
        self,
        link: MavlinkLink,
        vehicle: SimulatedPx4,
        schedule: Schedule,
        clock: Clock,
        asks_time: bool,
    ) -> None:
        super().__init__(link, vehicle, schedule, clock, 0.0 if asks_time else math.inf)
        self._timesync = TimesyncFilter()
        self._status: object = None
        self._status_s = -math.inf
        self._text_seen = 0
        self._chunk_id = 0
        self._handlers |= {
            "SET_POSITION_TARGET_LOCAL_NED": self._setpoint,
            "VISION_POSITION_ESTIMATE": self._vision_position,
            "ODOMETRY": self._odometry,
            "SET_GPS_GLOBAL_ORIGIN": self._origin,
            "SET_MODE": self._set_mode,
            "MANUAL_CONTROL": self._manual_control,
            "RC_CHANNELS_OVERRIDE": self._radio,
            "PARAM_REQUEST_LIST": self._parameter_list,
            "PARAM_REQUEST_READ": self._parameter_read,
            "PARAM_SET": self._parameter_set,
            "TIMESYNC": self._time,
            "PING": self._ping,
        }

    def _is_for_us(self, message: Any) -> bool:
        system = getattr(message, "target_system", getattr(message, "target", 0))
        component = getattr(message, "target_component", 0)
        own = self._vehicle.config.system_id
        if message.get_type() in _NEVER_BROADCAST:
            return system == own and component in (0, 1)
        return system in (0, own) and component in (0, 1)

    def _has_news(self, number: int) -> bool:
        """CURRENT_MODE goes out with a new vehicle_status: twice a second, or when it changes."""
        if number != _CURRENT_MODE:
            return True
        commander, t_s = self._vehicle.commander, self._vehicle.t_s
        status = (commander.state, commander.intended, commander.armed)
        if status == self._status and t_s - self._status_s < _STATUS_S - 1e-6:
            return False
        self._status, self._status_s = status, t_s
        return True

    def _say_texts(self) -> None:
        """Texts go only where a ground station is heard; they wait for it."""
        v = self._vehicle
        if v.t_s - self.link.gcs_heard_s > _GCS_SILENT_S:
            return
        for number, severity, text in v.texts:
            if number > self._text_seen:
                self._text_seen = number
                self._say_text(severity, text)

    def _say_text(self, severity: Severity, text: str) -> None:
        self._chunk_id = (self._chunk_id + 1) % 65536
        for message in text_messages(severity, text, self._chunk_id):
            self._send(message)

    def _do(self, command: VehicleCommand, context: CommandContext[SimulatedPx4]) -> Result:
        """In PX4's result codes."""
        handler = _HANDLERS.get(command.number)
        context.vehicle.look()
        if command.number in context.vehicle.refuses:
            return Result.TEMPORARILY_REJECTED
        return Result.UNSUPPORTED if handler is None else handler(command, context)

    def _set_mode(self, m: Any) -> None:
        """As the command does it, but nothing is acknowledged."""
        main, sub = m.custom_mode >> 16 & 255, m.custom_mode >> 24 & 255
        nothing = [math.nan] * 4
        command = VehicleCommand(176, float(m.base_mode), float(main), float(sub), *nothing)
        self._do(command, CommandContext(self._vehicle, self._schedule, []))

    def _setpoint(self, m: Any) -> None:
        setpoint = setpoint_of(m, self._vehicle.estimator.attitude.yaw_rad)
        if setpoint is not None:
            self._vehicle.set_target(setpoint)

    def _vision_position(self, m: Any) -> None:
        v = self._vehicle
        sample = vision_input.from_vision_position(m, self._stamp(m.usec), v.parameters)
        if sample is not None:
            v.estimator.handle_vision(sample)

    def _odometry(self, m: Any) -> None:
        v = self._vehicle
        sample = vision_input.from_odometry(m, self._stamp(m.time_usec), v.parameters)
        if sample is not None:
            v.estimator.handle_vision(sample)

    def _stamp(self, usec: int) -> float:
        """When a companion's message was measured, in the vehicle's time."""
        v = self._vehicle
        return v.t_s if v.config.speed != 1.0 else self._timesync.own_s(usec, v.t_s)

    def _origin(self, m: Any) -> None:
        place = (m.latitude * 1e-7, m.longitude * 1e-7, m.altitude * 1e-3)
        if is_place(*place):
            self._vehicle.estimator.set_origin(*place)
            self._answer(self._schedule.builders[49](self._vehicle))

    def _manual_control(self, m: Any) -> None:
        v = self._vehicle
        if all(abs(value) <= 1000 for value in (m.x, m.y, m.z, m.r)):
            v.manual.handle_joystick(m.x, m.y, m.z, m.r, v.t_s)

    def _radio(self, m: Any) -> None:
        channels = [getattr(m, f"chan{i}_raw") for i in range(1, 9)]
        self._vehicle.manual.handle_radio(channels, self._vehicle.t_s)

    def _parameter_list(self, _: Any) -> None:
        self._parameter_queue = [*range(len(self._vehicle.parameters)), -1]

    def _parameter_read(self, m: Any) -> None:
        names = self._vehicle.parameters.names
        if m.param_index >= 0:
            if m.param_index < len(names):
                self._send_parameter(m.param_index)
        elif m.param_id == HASH_CHECK:
            self._send_parameter(-1)
        elif m.param_id in self._vehicle.parameters:
            self._send_parameter(names.index(m.param_id))

    def _parameter_set(self, m: Any) -> None:
        parameters = self._vehicle.parameters
        if m.param_id not in parameters:
            return
        parameters.set_wire(m.param_id, m.param_value, m.param_type)
        self._vehicle.handle_parameter()
        self._send_parameter(parameters.names.index(m.param_id))

    def _send_parameter(self, index: int) -> None:
        """PARAM_VALUE of one parameter; -1 is the hash of all, as PX4 ends its list."""
        parameters = self._vehicle.parameters
        count = len(parameters)
        if index < 0:
            name, value, kind, index = HASH_CHECK, parameters.hash_wire_value(), 5, 65535
        else:
            name = parameters.names[index]
            value, kind = parameters.wire_value(name), parameters.type_of(name)
        self._send(mavlink.MAVLink_param_value_message(name.encode(), value, kind, count, index))

    def _time(self, m: Any) -> None:
        now_ns = round(self._clock() * 1e9)
        if m.tc1 == 0:
            self._send(mavlink.MAVLink_timesync_message(now_ns, m.ts1))
        else:
            self._timesync.handle_answer(m.ts1, m.tc1, now_ns)

    def _ping(self, m: Any) -> None:
        if m.target_system == 0:
            source = (m.get_srcSystem(), m.get_srcComponent())
            self._send(mavlink.MAVLink_ping_message(m.time_usec, m.seq, *source))


Handler = Callable[[VehicleCommand, CommandContext[SimulatedPx4]], Result]


def _takeoff(command: VehicleCommand, context: CommandContext[SimulatedPx4]) -> Result:
    v = context.vehicle
    result = v.commander.ask(NavState.TAKEOFF, v.health)
    if result is Result.ACCEPTED:
        v.plan_takeoff(command.z if math.isfinite(command.z) and command.z != 0.0 else None)
    return result


def _state(wanted: NavState) -> Handler:
    def ask(_: VehicleCommand, context: CommandContext[SimulatedPx4]) -> Result:
        return context.vehicle.commander.ask(wanted, context.vehicle.health)

    return ask


def _set_mode(command: VehicleCommand, context: CommandContext[SimulatedPx4]) -> Result:
    if not all(map(math.isfinite, (command.p1, command.p2))):
        return Result.DENIED
    if not int(command.p1) & _CUSTOM_MODE_ENABLED:
        return Result.UNSUPPORTED
    sub = int(command.p3) if math.isfinite(command.p3) else 0
    wanted = state_of_custom_mode(int(command.p2), sub)
    if wanted is None:
        return Result.TEMPORARILY_REJECTED
    if wanted is NavState.TAKEOFF:
        return _takeoff(command, context)
    return context.vehicle.commander.ask(wanted, context.vehicle.health)


def _set_interval(command: VehicleCommand, context: CommandContext[SimulatedPx4]) -> Result:
    """PX4's heartbeat comes once a second, whatever is asked for."""
    number = message_id(command.p1)
    known = number not in (None, _HEARTBEAT) and context.schedule.set_interval(
        number, command.p2, context.vehicle.t_s
    )
    return Result.ACCEPTED if known else Result.FAILED


def _request(command: VehicleCommand, context: CommandContext[SimulatedPx4]) -> Result:
    number = message_id(command.p1)
    if number is None:
        return Result.DENIED
    context.send_now.append(number)
    return Result.ACCEPTED


def _set_origin(command: VehicleCommand, context: CommandContext[SimulatedPx4]) -> Result:
    if not is_place(command.x, command.y, command.z):
        return Result.DENIED
    context.vehicle.estimator.set_origin(command.x, command.y, command.z)
    context.send_now.append(49)
    return Result.ACCEPTED


_HANDLERS: dict[int, Handler] = {
    **COMMON_COMMANDS,
    17: _state(NavState.HOLD),  # NAV_LOITER_UNLIM
    20: _state(NavState.RETURN),
    21: _state(NavState.LAND),
    22: _takeoff,
    176: _set_mode,
    179: partial(set_home, Result.TEMPORARILY_REJECTED),
    246: partial(reboot, (Result.TEMPORARILY_REJECTED, Result.DENIED)),
    511: _set_interval,
    512: _request,
    611: _set_origin,
}
