"""Mode numbers of both autopilots, there and back."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavutil

from vwnav.mavlink.modes import AutopilotKind, flight_mode, mode_command
from vwnav.vehicle import FlightMode

COMMANDED = [FlightMode.OFFBOARD, FlightMode.HOLD, FlightMode.RETURN, FlightMode.LAND]


@pytest.mark.parametrize("mode", COMMANDED)
def test_a_commanded_mode_reads_back_as_itself(mode):
    _, main, sub = mode_command(AutopilotKind.PX4, mode).params
    assert flight_mode(AutopilotKind.PX4, int(main) << 16 | int(sub) << 24) is mode
    _, number = mode_command(AutopilotKind.ARDUPILOT, mode).params
    assert flight_mode(AutopilotKind.ARDUPILOT, int(number)) is mode


@given(st.sampled_from(AutopilotKind), st.integers(0, 2**32 - 1))
def test_any_number_has_a_mode(kind, custom_mode):
    assert flight_mode(kind, custom_mode) in FlightMode


def test_px4_numbers_are_those_of_pymavlink():
    names = {"OFFBOARD": FlightMode.OFFBOARD, "LOITER": FlightMode.HOLD, "RTL": FlightMode.RETURN}
    names |= {"LAND": FlightMode.LAND, "MISSION": FlightMode.MISSION, "POSCTL": FlightMode.MANUAL}
    for name, mode in names.items():
        _, main, sub = mavutil.px4_map[name]
        assert flight_mode(AutopilotKind.PX4, main << 16 | sub << 24) is mode


def test_copter_numbers_are_those_of_pymavlink():
    names = {"GUIDED": FlightMode.OFFBOARD, "BRAKE": FlightMode.HOLD, "RTL": FlightMode.RETURN}
    names |= {"LAND": FlightMode.LAND, "AUTO": FlightMode.MISSION, "LOITER": FlightMode.MANUAL}
    numbers = {name: number for number, name in mavutil.mode_mapping_acm.items()}
    for name, mode in names.items():
        assert flight_mode(AutopilotKind.ARDUPILOT, numbers[name]) is mode
