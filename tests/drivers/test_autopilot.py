"""The autopilot link over real MAVLink: MAVSDK on one side, a pymavlink peer on the other."""

import math
import threading
import time

import numpy as np
import pytest
from autopilot_links import HOME, estimate, has_origin, link
from link_peer import (
    DENIED,
    PX4_DESCEND,
    PX4_HOLD,
    PX4_OFFBOARD,
    PX4_POSITION,
    TEMPORARILY_REJECTED,
    Peer,
    free_port,
    wait_for,
)
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.drivers.autopilot import MavsdkAutopilot
from vwnav.errors import LinkError
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import (
    euler_from_rotation,
    rotation_from_quat,
)
from vwnav.safety.flight_modes import AutopilotKind
from vwnav.types import FlightMode, VelocitySetpoint

MAVSDKS_OWN = ("TIMESYNC", "PING")  # questions to everybody


@pytest.fixture(scope="module")
def px4():
    yield from link(mavlink.MAV_AUTOPILOT_PX4)


def test_no_autopilot_is_one_clear_line():
    with pytest.raises(LinkError, match="no autopilot on udpin") as error:
        MavsdkAutopilot(f"udpin://127.0.0.1:{free_port()}", timeout_s=0.5)
    assert "\n" not in str(error.value)


def test_a_wrong_url_is_one_clear_line():
    with pytest.raises(LinkError, match="cannot open the link"):
        MavsdkAutopilot("carrier-pigeon://127.0.0.1", timeout_s=0.5)


def test_an_unknown_firmware_is_refused():
    port = free_port()
    with (
        Peer(port, mavlink.MAV_AUTOPILOT_GENERIC),
        pytest.raises(LinkError, match="neither PX4 nor ArduPilot"),
    ):
        MavsdkAutopilot(f"udpin://127.0.0.1:{port}", timeout_s=10.0)


def test_identity_and_telemetry_arrive(px4):
    _peer, autopilot = px4
    assert autopilot.kind is AutopilotKind.PX4
    state = wait_for(lambda: autopilot.state() if autopilot.state().height_t_s else None)
    wait_for(lambda: autopilot.state().armable and autopilot.state().local_position_ok)
    assert state.connected
    assert not state.armed
    assert not state.in_air
    assert state.battery_ratio == 0.87
    assert state.rc_available
    assert abs(state.height_m) < 0.1
    assert state.heartbeat_age_s < 0.5


def test_rates_are_asked_for(px4):
    peer, _ = px4
    wait_for(lambda: peer.commands(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL)[8:])
    asked = {int(c.param1): c.param2 for c in peer.commands(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL)}
    assert asked[30] == 20000.0
    assert asked[29] == 50000.0
    assert asked[0] == 200000.0
    assert 230 in asked
    assert 193 not in asked
    assert wait_for(lambda: 105 in peer.streamed)


def test_the_imu_arrives_on_our_clock(px4):
    _, autopilot = px4
    autopilot.take_imu()
    first = wait_for(autopilot.take_imu)[0]
    assert first.t_s == pytest.approx(time.monotonic(), abs=0.5)
    assert first.specific_force_m_s2 == pytest.approx([0.0, 0.0, -9.80665])
    assert first.rates_rad_s == pytest.approx([0.0, 0.0, 0.1])
    time.sleep(0.1)
    assert all(sample.t_s > first.t_s for sample in autopilot.take_imu())


def test_everything_names_the_autopilots_own_system(px4):
    peer, autopilot = px4
    peer.heard.clear()
    has_origin(peer, autopilot)
    autopilot.send_velocity(VelocitySetpoint(0.0, 0.0, 0.0))
    autopilot.hold()
    peer.params["COM_OF_LOSS_T"] = (1.0, mavlink.MAV_PARAM_TYPE_REAL32)
    autopilot.preflight()
    wait_for(lambda: peer.of("SET_POSITION_TARGET_LOCAL_NED"))
    heard = [message for _, message in list(peer.heard)]
    targets = {m.get_type(): m.target_system for m in heard if hasattr(m, "target_system")}
    assert {"COMMAND_LONG", "SET_GPS_GLOBAL_ORIGIN", "PARAM_REQUEST_READ"} <= set(targets)
    assert all(system == 7 for kind, system in targets.items() if kind not in MAVSDKS_OWN), targets


def test_an_answer_to_somebody_else_is_not_taken_for_ours(px4):
    peer, autopilot = px4
    peer.answers = False
    set_mode = mavlink.MAV_CMD_DO_SET_MODE
    other = threading.Timer(
        0.1, lambda: peer.send(mavlink.MAVLink_command_ack_message(set_mode, 0, 0, 0, 7, 192))
    )
    other.start()
    assert "no answer" in autopilot.hold()
    peer.answers = True


def test_another_aircraft_on_the_link_is_not_listened_to(px4):
    peer, autopilot = px4
    wait_for(lambda: autopilot.state().mode is FlightMode.HOLD)
    other = mavlink.MAVLink(None, srcSystem=9, srcComponent=1)
    beat = mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, 129, PX4_POSITION, 4, 3)
    for _ in range(20):
        peer.socket.sendto(bytes(beat.pack(other)), peer.to)
        time.sleep(0.01)
        assert not autopilot.state().armed
    assert autopilot.state().mode is FlightMode.HOLD


def test_height_follows_the_pressure_and_the_stamp_its_clock(px4):
    peer, autopilot = px4
    wait_for(lambda: autopilot.state().height_m is not None)
    peer.pressure_hpa = 1008.0 - 6.0  # about 50 m up: 12 Pa a metre
    wait_for(lambda: autopilot.state().height_m > 49.0)
    state = autopilot.state()
    assert state.height_m == pytest.approx(50.3, abs=0.3)
    assert 0.0 <= state.t_s - state.height_t_s < 0.2
    peer.pressure_hpa = 1008.0


def test_attitude_is_known_at_the_time_of_an_exposure(px4):
    _peer, autopilot = px4
    time.sleep(0.3)
    attitude = autopilot.attitude_at(time.monotonic() - 0.1)
    angles = euler_from_rotation(rotation_from_quat(attitude.quat_wxyz))
    assert angles == pytest.approx((0.1, -0.2, 0.5), abs=1e-6)
    assert autopilot.attitude_at(time.monotonic() + 1.0) is None
    assert autopilot.attitude_at(time.monotonic() - 1000.0) is None


def test_the_clock_is_joined_within_5_ms(px4):
    peer, autopilot = px4
    wait_for(lambda: len(autopilot._telemetry.clock._round_trips) > 3)
    joined_s = autopilot._telemetry.clock.to_monotonic(peer.boot_s())
    assert joined_s == pytest.approx(time.monotonic(), abs=0.005)


def test_timesync_questions_are_answered_on_the_clock_of_the_estimates(px4):
    peer, _ = px4
    peer.send(mavlink.MAVLink_timesync_message(0, 123456789))
    answer = wait_for(lambda: [m for m in peer.of("TIMESYNC") if m.ts1 == 123456789])[0]
    assert answer.tc1 / 1e9 == pytest.approx(time.monotonic(), abs=0.3)


@pytest.mark.parametrize(
    ("custom_mode", "mode"),
    [
        (PX4_POSITION, FlightMode.MANUAL),
        (PX4_DESCEND, FlightMode.DESCEND),
        (PX4_OFFBOARD, FlightMode.OFFBOARD),
        (PX4_HOLD, FlightMode.HOLD),
    ],
)
def test_a_mode_change_shows_within_a_heartbeat(px4, custom_mode, mode):
    peer, autopilot = px4
    peer.custom_mode = custom_mode
    start_s = time.monotonic()
    wait_for(lambda: autopilot.state().mode is mode)
    assert time.monotonic() - start_s < 0.4


def test_the_estimate_waits_for_the_origin_and_is_sent_about_it(px4):
    peer, autopilot = px4
    has_origin(peer, autopilot)
    autopilot.send_estimate(estimate())
    message = wait_for(lambda: peer.of("VISION_POSITION_ESTIMATE"))[-1]
    assert peer.origin == (604030000, 224610000, 40000)
    assert (message.x, message.y, message.z) == (10.0, -20.0, -30.0)
    assert (message.roll, message.pitch, message.yaw) == pytest.approx((0.1, -0.2, 0.0), abs=1e-6)
    assert [message.covariance[i] for i in (0, 1, 6, 11)] == [1.0, 0.0, 2.0, 3.0]
    assert message.covariance[20] == pytest.approx(math.pi**2)
    assert message.reset_counter == 2
    assert message.usec / 1e6 <= time.monotonic()
    assert not peer.of("VISION_SPEED_ESTIMATE")


def test_an_origin_that_is_there_already_is_kept(px4):
    """Setting it anew makes PX4's position jump, and it may have flown on it before."""
    peer, autopilot = px4
    peer.origin = (604040000, 224610000, 45000)
    has_origin(peer, autopilot)
    assert not peer.of("SET_GPS_GLOBAL_ORIGIN")
    assert autopilot._origin.offset_ned_m[0] == pytest.approx(-111.4, abs=1.0)


def test_an_origin_on_another_continent_is_set_anew(px4):
    peer, autopilot = px4
    peer.origin = (473977420, 85455940, 488000)
    has_origin(peer, autopilot)
    assert peer.origin == (604030000, 224610000, 40000)
    assert np.linalg.norm(autopilot._origin.offset_ned_m) < 0.1


def test_an_origin_is_set_until_a_filter_is_there_to_take_it(px4):
    peer, autopilot = px4
    peer.origin, peer.keeps_origin = None, True  # still starting
    autopilot.set_origin(*HOME)
    time.sleep(3.0)
    autopilot.send_estimate(estimate())
    assert autopilot._origin.offset_ned_m is None
    peer.keeps_origin = False
    wait_for(lambda: autopilot._origin.offset_ned_m is not None)
    assert peer.origin == (604030000, 224610000, 40000)


def test_an_autopilot_that_keeps_its_own_origin_gets_estimates_about_that_one(px4):
    peer, autopilot = px4
    peer.origin, peer.keeps_origin = (604040000, 224610000, 45000), True
    has_origin(peer, autopilot)
    autopilot.send_estimate(estimate())
    message = wait_for(lambda: peer.of("VISION_POSITION_ESTIMATE"))[-1]
    offset = LocalFrame(60.404, 22.461, 45.0).to_ned(*HOME)
    assert (message.x, message.z) == pytest.approx((10.0 + offset[0], -30.0 + offset[2]), abs=0.01)
    peer.keeps_origin = False


def test_velocities_go_out_once_and_hold_the_heading_when_none_is_asked_for(px4):
    peer, autopilot = px4
    peer.heard.clear()
    autopilot.send_velocity(VelocitySetpoint(1.0, 2.0, -3.0, 1.0))
    autopilot.send_velocity(VelocitySetpoint(0.0, 0.0, 0.0))
    time.sleep(0.4)
    first, second = peer.of("SET_POSITION_TARGET_LOCAL_NED")
    assert (first.vx, first.vy, first.vz, first.type_mask) == (1.0, 2.0, -3.0, 2503)
    assert second.yaw == first.yaw


def test_a_heading_is_asked_for_in_terms_of_the_compass(px4):
    peer, autopilot = px4
    has_origin(peer, autopilot)
    autopilot.send_estimate(estimate(yaw_rad=0.4))  # the compass says 0.5
    peer.heard.clear()
    autopilot.send_velocity(VelocitySetpoint(0.0, 0.0, 0.0, 1.0))
    (message,) = wait_for(lambda: peer.of("SET_POSITION_TARGET_LOCAL_NED"))
    assert message.yaw == pytest.approx(1.1, abs=1e-3)


def test_a_px4_flight_arms_takes_off_and_takes_control(px4):
    peer, autopilot = px4
    peer.params["MIS_TAKEOFF_ALT"] = (2.5, mavlink.MAV_PARAM_TYPE_REAL32)
    assert autopilot.arm() is None
    assert wait_for(lambda: autopilot.state().armed)
    assert autopilot.takeoff(8.0) is None
    assert peer.params["MIS_TAKEOFF_ALT"][0] == 8.0
    assert math.isnan(peer.commands(mavlink.MAV_CMD_NAV_TAKEOFF)[-1].param7)
    peer.heard.clear()
    assert autopilot.start_offboard() is None
    assert autopilot.state().mode is FlightMode.OFFBOARD
    assert peer.custom_mode == PX4_OFFBOARD
    assert len(peer.of("SET_POSITION_TARGET_LOCAL_NED")) >= 4


def test_modes_are_commanded_and_seen_at_once_though_heartbeats_lag(px4):
    peer, autopilot = px4
    peer.heartbeat_hz = 1.0
    time.sleep(1.2)
    for ask, mode in (
        (autopilot.hold, FlightMode.HOLD),
        (autopilot.land, FlightMode.LAND),
        (autopilot.return_home, FlightMode.RETURN),
    ):
        assert ask() is None
        assert autopilot.state().mode is mode
    peer.heartbeat_hz = 10.0
    peer.custom_mode = PX4_POSITION
    wait_for(lambda: autopilot.state().mode is FlightMode.MANUAL, 1.5)


def test_a_refusal_comes_in_words_with_the_autopilots_own(px4):
    peer, autopilot = px4
    peer.refuse = {mavlink.MAV_CMD_COMPONENT_ARM_DISARM: DENIED}
    texts = [b"Arming denied: Resolve system health failures firs", b"t"]
    for number, text in enumerate(texts):
        peer.send(mavlink.MAVLink_statustext_message(2, text, 9, number))
    assert autopilot.disarm() == ("denied (Arming denied: Resolve system health failures first)")
    peer.refuse = {mavlink.MAV_CMD_DO_SET_MODE: TEMPORARILY_REJECTED}
    assert autopilot.start_offboard().startswith("not now")
    peer.refuse = {}


def test_an_aircraft_that_is_not_ready_is_not_armed(px4):
    peer, autopilot = px4
    peer.prearm = False
    wait_for(lambda: not autopilot.state().armable)
    assert autopilot.arm().startswith("not ready to arm")
    peer.prearm = True


def test_a_vision_failure_shows_early(px4):
    peer, autopilot = px4
    wait_for(autopilot.aiding)
    peer.flags = 0x07F  # as recorded 1 s after vision stopped
    wait_for(lambda: autopilot.aiding() is False)
    assert autopilot.state().local_position_ok
    peer.flags = 0x065
    wait_for(lambda: not autopilot.state().local_position_ok)
    peer.flags = 0x1FF


def test_an_insane_local_position_is_not_a_position(px4):
    peer, autopilot = px4
    wait_for(lambda: autopilot.state().local_position_ok)
    peer.send(mavlink.MAVLink_local_position_ned_message(1, 6310841.0, 3000509.0, 0, 0, 0, 0))
    wait_for(lambda: not autopilot.state().local_position_ok)
    peer.send(mavlink.MAVLink_local_position_ned_message(1, 1.0, 2.0, 0, 0, 0, 0))
    wait_for(lambda: autopilot.state().local_position_ok)


def test_parameters_are_checked_with_the_bits_of_px4_integers(px4):
    peer, autopilot = px4
    integer = mavlink.MAV_PARAM_TYPE_INT32
    bits = {"EKF2_EV_CTRL": 0, "EKF2_HGT_REF": 1, "COM_RC_OVERRIDE": 3, "NAV_DLL_ACT": -1}
    for name, value in bits.items():
        peer.params[name] = (np.int32(value).view(np.float32).item(), integer)
    peer.params["COM_OF_LOSS_T"] = (1.0, mavlink.MAV_PARAM_TYPE_REAL32)
    findings = {f.parameter: f for f in autopilot.preflight()}
    assert findings["EKF2_EV_CTRL"].severity == "fail"
    assert findings["EKF2_EV_CTRL"].present == 0
    assert findings["EKF2_HGT_REF"].present == 1
    assert findings["NAV_DLL_ACT"].present == -1
    assert "COM_RC_OVERRIDE" not in findings
    assert "COM_OF_LOSS_T" not in findings


def test_a_link_that_falls_silent_is_not_connected(px4):
    peer, autopilot = px4
    peer.speaks = False
    wait_for(lambda: not autopilot.state().connected, 4.0)
    assert autopilot.state().heartbeat_age_s > 2.5
    assert autopilot.arm() == "the autopilot is not heard"
    peer.speaks = True
    wait_for(lambda: autopilot.state().connected)


def test_a_restarted_autopilot_is_asked_for_its_rates_again(px4):
    peer, autopilot = px4
    peer.time_skew_s -= 90.0
    peer.heard.clear()
    time.sleep(0.5)
    state = autopilot.state()
    assert state.t_s - state.attitude.t_s < 0.3
