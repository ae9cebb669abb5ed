"""COMMAND_LONG and COMMAND_INT: what the simulated ArduCopter does with each, and its answer."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from vwnav.sim.copter.copter import SimulatedCopter
from vwnav.sim.copter.modes import Mode
from vwnav.sim.mavlink.command import (
    FORCE_MAGIC,
    Result,
    Severity,
    VehicleCommand,
    is_place,
    message_id,
)
from vwnav.sim.mavlink.conversation import GET_MESSAGE_INTERVAL, MESSAGE_INTERVAL
from vwnav.sim.mavlink.schedule import Schedule

_CUSTOM_MODE_ENABLED = 1
_SHORTEST_US = 3125.0  # a shorter interval is denied


@dataclass(slots=True)
class CopterCommandContext:
    """What a command may touch besides the vehicle: its link's streams, and a message to send."""

    vehicle: SimulatedCopter
    schedule: Schedule
    send_now: list[int]
    reboot: bool = False


Handler = Callable[[VehicleCommand, CopterCommandContext], Result]


def execute(command: VehicleCommand, context: CopterCommandContext) -> Result:
    """Do a command and say how it went, in ArduCopter's result codes."""
    handler = _HANDLERS.get(command.number)
    if command.number in context.vehicle.refuses:
        return Result.FAILED
    return Result.UNSUPPORTED if handler is None else handler(command, context)


def _arm(command: VehicleCommand, context: CopterCommandContext) -> Result:
    v = context.vehicle
    forced = command.p2 == FORCE_MAGIC
    if command.p1 == 1.0:
        result = v.commander.arm(v.health, forced, v.t_s)
        if result is Result.ACCEPTED:
            v.set_home_here()
        return result
    if command.p1 == 0.0:
        return v.commander.disarm(v.health, forced)
    return Result.UNSUPPORTED


def _takeoff(command: VehicleCommand, context: CopterCommandContext) -> Result:
    return context.vehicle.take_off(command.z) if math.isfinite(command.z) else Result.FAILED


def _mode(wanted: Mode) -> Handler:
    return lambda _, context: context.vehicle.ask(wanted)


def _set_mode(command: VehicleCommand, context: CopterCommandContext) -> Result:
    if not all(map(math.isfinite, (command.p1, command.p2))):
        return Result.FAILED
    if not int(command.p1) & _CUSTOM_MODE_ENABLED:
        return Result.UNSUPPORTED
    wanted = next((mode for mode in Mode if mode == int(command.p2)), None)
    return Result.FAILED if wanted is None else context.vehicle.ask(wanted)


def _set_interval(command: VehicleCommand, context: CopterCommandContext) -> Result:
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


def _request(command: VehicleCommand, context: CopterCommandContext) -> Result:
    number = message_id(command.p1)
    if number is None or number not in context.schedule.builders:
        return Result.FAILED
    context.send_now.append(number)
    return Result.ACCEPTED


def _request_version(_: VehicleCommand, context: CopterCommandContext) -> Result:
    context.send_now.append(148)
    return Result.ACCEPTED


def _get_interval(command: VehicleCommand, context: CopterCommandContext) -> Result:
    if message_id(command.p1) is None:
        return Result.DENIED
    context.send_now.append(MESSAGE_INTERVAL)
    return Result.ACCEPTED


def _set_home(command: VehicleCommand, context: CopterCommandContext) -> Result:
    v = context.vehicle
    if command.p1 == 1.0:
        done = v.set_home_here()
    elif is_place(command.x, command.y, command.z):
        done = v.set_home(command.x, command.y, command.z)
    else:
        return Result.DENIED
    return Result.ACCEPTED if done else Result.FAILED


def _reboot(command: VehicleCommand, context: CopterCommandContext) -> Result:
    if context.vehicle.commander.armed:
        return Result.FAILED
    if command.p1 != 1.0:
        return Result.UNSUPPORTED
    context.reboot = True
    return Result.ACCEPTED


def _accept(_: VehicleCommand, __: CopterCommandContext) -> Result:
    return Result.ACCEPTED


_HANDLERS: dict[int, Handler] = {
    17: _mode(Mode.LOITER),  # NAV_LOITER_UNLIM
    20: _mode(Mode.RTL),
    21: _mode(Mode.LAND),
    22: _takeoff,
    176: _set_mode,
    178: _accept,  # DO_CHANGE_SPEED
    179: _set_home,
    246: _reboot,
    400: _arm,
    GET_MESSAGE_INTERVAL: _get_interval,
    511: _set_interval,
    512: _request,
    520: _request_version,
}
