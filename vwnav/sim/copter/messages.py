"""What the simulated ArduCopter tells: one function per message, from the vehicle's present state.

A function returns None when ArduCopter would not send it now.
"""

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.sim.copter.copter import SimulatedCopter
from vwnav.sim.copter.modes import Mode, base_mode
from vwnav.sim.mavlink.schedule import Schedule
from vwnav.sim.mavlink.units import cm_s, int16, mm, ms, us
from vwnav.sim.multirotor.messages import (
    attitude,
    attitude_quaternion,
    distance_sensor,
    field_gauss,
    system_time,
)
from vwnav.sim.multirotor.sensors import pressure_hpa

Builder = Callable[[SimulatedCopter], Any]

_ARMED = 128
_MILLI_G = 1000.0 / 9.80665
_VERSION = 0x04070000  # 4.7.0, type 0: a development version
_CAPABILITIES = 0xFBEF
_GIT_HASH = [50, 53, 57, 56, 101, 57, 100, 52]
_UNUSED_CELLS = [65535] * 9
_CURRENT_CA = 2810  # in flight
_NO_QUATERNION = [math.nan] * 4
# SYS_STATUS bits (MAV_SYS_STATUS_SENSOR), as recorded without GPS
_PRESENT, _ENABLED, _HEALTHY = 0x5371FC8F, 0x52419C8F, 0x47719C0F
_VISION, _Z_CONTROL, _XY_CONTROL, _RC = 0x80, 0x2000, 0x4000, 0x10000
_AHRS, _LOGGING, _BATTERY, _PREARM = 0x200000, 0x1000000, 0x2000000, 0x10000000


def heartbeat(v: SimulatedCopter) -> Any:
    """Identity, mode and system status."""
    commander = v.commander
    flags = base_mode(v.modes.holds_position) | (_ARMED if commander.armed else 0)
    status = 3 if v.landed else 4
    if v.failsafes.active:
        status = 5
    elif not v.estimator.is_aligned:
        status = 1
    return mavlink.MAVLink_heartbeat_message(2, 3, flags, commander.mode, status, 3)


def sys_status(v: SimulatedCopter) -> Any:
    """Sensor bits, prearm check, battery."""
    armed, is_settled = v.commander.armed, v.health.settled
    control = 0 if v.commander.mode is Mode.STABILIZE else _Z_CONTROL
    control |= _XY_CONTROL if v.modes.holds_position else 0
    enabled = _ENABLED | control | (_AHRS if is_settled else 0) | (_LOGGING if armed else 0)
    health = _HEALTHY | control | (_VISION if v.estimator.vision_ok else 0)
    health &= ~(0 if is_settled else _AHRS) & ~(_BATTERY if v.battery.level else 0)
    health |= _PREARM if armed or v.commander.prearm_ok else 0
    no_radio = 0 if v.radio.available(v.t_s) else _RC
    percent = int(100.0 * v.battery.remaining)
    return mavlink.MAVLink_sys_status_message(
        _PRESENT & ~no_radio, enabled & ~no_radio, health & ~no_radio, 0,
        round(1000.0 * v.battery.voltage_v), _current_ca(v), percent, 0, 0, 0, 0, 0, 0,
    )  # fmt: skip


def extended_sys_state(v: SimulatedCopter) -> Any:
    """Landed state."""
    return mavlink.MAVLink_extended_sys_state_message(3, v.landed_state)


def ekf_status_report(v: SimulatedCopter) -> Any:
    """Flags of the estimator; its variances are those of a quiet flight."""
    return mavlink.MAVLink_ekf_status_report_message(v.estimator.flags, 0.1, 0.1, 0.005, 0.01, 0.0)


def local_position_ned(v: SimulatedCopter) -> Any:
    """Position and velocity of the estimator about its origin; nothing before the first."""
    e = v.estimator
    if not e.ever_aided:
        return None
    return mavlink.MAVLink_local_position_ned_message(
        ms(v.t_s), e.north.x, e.east.x, e.down.x, e.north.v, e.east.v, e.down.v
    )


def global_position_int(v: SimulatedCopter) -> Any:
    """Geodetic position; zeros before the origin."""
    e = v.estimator
    heading_cdeg = round(math.degrees(e.attitude.yaw_rad) * 100.0) % 36000
    place = e.geodetic()
    if place is None:
        return mavlink.MAVLink_global_position_int_message(
            ms(v.t_s), 0, 0, 0, 0, 0, 0, 0, heading_cdeg
        )
    lat, lon, alt = place
    above_m = alt - (v.home.alt_amsl_m if v.home is not None else e.start_alt_amsl_m)
    speed = (cm_s(e.north.v), cm_s(e.east.v), cm_s(e.down.v))
    return mavlink.MAVLink_global_position_int_message(
        ms(v.t_s), round(lat * 1e7), round(lon * 1e7), mm(alt), mm(above_m), *speed, heading_cdeg
    )


def highres_imu(v: SimulatedCopter) -> Any:
    """Inertial sensors, magnetic field in the body, barometer."""
    imu = v.imu
    inertial = (imu.ax, imu.ay, imu.az, imu.p, imu.q, imu.r)
    field_milligauss = [1e3 * axis for axis in field_gauss(v)]
    return mavlink.MAVLink_highres_imu_message(
        us(v.t_s), *inertial, *field_milligauss, _pressure_hpa(v), 0.0, 0.0, 25.0, 8191
    )


def raw_imu(v: SimulatedCopter) -> Any:
    """The same in milli-g, milliradians a second and milligauss."""
    return mavlink.MAVLink_raw_imu_message(us(v.t_s), *_scaled(v), 0, 2500)


def scaled_imu(v: SimulatedCopter) -> Any:
    """The same, with another stamp."""
    return mavlink.MAVLink_scaled_imu_message(ms(v.t_s), *_scaled(v), 2500)


def scaled_pressure(v: SimulatedCopter) -> Any:
    """Barometer."""
    return mavlink.MAVLink_scaled_pressure_message(ms(v.t_s), _pressure_hpa(v), 0.0, 2695)


def battery_status(v: SimulatedCopter) -> Any:
    """Charge and voltage."""
    b = v.battery
    volts = [round(1000.0 * b.voltage_v), *_UNUSED_CELLS]
    percent = int(100.0 * b.remaining)
    return mavlink.MAVLink_battery_status_message(
        0, 0, 0, 32767, volts, _current_ca(v), round(b.consumed_mah), 0, percent, 0, b.charge_state
    )


def home_position(v: SimulatedCopter) -> Any:
    """Where RTL goes."""
    home = v.home
    if home is None:
        return None
    place = (round(home.lat_deg * 1e7), round(home.lon_deg * 1e7), mm(home.alt_amsl_m))
    return mavlink.MAVLink_home_position_message(
        *place, *home.local_m, _NO_QUATERNION, 0.0, 0.0, 0.0, round(home.t_s * 1e6)
    )


def gps_global_origin(v: SimulatedCopter) -> Any:
    """The estimator's origin."""
    origin = v.estimator.origin
    if origin is None:
        return None
    place = (round(origin.lat_deg * 1e7), round(origin.lon_deg * 1e7), mm(origin.alt_amsl_m))
    return mavlink.MAVLink_gps_global_origin_message(*place, us(v.t_s))


def gps_raw_int(v: SimulatedCopter) -> Any:
    """No receiver."""
    return mavlink.MAVLink_gps_raw_int_message(0, 0, 0, 0, 0, 65535, 65535, 0, 0, 0)


def vfr_hud(v: SimulatedCopter) -> Any:
    """Speed, heading, throttle, climb."""
    e = v.estimator
    speed = math.hypot(e.north.v, e.east.v)
    heading = round(math.degrees(e.attitude.yaw_rad)) % 360
    throttle = round(100.0 * v.controller.thrust)
    amsl = e.alt_amsl_m - e.down.x
    return mavlink.MAVLink_vfr_hud_message(speed, speed, heading, throttle, amsl, -e.down.v)


def nav_controller_output(v: SimulatedCopter) -> Any:
    """The attitude that it is at, and no waypoint."""
    roll, pitch, yaw = (math.degrees(angle) for angle in v.estimator.attitude.euler_rad)
    return mavlink.MAVLink_nav_controller_output_message(
        roll, pitch, round(yaw), 0, 0, 0.0, 0.0, 0.0
    )


def servo_output_raw(v: SimulatedCopter) -> Any:
    """Rotor commands in microseconds."""
    rotors = [round(1000 + 1000 * f) for f in v.body.rotors]
    return mavlink.MAVLink_servo_output_raw_message(us(v.t_s) % 2**32, 0, *rotors, *([0] * 12))


def rc_channels(v: SimulatedCopter) -> Any:
    """The radio's channels."""
    heard = v.radio.channels_us
    channels = [*heard, *([0] * (18 - len(heard)))]
    return mavlink.MAVLink_rc_channels_message(ms(v.t_s), len(heard), *channels, 255)


def mission_current(v: SimulatedCopter) -> Any:
    """No mission: this vehicle has none."""
    return mavlink.MAVLink_mission_current_message(0, 0, 1, 0)


def power_status(v: SimulatedCopter) -> Any:
    """A good supply."""
    return mavlink.MAVLink_power_status_message(5000, 0, 0)


def vibration(v: SimulatedCopter) -> Any:
    """A quiet airframe."""
    return mavlink.MAVLink_vibration_message(us(v.t_s), 0.003, 0.003, 0.003, 0, 0, 0)


def autopilot_version(v: SimulatedCopter) -> Any:
    """Capabilities and version, as the recorded ArduCopter reports itself."""
    nothing = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        _CAPABILITIES, _VERSION, 0, 0, 0, _GIT_HASH, nothing, nothing, 0, 0, 0
    )


def sim_state(v: SimulatedCopter) -> Any:
    """Ground truth, for the renderer and the score only; without a time stamp."""
    b = v.body
    lat, lon, alt = (float(x) for x in v.start_frame.to_geodetic([b.n, b.e, b.d]))
    quat_wxyz = (b.qw, b.qx, b.qy, b.qz)
    return mavlink.MAVLink_sim_state_message(
        *quat_wxyz, *b.euler_rad, b.axb, b.ayb, b.azb, b.p, b.q, b.r,
        lat * 1e7, lon * 1e7, alt, 0.0, 0.0, b.vn, b.ve, b.vd,
        round(lat * 1e7), round(lon * 1e7),
    )  # fmt: skip


def _scaled(v: SimulatedCopter) -> tuple[int, ...]:
    imu = v.imu
    force = (int16(_MILLI_G * axis) for axis in (imu.ax, imu.ay, imu.az))
    rates = (int16(1e3 * axis) for axis in (imu.p, imu.q, imu.r))
    return (*force, *rates, *(int16(1e3 * axis) for axis in field_gauss(v)))


def _pressure_hpa(v: SimulatedCopter) -> float:
    return pressure_hpa(v.config.home_alt_amsl_m + v.baro_height_m)


def _current_ca(v: SimulatedCopter) -> int:
    return 0 if v.landed else _CURRENT_CA


BUILDERS: dict[int, Builder] = {
    0: heartbeat,
    1: sys_status,
    2: system_time,
    24: gps_raw_int,
    26: scaled_imu,
    27: raw_imu,
    29: scaled_pressure,
    30: attitude,
    31: attitude_quaternion,
    32: local_position_ned,
    33: global_position_int,
    36: servo_output_raw,
    42: mission_current,
    49: gps_global_origin,
    62: nav_controller_output,
    65: rc_channels,
    74: vfr_hud,
    105: highres_imu,
    108: sim_state,
    125: power_status,
    132: distance_sensor,
    147: battery_status,
    148: autopilot_version,
    193: ekf_status_report,
    241: vibration,
    242: home_position,
    245: extended_sys_state,
}
UNASKED_HZ: dict[int, float] = {0: 1.0}


def truth_rates(rate_hz: float) -> dict[int, float]:
    """The truth link carries a heartbeat, SIM_STATE and the time that it lacks."""
    return {0: 1.0, 2: rate_hz, 108: rate_hz}


def schedule_of(rates_hz: dict[int, float]) -> Schedule:
    """A link's schedule."""
    return Schedule(rates_hz, BUILDERS, lambda interval_s: interval_s)
