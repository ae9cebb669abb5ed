"""Height from pressure."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.mavlink.telemetry.barometer import BarometricHeight, hectopascal, pressure_altitude_m


@pytest.mark.parametrize(
    ("pressure_hpa", "altitude_m"),
    [(1013.25, 0.0), (954.61, 500.0), (898.76, 1000.0), (701.21, 3000.0)],
)
def test_the_table_of_the_standard_atmosphere_is_met(pressure_hpa, altitude_m):
    # US Standard Atmosphere 1976, table I (by geometric altitude).
    assert pressure_altitude_m(pressure_hpa) == pytest.approx(altitude_m, rel=5e-4, abs=0.5)


@given(st.floats(800.0, 1040.0), st.floats(1.0, 20.0))
def test_less_pressure_is_higher(pressure_hpa, less_hpa):
    assert pressure_altitude_m(pressure_hpa - less_hpa) > pressure_altitude_m(pressure_hpa)


def test_height_counts_from_the_mean_of_the_first_pressures():
    barometer = BarometricHeight(settle=4)
    settling = [barometer.height_m(p) for p in (1000.0, 1000.2, 999.8, 1000.0)]
    assert settling[:3] == [None, None, None]
    assert barometer.height_m(1000.0) == pytest.approx(0.0, abs=0.05)
    assert barometer.height_m(994.0) == pytest.approx(50.8, abs=0.5)


def test_pascal_of_px4_1_16_is_recognised():
    assert hectopascal(100844.0) == pytest.approx(1008.44)
    assert hectopascal(1008.44) == 1008.44
