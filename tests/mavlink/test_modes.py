"""Mode numbers of both autopilots, there and back."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavutil

from vwnav.mavlink.modes import AutopilotKind, flight_mode, mode_command
from vwnav.mavlink.telemetry.mode_track import ModeTrack
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


def told(track: ModeTrack, kind: AutopilotKind, mode: FlightMode, t_s: float) -> None:
    command = mode_command(kind, mode).params
    number = int(command[1])
    custom = number if kind is AutopilotKind.ARDUPILOT else number << 16 | int(command[2]) << 24
    track.handle_heartbeat(kind, {"custom_mode": custom, "system_status": 4}, t_s)


@pytest.mark.parametrize("lost_first", [True, False])
def test_copter_that_has_no_position_in_land_lands_blind_once_it_has_one_until_another_mode(
    lost_first,
):
    track, copter = ModeTrack(), AutopilotKind.ARDUPILOT
    track.handle_position(True, 0.0)
    if lost_first:
        track.handle_position(False, 1.0)
        told(track, copter, FlightMode.LAND, 2.0)
    else:
        told(track, copter, FlightMode.LAND, 1.0)
        track.handle_position(False, 2.0)
    assert not track.lands_blind(5.0)
    track.handle_position(True, 6.0)
    assert not track.lands_blind(7.0)
    track.handle_position(True, 7.0)
    assert track.lands_blind(7.6)
    told(track, copter, FlightMode.LAND, 8.0)
    assert track.lands_blind(9.0)
    told(track, copter, FlightMode.HOLD, 9.5)
    told(track, copter, FlightMode.LAND, 10.0)
    assert not track.lands_blind(20.0)


@given(
    st.sampled_from(AutopilotKind),
    st.lists(st.tuples(st.sampled_from([*COMMANDED, None]), st.booleans()), max_size=30),
)
def test_nobody_else_lands_blind_nor_one_that_always_had_a_position(kind, events):
    """None: news of the position, which is or is not known."""
    track, always, landed = ModeTrack(), True, False
    for i, (mode, known) in enumerate(events):
        if mode is None:
            track.handle_position(known, float(i))
            always = always and known
        else:
            told(track, kind, mode, float(i))
            landed = mode is FlightMode.LAND
        if track.lands_blind(float(i)):
            assert kind is AutopilotKind.ARDUPILOT
            assert landed
            assert not always
