"""What the simulated ArduCopter hears and says on one link, and does when it is commanded."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.sim.copter import vision_input
from vwnav.sim.copter.copter import SimulatedCopter
from vwnav.sim.copter.modes import Mode
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
from vwnav.sim.mavlink.velocity_target import setpoint_of

_ORIGIN = 49


_CUSTOM_MODE_ENABLED = 1
_SHORTEST_US = 3125.0  # a shorter interval is denied


class CopterSession(Conversation[SimulatedCopter]):
    """A link's conversation with the simulated ArduCopter."""

    ACK_DELAY_S = 0.005  # recorded: 0 to 12 ms
    TIMESYNC_EVERY_S = 10.0
    DEGE7_COMMANDS = frozenset({179})
    UNKNOWN_MESSAGE = Result.FAILED

    def __init__(
        self,
        link: MavlinkLink,
        vehicle: SimulatedCopter,
        schedule: Schedule,
        clock: Callable[[], float],
    ) -> None:
        super().__init__(link, vehicle, schedule, clock, self.TIMESYNC_EVERY_S)
        self._text_seen = 0
        self._handlers |= {
            "SET_POSITION_TARGET_LOCAL_NED": self._setpoint,
            "VISION_POSITION_ESTIMATE": self._vision_position,
            "VISION_SPEED_ESTIMATE": self._vision_speed,
            "SET_GPS_GLOBAL_ORIGIN": self._origin,
            "SET_MODE": self._set_mode,
            "RC_CHANNELS_OVERRIDE": self._radio,
            "PARAM_REQUEST_LIST": self._parameter_list,
            "PARAM_REQUEST_READ": self._parameter_read,
            "PARAM_SET": self._parameter_set,
            "TIMESYNC": self._time,
        }

    def _is_for_us(self, message: Any) -> bool:
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self._vehicle.config.system_id) and component in (0, 1)

    def _say_texts(self) -> None:
        """To everybody, a ground station or not."""
        texts = self._vehicle.texts
        if not texts or texts[-1][0] <= self._text_seen:
            return
        for number, severity, text in texts:
            if number > self._text_seen:
                self._text_seen = number
                for message in text_messages(severity, text, number % 65536):
                    self._send(message)

    def _do(self, command: VehicleCommand, context: CommandContext[SimulatedCopter]) -> Result:
        """In ArduCopter's result codes."""
        handler = _HANDLERS.get(command.number)
        if command.number in context.vehicle.refuses:
            return Result.FAILED
        return Result.UNSUPPORTED if handler is None else handler(command, context)

    def _set_mode(self, m: Any) -> None:
        """As the command does it, but nothing is acknowledged."""
        nothing = [math.nan] * 5
        command = VehicleCommand(176, float(m.base_mode), float(m.custom_mode), *nothing)
        self._do(command, CommandContext(self._vehicle, self._schedule, []))

    def _setpoint(self, m: Any) -> None:
        setpoint = setpoint_of(m, self._vehicle.estimator.attitude.yaw_rad)
        if setpoint is not None:
            self._vehicle.set_target(setpoint)

    def _vision_position(self, m: Any) -> None:
        vision_input.feed_position(m, self._vehicle.estimator)

    def _vision_speed(self, m: Any) -> None:
        vision_input.feed_velocity(m, self._vehicle.estimator)

    def _origin(self, m: Any) -> None:
        """Set once: ArduPilot keeps the origin that it has."""
        v, place = self._vehicle, (m.latitude * 1e-7, m.longitude * 1e-7, m.altitude * 1e-3)
        if is_place(*place) and v.estimator.set_origin(*place):
            v.say(Severity.INFO, "EKF3 IMU0 origin set")
            v.say(Severity.INFO, f"Field Elevation Set: {place[2]:.0f}m")
            self._answer(self._schedule.builders[_ORIGIN](v))

    def _radio(self, m: Any) -> None:
        channels = [getattr(m, f"chan{i}_raw") for i in range(1, 9)]
        self._vehicle.radio.handle_override(channels, self._vehicle.t_s)

    def _parameter_list(self, _: Any) -> None:
        self._parameter_queue = list(range(len(self._vehicle.parameters)))

    def _parameter_read(self, m: Any) -> None:
        names = self._vehicle.parameters.names
        if 0 <= m.param_index < len(names):
            self._send_parameter(m.param_index)
        elif m.param_index < 0 and m.param_id in names:
            self._send_parameter(names.index(m.param_id))

    def _parameter_set(self, m: Any) -> None:
        parameters = self._vehicle.parameters
        if m.param_id in parameters and parameters.set(m.param_id, m.param_value):
            self._send_parameter(parameters.names.index(m.param_id))

    def _send_parameter(self, index: int) -> None:
        parameters = self._vehicle.parameters
        name = parameters.names[index]
        value, kind = parameters[name], parameters.type_of(name)
        self._send(
            mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(parameters), index)
        )

    def _time(self, m: Any) -> None:
        if m.tc1 == 0:
            now_ns = round(self._clock() * 1e9)
            self._answer(mavlink.MAVLink_timesync_message(now_ns, m.ts1))


Handler = Callable[[VehicleCommand, CommandContext[SimulatedCopter]], Result]


def _takeoff(command: VehicleCommand, context: CommandContext[SimulatedCopter]) -> Result:
    return context.vehicle.take_off(command.z) if math.isfinite(command.z) else Result.FAILED


def _mode(wanted: Mode) -> Handler:
    return lambda _, context: context.vehicle.ask(wanted)


def _set_mode(command: VehicleCommand, context: CommandContext[SimulatedCopter]) -> Result:
    if not all(map(math.isfinite, (command.p1, command.p2))):
        return Result.FAILED
    if not int(command.p1) & _CUSTOM_MODE_ENABLED:
        return Result.UNSUPPORTED
    wanted = next((mode for mode in Mode if mode == int(command.p2)), None)
    return Result.FAILED if wanted is None else context.vehicle.ask(wanted)


def _set_interval(command: VehicleCommand, context: CommandContext[SimulatedCopter]) -> Result:
    number, interval_us = message_id(command.p1), command.p2
    if number is None or math.isnan(interval_us):
        return Result.DENIED
    if number not in context.schedule.builders:
        text = f"No ap_message for mavlink id ({number})"
        context.vehicle.say(Severity.INFO, text)
        return Result.DENIED
    if 0.0 < interval_us < _SHORTEST_US:
        return Result.DENIED
    context.schedule.set_interval(number, interval_us, context.vehicle.t_s)
    return Result.ACCEPTED


def _request(command: VehicleCommand, context: CommandContext[SimulatedCopter]) -> Result:
    number = message_id(command.p1)
    if number is None or number not in context.schedule.builders:
        return Result.FAILED
    context.send_now.append(number)
    return Result.ACCEPTED


_HANDLERS: dict[int, Handler] = {
    **COMMON_COMMANDS,
    17: _mode(Mode.LOITER),  # NAV_LOITER_UNLIM
    20: _mode(Mode.RTL),
    21: _mode(Mode.LAND),
    22: _takeoff,
    176: _set_mode,
    179: partial(set_home, Result.FAILED),
    246: partial(reboot, (Result.FAILED, Result.UNSUPPORTED)),
    511: _set_interval,
    512: _request,
}
