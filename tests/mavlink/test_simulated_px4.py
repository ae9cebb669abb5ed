"""The whole link as in flight: simulated PX4, watchdog process, MAVSDK."""

import time

import numpy as np
import pytest
from autopilot_links import stepped
from link_peer import free_port, wait_for

from vwnav.geometry.rotations import rotation_from_quat
from vwnav.mavlink.mavsdk_autopilot import MavsdkAutopilot, wait_for_findings
from vwnav.mavlink.modes import AutopilotKind
from vwnav.sim.truth import TruthReader
from vwnav.sim.vehicle import VehicleConfig, start_vehicle
from vwnav.types import Estimate
from vwnav.vehicle import FlightMode
from vwnav.watchdog.launch import start_watchdog


@pytest.fixture(scope="module")
def link():
    port = free_port()
    companion = f"udpout:127.0.0.1:{port}"
    config = VehicleConfig(companion_url=companion, ground_url="", truth_url="", system_id=5)
    with start_vehicle(config), start_watchdog(f"udpin://127.0.0.1:{port}") as watchdog:
        autopilot = MavsdkAutopilot(watchdog.navigator_url)
        with stepped(autopilot):
            yield autopilot, watchdog
        autopilot.close()


@pytest.fixture(scope="module")
def px4(link):
    return link[0]


def test_it_is_a_px4_on_the_ground_with_attitude_and_height(px4):
    assert px4.kind is AutopilotKind.PX4
    wait_for(lambda: px4.state().height_m is not None and px4.state().attitude is not None)
    state = px4.state()
    assert rotation_from_quat(state.attitude.quat_wxyz)[2, 2] > 0.99
    assert state.height_m == pytest.approx(0.0, abs=1.0)
    assert (state.armed, state.in_air, state.mode) == (False, False, FlightMode.HOLD)


def test_its_parameters_can_be_read(px4):
    assert all(finding.present is not None for finding in wait_for_findings(px4))


def test_it_has_a_position_only_once_it_gets_estimates(px4):
    assert not px4.state().local_position_ok
    assert px4.arm().refused is not None
    px4.set_origin(41.1, 29.0, 40.0)
    level = np.array([1.0, 0.0, 0.0, 0.0])
    until_s = time.monotonic() + 15.0
    while not px4.state().local_position_ok and time.monotonic() < until_s:
        now_s = time.monotonic()
        still = np.zeros(3)
        px4.send_estimate(
            Estimate(now_s, still, still, np.eye(6) * 0.2, level, 0.1, 0.1, 0.1, None, 0)
        )
        time.sleep(0.03)
    assert px4.state().local_position_ok
    assert px4.state().aiding


def test_truth_on_the_same_link_is_read_through_the_watchdog(link):
    _, watchdog = link
    reader = TruthReader(watchdog.observer_url)
    first = reader.wait(10.0)
    wait_for(lambda: len(reader._states) > 100)
    reader.close()
    assert abs(first.lat_deg) > 1.0
    assert watchdog.process.poll() is None
