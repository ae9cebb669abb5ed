"""What the simulated PX4 tells of its estimate, and of what its controllers follow.

A function makes one message of the vehicle's present state; None where PX4 would not send it now.
"""

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from vwnav.sim.mavlink.units import cm_s, mm, ms, us
from vwnav.sim.multirotor.messages import attitude, attitude_quaternion
from vwnav.sim.px4.px4 import SimulatedPx4

_NAN = math.nan


def attitude_target(v: SimulatedPx4) -> Any:
    """What the attitude controller follows."""
    control = v.controller
    return mavlink.MAVLink_attitude_target_message(
        ms(v.t_s), 0, list(control.attitude_wxyz), *control.rates_sp, control.thrust
    )


def local_position_ned(v: SimulatedPx4) -> Any:
    """Position and velocity of the estimator about its origin, valid or not."""
    e = v.estimator
    return mavlink.MAVLink_local_position_ned_message(
        ms(v.t_s), e.north.x, e.east.x, e.down.x, e.north.v, e.east.v, e.down.v
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
        us(v.t_s), 1, 1, *position, quat, *speed, *e.attitude.rates, pose, velocity, counter, 8, 0
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
        ms(v.t_s),
        round(lat * 1e7) if known else 0,
        round(lon * 1e7) if known else 0,
        mm(alt),
        mm(above_m),
        cm_s(e.north.v),
        cm_s(e.east.v),
        cm_s(e.down.v),
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
        us(v.t_s), monotonic, amsl, -e.down.x, relative, amsl - clearance, clearance
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
        us(v.t_s),
        flags,
        ratio,
        ratio,
        0.003,
        _NAN,
        _NAN,
        _NAN,
        e.sigma_horizontal_m,
        e.down.sigma_m,
    )


def home_position(v: SimulatedPx4) -> Any:
    """Where RTL goes."""
    home = v.home
    if home is None:
        return None
    lat, lon, alt = (
        round(home.lat_deg * 1e7),
        round(home.lon_deg * 1e7),
        mm(home.alt_amsl_m),
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
        mm(origin.alt_amsl_m),
        round(max(0.0, v.estimator.origin_t_s) * 1e6),
    )


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
        ms(v.t_s), 1, 63 if sp.idle else 0, *position, *speed, *push, *yaw
    )


def _free(value: float | None) -> float:
    return _NAN if value is None else value


BUILDERS: dict[int, Callable[[SimulatedPx4], Any]] = {
    30: attitude,
    31: attitude_quaternion,
    32: local_position_ned,
    33: global_position_int,
    49: gps_global_origin,
    74: vfr_hud,
    83: attitude_target,
    85: position_target_local_ned,
    141: altitude,
    230: estimator_status,
    242: home_position,
    331: odometry,
}
