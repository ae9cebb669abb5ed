"""The driver of a PX4, in memory: what it says, when, and what it makes of the answers."""

import math
from dataclasses import replace

import numpy as np
import pytest
from autopilot_links import (
    ARM,
    COPTER,
    DENIED,
    HIGHRES_IMU,
    HOME,
    INTERVAL,
    NOT_NOW,
    PX4,
    PX4_DESCEND,
    PX4_HOLD,
    PX4_OFFBOARD,
    PX4_POSITION,
    RAW_IMU,
    SET_MODE,
    TAKEOFF,
    Bench,
)
from pymavlink.dialects.v20 import all as mavlink

from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import euler_from_rotation, rotation_from_quat
from vwnav.mavlink.modes import AutopilotKind
from vwnav.types import Attitude, Height, ImuSample, Stationary
from vwnav.vehicle import FlightMode, VelocitySetpoint


@pytest.fixture
def bench():
    return Bench()


def of_kind(measurements, kind):
    return [each for each in measurements if isinstance(each, kind)]


def test_identity_and_telemetry_arrive(bench):
    state = bench.autopilot.state()
    assert bench.autopilot.kind is AutopilotKind.PX4
    assert (state.connected, state.armed, state.in_air) == (True, False, False)
    assert (state.armable, state.local_position_ok, state.rc_available) == (True, True, True)
    assert state.battery_ratio == 0.87
    assert abs(state.height_m) < 0.1
    assert state.silence_s < 0.3


def test_rates_are_asked_for_until_they_come(bench):
    asked = {int(c.param1): c.param2 for c in bench.peer.commands(INTERVAL)}
    assert asked[30] == 20000.0
    assert asked[29] == 100000.0
    assert 0 not in asked  # PX4 refuses it
    assert 436 in asked
    assert 193 not in asked
    assert RAW_IMU not in asked
    bench.run(10.0)
    bench.peer.heard.clear()
    bench.run(10.0)
    still = {int(c.param1) for c in bench.peer.commands(INTERVAL)}
    assert not still & {0, 30, 105}  # these come as they were asked for


def test_measurements_come_in_order_of_arrival_and_each_once(bench):
    bench.autopilot.take_measurements()
    bench.run(1.0)
    taken = bench.autopilot.take_measurements()
    attitudes, heights = of_kind(taken, Attitude), of_kind(taken, Height)
    samples, still = of_kind(taken, ImuSample), of_kind(taken, Stationary)
    for each, count in ((attitudes, 50), (samples, 50), (heights, 10), (still, 10)):
        assert len(each) == pytest.approx(count, abs=2)
        assert np.all(np.diff([one.t_s for one in each]) > 0.0)
    angles = euler_from_rotation(rotation_from_quat(attitudes[-1].quat_wxyz))
    assert angles == pytest.approx((0.1, -0.2, 0.5), abs=1e-6)
    assert samples[-1].rates_rad_s == pytest.approx([0.0, 0.0, 0.1])
    assert attitudes[-1].t_s == pytest.approx(bench.clock(), abs=0.03)
    assert bench.autopilot.take_measurements() == ()


@pytest.mark.parametrize("kind", ["px4", "copter"])
def test_a_px4_that_stands_in_offboard_is_asked_for_hold_and_a_copter_in_guided_for_nothing(kind):
    bench = Bench() if kind == "px4" else Bench(COPTER)
    request = bench.autopilot.stand_by()
    bench.run(1.0)
    assert (request.done, request.refused) == (True, None)
    assert len(bench.peer.commands(SET_MODE)) == (kind == "px4")


def test_an_armed_aircraft_does_not_stand(bench):
    bench.peer.armed = True
    bench.run(0.5)
    bench.autopilot.take_measurements()
    bench.run(0.5)
    assert not of_kind(bench.autopilot.take_measurements(), Stationary)


def test_everything_names_the_autopilots_own_system(bench):
    bench.has_origin()
    bench.autopilot.send_velocity(VelocitySetpoint(0.0, 0.0, 0.0))
    bench.finish(bench.autopilot.hold())
    targets = {
        m.get_type(): m.target_system for _, m in bench.peer.heard if hasattr(m, "target_system")
    }
    assert {"COMMAND_LONG", "SET_GPS_GLOBAL_ORIGIN"} <= set(targets)
    assert all(system == 7 for kind, system in targets.items() if kind != "TIMESYNC"), targets


def test_an_answer_to_somebody_else_is_not_taken_for_ours(bench):
    bench.peer.deaf = {SET_MODE}
    bench.peer.refuse = {SET_MODE: DENIED}
    request = bench.autopilot.hold()
    bench.peer.send(mavlink.MAVLink_command_ack_message(SET_MODE, 0, 0, 0, 7, 192))
    assert "no answer" in bench.finish(request)


def test_another_aircraft_on_the_link_is_not_listened_to(bench):
    bench.peer.armed = False
    for _ in range(20):
        bench.peer.beat(system_id=9, custom_mode=PX4_POSITION)
        bench.run(0.02)
        assert bench.autopilot.state().mode is FlightMode.HOLD


def test_height_follows_the_pressure_and_the_stamp_its_clock(bench):
    bench.peer.pressure_hpa = 1008.0 - 6.0  # about 50 m up: 12 Pa a metre
    bench.run(0.1)
    state = bench.autopilot.state()
    assert state.height_m == pytest.approx(50.3, abs=0.3)
    assert 0.0 <= state.t_s - state.height_t_s < 0.05


def test_timesync_questions_are_answered_on_the_clock_of_the_estimates(bench):
    bench.peer.send(mavlink.MAVLink_timesync_message(0, 123456789))
    bench.run(0.05)
    (answer,) = [m for m in bench.peer.of("TIMESYNC") if m.ts1 == 123456789]
    assert answer.tc1 / 1e9 == pytest.approx(bench.clock(), abs=0.06)


@pytest.mark.parametrize(
    ("custom_mode", "mode"),
    [
        (PX4_POSITION, FlightMode.MANUAL),
        (PX4_DESCEND, FlightMode.DESCEND),
        (PX4_OFFBOARD, FlightMode.OFFBOARD),
        (PX4_HOLD, FlightMode.HOLD),
    ],
)
def test_a_mode_change_shows_within_a_tenth_of_a_second(bench, custom_mode, mode):
    bench.peer.custom_mode = custom_mode
    bench.run(0.13)
    assert bench.autopilot.state().mode is mode


def test_the_estimate_waits_for_the_origin_and_is_sent_about_it(bench):
    bench.has_origin()
    bench.autopilot.send_estimate(bench.estimate())
    bench.run(0.05)
    message = bench.peer.of("VISION_POSITION_ESTIMATE")[-1]
    assert bench.peer.origin == (604030000, 224610000, 40000)
    assert (message.x, message.y, message.z) == (10.0, -20.0, -30.0)
    assert (message.roll, message.pitch, message.yaw) == pytest.approx((0.1, -0.2, 0.0), abs=1e-6)
    assert [message.covariance[i] for i in (0, 1, 6, 11)] == [1.0, 0.0, 2.0, 3.0]
    assert message.covariance[20] == pytest.approx(math.pi**2)
    assert message.reset_counter == 2
    assert not bench.peer.of("VISION_SPEED_ESTIMATE")


def test_a_px4_is_told_the_velocity_too_where_the_place_is_unsure(bench):
    bench.has_origin()
    unsure = np.diag([1600.0, 400.0, 1.0, 0.25, 0.5, 0.1])
    bench.autopilot.send_estimate(replace(bench.estimate(), covariance=unsure))
    bench.run(0.05)
    message = bench.peer.of("ODOMETRY")[-1]
    assert not bench.peer.of("VISION_POSITION_ESTIMATE")
    assert (message.frame_id, message.child_frame_id, message.estimator_type) == (1, 1, 2)
    assert (message.x, message.y, message.z) == (10.0, -20.0, -30.0)
    velocity = bench.estimate().velocity_ned_m_s
    assert (message.vx, message.vy, message.vz) == pytest.approx(tuple(velocity), abs=1e-6)
    assert [message.pose_covariance[i] for i in (0, 6, 11)] == [1600.0, 400.0, 1.0]
    assert [message.velocity_covariance[i] for i in (0, 6, 11)] == pytest.approx([0.25, 0.5, 0.1])
    assert math.isnan(message.yawspeed)
    assert message.reset_counter == 2


def test_a_px4_is_told_the_position_alone_before_a_first_fix(bench):
    bench.has_origin()
    fair = np.diag([28.0, 28.0, 1.0, 0.25, 0.5, 0.1])
    bench.autopilot.send_estimate(replace(bench.estimate(), covariance=fair))
    bench.run(0.05)
    assert bench.peer.of("VISION_POSITION_ESTIMATE")
    assert not bench.peer.of("ODOMETRY")


def test_an_origin_that_is_there_already_is_kept(bench):
    """Setting it anew makes PX4's position jump, and it may have flown on it before."""
    bench.peer.origin = (604040000, 224610000, 45000)
    bench.has_origin()
    assert not bench.peer.of("SET_GPS_GLOBAL_ORIGIN")
    assert bench.offset_ned_m()[0] == pytest.approx(-111.4, abs=1.0)


def test_an_origin_on_another_continent_is_set_anew(bench):
    bench.peer.origin = (473977420, 85455940, 488000)
    bench.has_origin()
    assert bench.peer.origin == (604030000, 224610000, 40000)
    assert np.linalg.norm(bench.offset_ned_m()) < 0.1


def test_an_origin_is_set_until_a_filter_is_there_to_take_it(bench):
    bench.peer.keeps_origin = True  # still starting
    bench.autopilot.set_origin(*HOME)
    bench.run(3.0)
    bench.autopilot.send_estimate(bench.estimate())
    assert bench.offset_ned_m() is None
    bench.peer.keeps_origin = False
    bench.wait(lambda: bench.offset_ned_m() is not None)
    assert bench.peer.origin == (604030000, 224610000, 40000)


def test_one_that_takes_long_to_start_is_given_its_origin_all_the_same(bench):
    bench.peer.keeps_origin = True
    bench.autopilot.set_origin(*HOME)
    bench.run(25.0)
    bench.peer.keeps_origin = False
    bench.wait(lambda: bench.peer.origin, 8.0)


def test_an_autopilot_that_keeps_its_own_origin_gets_estimates_about_that_one(bench):
    bench.peer.origin, bench.peer.keeps_origin = (604040000, 224610000, 45000), True
    bench.has_origin()
    bench.autopilot.send_estimate(bench.estimate())
    bench.run(0.05)
    message = bench.peer.of("VISION_POSITION_ESTIMATE")[-1]
    offset = LocalFrame(60.404, 22.461, 45.0).to_ned(*HOME)
    assert (message.x, message.z) == pytest.approx((10.0 + offset[0], -30.0 + offset[2]), abs=0.01)


def test_an_autopilot_that_restarts_is_given_its_origin_again_before_any_estimate(bench):
    bench.has_origin()
    bench.peer.origin, bench.peer.boot_at_s = None, bench.clock()
    bench.run(0.1)
    bench.peer.heard.clear()
    for _ in range(200):
        bench.autopilot.send_estimate(bench.estimate())
        bench.run(0.02)
    order = [m.get_type() for _, m in bench.peer.heard]
    assert order.index("SET_GPS_GLOBAL_ORIGIN") < order.index("VISION_POSITION_ESTIMATE")


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_one_that_restarts_so_early_that_no_clock_shows_it_is_given_its_origin_again(kind):
    bench = Bench(kind, settle_s=0.0)
    bench.peer.boot_at_s = bench.clock() - 1.0
    bench.has_origin()
    bench.down.cut = bench.up.cut = True
    bench.run(6.0)
    bench.down.cut = bench.up.cut = False
    bench.peer.origin, bench.peer.boot_at_s = None, bench.clock() - 4.0
    bench.wait(lambda: bench.peer.origin, 8.0)
    bench.wait(lambda: bench.offset_ned_m() is not None)


def test_an_origin_that_somebody_else_sets_on_the_ground_is_the_one_that_counts(bench):
    bench.has_origin()
    bench.peer.origin = (604040000, 224610000, 40000)
    bench.run(7.0)
    assert bench.offset_ned_m() == pytest.approx([-111.4, 0.0, 0.0], abs=0.2)


def test_an_origin_is_not_looked_for_in_flight_nor_given_up_in_a_cut(bench):
    bench.has_origin()
    bench.peer.heard.clear()
    bench.down.cut = True
    bench.run(30.0)
    assert bench.offset_ned_m() is not None
    assert not bench.peer.of("SET_GPS_GLOBAL_ORIGIN")
    bench.down.cut, bench.peer.armed = False, True
    bench.run(1.0)
    bench.peer.origin = (604040000, 224610000, 40000)
    bench.peer.heard.clear()
    bench.run(20.0)
    assert not bench.peer.commands(512)
    assert bench.offset_ned_m() == pytest.approx([0.0, 0.0, 0.0], abs=0.2)


@pytest.mark.parametrize("after_s", [0.1, 0.9])
def test_who_arms_while_its_origin_is_looked_for_is_not_left_without_estimates(bench, after_s):
    """Answers that are lost tell nothing: in the air they were taken for an origin forgotten."""
    bench.has_origin()
    bench.peer.origin, bench.peer.keeps_origin = None, True  # it answers nothing
    bench.peer.heard.clear()
    bench.wait(lambda: bench.peer.commands(512), 7.0)
    bench.run(after_s)
    bench.peer.armed = True
    bench.run(1.0)
    bench.peer.heard.clear()
    bench.run(4.0, lambda: bench.autopilot.send_estimate(bench.estimate()))
    assert len(bench.peer.of("VISION_POSITION_ESTIMATE")) > 100
    assert not bench.peer.of("SET_GPS_GLOBAL_ORIGIN")


def test_the_autopilots_own_position_is_told_about_the_runs_origin(bench):
    bench.peer.origin = (604040000, 224610000, 40000)
    bench.has_origin()
    bench.peer.send(mavlink.MAVLink_local_position_ned_message(1, 5.0, 6.0, -7.0, 0, 0, 0))
    bench.run(0.05)
    own = bench.autopilot.state().own_position_ned_m
    assert own == pytest.approx([5.0 + 111.4, 6.0, -7.0], abs=1.0)
    bench.run(1.1)
    assert bench.autopilot.state().own_position_ned_m is None


def test_velocities_go_out_once_and_hold_the_heading_when_none_is_asked_for(bench):
    bench.autopilot.send_velocity(VelocitySetpoint(1.0, 2.0, -3.0, 1.0))
    bench.autopilot.send_velocity(VelocitySetpoint(0.0, 0.0, 0.0))
    bench.run(0.4)
    first, second = bench.peer.of("SET_POSITION_TARGET_LOCAL_NED")
    assert (first.vx, first.vy, first.vz, first.type_mask) == (1.0, 2.0, -3.0, 2503)
    assert second.yaw == first.yaw


def test_a_heading_is_asked_for_in_terms_of_the_compass(bench):
    bench.has_origin()
    bench.autopilot.send_estimate(bench.estimate(yaw_rad=0.4))  # the compass says 0.5
    bench.autopilot.send_velocity(VelocitySetpoint(0.0, 0.0, 0.0, 1.0))
    bench.run(0.05)
    (message,) = bench.peer.of("SET_POSITION_TARGET_LOCAL_NED")
    assert message.yaw == pytest.approx(1.1, abs=1e-3)


def test_an_autopilot_whose_compass_is_far_off_is_told_all_in_terms_of_its_own_north(bench):
    """By a heading that is 180 degrees off it leans the wrong way: flown, it left at 43 m/s."""
    bench.has_origin()
    bench.peer.yaw_rad = math.pi
    bench.run(1.0)
    for _ in range(20):
        bench.autopilot.send_estimate(bench.estimate())  # north by the map
        bench.run(0.05)
    first, last = (bench.peer.of("VISION_POSITION_ESTIMATE")[i] for i in (0, -1))
    assert (last.x, last.y, last.z) == pytest.approx((first.x, first.y, first.z), abs=1e-4)
    assert (first.yaw, abs(last.yaw)) == pytest.approx((0.0, math.pi), abs=1e-3)
    moved = replace(bench.estimate(), position_ned_m=np.array([13.0, -20.0, -30.0]))
    bench.autopilot.send_estimate(moved)
    bench.autopilot.send_velocity(VelocitySetpoint(2.0, 1.0, -3.0, 0.0))
    bench.run(0.05)
    there = bench.peer.of("VISION_POSITION_ESTIMATE")[-1]
    assert there.x == pytest.approx(first.x - 3.0, abs=1e-3)
    asked = bench.peer.of("SET_POSITION_TARGET_LOCAL_NED")[-1]
    assert (asked.vx, asked.vy, asked.vz) == pytest.approx((-2.0, -1.0, -3.0), abs=1e-3)
    _, words = bench.autopilot.take_orders()
    assert [each for each in words if "north is 180 degrees off" in each]
    where = (there.x, there.y, there.z)
    bench.peer.send(mavlink.MAVLink_local_position_ned_message(1, *where, 0, 0, 0))
    bench.run(0.05)
    own = bench.autopilot.state().own_position_ned_m
    assert own == pytest.approx(moved.position_ned_m, abs=0.01)


@pytest.mark.parametrize("round_trip_s", [0.004, 0.25, 0.5])
def test_a_px4_flight_arms_takes_off_and_takes_control_on_any_link(round_trip_s):
    bench = Bench(round_trip_s=round_trip_s)
    assert bench.finish(bench.autopilot.arm()) is None
    assert bench.peer.armed
    assert bench.finish(bench.autopilot.takeoff(8.0)) is None
    assert bench.autopilot.state().mode is FlightMode.TAKEOFF
    assert bench.peer.params["MIS_TAKEOFF_ALT"][0] == 8.0
    assert math.isnan(bench.peer.commands(TAKEOFF)[-1].param7)
    bench.run(1.0)
    assert bench.finish(bench.autopilot.start_offboard()) is None
    assert bench.autopilot.state().mode is FlightMode.OFFBOARD
    assert bench.peer.custom_mode == PX4_OFFBOARD
    assert len(bench.peer.of("SET_POSITION_TARGET_LOCAL_NED")) >= 4
    for number in (ARM, TAKEOFF, SET_MODE):
        assert len(bench.peer.commands(number)) == 1  # nothing twice where nothing was lost


@pytest.mark.parametrize("name", ["arm", "start_offboard", "hold", "land", "disarm"])
def test_no_request_waits_even_on_a_dead_link(bench, name):
    bench.up.cut = bench.down.cut = True
    before_s = bench.clock()
    request = getattr(bench.autopilot, name)()
    assert bench.clock() == before_s
    assert not request.done
    assert "no answer" in bench.finish(request)


def test_a_command_that_was_lost_is_sent_again_with_its_confirmation_counted(bench):
    bench.up.cut = True
    request = bench.autopilot.hold()
    bench.run(0.2)
    bench.up.cut = False
    assert bench.finish(request) is None
    assert [c.confirmation for c in bench.peer.commands(SET_MODE)] == [1]


def test_a_command_whose_answer_was_lost_is_taken_for_done_when_it_shows(bench):
    bench.peer.deaf = {ARM}
    assert bench.finish(bench.autopilot.arm()) is None
    assert len(bench.peer.commands(ARM)) == 1


def test_an_arm_without_answer_is_not_sent_again_after_the_pilot_disarmed(bench):
    bench.peer.deaf = {ARM}
    request = bench.autopilot.arm()
    bench.wait(lambda: bench.autopilot.state().armed)
    bench.peer.armed = False
    bench.run(5.0)
    assert request.done
    assert len(bench.peer.commands(ARM)) == 1
    assert not bench.peer.armed


def test_a_refused_arm_is_not_sent_again(bench):
    bench.peer.refuse = {ARM: DENIED}
    assert bench.finish(bench.autopilot.arm()).startswith("denied")
    bench.run(5.0)
    assert len(bench.peer.commands(ARM)) == 1


def test_offboard_is_not_asked_for_again_once_somebody_chose_another_mode(bench):
    bench.peer.deaf, bench.peer.refuse = {SET_MODE}, {SET_MODE: DENIED}
    request = bench.autopilot.start_offboard()
    bench.wait(lambda: bench.peer.commands(SET_MODE))
    bench.peer.custom_mode = PX4_POSITION
    assert "somebody else chose the mode manual" in bench.finish(request)
    assert len(bench.peer.commands(SET_MODE)) == 1


@pytest.mark.parametrize("by", ["switch", "sticks"])
def test_land_is_not_asked_for_again_once_somebody_took_what_it_had_fallen_back_to(bench, by):
    """The flown mode stays the same: PX4 tells alone that it is intended now, or hears a radio."""
    bench.peer.custom_mode, bench.peer.intended_mode = PX4_POSITION, PX4_OFFBOARD
    bench.peer.radio = False
    bench.wait(lambda: bench.autopilot.state().is_fallback)
    bench.peer.deaf, bench.peer.refuse = {SET_MODE}, {SET_MODE: DENIED}
    request = bench.autopilot.land()
    bench.wait(lambda: bench.peer.commands(SET_MODE))
    if by == "switch":
        bench.peer.intended_mode = PX4_POSITION
    else:
        bench.peer.radio = True
    assert "somebody else chose the mode manual" in bench.finish(request)
    assert len(bench.peer.commands(SET_MODE)) == 1


def test_offboard_is_not_asked_for_at_all_when_the_pilot_comes_first(bench):
    request = bench.autopilot.start_offboard()
    bench.peer.custom_mode = PX4_POSITION
    assert "somebody else" in bench.finish(request)
    assert not bench.peer.commands(SET_MODE)


def test_a_new_request_replaces_the_one_under_way(bench):
    bench.peer.deaf, bench.peer.refuse = {SET_MODE}, {SET_MODE: DENIED}
    first = bench.autopilot.start_offboard()
    bench.run(0.1)
    second = bench.autopilot.land()
    assert first.done
    assert first.refused == "replaced by a newer command"
    assert not second.done
    setpoints = len(bench.peer.of("SET_POSITION_TARGET_LOCAL_NED"))
    bench.run(1.0)
    assert len(bench.peer.of("SET_POSITION_TARGET_LOCAL_NED")) == setpoints


def test_the_late_answer_to_a_replaced_command_is_not_taken_for_the_new_ones():
    bench = Bench(round_trip_s=0.5)
    bench.autopilot.hold()
    bench.run(0.3)
    bench.peer.refuse = {SET_MODE: DENIED}
    request = bench.autopilot.land()
    bench.run(0.25)  # the answer to hold has come
    assert not request.done
    assert bench.finish(request).startswith("denied")


def test_the_stream_before_offboard_is_the_newest_setpoint_only_while_somebody_steers(bench):
    bench.autopilot.send_velocity(VelocitySetpoint(1.0, 0.0, 0.0))
    bench.peer.refuse = {SET_MODE: NOT_NOW}
    request = bench.autopilot.start_offboard()
    bench.finish(request)
    sent = [m.vx for m in bench.peer.of("SET_POSITION_TARGET_LOCAL_NED")]
    assert sent[0] == 1.0
    assert sent[-1] == 0.0


def test_offboard_is_asked_for_twice(bench):
    bench.peer.refuse = {SET_MODE: NOT_NOW}
    assert bench.finish(bench.autopilot.start_offboard()).startswith("not now")
    assert len(bench.peer.commands(SET_MODE)) == 2


def test_modes_are_commanded_and_seen_at_once_though_heartbeats_lag(bench):
    bench.peer.heartbeat_hz = 1.0
    bench.peer.intervals_us.pop(436)
    bench.run(1.2)
    for ask, mode in (
        (bench.autopilot.hold, FlightMode.HOLD),
        (bench.autopilot.land, FlightMode.LAND),
    ):
        assert bench.finish(ask()) is None
        assert bench.autopilot.state().mode is mode
    bench.peer.custom_mode = PX4_POSITION
    bench.wait(lambda: bench.autopilot.state().mode is FlightMode.MANUAL, 1.5)


def test_a_refusal_comes_in_words_with_the_autopilots_own(bench):
    bench.peer.refuse = {ARM: DENIED}
    texts = [b"Arming denied: Resolve system health failures firs", b"t"]
    request = bench.autopilot.disarm()
    bench.run(0.03)
    for number, text in enumerate(texts):
        bench.peer.send(mavlink.MAVLink_statustext_message(2, text, 9, number))
    wanted = "denied (Arming denied: Resolve system health failures first)"
    assert bench.finish(request) == wanted


def test_an_aircraft_that_is_not_ready_is_not_armed(bench):
    bench.peer.prearm = False
    bench.run(0.5)
    request = bench.autopilot.arm()
    assert request.done
    assert request.refused.startswith("not ready to arm")
    assert not bench.peer.commands(ARM)


@pytest.mark.parametrize("how", ["flown", "refused", "closed", "lost"])
def test_the_owners_takeoff_height_is_put_back(bench, how):
    bench.finish(bench.autopilot.arm())
    if how == "refused":
        bench.peer.refuse = {TAKEOFF: DENIED}
    if how == "lost":
        bench.peer.deaf = {TAKEOFF}
        bench.peer.refuse = {TAKEOFF: DENIED}
    outcome = bench.finish(bench.autopilot.takeoff(8.0))
    assert (outcome is None) == (how in ("flown", "closed"))
    if how == "closed":
        assert bench.peer.params["MIS_TAKEOFF_ALT"][0] == 8.0
        bench.autopilot.close()
        bench.port._link.closed = False
    elif how == "flown":
        bench.run(5.0)
        assert bench.peer.params["MIS_TAKEOFF_ALT"][0] == 8.0  # PX4 may read it while it climbs
        bench.finish(bench.autopilot.start_offboard())
    bench.run(5.0)
    assert bench.peer.params["MIS_TAKEOFF_ALT"][0] == 2.5


def test_a_vision_failure_shows_early(bench):
    assert bench.autopilot.state().aiding
    bench.peer.flags = 0x07F  # as recorded 1 s after vision stopped
    bench.run(0.3)
    state = bench.autopilot.state()
    assert state.aiding is False
    assert state.local_position_ok
    bench.peer.flags = 0x065
    bench.run(0.3)
    assert not bench.autopilot.state().local_position_ok


def test_an_insane_local_position_is_not_a_position(bench):
    bench.peer.send(mavlink.MAVLink_local_position_ned_message(1, 6310841.0, 3000509.0, 0, 0, 0, 0))
    bench.run(0.05)
    assert not bench.autopilot.state().local_position_ok
    bench.peer.send(mavlink.MAVLink_local_position_ned_message(1, 1.0, 2.0, 0, 0, 0, 0))
    bench.run(0.05)
    assert bench.autopilot.state().local_position_ok


def test_parameters_are_read_in_the_background_with_the_bits_of_px4_integers():
    bench = Bench(settle_s=0.0)
    integers = {"EKF2_EV_CTRL": 0, "EKF2_HGT_REF": 1, "COM_RC_OVERRIDE": 3, "NAV_DLL_ACT": -1}
    for name, value in integers.items():
        bits = np.int32(value).view(np.float32).item()
        bench.peer.params[name] = (bits, mavlink.MAV_PARAM_TYPE_INT32)
    bench.peer.params["COM_OF_LOSS_T"] = (1.0, mavlink.MAV_PARAM_TYPE_REAL32)
    assert bench.autopilot.findings is None
    bench.wait(lambda: bench.autopilot.findings is not None)
    findings = {f.parameter: f for f in bench.autopilot.findings}
    assert findings["EKF2_EV_CTRL"].severity == "fail"
    assert findings["EKF2_EV_CTRL"].present == 0
    assert findings["EKF2_HGT_REF"].present == 1
    assert findings["NAV_DLL_ACT"].present == -1
    assert "COM_RC_OVERRIDE" not in findings
    assert "COM_OF_LOSS_T" not in findings


def test_parameters_whose_answers_were_lost_are_asked_for_again():
    """One that starts anew while they are read answers some, and nothing for seconds."""
    bench = Bench(settle_s=0.0)
    bench.peer.params |= {"EKF2_HGT_REF": (0.0, 9), "COM_OF_LOSS_T": (1.0, 9)}
    table = bench.autopilot._parameters.values
    bench.wait(lambda: table)
    bench.down.cut = True
    bench.run(6.0)
    missing = {f.parameter for f in bench.autopilot.findings or () if f.present is None}
    assert "COM_OF_LOSS_T" in missing, "the answers were to be lost"
    bench.down.cut = False
    bench.run(7.0)
    assert "COM_OF_LOSS_T" not in {f.parameter for f in bench.autopilot.findings}


def test_a_parameter_that_somebody_mends_is_no_finding_any_more(bench):
    bench.wait(lambda: bench.autopilot.findings is not None)
    assert "COM_OF_LOSS_T" in {f.parameter for f in bench.autopilot.findings}
    bench.peer.send(mavlink.MAVLink_param_value_message(b"COM_OF_LOSS_T", 1.0, 9, 1, 0))
    bench.run(0.1)
    assert "COM_OF_LOSS_T" not in {f.parameter for f in bench.autopilot.findings}


def test_a_link_that_falls_silent_is_not_connected(bench):
    bench.down.cut = True
    bench.run(3.5)
    assert not bench.autopilot.state().connected
    assert bench.autopilot.state().silence_s > 2.5
    request = bench.autopilot.arm()
    assert request.refused == "the autopilot is not heard"
    bench.down.cut = False
    bench.run(0.5)
    assert bench.autopilot.state().connected


def test_a_restarted_autopilot_is_asked_for_its_rates_again(bench):
    bench.peer.boot_at_s = bench.clock()
    bench.peer.intervals_us.clear()
    bench.run(1.0)
    assert {30, 105, 436} <= set(bench.peer.intervals_us)


def test_an_autopilot_that_forgot_its_rates_in_a_cut_is_asked_again(bench):
    bench.run(5.0)
    bench.down.cut = True
    bench.run(40.0)
    bench.peer.intervals_us.clear()
    bench.down.cut = False
    bench.run(5.0)
    assert {105, 436} <= set(bench.peer.intervals_us)


def test_what_a_flight_needs_is_asked_for_within_ten_seconds_however_long_nobody_heard():
    """A line of which one way was loose: an ArduPilot sends nothing that it was not asked for."""
    bench = Bench(COPTER, settle_s=0.0)
    bench.up.cut, bench.peer.unknown = True, {HIGHRES_IMU}
    bench.peer.intervals_us = dict.fromkeys((30, 29, 1, 245, 193), 1e9)  # as good as never
    bench.run(35.0)
    bench.up.cut = False
    bench.wait(lambda: bench.peer.intervals_us[30] < 1e6, 10.0)
    bench.run(40.0)
    bench.peer.heard.clear()
    bench.run(60.0)
    asked = [each.param1 for each in bench.peer.commands(INTERVAL)]
    assert asked.count(HIGHRES_IMU) <= 2  # each time it tells all ground stations that it cannot


def test_the_first_autopilot_is_listened_to_and_nobody_elses_commands(bench):
    assert Bench(COPTER).autopilot.kind is AutopilotKind.ARDUPILOT
    assert str(bench.autopilot.kind) == "PX4"
