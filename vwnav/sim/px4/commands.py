"""COMMAND_LONG and COMMAND_INT: what the simulated PX4 does with each, and its answer."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from vwnav.sim.mavlink.command import FORCE_MAGIC, Result, VehicleCommand, is_place, message_id
from vwnav.sim.mavlink.conversation import MESSAGE_INTERVAL
from vwnav.sim.mavlink.schedule import Schedule
from vwnav.sim.px4.modes import NavState, state_of_custom_mode
from vwnav.sim.px4.px4 import SimulatedPx4

_CUSTOM_MODE_ENABLED = 1


@dataclass(slots=True)
class Px4CommandContext:
    """What a command may touch besides the vehicle: its link's streams, and a message to send."""

    vehicle: SimulatedPx4
    schedule: Schedule
    send_now: list[int]
    reboot: bool = False


Handler = Callable[[VehicleCommand, Px4CommandContext], Result]


def execute(command: VehicleCommand, context: Px4CommandContext) -> Result:
    """Do a command and say how it went, in PX4's result codes."""
    handler = _HANDLERS.get(command.number)
    context.vehicle.look()
    if command.number in context.vehicle.refuses:
        return Result.TEMPORARILY_REJECTED
    return Result.UNSUPPORTED if handler is None else handler(command, context)


def _arm(command: VehicleCommand, context: Px4CommandContext) -> Result:
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


def _takeoff(command: VehicleCommand, context: Px4CommandContext) -> Result:
    v = context.vehicle
    result = v.commander.ask(NavState.TAKEOFF, v.health)
    if result is Result.ACCEPTED:
        v.plan_takeoff(command.z if math.isfinite(command.z) and command.z != 0.0 else None)
    return result


def _state(wanted: NavState) -> Handler:
    def ask(_: VehicleCommand, context: Px4CommandContext) -> Result:
        return context.vehicle.commander.ask(wanted, context.vehicle.health)

    return ask


def _set_mode(command: VehicleCommand, context: Px4CommandContext) -> Result:
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


def _set_interval(command: VehicleCommand, context: Px4CommandContext) -> Result:
    number = message_id(command.p1)
    known = number is not None and context.schedule.set_interval(
        number, command.p2, context.vehicle.t_s
    )
    return Result.ACCEPTED if known else Result.FAILED


def _request(command: VehicleCommand, context: Px4CommandContext) -> Result:
    number = message_id(command.p1)
    if number is None:
        return Result.DENIED
    context.send_now.append(number)
    return Result.ACCEPTED


def _request_version(_: VehicleCommand, context: Px4CommandContext) -> Result:
    context.send_now.append(148)
    return Result.ACCEPTED


def _get_interval(command: VehicleCommand, context: Px4CommandContext) -> Result:
    if message_id(command.p1) is None:
        return Result.DENIED
    context.send_now.append(MESSAGE_INTERVAL)
    return Result.ACCEPTED


def _set_home(command: VehicleCommand, context: Px4CommandContext) -> Result:
    v = context.vehicle
    if command.p1 == 1.0:
        done = v.set_home_here()
    elif is_place(command.x, command.y, command.z):
        done = v.set_home(command.x, command.y, command.z)
    else:
        return Result.DENIED
    return Result.ACCEPTED if done else Result.TEMPORARILY_REJECTED


def _set_origin(command: VehicleCommand, context: Px4CommandContext) -> Result:
    if not is_place(command.x, command.y, command.z):
        return Result.DENIED
    context.vehicle.estimator.set_origin(command.x, command.y, command.z)
    context.send_now.append(49)
    return Result.ACCEPTED


def _reboot(command: VehicleCommand, context: Px4CommandContext) -> Result:
    if context.vehicle.commander.armed:
        return Result.TEMPORARILY_REJECTED
    if command.p1 != 1.0:
        return Result.DENIED
    context.reboot = True
    return Result.ACCEPTED


def _accept(_: VehicleCommand, __: Px4CommandContext) -> Result:
    return Result.ACCEPTED


_HANDLERS: dict[int, Handler] = {
    17: _state(NavState.HOLD),  # NAV_LOITER_UNLIM
    20: _state(NavState.RETURN),
    21: _state(NavState.LAND),
    22: _takeoff,
    176: _set_mode,
    178: _accept,  # DO_CHANGE_SPEED
    179: _set_home,
    246: _reboot,
    400: _arm,
    510: _get_interval,
    511: _set_interval,
    512: _request,
    520: _request_version,
    611: _set_origin,
}
