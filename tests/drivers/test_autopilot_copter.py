"""The autopilot link to an ArduCopter, over real MAVLink."""

import time

import pytest
from autopilot_links import estimate, has_origin, link
from link_peer import (
    COPTER_BRAKE,
    COPTER_GUIDED,
    COPTER_LAND,
    HIGHRES_IMU,
    RAW_IMU,
    Peer,
    free_port,
    wait_for,
)
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.drivers.autopilot import MavsdkAutopilot
from vwnav.types import FlightMode


@pytest.fixture(scope="module")
def copter():
    yield from link(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)


def test_estimates_before_an_origin_are_a_mistake(copter):
    _, autopilot = copter
    with pytest.raises(ValueError, match="set_origin"):
        autopilot.send_estimate(estimate())


def test_copter_waits_for_the_position_that_guided_needs(copter):
    peer, autopilot = copter
    peer.flags = 0x025
    wait_for(lambda: peer.commands(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL))
    time.sleep(0.5)
    assert not autopilot.state().armable
    assert autopilot.arm().startswith("not ready")
    peer.flags = 0x33F
    wait_for(lambda: autopilot.state().armable and autopilot.state().local_position_ok)


def test_copter_flies_in_guided_and_holds_by_brake(copter):
    peer, autopilot = copter
    peer.flags = 0x33F
    wait_for(lambda: autopilot.state().armable)
    assert autopilot.arm() is None
    assert peer.custom_mode == COPTER_GUIDED
    assert peer.armed
    assert autopilot.takeoff(7.0) is None
    assert peer.commands(mavlink.MAV_CMD_NAV_TAKEOFF)[-1].param7 == 7.0
    assert autopilot.hold() is None
    assert peer.custom_mode == COPTER_BRAKE
    assert autopilot.land() is None
    assert peer.custom_mode == COPTER_LAND
    assert autopilot.state().mode is FlightMode.LAND


def test_copter_gets_velocity_beside_position(copter):
    peer, autopilot = copter
    has_origin(peer, autopilot)
    autopilot.send_estimate(estimate())
    message = wait_for(lambda: peer.of("VISION_SPEED_ESTIMATE"))[-1]
    assert (message.x, message.y, message.z) == (4.0, 5.0, -6.0)
    assert [message.covariance[i] for i in (0, 4, 8)] == [4.0, 5.0, 6.0]


def test_copter_parameters_are_checked(copter):
    peer, autopilot = copter
    for name, value in {"VISO_TYPE": 0.0, "EK3_SRC1_POSXY": 6.0, "GPS1_TYPE": 0.0}.items():
        peer.params[name] = (value, mavlink.MAV_PARAM_TYPE_INT8)
    findings = {f.parameter: f for f in autopilot.preflight()}
    assert findings["VISO_TYPE"].severity == "fail"
    assert findings["VISO_TYPE"].present == 0.0
    assert "EK3_SRC1_POSXY" not in findings
    assert "GPS1_TYPE" not in findings


def test_a_copter_without_highres_imu_is_asked_for_its_raw_one():
    port = free_port()
    with Peer(port, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA) as peer:
        peer.unknown = {HIGHRES_IMU}
        autopilot = MavsdkAutopilot(f"udpin://127.0.0.1:{port}", timeout_s=10.0)
        try:
            sample = wait_for(autopilot.take_imu)[0]
        finally:
            autopilot.close()
    assert peer.streamed & {HIGHRES_IMU, RAW_IMU} == {RAW_IMU}
    assert sample.specific_force_m_s2 == pytest.approx([0.0, 0.0, -9.80665])
    assert sample.rates_rad_s == pytest.approx([0.0, 0.0, 0.1])
