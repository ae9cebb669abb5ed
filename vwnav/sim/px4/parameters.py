"""The parameters of the simulated PX4: real names, types and defaults of those that matter here."""

import math
import struct
import zlib
from collections.abc import Iterable

from vwnav.sim.mavlink.parameter_table import SimulatedParameters

INT32, REAL32 = 6, 9  # MAV_PARAM_TYPE
HASH_CHECK = "_HASH_CHECK"

_INTEGERS: dict[str, int] = {
    "BAT1_N_CELLS": 4,
    "BAT1_SOURCE": 0,
    "CAL_ACC0_ID": 1310988,
    "CAL_GYRO0_ID": 1310988,
    "CAL_MAG0_ID": 197388,
    "CBRK_SUPPLY_CHK": 0,
    "COM_ARM_WO_GPS": 1,
    "COM_DL_LOSS_T": 10,
    "COM_FLTMODE1": -1,
    "COM_FLTMODE2": -1,
    "COM_FLTMODE3": -1,
    "COM_FLTMODE4": -1,
    "COM_FLTMODE5": -1,
    "COM_FLTMODE6": -1,
    "COM_LOW_BAT_ACT": 0,
    "COM_OBL_RC_ACT": 0,
    "COM_POS_LOW_ACT": 3,
    "COM_POSCTL_NAVL": 0,
    "COM_RC_IN_MODE": 3,
    "COM_RC_OVERRIDE": 1,
    "COM_RCL_EXCEPT": 0,
    "EKF2_AGP0_CTRL": 0,
    "EKF2_AGP0_ID": 0,
    "EKF2_BARO_CTRL": 1,
    "EKF2_EN": 1,
    "EKF2_EV_CTRL": 0,
    "EKF2_EV_NOISE_MD": 0,
    "EKF2_GPS_CTRL": 7,
    "EKF2_HGT_REF": 1,
    "EKF2_IMU_CTRL": 7,
    "EKF2_MAG_TYPE": 0,
    "EKF2_NOAID_TOUT": 5000000,
    "EKF2_OF_CTRL": 1,
    "EKF2_PREDICT_US": 10000,
    "EKF2_RNG_CTRL": 1,
    "GF_ACTION": 2,
    "GF_MAX_ACTION": 2,
    "MAV_SYS_ID": 1,
    "MAV_TYPE": 2,
    "MPC_POS_MODE": 4,
    "NAV_DLL_ACT": 0,
    "NAV_RCL_ACT": 2,
    "RC_MAP_FLTMODE": 0,
    "RC_MAP_PITCH": 0,
    "RC_MAP_ROLL": 0,
    "RC_MAP_THROTTLE": 0,
    "RC_MAP_YAW": 0,
    "RTL_CONE_ANG": 45,
    "RTL_TYPE": 0,
    "SENS_EN_GPSSIM": 1,
    "SIM_GPS_USED": 0,
    "SYS_AUTOSTART": 10040,
    "SYS_HAS_BARO": 1,
    "SYS_HAS_GPS": 1,
    "SYS_HAS_MAG": 1,
    "SYS_HITL": 0,
}
_FLOATS: dict[str, float] = {
    "BAT_CRIT_THR": 0.07,
    "BAT_EMERGEN_THR": 0.05,
    "BAT_LOW_THR": 0.15,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "COM_FAIL_ACT_T": 5.0,
    "COM_OF_LOSS_T": 1.0,
    "COM_POS_FS_EPH": 5.0,
    "COM_RC_LOSS_T": 1.0,
    "COM_RC_STICK_OV": 30.0,
    "COM_SPOOLUP_TIME": 1.0,
    "EKF2_AGP0_DELAY": 0.0,
    "EKF2_AGP0_GATE": 3.0,
    "EKF2_AGP0_NOISE": 1.0,
    "EKF2_BARO_GATE": 5.0,
    "EKF2_BARO_NOISE": 3.5,
    "EKF2_DELAY_MAX": 200.0,
    "EKF2_EVA_NOISE": 0.1,
    "EKF2_EVP_GATE": 5.0,
    "EKF2_EVP_NOISE": 0.1,
    "EKF2_EVV_GATE": 3.0,
    "EKF2_EVV_NOISE": 0.1,
    "EKF2_EV_DELAY": 0.0,
    "EKF2_EV_POS_X": 0.0,
    "EKF2_EV_POS_Y": 0.0,
    "EKF2_EV_POS_Z": 0.0,
    "EKF2_EV_QMIN": 0.0,
    "GF_MAX_HOR_DIST": 0.0,
    "GF_MAX_VER_DIST": 0.0,
    "LNDMC_XY_VEL_MAX": 1.5,
    "MAN_OVERRIDE_SPD": 0.25,
    "MC_PITCHRATE_P": 0.15,
    "MC_PITCH_P": 6.5,
    "MC_ROLLRATE_P": 0.15,
    "MC_ROLL_P": 6.5,
    "MC_YAW_P": 2.8,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_ACC_HOR": 3.0,
    "MPC_LAND_ALT1": 10.0,
    "MPC_LAND_ALT2": 5.0,
    "MPC_LAND_SPEED": 0.7,
    "MPC_MAN_TILT_MAX": 35.0,
    "MPC_MAN_Y_MAX": 150.0,
    "MPC_THR_HOVER": 0.5,
    "MPC_THR_MAX": 1.0,
    "MPC_THR_MIN": 0.12,
    "MPC_TILTMAX_AIR": 45.0,
    "MPC_TILTMAX_LND": 12.0,
    "MPC_TKO_RAMP_T": 3.0,
    "MPC_TKO_SPEED": 1.5,
    "MPC_VEL_MANUAL": 10.0,
    "MPC_XY_CRUISE": 5.0,
    "MPC_XY_P": 0.95,
    "MPC_XY_VEL_D_ACC": 0.2,
    "MPC_XY_VEL_I_ACC": 0.4,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_XY_VEL_P_ACC": 1.8,
    "MPC_YAWRAUTO_MAX": 60.0,
    "MPC_Z_P": 1.0,
    "MPC_Z_VEL_D_ACC": 0.0,
    "MPC_Z_VEL_I_ACC": 2.0,
    "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0,
    "MPC_Z_VEL_P_ACC": 4.0,
    "MPC_Z_V_AUTO_DN": 1.5,
    "MPC_Z_V_AUTO_UP": 3.0,
    "NAV_ACC_RAD": 10.0,
    "RC5_MAX": 2000.0,
    "RC5_MIN": 1000.0,
    "RTL_DESCEND_ALT": 30.0,
    "RTL_LAND_DELAY": 0.0,
    "RTL_RETURN_ALT": 30.0,
    "SIM_BAT_DRAIN": 60.0,
    "SIM_BAT_MIN_PCT": 0.0,
}
# No GPS, vision for the horizontal position and the velocity, barometer for the height.
NO_GPS: tuple[tuple[str, float], ...] = (
    ("EKF2_EV_CTRL", 5),
    ("EKF2_GPS_CTRL", 0),
    ("EKF2_HGT_REF", 0),
    ("SENS_EN_GPSSIM", 0),
    ("SYS_HAS_GPS", 0),
)


class Px4Parameters(SimulatedParameters):
    """Names in PX4's (alphabetical) order with their values; integers travel byte by byte."""

    def __init__(self, overrides: Iterable[tuple[str, float]]) -> None:
        integers = {name: (INT32, float(value)) for name, value in _INTEGERS.items()}
        floats = {name: (REAL32, value) for name, value in _FLOATS.items()}
        super().__init__(dict(sorted((integers | floats).items())), overrides)

    def wire_value(self, name: str) -> float:
        """The float that carries the value in PARAM_VALUE: an integer's bytes, not its number."""
        value = self._values[name]
        if self._types[name] == REAL32:
            return value
        return float(struct.unpack("<f", struct.pack("<i", int(value)))[0])

    def set_wire(self, name: str, wire_value: float, wire_type: int) -> bool:
        """Set from a PARAM_SET; False, and nothing changed, when type or value does not fit."""
        if wire_type != self._types[name]:
            return False
        if wire_type == REAL32:
            if not math.isfinite(wire_value):
                return False
            self._values[name] = wire_value
        else:
            self._values[name] = int(struct.unpack("<i", struct.pack("<f", wire_value))[0])
        return True

    def hash_wire_value(self) -> float:
        """PX4's _HASH_CHECK: a number that changes with any name or value."""
        text = ";".join(f"{name}={value:.9g}" for name, value in self._values.items())
        crc = zlib.crc32(text.encode()) & 0x7F7FFFFF  # keep clear of the NaN patterns
        return float(struct.unpack("<f", struct.pack("<I", crc))[0])
