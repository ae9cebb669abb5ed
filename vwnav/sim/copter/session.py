"""What the simulated ArduCopter hears and says on one link."""

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.sim.copter import vision_input
from vwnav.sim.copter.commands import GET_MESSAGE_INTERVAL, MESSAGE_INTERVAL, Context, execute
from vwnav.sim.copter.copter import SimulatedCopter
from vwnav.sim.copter.streams import BUILDERS
from vwnav.sim.mavlink.answers import Answers
from vwnav.sim.mavlink.command import Command, is_place
from vwnav.sim.mavlink.enums import Result, Severity
from vwnav.sim.mavlink.link import MavlinkLink
from vwnav.sim.mavlink.schedule import Schedule
from vwnav.sim.mavlink.texts import text_messages
from vwnav.sim.mavlink.velocity_target import setpoint_of

ACK_DELAY_S = 0.005  # recorded: 0 to 12 ms
_TIMESYNC_EVERY_S = 10.0
_PARAMETERS_AT_ONCE = 4
_DEGE7_COMMANDS = frozenset({179})  # x and y of COMMAND_INT are degrees * 1e7 here
_REQUEST_MESSAGE, _ORIGIN = 512, 49


class Session:
    """A link's conversation with the vehicle.

    Args:
        clock: the vehicle's time now, finer than its steps, for TIMESYNC.
    """

    def __init__(
        self,
        link: MavlinkLink,
        vehicle: SimulatedCopter,
        schedule: Schedule,
        clock: Callable[[], float],
    ) -> None:
        self.link = link
        self._vehicle = vehicle
        self._schedule = schedule
        self._clock = clock
        self._timesync_due_s = _TIMESYNC_EVERY_S
        self._answers = Answers()
        self._parameter_queue: list[int] = []
        self._text_seen = 0
        self._reboot_wanted = False
        self._handlers: dict[str, Callable[[Any], None]] = {
            "COMMAND_LONG": self._command_long,
            "COMMAND_INT": self._command_int,
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
            "MISSION_REQUEST_LIST": self._mission_list,
        }

    def hear(self) -> None:
        """Handle everything that has arrived."""
        for message in self.link.receive(self._vehicle.t_s):
            handler = self._handlers.get(message.get_type())
            if handler is not None and self._is_for_us(message):
                handler(message)

    def _is_for_us(self, message: Any) -> bool:
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self._vehicle.config.system_id) and component in (0, 1)

    @property
    def reboot_wanted(self) -> bool:
        """A reboot was commanded and acknowledged."""
        return self._reboot_wanted and not self._answers

    def say(self) -> None:
        """Send what is due."""
        v = self._vehicle
        for message_id in self._schedule.due(v.t_s):
            self._send(BUILDERS[message_id](v))
        for answer in self._answers.due(v.t_s):
            self._send(answer)
        if v.t_s >= self._timesync_due_s:
            self._timesync_due_s += _TIMESYNC_EVERY_S
            self._send(mavlink.MAVLink_timesync_message(0, round(self._clock() * 1e9)))
        for _ in range(min(_PARAMETERS_AT_ONCE, len(self._parameter_queue))):
            self._send_parameter(self._parameter_queue.pop(0))
        if v.texts and v.texts[-1][0] > self._text_seen:
            self._say_texts()

    def _say_texts(self) -> None:
        """To everybody, a ground station or not."""
        for number, severity, text in self._vehicle.texts:
            if number > self._text_seen:
                self._text_seen = number
                for message in text_messages(severity, text, number % 65536):
                    self._send(message)

    def _send(self, message: Any) -> None:
        if message is not None:
            self.link.send(message)

    def _answer(self, message: Any) -> None:
        """Send after the time that ArduCopter takes to acknowledge."""
        self._answers.put(message, self._vehicle.t_s + ACK_DELAY_S * self._vehicle.config.speed)

    def _command_long(self, m: Any) -> None:
        place = (m.param5, m.param6, m.param7)
        self._execute(m, Command(m.command, m.param1, m.param2, m.param3, m.param4, *place))

    def _command_int(self, m: Any) -> None:
        scale = 1e-7 if m.command in _DEGE7_COMMANDS else 1.0
        place = (m.x * scale, m.y * scale, m.z)
        self._execute(m, Command(m.command, m.param1, m.param2, m.param3, m.param4, *place))

    def _execute(self, message: Any, command: Command) -> None:
        context = Context(self._vehicle, self._schedule, [])
        result = execute(command, context)
        wanted = [self._requested(number, command) for number in context.send_now]
        if None in wanted and command.number == _REQUEST_MESSAGE:
            result = Result.FAILED
        source = (message.get_srcSystem(), message.get_srcComponent())
        self._answer(mavlink.MAVLink_command_ack_message(command.number, result, 0, 0, *source))
        for built in wanted:
            if built is not None:
                self._answer(built)
        self._reboot_wanted = self._reboot_wanted or context.reboot

    def _requested(self, message_id: int, command: Command) -> Any:
        if message_id == MESSAGE_INTERVAL and command.number == GET_MESSAGE_INTERVAL:
            asked = int(command.p1)
            interval_us = self._schedule.interval_us(asked)
            return mavlink.MAVLink_message_interval_message(asked, interval_us)
        builder = BUILDERS.get(message_id)
        return None if builder is None else builder(self._vehicle)

    def _set_mode(self, m: Any) -> None:
        nothing = [math.nan] * 5
        execute(
            Command(176, float(m.base_mode), float(m.custom_mode), *nothing),
            Context(self._vehicle, self._schedule, []),
        )

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
            self._answer(BUILDERS[_ORIGIN](v))

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

    def _mission_list(self, m: Any) -> None:
        source = (m.get_srcSystem(), m.get_srcComponent())
        self._send(mavlink.MAVLink_mission_count_message(*source, 0, m.mission_type))
