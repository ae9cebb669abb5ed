"""Faults of the aircraft, and what its pilot does."""

from dataclasses import dataclass, replace

from pymavlink.dialects.v20 import common as mavlink

from vwnav.bench.flights.stage import FlightStage, Lasting
from vwnav.vehicle import Order

_FREEZING_K, _STANDARD_K = 273.15, 288.15
_ORDERS = {  # the command, and its first parameter
    Order.PAUSE: (mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 0.0),
    Order.GO_ON: (mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 1.0),
    Order.RETURN: (mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, 0.0),
    Order.LAND: (mavlink.MAV_CMD_NAV_LAND, 0.0),
}


@dataclass(frozen=True)
class BatteryAt(Lasting):
    """The charge falls to so much at once."""

    ratio: float

    def begin(self, world: FlightStage) -> None:
        """A cell fails."""
        world.core.vehicle.battery.remaining = self.ratio


@dataclass(frozen=True)
class BarometerWrong:
    """The pressure at the port is off, for the autopilot as for us."""

    metres: float

    def begin(self, world: FlightStage) -> None:
        """A gust."""
        world.core.vehicle.sensors.baro_error_m = self.metres

    def end(self, world: FlightStage) -> None:
        """Calm."""
        world.core.vehicle.sensors.baro_error_m = 0.0


@dataclass(frozen=True)
class BarometerDrifts:
    """The air pressure changes: the barometric height runs away at a steady rate."""

    metres_per_s: float

    def begin(self, world: FlightStage) -> None:
        """A front comes."""
        world.core.vehicle.sensors.baro_drift_m_s = self.metres_per_s

    def end(self, world: FlightStage) -> None:
        """What it was is kept."""
        world.core.vehicle.sensors.baro_drift_m_s = 0.0


@dataclass(frozen=True)
class AirTemperature(Lasting):
    """Warm or cold: pressure falls by less or more a metre than in the standard atmosphere.

    By the ratio of the absolute temperatures (the hydrostatic equation, ISO 2533).
    """

    degrees_c: float

    def begin(self, world: FlightStage) -> None:
        """As it is."""
        world.core.vehicle.sensors.baro_scale = _STANDARD_K / (_FREEZING_K + self.degrees_c)


@dataclass(frozen=True)
class RangefinderStuck:
    """It says the same again and again: fog, a spider, a driver that hangs."""

    metres: float

    def begin(self, world: FlightStage) -> None:
        """Stuck."""
        world.core.vehicle.sensors.range_stuck_m = self.metres

    def end(self, world: FlightStage) -> None:
        """It measures."""
        world.core.vehicle.sensors.range_stuck_m = None


@dataclass(frozen=True)
class RangefinderOff:
    """It says so many times the distance: tree tops, a wrong unit, a mirror."""

    times: float

    def begin(self, world: FlightStage) -> None:
        """Off."""
        world.core.vehicle.sensors.range_scale = self.times

    def end(self, world: FlightStage) -> None:
        """It measures."""
        world.core.vehicle.sensors.range_scale = 1.0


@dataclass(frozen=True)
class RangefinderEnds(Lasting):
    """It says so of all that is farther, as many do, and not that it sees nothing."""

    metres: float

    def begin(self, world: FlightStage) -> None:
        """It never says more."""
        world.core.vehicle.sensors.range_ends_m = self.metres


@dataclass(frozen=True)
class RangefinderWild(Lasting):
    """Such a share of what it says is anything: sunlight, dust, a second one's light."""

    share: float

    def begin(self, world: FlightStage) -> None:
        """Wild."""
        world.core.vehicle.sensors.range_wild = self.share


@dataclass(frozen=True)
class HeadingReset(Lasting):
    """The autopilot realigns its heading by so much at once, as PX4 does after take-off."""

    turn_rad: float

    def begin(self, world: FlightStage) -> None:
        """Its attitude is another one, and it believes its compass so from now on."""
        vehicle = world.core.vehicle
        vehicle.estimator.attitude.turn_heading(self.turn_rad)
        vehicle.sensors.heading_bias_rad += self.turn_rad


@dataclass(frozen=True)
class Reboots(Lasting):
    """The autopilot starts anew; only ever on the ground."""

    def begin(self, world: FlightStage) -> None:
        """Power off and on."""
        world.core.reboot()


@dataclass(frozen=True)
class SimulatorStands:
    """A simulator gets no processor: for so long neither aircraft nor camera nor their time go on.

    What it sends next follows on what it sent last, as if nothing had been.
    """

    seconds: float

    def begin(self, world: FlightStage) -> None:
        """It stands."""
        world.core.wait(self.seconds)
        world.camera.troubles[id(self)] = lambda frame: None

    def end(self, world: FlightStage) -> None:
        """It goes on."""
        del world.camera.troubles[id(self)]


@dataclass(frozen=True)
class PilotSwitches(Lasting):
    """The pilot flips the mode switch to Position and flies."""

    def begin(self, world: FlightStage) -> None:
        """Flipped."""
        vehicle = world.core.vehicle
        vehicle.pilot.plan = replace(vehicle.pilot.plan, switch_at_s=vehicle.t_s)
        world.note("pilot switches")


@dataclass(frozen=True)
class PilotStopsMotors(Lasting):
    """The pilot flips the kill switch."""

    def begin(self, world: FlightStage) -> None:
        """Disarmed, wherever it is."""
        world.core.vehicle.stop_motors()
        world.note("pilot stops the motors")


@dataclass(frozen=True)
class PilotPushes(Lasting):
    """The pilot pushes the pitch stick forward for three seconds, and flies."""

    def begin(self, world: FlightStage) -> None:
        """A ramp of 0.4 s."""
        vehicle = world.core.vehicle
        vehicle.pilot.plan = replace(vehicle.pilot.plan, takes_over_at_s=vehicle.t_s)
        world.note("pilot pushes the stick")


@dataclass(frozen=True)
class RadioOff:
    """The pilot's transmitter goes off."""

    def begin(self, world: FlightStage) -> None:
        """Off."""
        vehicle = world.core.vehicle
        vehicle.pilot.plan = replace(vehicle.pilot.plan, rc_lost_at_s=vehicle.t_s)
        world.note("the radio goes off")

    def end(self, world: FlightStage) -> None:
        """On again."""
        vehicle = world.core.vehicle
        vehicle.pilot.plan = replace(vehicle.pilot.plan, rc_back_at_s=vehicle.t_s)


@dataclass(frozen=True)
class PilotHandsBack(Lasting):
    """The pilot's ground station asks the navigator to go on."""

    def begin(self, world: FlightStage) -> None:
        """One command, to the navigator itself."""
        vehicle = world.core.vehicle
        vehicle.pilot.plan = replace(vehicle.pilot.plan, switch_at_s=None)
        world.autopilot_link.a.write(order_packet(Order.GO_ON, *world.navigator.port.own_id))
        world.note("pilot hands back")


@dataclass(frozen=True)
class StationOrders(Lasting):
    """A ground station asks the navigator for something: see `vwnav.mavlink.ground_commands`."""

    order: Order

    def begin(self, world: FlightStage) -> None:
        """One command, to the navigator itself."""
        world.autopilot_link.a.write(order_packet(self.order, *world.navigator.port.own_id))
        world.note(f"the ground station orders {self.order.value}")


def order_packet(order: Order, system: int, component: int) -> bytes:
    """Of a ground station to the navigator that has these ids."""
    station = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    number, goes_on = _ORDERS[order]
    command = mavlink.MAVLink_command_long_message(
        system, component, number, 0, goes_on, 0, 0, 0, 0, 0, 0
    )
    return bytes(command.pack(station))


@dataclass(frozen=True)
class CommandRefused:
    """The autopilot refuses a command (its MAV_CMD number)."""

    number: int

    def begin(self, world: FlightStage) -> None:
        """Refused from now on."""
        world.core.vehicle.refuses.add(self.number)

    def end(self, world: FlightStage) -> None:
        """Taken again."""
        world.core.vehicle.refuses.discard(self.number)
