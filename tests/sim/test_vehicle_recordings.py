"""Conformance of the simulated vehicle with recordings of the real PX4 1.18."""

import math
import struct
from collections import Counter
from typing import Any

import numpy as np
import pytest
from px4_bench import Bench
from pymavlink.dialects.v20 import development as mavlink
from test_vehicle_session import Talk
from tlogs import RECORDS, needs, packets, recorded

from vwnav.sim.mavlink.command import Result
from vwnav.sim.px4 import estimate_messages, messages
from vwnav.sim.px4.modes import NavState
from vwnav.sim.px4.streams import COMPANION_RATES
from vwnav.vehicle import FlightMode

NOMINAL, VISION = "px4-1.18_nominal", "px4-1.18_vpe_nogps_from_boot"
pytestmark = needs(NOMINAL)
# What the simulated vehicle leaves out: nothing in it feeds a navigator.
LEFT_OUT = {
    "OPEN_DRONE_ID_LOCATION",
    "OPEN_DRONE_ID_SYSTEM",
    "GNSS_INTEGRITY",
    "POSITION_TARGET_GLOBAL_INT",
    "COMMAND_LONG",  # to gimbals and grippers
    "UNKNOWN_8",  # LINK_NODE_STATUS
    "UNKNOWN_290",  # ESC_INFO
    "UNKNOWN_291",  # ESC_STATUS
    "UNKNOWN_380",  # TIME_ESTIMATE_TO_TARGET
    "UNKNOWN_410",  # EVENT
    "UNKNOWN_411",  # CURRENT_EVENT_SEQUENCE
    "UNKNOWN_514",  # ESTIMATOR_SENSOR_FUSION_STATUS
}
ON_REQUEST = {"DISTANCE_SENSOR", "GPS_RAW_INT", "HIL_STATE_QUATERNION"}


def kind_of(number: int) -> str:
    known = mavlink.mavlink_map.get(number)
    return f"UNKNOWN_{number}" if known is None else str(known.msgname)


@pytest.fixture(scope="module")
def sent() -> Counter[str]:
    """How often each message is sent in 20 s of standing with a position."""
    talk = Talk()
    talk.run(1.0)
    talk.vehicle.estimator.set_origin(41.1, 29.0, 40.0)
    bench = Bench()
    bench.vehicle, bench.vision = talk.vehicle, True
    bench.run(3.0)
    counter: Counter[str] = Counter()
    for _ in range(600):
        bench.see()
        counter.update(message.get_type() for message in talk.run(20.0 / 600))
    return counter


def test_default_rates_are_the_recorded_ones(sent: Counter[str]) -> None:
    stream = packets(NOMINAL)
    seconds = stream[-1][0]
    theirs = Counter(kind_of(number) for _, number, _ in stream)
    changed = {"EXTENDED_SYS_STATE"}  # MAVSDK asked for another rate
    for number in COMPANION_RATES.keys() - {24, 65, 436}:
        kind = kind_of(number)
        if kind not in changed:
            rate = theirs[kind] / seconds
            assert sent[kind] / 20.0 == pytest.approx(rate, rel=0.22 if rate < 2 else 0.05), kind


def test_the_message_set_is_the_recorded_one_but_for_a_known_rest(sent: Counter[str]) -> None:
    streams = {kind_of(number) for name in (NOMINAL, VISION) for _, number, _ in packets(name)}
    answers = {"COMMAND_ACK", "PARAM_VALUE", "AUTOPILOT_VERSION", "STATUSTEXT", "GPS_GLOBAL_ORIGIN"}
    assert streams - sent.keys() - answers - ON_REQUEST - LEFT_OUT == set()
    assert sent.keys() - streams == set()


@pytest.mark.parametrize("name", sorted(path.name[:-8] for path in RECORDS.glob("px4-1.18*.gz")))
def test_mode_numbers_are_the_recorded_ones(name: str) -> None:
    ours = {(s.base_mode | armed, s.custom_mode) for s in NavState for armed in (0, 128)}
    mission = 4 << 16 | 4 << 24
    for _, message in recorded(name, 0):
        if message.custom_mode != mission:
            assert (message.base_mode, message.custom_mode) in ours


def test_the_version_is_the_recorded_one() -> None:
    theirs = recorded(NOMINAL, 148)[0][1]
    ours = messages.autopilot_version(Bench().vehicle)
    for field in ("capabilities", "flight_sw_version", "vendor_id", "product_id", "board_version"):
        assert getattr(ours, field) == getattr(theirs, field)


def flags_of(bench: Bench) -> int:
    return int(estimate_messages.estimator_status(bench.vehicle).flags)


def gps_hoped_for() -> Bench:
    """As in the recording: PX4's defaults, but vision on and the barometer for height."""
    return Bench(autopilot_defaults=True, parameters=(("EKF2_EV_CTRL", 1), ("EKF2_HGT_REF", 0)))


def test_estimator_flags_go_through_the_recorded_values() -> None:
    theirs = [m.flags for t_s, m in recorded(VISION, 230) if t_s > 1.5]
    bench = gps_hoped_for()
    bench.run(1.0)
    ours = [flags_of(bench)]
    bench.get_ready()
    ours.append(flags_of(bench))
    bench.hover()
    ours.append(flags_of(bench))
    bench.vision = False
    for seconds in (1.0, 6.0):
        bench.run(seconds)
        ours.append(flags_of(bench))
    assert ours == list(dict.fromkeys(theirs))


def sensor_bits(bench: Bench) -> tuple[int, int]:
    m = messages.sys_status(bench.vehicle)
    return m.onboard_control_sensors_present, m.onboard_control_sensors_health


def test_sensor_bits_are_recorded_ones() -> None:
    theirs = {
        (m.onboard_control_sensors_present, m.onboard_control_sensors_health)
        for t_s, m in recorded(VISION, 1)
        if t_s > 2.0
    }
    bench = gps_hoped_for()
    bench.run(0.5)
    ours = {sensor_bits(bench)}
    bench.hover()
    ours.add(sensor_bits(bench))
    bench.vision = False
    bench.run(6.0)
    ours.add(sensor_bits(bench))
    assert ours <= theirs


def modes_from(name: str, start_s: float) -> list[tuple[int, int, int]]:
    """(main, sub, system status) one after the other, without repeats."""
    found = []
    for t_s, m in recorded(name, 0):
        if t_s >= start_s:
            mode = (m.custom_mode >> 16 & 255, m.custom_mode >> 24, m.system_status)
            if not found or found[-1] != mode:
                found.append(mode)
    return found


def mode_now(bench: Bench) -> tuple[int, int, int]:
    m = messages.heartbeat(bench.vehicle)
    return (m.custom_mode >> 16 & 255, m.custom_mode >> 24, m.system_status)


def test_vision_lost_and_back_goes_through_the_recorded_modes() -> None:
    bench = Bench().hover().offboard((0.5, 0.0, 0.0))
    ours = [mode_now(bench)]
    bench.vision = False
    bench.run(7.0)
    ours.append(mode_now(bench))
    bench.vision = True
    bench.run(3.0)
    ours.append(mode_now(bench))
    bench.ask(NavState.LAND)
    bench.run(1.0)
    ours.append(mode_now(bench))
    bench.run(20.0)
    ours.append(mode_now(bench))
    assert ours == modes_from(VISION, 37.0)[: len(ours)]


def test_an_empty_battery_goes_through_the_recorded_modes() -> None:
    name = "px4-1.18_battery"
    limits = (("COM_LOW_BAT_ACT", 3), ("BAT_CRIT_THR", 0.3), ("BAT_EMERGEN_THR", 0.12))
    bench = Bench(parameters=(*limits, ("BAT_LOW_THR", 0.5)), battery_drain_s=75.0)
    bench.hover().offboard()
    ours = [mode_now(bench)]
    for _ in range(3500):
        bench.run(0.02)
        if mode_now(bench) != ours[-1]:
            ours.append(mode_now(bench))
    assert ours[:4] == modes_from(name, 21.0)[:4]


def intended_from(name: str, start_s: float, end_s: float) -> list[tuple[int, int]]:
    """(mode flown, mode intended) of CURRENT_MODE one after the other, without repeats."""
    pairs = [
        (m.custom_mode, m.intended_custom_mode)
        for t_s, m in recorded(name, 436)
        if start_s <= t_s <= end_s
    ]
    return list(dict.fromkeys(pairs))


def test_blind_the_intended_mode_stays_offboard_as_recorded() -> None:
    bench = Bench().hover().offboard()
    ours = [messages.current_mode(bench.vehicle)]
    bench.vision = False
    bench.run(6.0)
    ours.append(messages.current_mode(bench.vehicle))
    pairs = [(m.custom_mode, m.intended_custom_mode) for m in ours]
    assert pairs == intended_from("px4-1.18_vpe_gps_lost", 56.0, 72.0)


def test_sticks_are_told_of_as_recorded() -> None:
    def told(status) -> tuple[bool, bool]:
        fields = status.onboard_control_sensors_present, status.onboard_control_sensors_health
        return tuple(bool(field & 0x10000) for field in fields)

    bench = Bench().hover()
    assert told(messages.sys_status(bench.vehicle)) == told(recorded("px4-1.18_nominal", 1)[-1][1])
    bench.sticks = (0, 0, 500, 0)
    bench.run(0.5)
    theirs = [told(m) for t_s, m in recorded("px4-1.18_pilot_sticks", 1) if 20.0 < t_s < 32.0]
    assert {told(messages.sys_status(bench.vehicle))} == set(theirs)


def test_a_stick_changes_the_intended_mode_as_recorded() -> None:
    bench = Bench().hover().offboard()
    ours = [messages.current_mode(bench.vehicle)]
    for push in range(0, 900, 100):
        bench.sticks = (push, 0, 500, 0)
        bench.run(0.04)
    ours.append(messages.current_mode(bench.vehicle))
    pairs = [(m.custom_mode, m.intended_custom_mode) for m in ours]
    assert pairs == intended_from("px4-1.18_pilot_sticks", 23.0, 32.0)


# ---- of the 1.16 era

OLD_VISION, OLD_OFFBOARD = "px4-1.16dev_vpe_gps_lost", "px4-1.16dev_offboard_loss"
OLD_STICKS = "px4-1.16dev_pilot_sticks"


def mode_pair(bench: Bench) -> tuple[int, int]:
    m = messages.current_mode(bench.vehicle)
    return (m.custom_mode, m.intended_custom_mode)


def test_the_old_one_falls_back_to_altitude_when_vision_is_lost_as_recorded() -> None:
    bench = Bench(manners="px4-1.16").hover().offboard()
    ours, pairs = [mode_now(bench)], [mode_pair(bench)]
    bench.vision = False
    bench.run(7.0)
    ours.append(mode_now(bench))
    pairs.append(mode_pair(bench))
    bench.vision = True
    bench.run(3.0)
    ours.append(mode_now(bench))
    assert ours == modes_from(OLD_VISION, 29.9)[:3]
    assert pairs == intended_from(OLD_VISION, 30.5, 70.0)


def test_the_old_one_without_setpoints_falls_back_to_position_as_recorded() -> None:
    bench = Bench(manners="px4-1.16").hover().offboard()
    ours = [mode_now(bench)]
    for action in (0, 5, 4):
        bench.vehicle.parameters.set_wire("COM_OBL_RC_ACT", bits(action), 6)
        velocity, bench.velocity = bench.velocity, None
        bench.run(3.0)
        ours.append(mode_now(bench))
        if action != 4:
            bench.velocity = velocity
            bench.run(2.0)
            ours.append(mode_now(bench))
    assert ours == modes_from(OLD_OFFBOARD, 21.9)[: len(ours)]


def bits(number: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", number))[0])


def test_a_stick_step_takes_the_old_one_over_as_recorded() -> None:
    bench = Bench(manners="px4-1.16", parameters=(("COM_RC_OVERRIDE", 3),))
    bench.sticks = (0, 0, 500, 0)
    bench.hover().offboard()
    ours = [mode_pair(bench)]
    bench.sticks = (900, 0, 500, 0)
    bench.run(0.2)
    ours.append(mode_pair(bench))
    assert ours == intended_from(OLD_STICKS, 23.5, 32.0)
    later = Bench(parameters=(("COM_RC_OVERRIDE", 3),))
    later.sticks = (0, 0, 500, 0)
    later.hover().offboard()
    later.sticks = (900, 0, 500, 0)
    later.run(0.2)
    assert mode_pair(later) == ours[0]


def test_sticks_in_a_mode_that_it_fell_back_to_are_flown_and_told_of_by_nothing() -> None:
    """As PX4's Commander: it looks for sticks that take over in modes that are not theirs."""
    bench = Bench(manners="px4-1.16", parameters=(("COM_RC_OVERRIDE", 3),))
    bench.sticks = (0, 0, 500, 0)
    bench.hover().offboard()
    bench.velocity = None
    bench.run(3.0)
    assert (bench.state, bench.vehicle.commander.intended) == (NavState.POSITION, NavState.OFFBOARD)
    assert bench.vehicle.flight_mode is FlightMode.MANUAL
    bench.sticks = (900, 0, 500, 0)
    bench.run(1.0)
    assert (bench.state, bench.vehicle.commander.intended) == (NavState.POSITION, NavState.OFFBOARD)


def test_by_default_no_stick_ends_the_old_ones_offboard() -> None:
    bench = Bench(manners="px4-1.16")
    bench.sticks = (0, 0, 500, 0)
    bench.hover().offboard()
    bench.sticks = (900, 0, 500, 0)
    bench.run(0.2)
    assert bench.state is NavState.OFFBOARD


def test_the_old_one_tells_pressure_in_the_recorded_unit_and_its_version() -> None:
    theirs_pa = recorded(OLD_VISION, 105)[0][1].abs_pressure
    bench = Bench(manners="px4-1.16", home_alt_amsl_m=40.0)
    assert messages.highres_imu(bench.vehicle).abs_pressure == pytest.approx(theirs_pa, rel=0.01)
    version = messages.autopilot_version(bench.vehicle).flight_sw_version
    assert version == recorded(OLD_VISION, 148)[0][1].flight_sw_version


def scatter(samples: list[Any]) -> list[float]:
    """One sigma of a sample, of gyro and accelerometer, by how neighbours differ."""
    axes = [(m.xgyro, m.ygyro, m.zgyro, m.xacc, m.yacc, m.zacc) for m in samples]
    return (np.diff(axes, axis=0).std(axis=0) / math.sqrt(2.0)).tolist()


def test_the_imu_of_the_old_ones_own_simulator_is_as_noisy_in_the_air_as_recorded() -> None:
    """Twenty times the present one's: a filter that took it for quiet was 3.7 sigmas off."""
    in_the_air = [m for t_s, m in recorded(OLD_VISION, 105) if 22.0 < t_s < 29.0]
    bench, ours = Bench(manners="px4-1.16").hover().offboard(), []
    for _ in range(len(in_the_air)):
        bench.run(0.02)
        ours.append(messages.highres_imu(bench.vehicle))
    assert scatter(ours) == pytest.approx(scatter(in_the_air), rel=0.35)


def test_no_landing_begins_in_the_air_without_a_position() -> None:
    """As PX4's UserModeIntention: a mode that cannot be flown is refused; Descend goes on."""
    bench = Bench().hover().offboard()
    bench.vision = False
    bench.run(7.0)
    assert bench.ask(NavState.LAND) is Result.TEMPORARILY_REJECTED
    assert bench.state is NavState.DESCEND
