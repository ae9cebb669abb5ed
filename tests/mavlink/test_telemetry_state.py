"""Recorded autopilots, message by message, through the state that the flight loop reads."""

import gzip
import struct
from functools import cache

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as mavlink

from vwnav.mavlink.framing import packet_at
from vwnav.mavlink.modes import AutopilotKind
from vwnav.mavlink.telemetry.telemetry_state import TelemetryState
from vwnav.safety.conditions import PilotWatch
from vwnav.safety.safety_config import SafetyConfig
from vwnav.types import Attitude, ImuSample, Range
from vwnav.vehicle import FlightMode, VehicleState

MAV = mavlink.MAVLink(None)
UNDERSTOOD = {
    number
    for number, kind in mavlink.mavlink_map.items()
    if kind.msgname in TelemetryState().messages
}


def messages(path):
    """(seconds since the start, message) of what the autopilot said in a recording."""
    data, at, start_s = gzip.decompress(path.read_bytes()), 0, None
    while at + 8 < len(data):
        t_s = struct.unpack_from(">Q", data, at)[0] / 1e6
        packet = packet_at(data, at + 8)
        at += 8 + len(packet.data)
        start_s = t_s if start_s is None else start_s
        if packet.component_id == 1 and packet.message_id in UNDERSTOOD:
            yield t_s - start_s, MAV.decode(bytearray(packet.data))


@cache
def replay(path) -> list[tuple[float, VehicleState, bool | None]]:
    """States ten times a second; NaN comes as None, as MAVSDK hands it over."""
    telemetry, states, next_s = TelemetryState(), [], 0.0
    for t_s, message in messages(path):
        values = {name: getattr(message, name) for name in message.fieldnames}
        fields = {name: None if value != value else value for name, value in values.items()}
        telemetry.handle(message.get_type(), fields, t_s)
        if t_s >= next_s and telemetry.kind is not None:
            states.append((t_s, telemetry.state(t_s), telemetry.aiding(t_s)))
            next_s = t_s + 0.1
    return states


def imu_of(path, without: str = ""):
    """All samples of a recording, taken every half second."""
    telemetry, samples, next_s = TelemetryState(), [], 0.0
    for t_s, message in messages(path):
        if message.get_type() == without:
            continue
        values = {name: getattr(message, name) for name in message.fieldnames}
        fields = {name: None if value != value else value for name, value in values.items()}
        telemetry.handle(message.get_type(), fields, t_s)
        if t_s >= next_s:
            taken = telemetry.take_measurements()
            samples += [each for each in taken if isinstance(each, ImuSample)]
            next_s = t_s + 0.5
    return samples


def modes(states) -> list[FlightMode]:
    seen = [state.mode for _, state, _ in states]
    return [mode for i, mode in enumerate(seen) if i == 0 or mode is not seen[i - 1]]


@pytest.fixture(scope="module")
def vision_flight(data_folder):
    return replay(data_folder / "mavlink/px4-1.18_vpe_nogps_from_boot.tlog.gz")


@pytest.fixture(scope="module")
def copter_flight(data_folder):
    return replay(data_folder / "mavlink/arducopter-4.7dev_extnav_nogps.tlog.gz")


def at(states, t_s: float):
    return next((state, aiding) for t, state, aiding in states if t >= t_s)


def test_px4_modes_are_named_descend_included(vision_flight):
    assert modes(vision_flight) == [
        FlightMode.HOLD,
        FlightMode.TAKEOFF,
        FlightMode.HOLD,
        FlightMode.OFFBOARD,
        FlightMode.DESCEND,
        FlightMode.OFFBOARD,
        FlightMode.LAND,
        FlightMode.OFFBOARD,
    ]


def test_copter_modes_are_named(copter_flight):
    wanted = [FlightMode.MANUAL, FlightMode.OFFBOARD, FlightMode.LAND]
    assert modes(copter_flight) == [*wanted, FlightMode.OFFBOARD, FlightMode.LAND]


def test_readiness_flickers_as_recorded_and_position_follows_vision(vision_flight):
    assert not at(vision_flight, 5.0)[0].local_position_ok
    assert at(vision_flight, 13.5)[0].armable
    assert not at(vision_flight, 18.0)[0].armable
    state = at(vision_flight, 23.0)[0]
    assert state.armable
    assert state.local_position_ok


def test_the_loss_of_vision_shows_in_aiding_before_the_position_goes(vision_flight):
    assert at(vision_flight, 58.0)[1] is True  # vision stops at 59.8 s
    state, aiding = at(vision_flight, 61.0)
    assert aiding is False
    assert state.local_position_ok
    assert state.mode is FlightMode.OFFBOARD
    assert not at(vision_flight, 65.0)[0].local_position_ok


def test_height_comes_from_pressure_and_agrees_with_the_rangefinder(vision_flight):
    for t_s in (35.0, 45.0, 55.0):
        state = at(vision_flight, t_s)[0]
        assert state.height_m == pytest.approx(state.rangefinder_m, abs=1.0)
        assert 0.0 <= state.t_s - state.height_t_s < 0.6


def test_arming_flight_and_battery_are_told(vision_flight):
    ground, air, end = (at(vision_flight, t_s)[0] for t_s in (10.0, 40.0, 94.0))
    assert (ground.armed, ground.in_air) == (False, False)
    assert (air.armed, air.in_air) == (True, True)
    assert (end.armed, end.in_air) == (False, False)
    assert air.battery_ratio == pytest.approx(0.75, abs=0.02)
    assert not air.rc_available


def test_copter_is_ready_only_with_flag_0x10(copter_flight):
    first = next(t_s for t_s, state, _ in copter_flight if state.armable)
    assert first == pytest.approx(26.7, abs=0.5)
    assert at(copter_flight, 60.0)[0].local_position_ok
    assert not at(copter_flight, 73.5)[0].local_position_ok
    assert at(copter_flight, 60.0)[0].rc_available


def test_why_a_copter_cannot_be_armed_is_kept_for_whoever_waits(data_folder):
    states = replay(data_folder / "mavlink/arducopter-4.7dev_setpoint_loss.tlog.gz")
    told = {text for _, state, _ in states if not state.armed for text in state.complaints}
    assert any(text.startswith(("PreArm:", "Arm:")) for text in told), told


@pytest.mark.parametrize("name", ["px4-1.18_nominal", "arducopter-4.7dev_extnav_nogps"])
def test_the_imu_is_heard_in_order_and_feels_gravity_at_rest(data_folder, name):
    samples = imu_of(data_folder / f"mavlink/{name}.tlog.gz")
    times_s = np.array([sample.t_s for sample in samples])
    assert np.all(np.diff(times_s) > 0.0)
    assert np.median(np.diff(times_s)) < 0.045
    at_rest = np.median([sample.specific_force_m_s2 for sample in samples[:50]], axis=0)
    assert at_rest == pytest.approx([0.0, 0.0, -9.81], abs=0.05)
    assert max(abs(sample.rates_rad_s).max() for sample in samples) > 0.3


def test_arducopters_raw_imu_says_the_same_as_its_highres_one(data_folder):
    path = data_folder / "mavlink/arducopter-4.7dev_extnav_nogps.tlog.gz"
    fine, raw = imu_of(path), imu_of(path, without="HIGHRES_IMU")
    times_s = np.array([sample.t_s for sample in fine])
    forces = np.array([sample.specific_force_m_s2 for sample in fine])
    assert len(raw) > 500
    for sample in raw[::20]:
        nearest = int(np.argmin(np.abs(times_s - sample.t_s)))
        assert sample.specific_force_m_s2 == pytest.approx(forces[nearest], abs=0.3)


def test_px4_1_16_pressure_in_pascal_is_a_height_too(data_folder):
    states = replay(data_folder / "mavlink/px4-1.16dev_vpe_gps_lost.tlog.gz")
    assert max(state.height_m or 0.0 for _, state, _ in states) == pytest.approx(10.5, abs=0.5)


def test_a_late_origin_is_no_position(data_folder):
    states = replay(data_folder / "mavlink/px4-1.18_late_origin.tlog.gz")
    assert not at(states, 20.0)[0].local_position_ok


def test_a_pilots_takeover_is_seen_in_the_first_heartbeat(data_folder):
    for name in ("px4-1.16dev_pilot_sticks", "px4-1.18_pilot_rcswitch"):
        states = replay(data_folder / f"mavlink/{name}.tlog.gz")
        assert FlightMode.MANUAL in modes(states)
        assert any(state.rc_available for _, state, _ in states)


def test_flights_of_every_kind_are_taken_in_whole(data_folder):
    for name in ("px4-1.18_battery", "px4-1.16dev_offboard_loss", "arducopter-4.7dev_battery"):
        states = replay(data_folder / f"mavlink/{name}.tlog.gz")
        assert len(states) > 100
        assert states[-1][1].attitude is not None
        assert all(state.mode is not FlightMode.UNKNOWN for _, state, _ in states)


PX4_CHOICES = [
    ("px4-1.18_link_loss", 41.0, FlightMode.HOLD, FlightMode.OFFBOARD),  # no ground station
    ("px4-1.18_link_loss", 48.0, FlightMode.RETURN, FlightMode.OFFBOARD),
    ("px4-1.18_link_loss", 52.0, FlightMode.OFFBOARD, FlightMode.OFFBOARD),
    ("px4-1.18_vpe_gps_lost", 69.0, FlightMode.DESCEND, FlightMode.OFFBOARD),  # no position
    ("px4-1.18_vpe_gps_lost", 76.0, FlightMode.OFFBOARD, FlightMode.OFFBOARD),
    ("px4-1.18_vpe_gps_lost", 83.0, FlightMode.LAND, FlightMode.LAND),  # commanded
    ("px4-1.18_battery", 63.0, FlightMode.HOLD, FlightMode.OFFBOARD),
    ("px4-1.18_battery", 77.0, FlightMode.LAND, FlightMode.OFFBOARD),
    ("px4-1.18_pilot_sticks", 30.5, FlightMode.MANUAL, FlightMode.MANUAL),
    ("px4-1.16dev_pilot_sticks", 30.5, FlightMode.MANUAL, FlightMode.MANUAL),
    ("px4-1.16dev_offboard_loss", 40.0, FlightMode.MANUAL, FlightMode.OFFBOARD),  # no setpoints
    ("px4-1.16dev_vpe_gps_lost", 70.0, FlightMode.MANUAL, FlightMode.OFFBOARD),  # no position
]


@pytest.mark.parametrize(("name", "t_s", "flown", "asked"), PX4_CHOICES)
def test_px4_says_whether_a_failsafe_or_a_person_chose_the_mode(
    data_folder, name, t_s, flown, asked
):
    state = at(replay(data_folder / f"mavlink/{name}.tlog.gz"), t_s)[0]
    assert (state.mode, state.intended_mode) == (flown, asked)
    assert state.failsafe == state.is_fallback == (flown is not asked)
    assert state.tells_intent


COPTER_CHOICES = [
    ("link_loss", 32.0, FlightMode.OFFBOARD, False),
    ("link_loss", 35.0, FlightMode.RETURN, True),  # no ground station
    ("link_loss", 43.0, FlightMode.RETURN, False),  # it is back, the mode stays
    ("extnav_nogps", 74.0, FlightMode.LAND, True),  # EKF
    ("extnav_nogps", 80.0, FlightMode.LAND, False),
]


@pytest.mark.parametrize(("name", "t_s", "mode", "failsafe"), COPTER_CHOICES)
def test_copter_says_so_while_a_failsafe_flies(data_folder, name, t_s, mode, failsafe):
    state = at(replay(data_folder / f"mavlink/arducopter-4.7dev_{name}.tlog.gz"), t_s)[0]
    assert (state.mode, state.failsafe) == (mode, failsafe)


def test_copters_battery_failsafe_shows_and_a_pilots_switch_does_not(data_folder):
    def failsafes(name):
        states = replay(data_folder / f"mavlink/arducopter-4.7dev_{name}.tlog.gz")
        return {(state.mode, state.failsafe) for _, state, _ in states if state.in_air}

    assert (FlightMode.RETURN, True) in failsafes("battery")
    assert not any(failsafe for _, failsafe in failsafes("pilot_rcswitch"))


def test_no_recorded_takeover_by_a_person_ever_looks_like_a_failsafe(data_folder):
    """Not even for the moment in which the mode has changed and PX4 has not said who asked."""
    for name in ("px4-1.16dev_pilot_sticks", "px4-1.18_pilot_sticks", "px4-1.18_pilot_rcswitch"):
        for _, state, _ in replay(data_folder / f"mavlink/{name}.tlog.gz"):
            assert not (state.failsafe and state.mode is FlightMode.MANUAL)


def test_no_recorded_failsafe_ever_looks_like_a_person(data_folder):
    for name in ("px4-1.18_link_loss", "px4-1.18_vpe_gps_lost", "px4-1.18_offboard_loss"):
        for _, state, _ in replay(data_folder / f"mavlink/{name}.tlog.gz"):
            own = state.mode in (FlightMode.DESCEND, FlightMode.RETURN)
            assert not own or state.intended_mode in (FlightMode.UNKNOWN, FlightMode.OFFBOARD)


@pytest.mark.parametrize(
    ("name", "since_s", "until_s"),
    [("px4-1.16dev_vpe_gps_lost", 66.0, 76.0), ("px4-1.16dev_offboard_loss", 36.0, 45.0)],
)
def test_no_recorded_fallback_to_sticks_looks_like_a_pilot(data_folder, name, since_s, until_s):
    """HEARTBEAT is told of it 1 s before CURRENT_MODE there: both come as rarely as unasked."""
    watch, failsafes = PilotWatch(SafetyConfig(unknown_mode_s=2.0)), set()
    for t_s, state, _ in replay(data_folder / f"mavlink/{name}.tlog.gz"):
        if since_s < t_s < until_s:
            watch.step(state.mode, False, t_s, state.intended_mode)
            failsafes.add(watch.failsafe)
    assert watch.released is None
    assert failsafes == {None, FlightMode.MANUAL}


HOLD, OFFBOARD = (4 << 16) | (3 << 24), 6 << 16


def in_failsafe_hold(until_s: float) -> TelemetryState:
    """Told ten times a second, by both."""
    telemetry = TelemetryState()
    for i in range(round(10 * until_s)):
        beat = {"autopilot": 12, "base_mode": 128, "custom_mode": HOLD, "system_status": 4}
        telemetry.handle("HEARTBEAT", beat, 0.1 * i)
        asked = {"custom_mode": HOLD, "intended_custom_mode": OFFBOARD}
        telemetry.handle("CURRENT_MODE", asked, 0.1 * i)
    return telemetry


def test_whose_mode_it_is_holds_for_no_longer_than_it_is_told():
    """A person may choose the mode to which it had fallen back: CURRENT_MODE alone changes."""
    telemetry, told = in_failsafe_hold(5.0), []
    for i in range(50, 100):
        beat = {"autopilot": 12, "base_mode": 128, "custom_mode": HOLD, "system_status": 4}
        telemetry.handle("HEARTBEAT", beat, 0.1 * i)
        told.append(telemetry.state(0.1 * i).is_fallback)
    assert told[:40] == [True] * 40  # unasked it comes every two seconds
    assert not any(told[46:])


@pytest.mark.parametrize(("autopilot", "tells"), [(12, False), (3, True)])
def test_a_px4_that_tells_its_mode_alone_does_not_say_who_chose_it(autopilot, tells):
    """Before 1.15; ArduPilot says of itself that it flies a failsafe."""
    telemetry = TelemetryState()
    beat = {"autopilot": autopilot, "base_mode": 0, "custom_mode": HOLD, "system_status": 3}
    telemetry.handle("HEARTBEAT", beat, 1.0)
    assert telemetry.state(1.0).tells_intent is tells


def test_after_a_cut_it_is_not_known_whose_mode_it_is_until_it_is_told():
    telemetry = in_failsafe_hold(5.0)
    assert telemetry.state(12.0).is_fallback
    beat = {"autopilot": 12, "base_mode": 128, "custom_mode": HOLD, "system_status": 4}
    telemetry.handle("HEARTBEAT", beat, 12.0)
    assert telemetry.state(12.0).intended_mode is FlightMode.UNKNOWN
    asked = {"custom_mode": HOLD, "intended_custom_mode": OFFBOARD}
    telemetry.handle("CURRENT_MODE", asked, 12.1)
    assert telemetry.state(12.1).is_fallback


def test_another_component_with_the_autopilots_id_changes_nothing():
    telemetry = TelemetryState()
    beat = {"autopilot": 12, "base_mode": 128, "custom_mode": 6 << 16, "system_status": 4}
    telemetry.handle("HEARTBEAT", beat, 1.0)
    other = {"autopilot": 8, "base_mode": 0, "custom_mode": 0, "system_status": 0}
    telemetry.handle("HEARTBEAT", other, 1.1)
    state = telemetry.state(1.2)
    assert telemetry.kind is AutopilotKind.PX4
    assert state.armed
    assert state.mode is FlightMode.OFFBOARD


def beat(telemetry: TelemetryState, custom_mode: int, t_s: float) -> None:
    fields = {"autopilot": 12, "base_mode": 129, "custom_mode": custom_mode, "system_status": 4}
    telemetry.handle("HEARTBEAT", fields, t_s)


def test_an_accepted_mode_is_believed_until_another_one_is_told_anew():
    """Once a second, and a second and a half late from a busy machine."""
    hold, offboard = 4 << 16 | 3 << 24, 6 << 16
    telemetry = TelemetryState()
    beat(telemetry, hold, 10.0)
    telemetry.modes.expect(FlightMode.OFFBOARD, 10.5)
    beat(telemetry, hold, 10.6)  # was on its way
    assert telemetry.state(12.0).mode is FlightMode.OFFBOARD
    beat(telemetry, offboard, 12.1)
    assert telemetry.state(12.2).mode is FlightMode.OFFBOARD
    telemetry.modes.expect(FlightMode.LAND, 12.3)
    beat(telemetry, offboard, 13.1)
    assert telemetry.state(13.2).mode is FlightMode.OFFBOARD


def test_an_accepted_mode_is_believed_through_a_cut_of_the_link():
    """The mode of before, which nobody had told again, was a pilot's choice after 3 s."""
    manual, offboard = 3 << 16, 6 << 16
    telemetry = TelemetryState()
    beat(telemetry, manual, 10.0)
    telemetry.modes.expect(FlightMode.OFFBOARD, 10.5)
    assert telemetry.state(20.0).mode is FlightMode.OFFBOARD
    beat(telemetry, manual, 20.1)
    assert telemetry.state(20.1).mode is FlightMode.MANUAL
    telemetry.modes.expect(FlightMode.OFFBOARD, 20.5)
    beat(telemetry, offboard, 20.6)
    beat(telemetry, manual, 20.7)
    assert telemetry.state(20.7).mode is FlightMode.MANUAL


def test_a_range_is_dated_by_its_own_stamp_however_late_it_comes():
    telemetry = TelemetryState()
    beat(telemetry, 0, 100.0)
    names = ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")
    for i in range(50):
        attitude = dict.fromkeys(names, 0.0) | {"time_boot_ms": 20 * i}
        telemetry.handle("ATTITUDE", attitude, 100.0 + 0.02 * i)
    fields = {"time_boot_ms": 700, "min_distance": 0, "max_distance": 10000, "orientation": 25}
    for centimetres in (10000, 1200, 1300):  # farther than it can see; the same message once more
        telemetry.handle("DISTANCE_SENSOR", fields | {"current_distance": centimetres}, 101.0)
    ranges = [each for each in telemetry.take_measurements() if isinstance(each, Range)]
    assert [each.distance_m for each in ranges] == [12.0]
    assert ranges[0].t_s == pytest.approx(100.7, abs=0.01)


@pytest.mark.parametrize("up_for_s", [4294967.296 - 1.0, 5e6, 9e6, 100.0])
def test_an_autopilot_that_has_run_for_weeks_is_dated_by_both_of_its_counts(up_for_s):
    """One that waits in its dock: milliseconds, in 32 bits, have begun again."""
    telemetry = TelemetryState()
    beat(telemetry, 0, 100.0)
    names = ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")
    felt = dict.fromkeys(("xacc", "yacc", "xgyro", "ygyro", "zgyro", "abs_pressure"), 0.0)
    for i in range(150):
        now_s, boot_s = 100.0 + 0.02 * i, up_for_s + 0.02 * i
        stamp = {"time_boot_ms": round(1e3 * boot_s) % 2**32}
        telemetry.handle("ATTITUDE", dict.fromkeys(names, 0.0) | stamp, now_s)
        stamp = {"time_usec": round(1e6 * boot_s)}
        telemetry.handle("HIGHRES_IMU", felt | stamp | {"zacc": -9.8}, now_s)
    taken = telemetry.take_measurements()
    expected_s = [100.0 + 0.02 * i for i in range(150)]
    for kind in (Attitude, ImuSample):
        dated_s = [each.t_s for each in taken if isinstance(each, kind)]
        assert dated_s == pytest.approx(expected_s, abs=0.002)
    assert telemetry.clock.restarts == 0
