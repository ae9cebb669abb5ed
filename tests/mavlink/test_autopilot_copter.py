"""The driver of an ArduCopter, in memory."""

import pytest
from autopilot_links import (
    COPTER,
    COPTER_BRAKE,
    COPTER_GUIDED,
    COPTER_LAND,
    COPTER_LOITER,
    HIGHRES_IMU,
    RAW_IMU,
    SET_MODE,
    TAKEOFF,
    Bench,
)
from pymavlink.dialects.v20 import all as mavlink

from vwnav.types import ImuSample
from vwnav.vehicle import FlightMode


@pytest.fixture
def bench():
    return Bench(COPTER)


def test_estimates_before_an_origin_are_a_mistake(bench):
    with pytest.raises(ValueError, match="set_origin"):
        bench.autopilot.send_estimate(bench.estimate())


def test_copter_waits_for_the_position_that_guided_needs(bench):
    bench.peer.flags = 0x025
    bench.run(0.5)
    assert not bench.autopilot.state().armable
    assert bench.autopilot.arm().refused.startswith("not ready")
    bench.peer.flags = 0x33F
    bench.run(0.5)
    assert bench.autopilot.state().armable
    assert bench.autopilot.state().local_position_ok


@pytest.mark.parametrize("round_trip_s", [0.004, 0.25, 0.5])
def test_copter_flies_in_guided_and_holds_by_brake_on_any_link(round_trip_s):
    bench = Bench(COPTER, round_trip_s)
    assert bench.finish(bench.autopilot.arm()) is None
    assert bench.peer.custom_mode == COPTER_GUIDED
    assert bench.peer.armed
    assert bench.finish(bench.autopilot.takeoff(7.0)) is None
    assert bench.peer.commands(TAKEOFF)[-1].param7 == 7.0
    assert bench.finish(bench.autopilot.start_offboard()) is None
    assert bench.finish(bench.autopilot.hold()) is None
    assert bench.peer.custom_mode == COPTER_BRAKE
    assert bench.finish(bench.autopilot.land()) is None
    assert bench.peer.custom_mode == COPTER_LAND
    assert bench.autopilot.state().mode is FlightMode.LAND


def test_guided_is_seen_before_arming_is_asked_for(bench):
    bench.peer.heartbeat_hz = 1.0
    bench.autopilot.arm()
    bench.wait(lambda: bench.peer.commands(400))
    order = [int(m.command) for m in bench.peer.of("COMMAND_LONG") if m.command in (176, 400)]
    assert order == [176, 400]


def test_copter_gets_velocity_beside_position(bench):
    bench.has_origin()
    bench.autopilot.send_estimate(bench.estimate())
    bench.run(0.05)
    message = bench.peer.of("VISION_SPEED_ESTIMATE")[-1]
    assert (message.x, message.y, message.z) == (4.0, 5.0, -6.0)
    assert [message.covariance[i] for i in (0, 4, 8)] == [4.0, 5.0, 6.0]


def test_copter_parameters_are_checked():
    bench = Bench(COPTER, settle_s=0.0)
    for name, value in {"VISO_TYPE": 0.0, "EK3_SRC1_POSXY": 6.0, "GPS1_TYPE": 0.0}.items():
        bench.peer.params[name] = (value, mavlink.MAV_PARAM_TYPE_INT8)
    bench.wait(lambda: bench.autopilot.findings is not None)
    findings = {f.parameter: f for f in bench.autopilot.findings}
    assert findings["VISO_TYPE"].severity == "fail"
    assert findings["VISO_TYPE"].present == 0.0
    assert "EK3_SRC1_POSXY" not in findings
    assert "GPS1_TYPE" not in findings


def test_a_copter_without_highres_imu_is_asked_for_its_raw_one():
    bench = Bench(COPTER, settle_s=0.0)
    bench.peer.unknown = {HIGHRES_IMU}
    bench.run(6.0)
    samples = [each for each in bench.autopilot.take_measurements() if isinstance(each, ImuSample)]
    assert set(bench.peer.intervals_us) & {HIGHRES_IMU, RAW_IMU} == {RAW_IMU}
    assert samples[-1].specific_force_m_s2 == pytest.approx([-1.95, -0.96, -9.56], abs=0.02)
    assert samples[-1].rates_rad_s == pytest.approx([0.0, 0.0, 0.1])


def test_a_copter_with_highres_imu_is_not_asked_for_the_raw_one(bench):
    bench.run(10.0)
    assert RAW_IMU not in bench.peer.intervals_us


def test_after_a_failsafe_a_pilots_switch_ends_what_is_being_asked_for_too(bench):
    """The battery's leaves the system status critical for the rest of the flight."""
    bench.peer.custom_mode, bench.peer.system_status = COPTER_GUIDED, 5
    bench.run(0.3)
    bench.peer.deaf, bench.peer.refuse = {SET_MODE}, {SET_MODE: 4}
    request = bench.autopilot.land()
    bench.wait(lambda: bench.peer.commands(SET_MODE))
    bench.peer.custom_mode = COPTER_LOITER
    assert "somebody else chose the mode manual" in bench.finish(request)
    assert len(bench.peer.commands(SET_MODE)) == 1


def test_a_failsafe_shows_in_the_system_status_and_a_pilot_does_not(bench):
    bench.peer.custom_mode, bench.peer.system_status = COPTER_LAND, 5
    bench.run(0.3)
    assert bench.autopilot.state().failsafe
    bench.peer.custom_mode, bench.peer.system_status = COPTER_LOITER, 4
    bench.run(0.3)
    assert not bench.autopilot.state().failsafe
