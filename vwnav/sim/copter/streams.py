"""Which messages ArduCopter sends on a link: next to none before they are asked for."""

from vwnav.sim.copter import messages as make
from vwnav.sim.copter.messages import Builder
from vwnav.sim.mavlink.schedule import Schedule

SHORTEST_US = 3125.0  # a shorter interval is denied

BUILDERS: dict[int, Builder] = {
    0: make.heartbeat,
    1: make.sys_status,
    2: make.system_time,
    24: make.gps_raw_int,
    26: make.scaled_imu,
    27: make.raw_imu,
    29: make.scaled_pressure,
    30: make.attitude,
    31: make.attitude_quaternion,
    32: make.local_position_ned,
    33: make.global_position_int,
    36: make.servo_output_raw,
    42: make.mission_current,
    49: make.gps_global_origin,
    62: make.nav_controller_output,
    65: make.rc_channels,
    74: make.vfr_hud,
    105: make.highres_imu,
    108: make.sim_state,
    125: make.power_status,
    132: make.distance_sensor,
    147: make.battery_status,
    148: make.autopilot_version,
    193: make.ekf_status_report,
    241: make.vibration,
    242: make.home_position,
    245: make.extended_sys_state,
}
UNASKED_HZ: dict[int, float] = {0: 1.0}


def truth_rates(rate_hz: float) -> dict[int, float]:
    """The truth link carries a heartbeat and SIM_STATE only."""
    return {0: 1.0, 108: rate_hz}


def schedule_of(rates_hz: dict[int, float]) -> Schedule:
    """A link's schedule."""
    return Schedule(rates_hz, BUILDERS, lambda interval_s: interval_s)
