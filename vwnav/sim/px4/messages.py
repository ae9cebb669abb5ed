"""What the simulated PX4 tells of itself, its sensors and its pilot, and the truth.

A function makes one message of the vehicle's present state; None where PX4 would not send it now.
"""

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from vwnav.sim.mavlink.units import cm_s, mm, ms, us
from vwnav.sim.multirotor.messages import distance_sensor, field_gauss, system_time
from vwnav.sim.multirotor.sensors import pressure_hpa
from vwnav.sim.px4.px4 import SimulatedPx4

_NAN = math.nan
_UNUSED_CELLS = [65535] * (10 - 1)
_UINT16_MAX = 65535
_UPDATED = 63  # accelerometer, gyroscope, magnetometer
_ARMED = 128
_PASCAL = 100.0  # in which the 1.16 era tells HIGHRES_IMU's pressure
_OLD_VERSION = 0x010E0080  # 1.14.0, type 128, of the 1.16 era
_VERSION = 0x01080080  # 1.8.0, type 128: what the PX4 1.18-era simulation says of itself
_CAPABILITIES = 0xE8FF
_GIT_HASH = [0, 0, 0, 211, 36, 228, 74, 13]
# SYS_STATUS bits (MAV_SYS_STATUS_SENSOR), as recorded
_PRESENT = 0x300C00F
_ENABLED = 0x301C00F
_HEALTHY = 0x320881F
_GPS, _XY_CONTROL, _RC, _PREARM = 0x20, 0x4000, 0x10000, 0x10000000


def heartbeat(v: SimulatedPx4) -> Any:
    """Identity, mode and system status."""
    commander = v.commander
    armed = commander.armed
    if armed:
        status = 5 if commander.failsafe.active else 4
    else:
        status = 0 if commander.problems(v.health) else 3
    state = commander.state
    return mavlink.MAVLink_heartbeat_message(
        2, 12, state.base_mode | (_ARMED if armed else 0), state.custom_mode, status, 3
    )


def current_mode(v: SimulatedPx4) -> Any:
    """The mode flown and the one intended."""
    commander = v.commander
    return mavlink.MAVLink_current_mode_message(
        0, commander.state.custom_mode, commander.intended.custom_mode
    )


def sys_status(v: SimulatedPx4) -> Any:
    """Sensor bits, prearm check, battery."""
    no_gps = not v.parameters["SYS_HAS_GPS"]
    armed = v.commander.armed
    enabled = _ENABLED | (0 if armed or no_gps else _GPS)
    health = _HEALTHY | (_GPS if armed or no_gps else 0)
    health |= _XY_CONTROL if v.health.local_position_ok else 0
    radio = _RC if v.health.manual_ok else 0
    health |= radio
    health |= 0 if not armed and v.commander.problems(v.health) else _PREARM
    millivolts = round(1000.0 * v.battery.voltage_v)
    percent = int(100.0 * v.battery.remaining)
    return mavlink.MAVLink_sys_status_message(
        _PRESENT | radio, enabled, health, 120, millivolts, -1, percent, 0, 0, 0, 0, 0, 0, 0, 0, 1
    )


def extended_sys_state(v: SimulatedPx4) -> Any:
    """Landed state."""
    return mavlink.MAVLink_extended_sys_state_message(
        0, v.commander.landed_state(v.health, v.tasks.landing)
    )


def highres_imu(v: SimulatedPx4) -> Any:
    """Inertial sensors, magnetic field in the body, barometer."""
    imu = v.imu
    alt_m = v.config.home_alt_amsl_m + v.baro_height_m
    inertial = (imu.ax, imu.ay, imu.az, imu.p, imu.q, imu.r)
    pressure = pressure_hpa(alt_m) * (_PASCAL if v.old else 1.0)
    return mavlink.MAVLink_highres_imu_message(
        us(v.t_s), *inertial, *field_gauss(v), pressure, 0.0, alt_m, 15.0, _UPDATED
    )


def scaled_pressure(v: SimulatedPx4) -> Any:
    """Barometer."""
    alt_m = v.config.home_alt_amsl_m + v.baro_height_m
    return mavlink.MAVLink_scaled_pressure_message(ms(v.t_s), pressure_hpa(alt_m), 0.0, 1474)


def battery_status(v: SimulatedPx4) -> Any:
    """Charge and voltage."""
    b = v.battery
    volts = [round(1000.0 * b.voltage_v), *_UNUSED_CELLS]
    percent = int(100.0 * b.remaining)
    return mavlink.MAVLink_battery_status_message(
        0, 1, 1, 32767, volts, -1, round(b.consumed_mah), -1, percent, 0, b.charge_state
    )


def gps_raw_int(v: SimulatedPx4) -> Any:
    """A receiver without a fix, where PX4 expects one."""
    if not v.parameters["SYS_HAS_GPS"]:
        return None
    alt = mm(v.config.home_alt_amsl_m)
    return mavlink.MAVLink_gps_raw_int_message(us(v.t_s), 0, 0, 0, alt, 10000, 10000, 0, 0, 0)


def servo_output_raw(v: SimulatedPx4) -> Any:
    """Rotor commands in microseconds; 900 is disarmed."""
    armed = v.commander.armed
    rotors = [round(1000 + 1000 * f) if armed else 900 for f in v.body.rotors]
    rest = [900] * 12
    return mavlink.MAVLink_servo_output_raw_message(us(v.t_s) % 2**32, 0, *rotors, *rest)


def rc_channels(v: SimulatedPx4) -> Any:
    """The radio's channels."""
    if not v.manual.radio_available(v.t_s):
        return None
    heard = v.manual.channels
    channels = [*heard, *([_UINT16_MAX] * (18 - len(heard)))]
    return mavlink.MAVLink_rc_channels_message(ms(v.t_s), len(heard), *channels, 100)


def mission_current(v: SimulatedPx4) -> Any:
    """No mission: this vehicle has none."""
    return mavlink.MAVLink_mission_current_message(0, 65535, 1, 2)


def vibration(v: SimulatedPx4) -> Any:
    """A quiet airframe."""
    return mavlink.MAVLink_vibration_message(us(v.t_s), 0.0, 0.01, 0.1, 0, 0, 0)


def autopilot_version(v: SimulatedPx4) -> Any:
    """Capabilities and version, as the PX4 of its era reports itself in simulation."""
    version = _OLD_VERSION if v.old else _VERSION
    return mavlink.MAVLink_autopilot_version_message(
        _CAPABILITIES, version, version, 0x06122BFF, 1, _GIT_HASH, _GIT_HASH, [0] * 8, 0, 0, 1
    )


def ping(v: SimulatedPx4) -> Any:
    """A question whether anybody is there."""
    return mavlink.MAVLink_ping_message(us(v.t_s), int(v.t_s), 0, 0)


def hil_state_quaternion(v: SimulatedPx4) -> Any:
    """Ground truth, for the renderer and the score only."""
    b = v.body
    lat, lon, alt = v.start_frame.to_geodetic([b.n, b.e, b.d])
    place = (round(float(lat) * 1e7), round(float(lon) * 1e7), mm(float(alt)))
    speed = (cm_s(b.vn), cm_s(b.ve), cm_s(b.vd))
    quat = [b.qw, b.qx, b.qy, b.qz]
    return mavlink.MAVLink_hil_state_quaternion_message(
        us(v.t_s), quat, b.p, b.q, b.r, *place, *speed, 0, 0, 0, 0, 0
    )


BUILDERS: dict[int, Callable[[SimulatedPx4], Any]] = {
    0: heartbeat,
    1: sys_status,
    2: system_time,
    4: ping,
    24: gps_raw_int,
    29: scaled_pressure,
    36: servo_output_raw,
    42: mission_current,
    65: rc_channels,
    105: highres_imu,
    115: hil_state_quaternion,
    132: distance_sensor,
    147: battery_status,
    148: autopilot_version,
    241: vibration,
    245: extended_sys_state,
    436: current_mode,
}
