"""What the watchdog hears of an autopilot, and each message that it says itself."""

import math

import pytest
from link_peer import COPTER_BRAKE, COPTER_LAND, PX4_LAND, PX4_OFFBOARD
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.dialects.v20 import development

from vwnav.mavlink.framing import packet_at
from vwnav.mavlink.modes import AutopilotKind
from vwnav.vehicle import FlightMode
from vwnav.watchdog.dead_man import DeadManAction, VehicleView
from vwnav.watchdog.voice import AutopilotEar, Origin, Voice

AUTOPILOT = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
PX4, COPTER = mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
ACCEPTED, DENIED, IN_PROGRESS, SET_MODE = 0, 2, 5, mavlink.MAV_CMD_DO_SET_MODE


def beat(kind: int = PX4, mode: int = PX4_OFFBOARD, armed: bool = True):
    flags = 1 | (128 if armed else 0)
    return mavlink.MAVLink_heartbeat_message(2, kind, flags, mode, 4, 3)


def packed(message, mavlink1: bool = False) -> bytes:
    return bytes(message.pack(AUTOPILOT, force_mavlink1=mavlink1))


def ear_of(*messages, t_s: float = 10.0) -> AutopilotEar:
    ear = AutopilotEar()
    for message in (beat(), *messages):
        ear.listen(packed(message), t_s)
    return ear


def said(action: DeadManAction, ear: AutopilotEar, t_s: float = 10.0):
    packet = Voice().say(action, ear, t_s)
    return mavlink.MAVLink(None).decode(bytearray(packet.data))


def test_before_it_hears_anything_nothing_is_known():
    ear = AutopilotEar()
    assert (ear.kind, ear.system_id, ear.mavlink1, ear.origin) == (None, 0, False, None)
    assert ear.heard_t_s == ear.heartbeat_t_s == -math.inf
    assert ear.vehicle(5.0) == VehicleView()
    assert ear.heartbeat_age_s(5.0) == 1e6


def test_a_heartbeat_tells_mode_arming_and_who_it_is():
    ear = ear_of()
    assert (ear.kind, ear.system_id, ear.mavlink1) == (AutopilotKind.PX4, 7, False)
    assert ear.vehicle(10.0) == VehicleView(FlightMode.OFFBOARD, True)
    assert ear.heartbeat_age_s(12.5) == 2.5
    ear.listen(packed(beat(armed=False, mode=PX4_LAND), mavlink1=True), 11.0)
    assert ear.vehicle(11.0) == VehicleView(FlightMode.LAND, False)
    assert ear.mavlink1


HOLD, POSITION, RADIO = (4 << 16) | (3 << 24), 3 << 16, mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER


def mode_told(flown: int, asked: int) -> bytes:
    return packed(development.MAVLink_current_mode_message(0, flown, asked))


def status(radio: bool) -> bytes:
    bits = RADIO if radio else 0
    return packed(mavlink.MAVLink_sys_status_message(bits, bits, bits, *[0] * 10))


@pytest.mark.parametrize(
    ("flown", "radio", "fell_back"),
    [(HOLD, True, True), (POSITION, False, True), (POSITION, True, False)],
)
def test_px4_tells_of_a_failsafe_that_stays_up_but_sticks_that_are_heard_are_somebodys(
    flown, radio, fell_back
):
    ear = ear_of()
    assert not ear.vehicle(10.0).fell_back
    ear.listen(mode_told(PX4_OFFBOARD, PX4_OFFBOARD) + status(radio), 10.1)
    ear.listen(packed(beat(mode=flown)), 10.2)
    seen = ear.vehicle(10.2)
    assert (seen.fell_back, seen.is_choice_untold) == (False, fell_back)
    ear.listen(mode_told(flown, PX4_OFFBOARD), 10.3)
    seen = ear.vehicle(10.3)
    assert (seen.fell_back, seen.is_choice_untold) == (fell_back, False)
    ear.listen(mode_told(flown, flown), 10.4)  # a person chose it
    assert not ear.vehicle(10.4).fell_back


def test_after_a_cut_it_is_told_anew_who_chose_the_mode():
    ear = ear_of()
    ear.listen(mode_told(PX4_OFFBOARD, PX4_OFFBOARD) + status(False), 10.1)
    ear.listen(packed(beat(mode=POSITION)), 14.0)
    assert ear.vehicle(14.0) == VehicleView(
        FlightMode.MANUAL, True, mode_is_of_now=False, is_choice_untold=True
    )
    ear.listen(mode_told(POSITION, PX4_OFFBOARD), 14.1)
    assert ear.vehicle(14.6) == VehicleView(FlightMode.MANUAL, True, fell_back=True)


def test_flown_and_intended_mode_are_those_of_one_moment():
    ear = ear_of()
    ear.listen(mode_told(POSITION, PX4_OFFBOARD) + status(False), 10.1)
    assert ear.vehicle(10.1).fell_back
    ear.listen(mode_told(HOLD, HOLD), 10.2)  # which was asked for, before a heartbeat tells it
    assert ear.vehicle(10.2).mode is FlightMode.HOLD


def test_a_damaged_word_of_who_chose_the_mode_is_none():
    ear = ear_of()
    damaged = bytearray(mode_told(HOLD, PX4_OFFBOARD))
    damaged[14] ^= 1
    ear.listen(packed(beat(mode=HOLD)) + bytes(damaged), 10.1)
    seen = ear.vehicle(10.1)
    assert (seen.fell_back, seen.is_choice_untold) == (False, False)


def test_one_that_is_to_be_followed_is_not_the_first_that_is_heard():
    other = mavlink.MAVLink(None, srcSystem=9, srcComponent=1)
    ear = AutopilotEar(7)
    ear.listen(bytes(beat(armed=False, mode=PX4_LAND).pack(other)), 9.0)
    assert (ear.kind, ear.system_id, ear.heard_t_s) == (None, 7, -math.inf)
    ear.listen(packed(beat()), 10.0)
    assert ear.vehicle(10.0) == VehicleView(FlightMode.OFFBOARD, True)


def test_other_words_of_the_autopilot_are_signs_of_life_but_no_heartbeat():
    ear = ear_of()
    ear.listen(packed(mavlink.MAVLink_attitude_message(1, *[0.0] * 6)), 11.0)
    assert (ear.heard_t_s, ear.heartbeat_t_s) == (11.0, 10.0)
    ear.listen(packed(mavlink.MAVLink_heartbeat_message(26, 8, 0, 0, 4, 3)), 12.0)  # a gimbal's
    assert (ear.heartbeat_t_s, ear.kind) == (10.0, AutopilotKind.PX4)


@pytest.mark.parametrize(("flags", "ok"), [(0x08, True), (0x10, True), (0x1E7, False), (0, False)])
def test_both_kinds_of_estimator_tell_whether_there_is_a_position(flags, ok):
    assert ear_of().vehicle(10.0).position_ok is None
    of_px4 = mavlink.MAVLink_estimator_status_message(1, flags, *[0.0] * 8)
    of_copter = mavlink.MAVLink_ekf_status_report_message(flags, *[0.0] * 5)
    for message in (of_px4, of_copter):
        heard = ear_of(message).vehicle(10.0)
        assert heard.position_ok is ok
        assert (heard.mode, heard.armed) == (FlightMode.OFFBOARD, True)


def test_standing_on_the_ground_is_believed_for_three_seconds():
    for state, landed in [(0, None), (1, True), (2, False), (3, False), (4, False)]:
        ear = ear_of(mavlink.MAVLink_extended_sys_state_message(0, state))
        assert ear.vehicle(13.0).landed is landed
        assert ear.vehicle(13.1).landed is None
        assert ear.vehicle(13.1).armed


@pytest.mark.parametrize(
    ("result", "component", "answers"),
    [
        (ACCEPTED, 192, [True]), (ACCEPTED, 0, [True]), (IN_PROGRESS, 192, [True]),
        (DENIED, 192, [False]), (DENIED, 191, []), (ACCEPTED, 190, []),
    ],
)  # fmt: skip
def test_answers_to_its_own_mode_commands_are_told_from_others(result, component, answers):
    ear = ear_of()
    ack = mavlink.MAVLink_command_ack_message(SET_MODE, result, 0, 0, 7, component)
    assert ear.listen(packed(ack), 10.0) == answers
    other = mavlink.MAVLink_command_ack_message(400, result, 0, 0, 7, component)
    assert ear.listen(packed(other), 10.0) == []
    assert ear.listen(packed(ack) + packed(ack), 10.0) == answers * 2


def test_what_was_damaged_is_not_believed_and_what_follows_is():
    ear = ear_of()
    data = bytearray(packed(beat(armed=False)))
    data[-1] ^= 1
    ear.listen(bytes(data) + packed(mavlink.MAVLink_extended_sys_state_message(0, 1)), 11.0)
    assert ear.vehicle(11.0).armed
    assert ear.vehicle(11.0).landed


def origin(lat: int = 411000000, lon: int = 290000000):
    return packed(mavlink.MAVLink_gps_global_origin_message(lat, lon, 40500))


def test_the_origin_is_the_autopilots_word_and_else_the_one_that_was_sent():
    ear = ear_of()
    sent = mavlink.MAVLink_set_gps_global_origin_message(7, 600000000, -225000000, 1000)
    ear.handle_origin_sent(packet_at(packed(sent), 0))
    assert ear.origin == Origin(60.0, -22.5, 1.0)
    ear.listen(origin(), 10.0)
    assert ear.origin == Origin(41.1, 29.0, 40.5)
    ear.handle_origin_sent(packet_at(packed(sent), 0))
    assert ear.origin == Origin(41.1, 29.0, 40.5)


@pytest.mark.parametrize(("lat", "lon"), [(900000001, 0), (-900000001, 0), (0, 1800000001)])
def test_an_origin_that_is_nowhere_is_none(lat, lon):
    ear = ear_of()
    ear.listen(origin(lat, lon), 10.0)
    assert ear.origin is None
    ear.listen(origin(900000000, -1800000000), 10.0)
    assert ear.origin == Origin(90.0, -180.0, 40.5)


def test_a_damaged_origin_on_its_way_is_none():
    ear = ear_of()
    data = bytearray(packed(mavlink.MAVLink_set_gps_global_origin_message(7, 1, 2, 3)))
    data[-1] ^= 1
    ear.handle_origin_sent(packet_at(bytes(data), 0))
    assert ear.origin is None


def test_zero_velocity_is_velocity_alone_in_local_coordinates():
    message = said(DeadManAction.ZERO_VELOCITY, ear_of(), t_s=12.3456)
    assert message.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
    assert (message.target_system, message.target_component) == (7, 1)
    assert (message.get_srcSystem(), message.get_srcComponent()) == (7, 192)
    assert (message.coordinate_frame, message.time_boot_ms) == (mavlink.MAV_FRAME_LOCAL_NED, 12345)
    assert message.type_mask == 0b110111000111
    assert (message.vx, message.vy, message.vz, message.yaw_rate) == (0.0, 0.0, 0.0, 0.0)
    assert (
        said(DeadManAction.ZERO_VELOCITY, ear_of(), t_s=2.0**32 / 1000.0 + 5.0).time_boot_ms == 5000
    )


@pytest.mark.parametrize(
    ("action", "px4", "copter"),
    [(DeadManAction.HOLD, (4.0, 3.0), COPTER_BRAKE), (DeadManAction.LAND, (4.0, 6.0), COPTER_LAND)],
)
def test_hold_and_land_are_asked_for_as_each_kind_numbers_them(action, px4, copter):
    of_px4 = said(action, ear_of())
    assert (of_px4.param2, of_px4.param3) == px4
    of_copter = said(action, ear_of(beat(COPTER, 4)))
    assert (of_copter.param2, of_copter.param3) == (float(copter), 0.0)
    for message in (of_px4, of_copter):
        assert (message.get_type(), message.command) == ("COMMAND_LONG", SET_MODE)
        assert (message.target_system, message.target_component) == (7, 1)
        assert (message.confirmation, message.param1) == (0, 1.0)
        assert message.param4 == message.param7 == 0.0
        assert (message.get_srcSystem(), message.get_srcComponent()) == (7, 192)


def test_it_speaks_the_mavlink_that_it_hears():
    ear = ear_of()
    assert Voice().say(DeadManAction.LAND, ear, 10.0).data[0] == 0xFD
    ear.listen(packed(beat(), mavlink1=True), 11.0)
    assert Voice().say(DeadManAction.LAND, ear, 11.0).data[0] == 0xFE


def test_it_shows_itself_as_a_companion_computer_that_is_no_autopilot():
    packet = Voice().heartbeat()
    message = mavlink.MAVLink(None).decode(bytearray(packet.data))
    assert (packet.message_id, packet.system_id, packet.component_id) == (0, 1, 192)
    assert (message.type, message.autopilot) == (
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID,
    )  # fmt: skip
    assert (message.base_mode, message.custom_mode) == (0, 0)
    assert (message.system_status, message.mavlink_version) == (mavlink.MAV_STATE_ACTIVE, 3)
