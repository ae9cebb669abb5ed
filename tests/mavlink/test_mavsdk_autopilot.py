"""The same driver over real MAVLink: MAVSDK on one side, a pymavlink peer on the other."""

import math
import os
import subprocess
import sys
import time

import numpy as np
import pytest
from autopilot_links import HOME, stepped
from link_peer import PX4_OFFBOARD, Peer, free_port, wait_for
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.errors import LinkError
from vwnav.mavlink.mavsdk_autopilot import MavsdkAutopilot
from vwnav.mavlink.modes import AutopilotKind
from vwnav.types import Attitude, Estimate, ImuSample
from vwnav.vehicle import FlightMode, Order


@pytest.fixture(scope="module")
def px4():
    port = free_port()
    with Peer(port) as peer:
        url = f"udpin://127.0.0.1:{port}"
        autopilot = MavsdkAutopilot(url, timeout_s=10.0, ground_station_ids=(255,))
        with stepped(autopilot):
            yield peer, autopilot
        start_s = time.monotonic()
        autopilot.close()
        assert time.monotonic() - start_s < 2.0


def finish(request):
    wait_for(lambda: request.done)
    return request.refused


def test_no_autopilot_is_one_clear_line():
    with pytest.raises(LinkError, match="no autopilot on udpin") as error:
        MavsdkAutopilot(f"udpin://127.0.0.1:{free_port()}", timeout_s=0.5)
    assert "\n" not in str(error.value)


def test_a_wrong_url_is_one_clear_line():
    with pytest.raises(LinkError, match="is no connection: give"):
        MavsdkAutopilot("carrier-pigeon://127.0.0.1", timeout_s=0.5)


def test_an_unknown_firmware_is_refused():
    port = free_port()
    with (
        Peer(port, mavlink.MAV_AUTOPILOT_GENERIC),
        pytest.raises(LinkError, match="neither PX4 nor ArduPilot"),
    ):
        MavsdkAutopilot(f"udpin://127.0.0.1:{port}", timeout_s=10.0)


@pytest.mark.parametrize("missing", ["", "no/such/folder"])
def test_a_temporary_folder_that_is_none_does_not_end_the_process(missing, tmp_path):
    port = free_port()
    with Peer(port):
        program = (
            "from vwnav.mavlink.mavsdk_autopilot import MavsdkAutopilot\n"
            f"MavsdkAutopilot('udpin://127.0.0.1:{port}', timeout_s=10.0).close()"
        )
        folder = missing and str(tmp_path / missing)
        done = subprocess.run([sys.executable, "-c", program], env=os.environ | {"TMPDIR": folder})
    assert done.returncode == 0


@pytest.mark.parametrize("wanted", [7, 9])
def test_of_two_on_the_link_the_one_that_is_wanted_is_followed(wanted):
    port = free_port()
    with Peer(port) as one, Peer(port, system_id=9) as other:
        autopilot = MavsdkAutopilot(f"udpin://127.0.0.1:{port}", system_id=wanted)
        followed = autopilot.system_id()
        # Who hears us has been heard: on such a link nobody else's address is known.
        wait_for(lambda: one.of("HEARTBEAT") and other.of("HEARTBEAT"))
        refused = autopilot.link_refusal
        autopilot.close()
    assert followed == wanted
    assert "autopilots" not in (refused or "")


def test_with_two_on_the_link_none_is_armed_that_may_be_the_other():
    port = free_port()
    with Peer(port):
        autopilot = MavsdkAutopilot(f"udpin://127.0.0.1:{port}", timeout_s=10.0)
        assert autopilot.link_refusal is None
        with Peer(port, system_id=9):
            wait_for(lambda: autopilot.link_refusal is not None)
        refused = autopilot.link_refusal
        wait_for(lambda: autopilot.link_refusal is None)  # it was switched off
        autopilot.close()
    assert refused == (
        "autopilots of systems 7 and 9 are on it: say which in [flight] autopilot_id"
    )


def test_one_that_is_wanted_and_not_there_is_not_replaced_by_another():
    port = free_port()
    with Peer(port), pytest.raises(LinkError, match=r"no autopilot of system 9 .* of 7:"):
        MavsdkAutopilot(f"udpin://127.0.0.1:{port}", timeout_s=2.0, system_id=9)


def test_telemetry_and_measurements_arrive_on_our_clock(px4):
    _, autopilot = px4
    assert autopilot.kind is AutopilotKind.PX4
    wait_for(lambda: autopilot.state().height_t_s and autopilot.state().armable)
    assert autopilot.state().battery_ratio == 0.87
    taken = []
    wait_for(
        lambda: (
            taken.extend(autopilot.take_measurements())
            or {Attitude, ImuSample} <= {type(each) for each in taken}
        )
    )
    newest = [each for each in taken if isinstance(each, Attitude)][-1]
    assert newest.t_s == pytest.approx(time.monotonic(), abs=0.5)


def test_the_clock_is_joined_within_5_ms(px4):
    peer, autopilot = px4
    wait_for(lambda: autopilot._telemetry.clock.round_trip_s is not None)
    time.sleep(1.0)
    joined_s = autopilot._telemetry.clock.to_monotonic(peer.boot_s())
    assert joined_s == pytest.approx(time.monotonic(), abs=0.005)


def test_another_aircraft_on_the_link_is_not_listened_to(px4):
    peer, autopilot = px4
    wait_for(lambda: autopilot.state().mode is FlightMode.HOLD)
    other = mavlink.MAVLink(None, srcSystem=9, srcComponent=1)
    beat = mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, 129, 3 << 16, 4, 3)
    for _ in range(20):
        peer.socket.sendto(bytes(beat.pack(other)), peer.to)
        time.sleep(0.01)
        assert not autopilot.state().armed
    assert autopilot.state().mode is FlightMode.HOLD


def test_a_flight_arms_takes_off_and_takes_control(px4):
    peer, autopilot = px4
    peer.params["MIS_TAKEOFF_ALT"] = (2.5, mavlink.MAV_PARAM_TYPE_REAL32)
    autopilot.set_origin(*HOME)
    assert finish(autopilot.arm()) is None
    assert finish(autopilot.takeoff(8.0)) is None
    assert finish(autopilot.start_offboard()) is None
    assert peer.custom_mode == PX4_OFFBOARD
    wait_for(lambda: autopilot.state().mode is FlightMode.OFFBOARD)
    wait_for(lambda: peer.params["MIS_TAKEOFF_ALT"][0] == 2.5)
    targets = {m.get_type(): m.target_system for _, m in peer.heard if hasattr(m, "target_system")}
    assert {"COMMAND_LONG", "SET_GPS_GLOBAL_ORIGIN", "PARAM_REQUEST_READ"} <= set(targets)
    ours = {kind: system for kind, system in targets.items() if kind not in ("TIMESYNC", "PING")}
    assert set(ours.values()) == {7}, ours


def test_a_velocity_leaves_with_a_place_that_is_unsure(px4):
    peer, autopilot = px4
    autopilot.set_origin(*HOME)

    def send() -> list:
        estimate = Estimate(
            time.monotonic(), np.array([10.0, -20.0, -30.0]), np.array([4.0, 5.0, -6.0]),
            np.diag([1600.0, 400.0, 1.0, 0.25, 0.5, 0.1]), np.array([1.0, 0.0, 0.0, 0.0]),
            0.1, 30.0, 1.0, 1.0, 258,
        )  # fmt: skip
        autopilot.send_estimate(estimate)
        return peer.of("ODOMETRY")

    told = wait_for(send)[-1]
    assert (told.frame_id, told.child_frame_id, told.estimator_type, told.quality) == (1, 1, 2, 0)
    assert (told.vx, told.vy, told.vz, told.reset_counter) == (4.0, 5.0, -6.0, 2)
    assert [told.pose_covariance[i] for i in (0, 6)] == [1600.0, 400.0]
    assert [told.velocity_covariance[i] for i in (0, 6)] == [0.25, 0.5]
    assert math.isnan(told.rollspeed)


def test_a_link_that_falls_silent_is_not_connected(px4):
    peer, autopilot = px4
    peer.speaks = False
    wait_for(lambda: not autopilot.state().connected, 4.0)
    assert autopilot.arm().refused == "the autopilot is not heard"
    peer.speaks = True
    wait_for(lambda: autopilot.state().connected)


def test_texts_leave_and_a_ground_station_on_the_link_is_heard_and_obeyed(px4):
    peer, autopilot = px4
    autopilot.send_text("battery low: the way home")
    wait_for(
        lambda: any(each.text == "battery low: the way home" for each in peer.of("STATUSTEXT"))
    )
    own_system, own_component = autopilot._port.own_id
    station = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    command = mavlink.MAVLink_command_long_message(own_system, own_component, 193, *[0] * 8)
    beat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)

    def hears(message, what):
        peer.socket.sendto(bytes(message.pack(station)), peer.to)
        time.sleep(0.05)
        return what()

    wait_for(lambda: hears(beat, lambda: autopilot.state().ground_station))
    wait_for(lambda: hears(command, lambda: Order.PAUSE in autopilot.take_orders()[0]))
    wait_for(lambda: any(each.command == 193 for each in peer.of("COMMAND_ACK")))
