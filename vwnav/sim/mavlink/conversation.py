"""What every simulated autopilot does on a link; its own manners are in the sessions made of it."""

import heapq
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from pymavlink.dialects.v20 import common as mavlink

from vwnav.sim.config import VehicleConfig
from vwnav.sim.mavlink.command import FORCE_MAGIC, Result, VehicleCommand, is_place, message_id
from vwnav.sim.mavlink.link import MavlinkLink
from vwnav.sim.mavlink.schedule import Schedule

AUTOPILOT_VERSION, MESSAGE_INTERVAL = 148, 244
GET_MESSAGE_INTERVAL, REQUEST_MESSAGE = 510, 512
_PARAMETERS_AT_ONCE = 4


class Vehicle(Protocol):
    """What a conversation needs of any vehicle."""

    config: VehicleConfig
    t_s: float


VehicleT = TypeVar("VehicleT", bound=Vehicle)


class Conversation(ABC, Generic[VehicleT]):
    """A link's conversation with a vehicle: messages heard, streams, answers, parameters.

    Args:
        clock: the vehicle's time now, finer than its steps, for TIMESYNC.
        timesync_due_s: when it first asks for the time.
    """

    ACK_DELAY_S: ClassVar[float]
    TIMESYNC_EVERY_S: ClassVar[float]
    DEGE7_COMMANDS: ClassVar[frozenset[int]]  # x and y of COMMAND_INT are degrees * 1e7 here
    UNKNOWN_MESSAGE: ClassVar[Result]  # what a request for a message that it has not brings

    def __init__(
        self,
        link: MavlinkLink,
        vehicle: VehicleT,
        schedule: Schedule,
        clock: Callable[[], float],
        timesync_due_s: float,
    ) -> None:
        self.link = link
        self._vehicle = vehicle
        self._schedule = schedule
        self._clock = clock
        self._timesync_due_s = timesync_due_s
        self._answers = Answers()
        self._parameter_queue: list[int] = []
        self._reboot_wanted = False
        self._handlers: dict[str, Callable[[Any], None]] = {
            "COMMAND_LONG": self._command_long,
            "COMMAND_INT": self._command_int,
            "MISSION_REQUEST_LIST": self._mission_list,
        }

    @abstractmethod
    def _is_for_us(self, message: Any) -> bool: ...

    @abstractmethod
    def _do(self, command: VehicleCommand, context: "CommandContext[VehicleT]") -> Result:
        """Do a command and say how it went, in this autopilot's result codes."""

    def _has_news(self, number: int) -> bool:
        """Whether a message that is due has anything new to say."""
        return True

    @abstractmethod
    def _send_parameter(self, index: int) -> None: ...

    @abstractmethod
    def _say_texts(self) -> None: ...

    @property
    def reboot_wanted(self) -> bool:
        """A reboot was commanded and acknowledged."""
        return self._reboot_wanted and not self._answers

    def hear(self) -> None:
        """Handle everything that has arrived."""
        for message in self.link.receive(self._vehicle.t_s):
            handler = self._handlers.get(message.get_type())
            if handler is not None and self._is_for_us(message):
                handler(message)

    def say(self) -> None:
        """Send what is due."""
        t_s = self._vehicle.t_s
        for number in self._schedule.due(t_s):
            if self._has_news(number):
                self._send(self._schedule.builders[number](self._vehicle))
        for answer in self._answers.due(t_s):
            self._send(answer)
        if t_s >= self._timesync_due_s:
            self._timesync_due_s = t_s + self.TIMESYNC_EVERY_S
            self._send(mavlink.MAVLink_timesync_message(0, round(self._clock() * 1e9)))
        for _ in range(min(_PARAMETERS_AT_ONCE, len(self._parameter_queue))):
            self._send_parameter(self._parameter_queue.pop(0))
        self._say_texts()

    def _send(self, message: Any) -> None:
        if message is not None:
            self.link.send(message)

    def _answer(self, message: Any) -> None:
        """Send after the time that this autopilot takes to acknowledge."""
        due_s = self._vehicle.t_s + self.ACK_DELAY_S * self._vehicle.config.speed
        self._answers.put(message, due_s)

    def _command_long(self, m: Any) -> None:
        place = (m.param5, m.param6, m.param7)
        self._execute(m, VehicleCommand(m.command, m.param1, m.param2, m.param3, m.param4, *place))

    def _command_int(self, m: Any) -> None:
        scale = 1e-7 if m.command in self.DEGE7_COMMANDS else 1.0
        place = (m.x * scale, m.y * scale, m.z)
        self._execute(m, VehicleCommand(m.command, m.param1, m.param2, m.param3, m.param4, *place))

    def _execute(self, message: Any, command: VehicleCommand) -> None:
        context = CommandContext(self._vehicle, self._schedule, [])
        result = self._do(command, context)
        wanted = [self._requested(number, command) for number in context.send_now]
        if None in wanted and command.number == REQUEST_MESSAGE:
            result = self.UNKNOWN_MESSAGE
        source = (message.get_srcSystem(), message.get_srcComponent())
        self._answer(mavlink.MAVLink_command_ack_message(command.number, result, 0, 0, *source))
        for built in wanted:
            if built is not None:
                self._answer(built)
        self._reboot_wanted = self._reboot_wanted or context.reboot

    def _requested(self, number: int, command: VehicleCommand) -> Any:
        if number == MESSAGE_INTERVAL and command.number == GET_MESSAGE_INTERVAL:
            asked = int(command.p1)
            interval_us = self._schedule.interval_us(asked)
            return mavlink.MAVLink_message_interval_message(asked, interval_us)
        builder = self._schedule.builders.get(number)
        return None if builder is None else builder(self._vehicle)

    def _mission_list(self, m: Any) -> None:
        source = (m.get_srcSystem(), m.get_srcComponent())
        self._send(mavlink.MAVLink_mission_count_message(*source, 0, m.mission_type))


class Answers:
    """Kept in the order in which they are due, equals in the order in which they came."""

    def __init__(self) -> None:
        self._waiting: list[tuple[float, int, Any]] = []
        self._count = 0

    def __bool__(self) -> bool:
        """Whether any waits."""
        return bool(self._waiting)

    def put(self, message: Any, due_s: float) -> None:
        """Keep one until it is due."""
        self._count += 1
        heapq.heappush(self._waiting, (due_s, self._count, message))

    def due(self, t_s: float) -> list[Any]:
        """Those to send now."""
        found = []
        while self._waiting and self._waiting[0][0] <= t_s:
            found.append(heapq.heappop(self._waiting)[2])
        return found


@dataclass(slots=True)
class CommandContext(Generic[VehicleT]):
    """What a command may touch besides the vehicle: its link's streams, and a message to send."""

    vehicle: VehicleT
    schedule: Schedule
    send_now: list[int]
    reboot: bool = False


def arm(command: VehicleCommand, context: CommandContext[Any]) -> Result:
    """COMPONENT_ARM_DISARM; where it is armed is home."""
    v = context.vehicle
    forced = command.p2 == FORCE_MAGIC
    result: Result = Result.UNSUPPORTED
    if command.p1 == 1.0:
        result = v.commander.arm(v.health, forced, v.t_s)
        if result is Result.ACCEPTED:
            v.set_home_here()
    elif command.p1 == 0.0:
        result = v.commander.disarm(v.health, forced)
    return result


def request_version(_: VehicleCommand, context: CommandContext[Any]) -> Result:
    """REQUEST_AUTOPILOT_CAPABILITIES."""
    context.send_now.append(AUTOPILOT_VERSION)
    return Result.ACCEPTED


def get_interval(command: VehicleCommand, context: CommandContext[Any]) -> Result:
    """How often a message is sent."""
    if message_id(command.p1) is None:
        return Result.DENIED
    context.send_now.append(MESSAGE_INTERVAL)
    return Result.ACCEPTED


def set_home(refusal: Result, command: VehicleCommand, context: CommandContext[Any]) -> Result:
    """DO_SET_HOME; an autopilot has its own word for what it refuses."""
    v = context.vehicle
    if command.p1 == 1.0:
        done = v.set_home_here()
    elif is_place(command.x, command.y, command.z):
        done = v.set_home(command.x, command.y, command.z)
    else:
        return Result.DENIED
    return Result.ACCEPTED if done else refusal


def reboot(
    refusals: tuple[Result, Result], command: VehicleCommand, context: CommandContext[Any]
) -> Result:
    """PREFLIGHT_REBOOT_SHUTDOWN; refused when armed, and where something else than a reboot."""
    if context.vehicle.commander.armed:
        return refusals[0]
    if command.p1 != 1.0:
        return refusals[1]
    context.reboot = True
    return Result.ACCEPTED


def accept(_: VehicleCommand, __: CommandContext[Any]) -> Result:
    """Nothing comes of it."""
    return Result.ACCEPTED


# Those that both autopilots do alike.
COMMON_COMMANDS: dict[int, Callable[[VehicleCommand, CommandContext[Any]], Result]] = {
    178: accept,  # DO_CHANGE_SPEED
    400: arm,
    GET_MESSAGE_INTERVAL: get_interval,
    520: request_version,
}
