"""What passes from whom: every mode of both kinds of autopilot, in each way to ask for it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.mavlink.framing import Packet, packet_at
from vwnav.mavlink.modes import AutopilotKind, flight_mode
from vwnav.vehicle import FlightMode
from vwnav.watchdog.filter import Rights, may_pass, told_by
from vwnav.watchdog.relay_guard import RelayedPosition, RelayedVelocity

MAV = mavlink.MAVLink(None, srcSystem=7, srcComponent=191)
PX4, COPTER = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
MODES = [(PX4, main << 16 | sub << 24) for main in range(12) for sub in range(24)]
MODES += [(COPTER, number) for number in range(30)]
HARMLESS = {FlightMode.HOLD, FlightMode.LAND, FlightMode.RETURN, FlightMode.DESCEND}
SET_MODE = mavlink.MAV_CMD_DO_SET_MODE


def packed(message) -> Packet:
    packet = packet_at(bytes(message.pack(MAV)), 0)
    assert packet is not None
    return packet


def long(number: int, *params: float) -> Packet:
    values = [*params, *[0.0] * (7 - len(params))]
    return packed(mavlink.MAVLink_command_long_message(7, 1, number, 0, *values))


def requests(kind: AutopilotKind, custom_mode: int) -> list[Packet]:
    """COMMAND_LONG, COMMAND_INT and SET_MODE for one mode."""
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    numbers = (float(main), float(sub)) if kind is PX4 else (float(custom_mode), 0.0)
    params = (1.0, *numbers, 0.0)
    by_int = mavlink.MAVLink_command_int_message(7, 1, 0, SET_MODE, 0, 0, *params, 0, 0, 0.0)
    by_mode = mavlink.MAVLink_set_mode_message(7, 1, custom_mode)
    return [long(SET_MODE, *params), packed(by_int), packed(by_mode)]


@pytest.mark.parametrize(("kind", "custom_mode"), MODES)
def test_a_navigator_without_the_aircraft_may_ask_for_what_gives_it_up_and_nothing_else(
    kind, custom_mode
):
    harmless = flight_mode(kind, custom_mode) in HARMLESS
    for packet in requests(kind, custom_mode):
        assert may_pass(packet, Rights.FLIES, kind)
        assert may_pass(packet, Rights.GIVES_UP, kind) is harmless
        assert not may_pass(packet, Rights.ESTIMATES, kind)
        assert not may_pass(packet, Rights.LISTENS, kind)
        assert not may_pass(packet, Rights.GIVES_UP, None)


def test_rtl_of_arducopter_is_not_taken_for_offboard_of_px4():
    for packet in requests(COPTER, 6):
        assert may_pass(packet, Rights.GIVES_UP, COPTER)
        assert not may_pass(packet, Rights.GIVES_UP, PX4)


def vision() -> Packet:
    return packed(mavlink.MAVLink_vision_position_estimate_message(1, *[0.0] * 6))


def odometry(frames: tuple[int, int] = (1, 1)) -> mavlink.MAVLink_odometry_message:
    sigmas = [4.0, *[0.0] * 5, 9.0, *[0.0] * 14]
    return mavlink.MAVLink_odometry_message(
        2_000_000, *frames, 1, 2, -50, [1, 0, 0, 0], 5, 6, 7, 0, 0, 0, sigmas, sigmas, 3, 2, 0
    )


def test_odometry_tells_both_in_frames_that_are_judged_and_nothing_in_others():
    position, velocity = told_by(odometry())
    assert position == RelayedPosition(2.0, (1.0, 2.0, -50.0), 3.0, 3)
    assert velocity == RelayedVelocity(2.0, (5.0, 6.0, 7.0), 3.0)
    assert told_by(odometry((20, 12))) == (None, None)


@pytest.mark.parametrize(
    ("packet", "passes_for"),
    [
        (packed(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)), "FGEL"),
        (long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 30, 20000), "FGEL"),
        (long(mavlink.MAV_CMD_REQUEST_MESSAGE, 49), "FGEL"),
        (packed(mavlink.MAVLink_param_request_read_message(7, 1, b"A", -1)), "FGEL"),
        (packed(mavlink.MAVLink_timesync_message(0, 5)), "FGE"),
        (vision(), "FGE"),
        (packed(mavlink.MAVLink_vision_speed_estimate_message(1, 0, 0, 0)), "FGE"),
        (packed(odometry()), "FGE"),
        (long(mavlink.MAV_CMD_NAV_LAND), "FG"),
        (long(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH), "FG"),
        (long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0), "F"),
        (long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1), "F"),
        (long(mavlink.MAV_CMD_NAV_TAKEOFF), "F"),
        (long(mavlink.MAV_CMD_DO_REPOSITION), "F"),
        (long(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, 1), "F"),
        (long(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1), "F"),
        (long(SET_MODE, float("nan"), float("nan")), "F"),
        (long(SET_MODE, 4.0), "F"),
        (packed(mavlink.MAVLink_param_set_message(7, 1, b"A", 1.0, 9)), "F"),
        (packed(mavlink.MAVLink_manual_control_message(7, 0, 0, 500, 0, 0)), "F"),
        (packed(mavlink.MAVLink_set_gps_global_origin_message(7, 0, 0, 0)), "F"),
        (packed(mavlink.MAVLink_att_pos_mocap_message(1, [1, 0, 0, 0], 0, 0, 0)), ""),
        (packed(mavlink.MAVLink_gps_input_message(*[0] * 18)), ""),
        (Packet(b"garbage", None), ""),
    ],
)
def test_each_sender_has_its_rights(packet, passes_for):
    passing = "".join(r.name[0] for r in Rights if may_pass(packet, r, PX4))
    assert passing == passes_for


@given(st.integers(0, 2**24 - 1), st.binary(max_size=60))
def test_what_is_not_known_passes_only_from_the_one_who_flies(number, payload):
    known = {
        0,
        2,
        77,
        253,
        20,
        21,
        66,
        102,
        103,
        111,
        11,
        75,
        76,
        101,
        104,
        113,
        138,
        232,
        296,
        331,
    }
    packet = Packet(payload, number)
    passing = {r for r in Rights if may_pass(packet, r, PX4)} if number not in known else None
    assert passing in (None, {Rights.FLIES})
