"""What the simulated PX4 tells: one function per message, each from the vehicle's present state.

A function returns None when PX4 would not send it now (no origin, no radio, no GPS).
"""

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from vwnav.sim.multirotor.sensors import FIELD_GAUSS, pressure_hpa
from vwnav.sim.px4.px4 import SimulatedPx4

Builder = Callable[[SimulatedPx4], Any]

_NAN = math.nan
_UNUSED_CELLS = [65535] * (10 - 1)
_UINT16_MAX = 65535
_UPDATED = 63  # accelerometer, gyroscope, magnetometer
_ARMED = 128
_ZERO4 = [0.0] * 4
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
    health |= _RC if v.health.manual_ok else 0
    health |= 0 if not armed and v.commander.problems(v.health) else _PREARM
    millivolts = round(1000.0 * v.battery.voltage_v)
    percent = int(100.0 * v.battery.remaining)
    return mavlink.MAVLink_sys_status_message(
        _PRESENT, enabled, health, 120, millivolts, -1, percent, 0, 0, 0, 0, 0, 0, 0, 0, 1
    )


def extended_sys_state(v: SimulatedPx4) -> Any:
    """Landed state."""
    return mavlink.MAVLink_extended_sys_state_message(
        0, v.commander.landed_state(v.health, v.tasks.landing)
    )


def attitude(v: SimulatedPx4) -> Any:
    """Euler angles and body rates of the estimator."""
    filter_ = v.estimator.attitude
    return mavlink.MAVLink_attitude_message(_ms(v), *filter_.euler_rad, *filter_.rates)


def attitude_quaternion(v: SimulatedPx4) -> Any:
    """Quaternion and body rates of the estimator."""
    filter_ = v.estimator.attitude
    return mavlink.MAVLink_attitude_quaternion_message(
        _ms(v), *filter_.quat_wxyz, *filter_.rates, _ZERO4
    )


def attitude_target(v: SimulatedPx4) -> Any:
    """What the attitude controller follows."""
    control = v.controller
    return mavlink.MAVLink_attitude_target_message(
        _ms(v), 0, list(control.attitude_wxyz), *control.rates_sp, control.thrust
    )


def local_position_ned(v: SimulatedPx4) -> Any:
    """Position and velocity of the estimator about its origin, valid or not."""
    e = v.estimator
    return mavlink.MAVLink_local_position_ned_message(
        _ms(v), e.north.x, e.east.x, e.down.x, e.north.v, e.east.v, e.down.v
    )


def odometry(v: SimulatedPx4) -> Any:
    """The same with attitude, covariances and reset counter (frames LOCAL_NED as recorded)."""
    e = v.estimator
    pose, velocity = [0.0] * 21, [0.0] * 21
    pose[0], pose[6], pose[11] = e.north.p00, e.east.p00, e.down.p00
    pose[15] = pose[18] = 1e-4
    pose[20] = 1e-3
    velocity[0], velocity[6], velocity[11] = e.north.p11, e.east.p11, e.down.p11
    position = (e.north.x, e.east.x, e.down.x)
    speed = (e.north.v, e.east.v, e.down.v)
    quat = list(e.attitude.quat_wxyz)
    counter = e.reset_counter % 256
    return mavlink.MAVLink_odometry_message(
        _us(v), 1, 1, *position, quat, *speed, *e.attitude.rates, pose, velocity, counter, 8, 0
    )


def global_position_int(v: SimulatedPx4) -> Any:
    """Geodetic position; nothing before the origin, zeros before the position."""
    e = v.estimator
    place = e.geodetic()
    if place is None:
        return None
    lat, lon, alt = place
    known = e.ever_aided
    above_m = alt - (v.home.alt_amsl_m if v.home is not None else e.start_alt_amsl_m)
    return mavlink.MAVLink_global_position_int_message(
        _ms(v),
        round(lat * 1e7) if known else 0,
        round(lon * 1e7) if known else 0,
        _mm(alt),
        _mm(above_m),
        _cm_s(e.north.v),
        _cm_s(e.east.v),
        _cm_s(e.down.v),
        round(math.degrees(e.attitude.yaw_rad) * 100.0) % 36000,
    )


def altitude(v: SimulatedPx4) -> Any:
    """Heights of every kind."""
    e = v.estimator
    amsl = e.alt_amsl_m - e.down.x
    relative = amsl - v.home.alt_amsl_m if v.home is not None else _NAN
    clearance = max(0.0, -v.body.d)
    monotonic = v.config.home_alt_amsl_m + v.baro_height_m
    return mavlink.MAVLink_altitude_message(
        _us(v), monotonic, amsl, -e.down.x, relative, amsl - clearance, clearance
    )


def estimator_status(v: SimulatedPx4) -> Any:
    """Flags as recorded: 0x17f aided, 0x07f dead reckoning, 0x065 no position, 0x80 standing."""
    e = v.estimator
    valid = e.local_position_ok
    flags = 0x65
    if valid:
        flags |= 0x0A | (0x10 if e.origin is not None else 0)
    flags |= 0x100 if e.fusing else 0
    flags |= 0x80 if v.landed else 0
    flags |= 0x400 if not e.ever_aided and v.parameters["SYS_HAS_GPS"] else 0
    ratio = math.sqrt(e.test_ratio) if e.fusing else _NAN
    return mavlink.MAVLink_estimator_status_message(
        _us(v), flags, ratio, ratio, 0.003, _NAN, _NAN, _NAN, e.sigma_horizontal_m, e.down.sigma_m
    )


def highres_imu(v: SimulatedPx4) -> Any:
    """Inertial sensors, magnetic field in the body, barometer."""
    imu = v.imu
    r00, r01, r02, _, _, _, r20, r21, r22 = v.body.rotation
    flat, down = FIELD_GAUSS
    field = (flat * r00 + down * r20, flat * r01 + down * r21, flat * r02 + down * r22)
    alt_m = v.config.home_alt_amsl_m + v.baro_height_m
    inertial = (imu.ax, imu.ay, imu.az, imu.p, imu.q, imu.r)
    pressure = pressure_hpa(alt_m)
    return mavlink.MAVLink_highres_imu_message(
        _us(v), *inertial, *field, pressure, 0.0, alt_m, 15.0, _UPDATED
    )


def scaled_pressure(v: SimulatedPx4) -> Any:
    """Barometer."""
    alt_m = v.config.home_alt_amsl_m + v.baro_height_m
    return mavlink.MAVLink_scaled_pressure_message(_ms(v), pressure_hpa(alt_m), 0.0, 1474)


def distance_sensor(v: SimulatedPx4) -> Any:
    """Downward rangefinder, in cm."""
    distance_m = v.sensors.range_m(v.body)
    if distance_m is None or distance_m > 100.0:
        return None
    return mavlink.MAVLink_distance_sensor_message(
        _ms(v), 0, 10000, round(100.0 * distance_m), 0, 0, 25, 0, signal_quality=100
    )


def battery_status(v: SimulatedPx4) -> Any:
    """Charge and voltage."""
    b = v.battery
    volts = [round(1000.0 * b.voltage_v), *_UNUSED_CELLS]
    percent = int(100.0 * b.remaining)
    return mavlink.MAVLink_battery_status_message(
        0, 1, 1, 32767, volts, -1, round(b.consumed_mah), -1, percent, 0, b.charge_state
    )


def home_position(v: SimulatedPx4) -> Any:
    """Where RTL goes."""
    home = v.home
    if home is None:
        return None
    lat, lon, alt = (
        round(home.lat_deg * 1e7),
        round(home.lon_deg * 1e7),
        _mm(home.alt_amsl_m),
    )
    q = list(v.estimator.attitude.quat_wxyz)
    return mavlink.MAVLink_home_position_message(
        lat, lon, alt, *home.local_m, q, 0.0, 0.0, 0.0, round(home.t_s * 1e6)
    )


def gps_global_origin(v: SimulatedPx4) -> Any:
    """The estimator's origin."""
    origin = v.estimator.origin
    if origin is None:
        return None
    return mavlink.MAVLink_gps_global_origin_message(
        round(origin.lat_deg * 1e7),
        round(origin.lon_deg * 1e7),
        _mm(origin.alt_amsl_m),
        round(max(0.0, v.estimator.origin_t_s) * 1e6),
    )


def gps_raw_int(v: SimulatedPx4) -> Any:
    """A receiver without a fix, where PX4 expects one."""
    if not v.parameters["SYS_HAS_GPS"]:
        return None
    alt = _mm(v.config.home_alt_amsl_m)
    return mavlink.MAVLink_gps_raw_int_message(_us(v), 0, 0, 0, alt, 10000, 10000, 0, 0, 0)


def vfr_hud(v: SimulatedPx4) -> Any:
    """Speed, heading, throttle, climb."""
    e = v.estimator
    heading = round(math.degrees(e.attitude.yaw_rad)) % 360
    speed = math.hypot(e.north.v, e.east.v)
    percent = round(100.0 * v.controller.thrust)
    amsl = e.alt_amsl_m - e.down.x
    return mavlink.MAVLink_vfr_hud_message(_NAN, speed, heading, percent, amsl, -e.down.v)


def position_target_local_ned(v: SimulatedPx4) -> Any:
    """The setpoint the position controller flies; NaN is left free."""
    sp = v.controller.setpoint
    position = [_free(value) for value in (sp.north_m, sp.east_m, sp.down_m)]
    speed = [_free(value) for value in (sp.vn_m_s, sp.ve_m_s, sp.vd_m_s)]
    push = (0.0, 0.0, 100.0 if sp.idle else 0.0)
    yaw = (_free(sp.yaw_rad), sp.yaw_rate_rad_s or 0.0)
    return mavlink.MAVLink_position_target_local_ned_message(
        _ms(v), 1, 63 if sp.idle else 0, *position, *speed, *push, *yaw
    )


def servo_output_raw(v: SimulatedPx4) -> Any:
    """Rotor commands in microseconds; 900 is disarmed."""
    armed = v.commander.armed
    rotors = [round(1000 + 1000 * f) if armed else 900 for f in v.body.rotors]
    rest = [900] * 12
    return mavlink.MAVLink_servo_output_raw_message(_us(v) % 2**32, 0, *rotors, *rest)


def rc_channels(v: SimulatedPx4) -> Any:
    """The radio's channels."""
    if not v.manual.radio_available(v.t_s):
        return None
    heard = v.manual.channels
    channels = [*heard, *([_UINT16_MAX] * (18 - len(heard)))]
    return mavlink.MAVLink_rc_channels_message(_ms(v), len(heard), *channels, 100)


def mission_current(v: SimulatedPx4) -> Any:
    """No mission: this vehicle has none."""
    return mavlink.MAVLink_mission_current_message(0, 65535, 1, 2)


def vibration(v: SimulatedPx4) -> Any:
    """A quiet airframe."""
    return mavlink.MAVLink_vibration_message(_us(v), 0.0, 0.01, 0.1, 0, 0, 0)


def autopilot_version(v: SimulatedPx4) -> Any:
    """Capabilities and version, as the PX4 1.18-era simulation reports itself."""
    return mavlink.MAVLink_autopilot_version_message(
        _CAPABILITIES, _VERSION, _VERSION, 0x06122BFF, 1, _GIT_HASH, _GIT_HASH, [0] * 8, 0, 0, 1
    )


def ping(v: SimulatedPx4) -> Any:
    """A question whether anybody is there."""
    return mavlink.MAVLink_ping_message(_us(v), int(v.t_s), 0, 0)


def system_time(v: SimulatedPx4) -> Any:
    """Time since boot; without GPS the time of day is not known."""
    return mavlink.MAVLink_system_time_message(0, _ms(v))


def hil_state_quaternion(v: SimulatedPx4) -> Any:
    """Ground truth, for the renderer and the score only."""
    b = v.body
    lat, lon, alt = v.start_frame.to_geodetic([b.n, b.e, b.d])
    place = (round(float(lat) * 1e7), round(float(lon) * 1e7), _mm(float(alt)))
    speed = (_cm_s(b.vn), _cm_s(b.ve), _cm_s(b.vd))
    quat = [b.qw, b.qx, b.qy, b.qz]
    return mavlink.MAVLink_hil_state_quaternion_message(
        _us(v), quat, b.p, b.q, b.r, *place, *speed, 0, 0, 0, 0, 0
    )


def _free(value: float | None) -> float:
    return _NAN if value is None else value


def _cm_s(speed_m_s: float) -> int:
    return max(-32768, min(32767, round(100.0 * speed_m_s)))


def _mm(height_m: float) -> int:
    return max(-(2**31), min(2**31 - 1, round(1000.0 * height_m)))


def _ms(v: SimulatedPx4) -> int:
    return int(1000.0 * v.t_s)


def _us(v: SimulatedPx4) -> int:
    return int(1e6 * v.t_s)
