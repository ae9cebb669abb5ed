"""What simulated autopilots tell alike, each message from the vehicle's present state."""

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from vwnav.sim.mavlink.units import ms
from vwnav.sim.multirotor.sensors import FIELD_GAUSS
from vwnav.sim.multirotor.simulated import SimulatedMultirotor


def attitude(v: SimulatedMultirotor) -> Any:
    """Euler angles and body rates of the estimator."""
    filter_ = v.estimator.attitude
    return mavlink.MAVLink_attitude_message(ms(v.t_s), *filter_.euler_rad, *filter_.rates)


def attitude_quaternion(v: SimulatedMultirotor) -> Any:
    """Quaternion and body rates of the estimator."""
    filter_ = v.estimator.attitude
    return mavlink.MAVLink_attitude_quaternion_message(
        ms(v.t_s), *filter_.quat_wxyz, *filter_.rates, [0.0] * 4
    )


def distance_sensor(v: SimulatedMultirotor) -> Any:
    """Downward rangefinder, in cm."""
    distance_m = v.sensors.range_m(v.body)
    if distance_m is None or distance_m > v.config.range_most_m:
        return None
    most_cm, distance_cm = round(100.0 * v.config.range_most_m), round(100.0 * distance_m)
    return mavlink.MAVLink_distance_sensor_message(
        ms(v.t_s), 0, most_cm, distance_cm, 0, 0, 25, 0, signal_quality=100
    )


def system_time(v: SimulatedMultirotor) -> Any:
    """Time since boot; without GPS the time of day is not known."""
    return mavlink.MAVLink_system_time_message(0, ms(v.t_s))


def field_gauss(v: SimulatedMultirotor) -> tuple[float, float, float]:
    """The magnetic field along the body's axes."""
    r00, r01, r02, _, _, _, r20, r21, r22 = v.body.rotation
    flat, down = FIELD_GAUSS
    return flat * r00 + down * r20, flat * r01 + down * r21, flat * r02 + down * r22
