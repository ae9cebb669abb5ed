"""Which messages PX4 sends on a link, and how often by default."""

import math

from vwnav.sim.mavlink.schedule import Schedule
from vwnav.sim.px4 import messages as make
from vwnav.sim.px4.messages import Builder
from vwnav.sim.px4.px4 import STEP_S

_FASTEST_S = STEP_S
_DIVIDED_BELOW_S = 0.008  # shorter intervals are whole steps: 5 ms gives 125 Hz

BUILDERS: dict[int, Builder] = {
    0: make.heartbeat,
    1: make.sys_status,
    2: make.system_time,
    4: make.ping,
    24: make.gps_raw_int,
    29: make.scaled_pressure,
    30: make.attitude,
    31: make.attitude_quaternion,
    32: make.local_position_ned,
    33: make.global_position_int,
    36: make.servo_output_raw,
    42: make.mission_current,
    49: make.gps_global_origin,
    65: make.rc_channels,
    74: make.vfr_hud,
    83: make.attitude_target,
    85: make.position_target_local_ned,
    105: make.highres_imu,
    115: make.hil_state_quaternion,
    132: make.distance_sensor,
    141: make.altitude,
    147: make.battery_status,
    148: make.autopilot_version,
    230: make.estimator_status,
    241: make.vibration,
    242: make.home_position,
    245: make.extended_sys_state,
    331: make.odometry,
    436: make.current_mode,
}
# Hz, as recorded on the companion link of PX4 1.18 (DISTANCE_SENSOR only when asked for)
COMPANION_RATES: dict[int, float] = {
    0: 1.0,
    1: 5.0,
    2: 1.0,
    4: 1.0,
    24: 8.0,
    29: 1.0,
    30: 100.0,
    31: 50.0,
    32: 30.0,
    33: 50.0,
    36: 10.0,
    42: 1.0,
    65: 5.0,
    74: 10.0,
    83: 10.0,
    85: 10.0,
    105: 50.0,
    141: 10.0,
    147: 0.5,
    230: 1.0,
    241: 0.5,
    242: 0.5,
    245: 5.0,
    331: 30.0,
    436: 0.5,
}
# PX4's "normal" mode, for a ground station on a thin link
GROUND_RATES: dict[int, float] = {
    0: 1.0,
    1: 1.0,
    2: 1.0,
    4: 0.1,
    24: 1.0,
    30: 15.0,
    32: 1.0,
    33: 5.0,
    42: 1.0,
    65: 5.0,
    74: 4.0,
    85: 1.5,
    141: 1.0,
    147: 0.5,
    230: 0.5,
    241: 0.1,
    242: 0.5,
    245: 1.0,
    436: 0.5,
}


def truth_rates(rate_hz: float) -> dict[int, float]:
    """The truth link carries a heartbeat and HIL_STATE_QUATERNION only."""
    return {0: 1.0, 115: rate_hz}


def schedule_of(rates_hz: dict[int, float]) -> Schedule:
    """A link's schedule; PX4 divides fast rates from its own."""
    return Schedule(rates_hz, BUILDERS, _reachable)


def _reachable(interval_s: float) -> float:
    if interval_s >= _DIVIDED_BELOW_S:
        return interval_s
    return max(1, math.ceil(interval_s / _FASTEST_S - 1e-6)) * _FASTEST_S
