"""Height from air pressure alone: an autopilot's own height contains the fixes sent to it."""

# US Standard Atmosphere 1976: p0, T0, lapse rate, and the exponent g0 M / (R L).
_SEA_LEVEL_HPA = 1013.25
_SEA_LEVEL_K = 288.15
_LAPSE_K_PER_M = 0.0065
_EXPONENT = 5.255876
_LOWEST_HPA, _HIGHEST_HPA = 100.0, 1200.0  # 16 km up, and below every sea


def pressure_altitude_m(pressure_hpa: float) -> float:
    """Altitude in the standard atmosphere (US Standard Atmosphere 1976, eq. 33a inverted).

    Differences of it are heights, off by the ratio of the true air temperature to the standard
    one: 3.5 % for every 10 K.
    """
    ratio: float = (pressure_hpa / _SEA_LEVEL_HPA) ** (1.0 / _EXPONENT)
    return _SEA_LEVEL_K / _LAPSE_K_PER_M * (1.0 - ratio)


def is_pressure(pressure_hpa: float) -> bool:
    """Whether an aircraft can be where the air is like that."""
    return _LOWEST_HPA <= pressure_hpa <= _HIGHEST_HPA


def hectopascal(abs_pressure: float) -> float:
    """HIGHRES_IMU.abs_pressure in hPa, as MAVLink has it; PX4 of the 1.16 era sends Pa."""
    return abs_pressure / 100.0 if abs_pressure > _HIGHEST_HPA else abs_pressure


class BarometricHeight:
    """Height above the place where the first pressures were measured.

    Args:
        settle: how many pressures are averaged into that place's.
    """

    def __init__(self, settle: int = 10) -> None:
        self._settle = settle
        self._start_m: list[float] = []
        self._reference_m: float | None = None

    def height_m(self, pressure_hpa: float) -> float | None:
        """Height, up positive; None while the start is being averaged."""
        altitude_m = pressure_altitude_m(pressure_hpa)
        if self._reference_m is None:
            self._start_m.append(altitude_m)
            if len(self._start_m) < self._settle:
                return None
            self._reference_m = sum(self._start_m) / len(self._start_m)
        return altitude_m - self._reference_m
