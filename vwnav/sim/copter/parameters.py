"""The parameters of the simulated ArduCopter: names, types and defaults of those that matter."""

import math
from collections.abc import Iterable

from vwnav.sim.mavlink.parameter_table import SimulatedParameters

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9  # MAV_PARAM_TYPE

_DEFAULTS: dict[str, tuple[int, float]] = {
    "ANGLE_MAX": (INT16, 3000),  # centidegrees
    "ARMING_CHECK": (INT32, 1),
    "BATT_CAPACITY": (INT32, 3300),
    "BATT_CRT_VOLT": (REAL32, 0.0),
    "BATT_FS_CRT_ACT": (INT8, 0),
    "BATT_FS_LOW_ACT": (INT8, 0),
    "BATT_LOW_TIMER": (INT8, 10),
    "BATT_LOW_VOLT": (REAL32, 10.5),
    "BATT_MONITOR": (INT8, 4),
    "DISARM_DELAY": (INT8, 10),
    "EK3_ALT_M_NSE": (REAL32, 2.0),
    "EK3_ENABLE": (INT8, 1),
    "EK3_POS_I_GATE": (INT16, 500),
    "EK3_SRC1_POSXY": (INT8, 3),
    "EK3_SRC1_POSZ": (INT8, 1),
    "EK3_SRC1_VELXY": (INT8, 3),
    "EK3_SRC1_VELZ": (INT8, 3),
    "EK3_SRC1_YAW": (INT8, 1),
    "EK3_VEL_I_GATE": (INT16, 500),
    "FLTMODE1": (INT8, 7),
    "FLTMODE2": (INT8, 9),
    "FLTMODE3": (INT8, 6),
    "FLTMODE4": (INT8, 3),
    "FLTMODE5": (INT8, 5),
    "FLTMODE6": (INT8, 0),
    "FLTMODE_CH": (INT8, 5),
    "FS_EKF_ACTION": (INT8, 1),
    "FS_GCS_ENABLE": (INT8, 0),
    "FS_GCS_TIMEOUT": (REAL32, 5.0),
    "FS_THR_ENABLE": (INT8, 1),
    "GPS1_TYPE": (INT8, 1),
    "GUID_TIMEOUT": (REAL32, 3.0),
    "LAND_ALT_LOW": (INT16, 1000),  # cm
    "LAND_SPEED": (INT16, 50),  # cm/s
    "LAND_SPEED_HIGH": (INT16, 0),  # cm/s; 0: WPNAV_SPEED_DN
    "LOIT_SPEED": (REAL32, 1250.0),  # cm/s
    "MAV_GCS_SYSID": (INT16, 255),
    "RC_OVERRIDE_TIME": (REAL32, 3.0),
    "RTL_ALT": (INT32, 1500),  # cm
    "RTL_LOIT_TIME": (INT32, 5000),  # ms
    "SYSID_THISMAV": (INT16, 1),
    "VISO_DELAY_MS": (REAL32, 10.0),
    "VISO_POS_M_NSE": (REAL32, 0.2),
    "VISO_TYPE": (INT8, 0),
    "VISO_VEL_M_NSE": (REAL32, 0.1),
    "WPNAV_ACCEL": (REAL32, 250.0),  # cm/s^2
    "WPNAV_ACCEL_Z": (REAL32, 100.0),  # cm/s^2
    "WPNAV_SPEED": (REAL32, 1000.0),  # cm/s
    "WPNAV_SPEED_DN": (REAL32, 150.0),  # cm/s
    "WPNAV_SPEED_UP": (REAL32, 250.0),  # cm/s
}
# No GPS, vision for horizontal position and velocity, barometer for the height: as flown.
NO_GPS: tuple[tuple[str, float], ...] = (
    ("EK3_SRC1_POSXY", 6),
    ("EK3_SRC1_VELXY", 6),
    ("EK3_SRC1_VELZ", 0),
    ("GPS1_TYPE", 0),
    ("VISO_TYPE", 1),
)


class CopterParameters(SimulatedParameters):
    """Names in alphabetical order with their values; all travel as numbers."""

    def __init__(self, overrides: Iterable[tuple[str, float]]) -> None:
        super().__init__(_DEFAULTS, overrides)

    def set(self, name: str, value: float) -> bool:
        """Set from a PARAM_SET, whose type ArduPilot does not look at; False when not a number."""
        if not math.isfinite(value):
            return False
        self._values[name] = value if self.type_of(name) == REAL32 else float(round(value))
        return True
