"""The loops' gains by PX4's parameters."""

import math

from vwnav.sim.multirotor.controller import Gains
from vwnav.sim.px4.parameters import Px4Parameters


def gains_of(get: Px4Parameters) -> Gains:
    """As the parameters are now."""
    return Gains(
        xy_p=get["MPC_XY_P"],
        z_p=get["MPC_Z_P"],
        vxy_p=get["MPC_XY_VEL_P_ACC"],
        vxy_i=get["MPC_XY_VEL_I_ACC"],
        vz_p=get["MPC_Z_VEL_P_ACC"],
        vz_i=get["MPC_Z_VEL_I_ACC"],
        v_max_m_s=get["MPC_XY_VEL_MAX"],
        up_max_m_s=get["MPC_Z_VEL_MAX_UP"],
        down_max_m_s=get["MPC_Z_VEL_MAX_DN"],
        hover=max(0.1, get["MPC_THR_HOVER"]),
        thrust_min=get["MPC_THR_MIN"],
        thrust_max=get["MPC_THR_MAX"],
        tilt_max_rad=math.radians(get["MPC_TILTMAX_AIR"]),
        roll_p=get["MC_ROLL_P"],
        pitch_p=get["MC_PITCH_P"],
        yaw_p=get["MC_YAW_P"],
        rate_p=get["MC_ROLLRATE_P"],
    )
