"""Conformance of the simulated vehicle with recordings of the real ArduCopter 4.7."""

import math
from itertools import pairwise
from statistics import mean
from typing import Any

import pytest
from copter_bench import ARM, REQUEST, TAKEOFF, CopterBench
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tlogs import COMPANION, RECORDS, needs, packets, recorded

from vwnav.sim.copter import messages
from vwnav.sim.copter.modes import Mode, base_mode

PREFIX = "arducopter-4.7dev_"
NOMINAL, NO_GPS = f"{PREFIX}nominal", f"{PREFIX}extnav_nogps"
SETPOINTS, BATTERY = f"{PREFIX}setpoint_loss", f"{PREFIX}battery"
LINK, PILOT = f"{PREFIX}link_loss", f"{PREFIX}pilot_rcswitch"
pytestmark = needs(NOMINAL)
HEARTBEAT, SYS_STATUS, LOCAL, SIM_STATE, EKF, TEXT = 0, 1, 32, 108, 193, 253
LANDED, ACK, LONG, VERSION = 245, 77, 76, 148
PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK
Series = list[tuple[float, Any]]
BATTERY_LIMITS = (
    ("BATT_FS_LOW_ACT", 2),
    ("BATT_LOW_VOLT", 10.8),
    ("BATT_FS_CRT_ACT", 1),
    ("BATT_CRT_VOLT", 10.2),
    ("BATT_LOW_TIMER", 3),
)


def first(series: Series, since_s: float, good: Any) -> float:
    """Seconds from `since_s` until a message is good."""
    return next(t_s for t_s, m in series if t_s >= since_s and good(m)) - since_s


def changes(series: Series, value: Any) -> list[Any]:
    """Values one after the other, without repeats."""
    found: list[Any] = []
    for _, m in series:
        if not found or found[-1] != value(m):
            found.append(value(m))
    return found


def record_texts(name: str, since_s: float, until_s: float) -> list[str]:
    return [m.text for t_s, m in recorded(name, TEXT) if since_s <= t_s <= until_s]


def quiet(**config: Any) -> CopterBench:
    """Calm, with a heading that is right: what the recordings were made in."""
    bench = CopterBench(heading_bias_deg=0.0, **config)
    bench.ask_for(20.0)
    return bench


# ---- what is said


@pytest.mark.parametrize("name", sorted(p.name[:-8] for p in RECORDS.glob(f"{PREFIX}*.gz")))
def test_mode_numbers_are_the_recorded_ones(name: str) -> None:
    ours = {(base_mode(holds) | armed, m) for m in Mode for holds in (0, 1) for armed in (0, 128)}
    for _, m in recorded(name, HEARTBEAT):
        assert (m.base_mode, m.custom_mode) in ours
        assert (m.type, m.autopilot) == (2, 3)


def test_the_version_is_the_recorded_one() -> None:
    theirs, ours = (
        recorded(NOMINAL, VERSION)[0][1],
        messages.autopilot_version(CopterBench().vehicle),
    )
    for field in ("capabilities", "flight_sw_version", "flight_custom_version", "vendor_id"):
        assert getattr(ours, field) == getattr(theirs, field)


def test_unasked_it_sends_what_is_recorded_before_the_first_request() -> None:
    asked_s = recorded(NOMINAL, LONG, 195)[0][0]
    theirs = {number for t_s, number, _ in packets(NOMINAL) if t_s < asked_s}
    bench = CopterBench()
    bench.run(25.0)
    kinds = {m.get_type() for _, m in bench.got}
    assert theirs <= {HEARTBEAT, TEXT, 111}
    assert kinds == {"HEARTBEAT", "STATUSTEXT", "TIMESYNC"}
    assert len(bench.of("HEARTBEAT")) == pytest.approx(25, abs=1)
    assert len(bench.of("TIMESYNC")) == 2


def test_every_recorded_message_can_be_asked_for() -> None:
    answers = {ACK, TEXT, 111, 22}  # and texts, TIMESYNC, parameters
    theirs = {number for name in (NOMINAL, NO_GPS, BATTERY) for _, number, _ in packets(name)}
    bench = CopterBench()
    bench.run(1.0)
    for number in theirs - answers:
        assert bench.command(511, float(number), 40000.0) == 0, number


def test_acknowledgements_take_as_long_as_recorded() -> None:
    delays_s = []
    acks = recorded(NO_GPS, ACK)
    for asked_s, asked in recorded(NO_GPS, LONG, COMPANION):
        answers = [t for t, m in acks if 0.0 <= t - asked_s < 0.1 and m.command == asked.command]
        delays_s += answers[:1] and [answers[0] - asked_s]
    bench = CopterBench()
    sent_s = bench.t_s
    bench.command(REQUEST, float(VERSION))
    assert bench.of("COMMAND_ACK")[0][0] - sent_s == pytest.approx(mean(delays_s), abs=0.006)


def test_an_unknown_or_too_fast_message_is_denied_as_recorded() -> None:
    bench = CopterBench()
    assert bench.command(511, 115.0, 1e5) == 2
    bench.run(0.1)
    text = "No ap_message for mavlink id (115)"
    assert text in bench.texts()
    assert text in record_texts(NOMINAL, 0.0, 90.0)
    assert bench.command(511, 105.0, 3000.0) == 2


def test_sensor_bits_are_recorded_ones() -> None:
    def bits(m: Any) -> tuple[int, ...]:
        return (
            m.onboard_control_sensors_present,
            m.onboard_control_sensors_enabled,
            m.onboard_control_sensors_health,
        )

    theirs = {bits(m) for _, m in recorded(NO_GPS, SYS_STATUS)}
    bench = quiet()
    bench.channels = (1500, 1500, 1000, 1500, 1650, 1000, 1000, 1800)
    bench.set_parameter("FLTMODE5", 4)
    bench.hover()
    seen = {bits(m) for t_s, m in bench.of("SYS_STATUS") if t_s > 26.0}
    bench.vision = False
    bench.run(12.0)
    seen |= {bits(m) for t_s, m in bench.of("SYS_STATUS", bench.t_s - 11.0)}
    assert seen <= theirs


# ---- on the ground


def test_arming_without_a_position_is_refused_as_recorded() -> None:
    refused_s = next(t for t, m in recorded(SETPOINTS, ACK) if m.command == ARM and m.result)
    bench = CopterBench()
    bench.run(8.0)
    bench.set_mode(Mode.GUIDED)
    assert bench.command(ARM, 1.0) == 4
    assert record_texts(SETPOINTS, refused_s - 0.1, refused_s + 0.1) == bench.texts()[-1:]


def test_it_is_ready_so_long_after_the_origin_as_recorded() -> None:
    def ready_s(statuses: Series, origin_s: float) -> float:
        ready = 0x10000000
        return first(statuses, origin_s, lambda m: m.onboard_control_sensors_health & ready)

    theirs_s = ready_s(recorded(NO_GPS, SYS_STATUS), recorded(NO_GPS, 48, COMPANION)[0][0])
    bench = quiet()
    bench.run(9.0)
    bench.vision = True
    bench.run(1.0)
    origin_s = bench.t_s
    bench.set_origin()
    bench.run(15.0)
    assert ready_s(bench.of("SYS_STATUS"), origin_s) == pytest.approx(theirs_s, abs=1.5)


def test_it_takes_off_as_recorded() -> None:
    def times_s(states: Series, armed_s: float) -> list[float]:
        return [first(states, armed_s, lambda m, s=s: m.landed_state == s) for s in (3, 2)]

    armed_s = next(t for t, m in recorded(NO_GPS, ACK) if m.command == ARM)
    theirs_s = times_s(recorded(NO_GPS, LANDED), armed_s)
    bench = quiet().hover()
    ours_s = next(t for t, m in bench.of("COMMAND_ACK") if m.command == ARM)
    assert times_s(bench.of("EXTENDED_SYS_STATE"), ours_s) == pytest.approx(theirs_s, abs=1.0)


# ---- setpoints


def speeds(series: Series, since_s: float) -> list[tuple[float, float]]:
    return [(t_s - since_s, math.hypot(m.vx, m.vy)) for t_s, m in series if t_s >= since_s]


def test_without_setpoints_it_coasts_and_brakes_as_recorded() -> None:
    def milestones(found: list[tuple[float, float]]) -> list[float]:
        return [next(t for t, speed in found if speed < limit) for limit in (2.8, 1.5, 0.3)]

    stopped_s = max(t for t, m in recorded(SETPOINTS, 84, COMPANION) if t < 50.0)
    theirs = milestones(speeds(recorded(SETPOINTS, LOCAL), stopped_s))
    bench = quiet().aloft()
    bench.velocity = (3.0, 0.0, 0.0)
    bench.run(8.0)
    bench.velocity, stopped_s = None, bench.t_s
    bench.run(8.0)
    assert milestones(speeds(bench.of("LOCAL_POSITION_NED"), stopped_s)) == pytest.approx(
        theirs, abs=0.45
    )
    assert bench.mode is Mode.GUIDED


def test_the_tilt_at_3_m_s_is_the_recorded_one() -> None:
    theirs = mean(-m.pitch for t, m in recorded(NO_GPS, SIM_STATE) if 55.0 < t < 57.0)
    bench = quiet().aloft()
    bench.velocity = (3.0, 0.0, 0.0)
    bench.run(9.0)
    assert -bench.vehicle.body.euler_rad[1] == pytest.approx(theirs, rel=0.15)


# ---- vision


def test_vision_lost_and_back_goes_as_recorded() -> None:
    def story(
        beats: Series, flags: Series, texts: Series, gap_s: tuple[float, float]
    ) -> list[float]:
        lost_s, back_s = gap_s
        return [
            first(flags, lost_s, lambda m: m.flags == 0x025),
            first(beats, lost_s, lambda m: m.custom_mode == Mode.LAND),
            first(texts, lost_s, lambda m: m.text == "EKF Failsafe: changed to LAND Mode"),
            first(flags, back_s, lambda m: m.flags == 0x33F),
            first(texts, back_s, lambda m: m.text == "EKF Failsafe Cleared"),
        ]

    seen_s = [t for t, _ in recorded(NO_GPS, 102, COMPANION)]
    gaps_s = [(a, b) for a, b in pairwise(seen_s) if b - a > 5.0]
    theirs = [recorded(NO_GPS, number) for number in (HEARTBEAT, EKF, TEXT)]
    expected = story(*theirs, gaps_s[0])
    bench = quiet().aloft()
    lost_s, bench.vision = bench.t_s, False
    bench.run(gaps_s[0][1] - gaps_s[0][0])
    back_s, bench.vision = bench.t_s, True
    bench.run(5.0)
    ours = [bench.of(kind) for kind in ("HEARTBEAT", "EKF_STATUS_REPORT", "STATUSTEXT")]
    assert story(*ours, (lost_s, back_s)) == pytest.approx(expected, abs=0.6)
    beats = bench.of("HEARTBEAT", lost_s + 8.5)
    assert {(m.base_mode, m.custom_mode) for _, m in beats} == {(209, 9)}
    assert changes(beats, lambda m: m.system_status) == [5, 4]


def test_the_ekf_failsafe_waits_before_it_comes_down_as_recorded() -> None:
    def descends_s(series: Series, landing_s: float) -> float:
        return first(series, landing_s, lambda m: m.vd > 0.25)

    landing_s = next(t for t, m in recorded(NO_GPS, TEXT) if "changed to LAND" in m.text)
    expected_s = descends_s(recorded(NO_GPS, SIM_STATE), landing_s)
    bench = quiet().aloft()
    bench.vision = False
    bench.run(14.0)
    ours_s = next(t for t, m in bench.of("STATUSTEXT") if "changed to LAND" in m.text)
    assert descends_s(bench.of("SIM_STATE"), ours_s) == pytest.approx(expected_s, abs=0.5)


# ---- landing


def test_it_comes_down_and_disarms_as_recorded() -> None:
    def story(places: Series, beats: Series) -> list[float]:
        fast = mean(m.vz for _, m in places if 11.6 < -m.z < 13.5)
        slow = mean(m.vz for _, m in places if 2.0 < -m.z < 9.0)
        down_s = next(t for t, m in places if -m.z < 0.1)
        return [fast, slow, first(beats, down_s, lambda m: not m.base_mode & 128)]

    places = [(t, m) for t, m in recorded(NOMINAL, LOCAL) if t > 58.5]
    expected = story(places, recorded(NOMINAL, HEARTBEAT))
    bench = quiet().aloft(15.0)
    landing_s = bench.t_s
    bench.set_mode(Mode.LAND)
    bench.run(32.0)
    ours = story(bench.of("LOCAL_POSITION_NED", landing_s), bench.of("HEARTBEAT"))
    assert ours[:2] == pytest.approx(expected[:2], abs=0.1)
    assert ours[2] == pytest.approx(expected[2], abs=0.8)


# ---- failsafes and the pilot


def test_a_low_and_a_critical_battery_go_as_recorded() -> None:
    modes = changes(
        [(t, m) for t, m in recorded(BATTERY, HEARTBEAT) if 55.0 < t < 86.0],
        lambda m: (m.custom_mode, m.system_status),
    )
    bench = quiet(parameters=BATTERY_LIMITS)
    bench.aloft(15.0)
    since_s = bench.t_s - 0.1
    bench.vehicle.battery.remaining = 0.26
    low_s = bench.until(Mode.RTL, 5.0)
    bench.run(2.0)
    assert bench.set_mode(Mode.GUIDED) == 0
    bench.run(2.0)
    bench.vehicle.battery.remaining = 0.04
    critical_s = bench.until(Mode.LAND, 5.0)
    bench.run(2.0)
    assert bench.set_mode(Mode.GUIDED) == 0
    bench.run(1.0)
    beats = bench.of("HEARTBEAT", since_s)
    assert changes(beats, lambda m: (m.custom_mode, m.system_status)) == modes
    assert (low_s, critical_s) == pytest.approx((3.1, 3.2), abs=0.3)
    theirs = record_texts(BATTERY, 58.0, 86.0)
    assert [text.split(" 10.")[0].split(" 9.")[0] for text in bench.texts(since_s)] == [
        text.split(" 10.")[0] for text in theirs
    ]


def test_a_silent_ground_station_goes_as_recorded() -> None:
    beats = [t for t, m in recorded(LINK, HEARTBEAT, 190) if t < 40.0]
    expected_s = next(t for t, m in recorded(LINK, TEXT) if m.text == "GCS Failsafe") - beats[-1]
    bench = quiet(parameters=(("FS_GCS_ENABLE", 1),))
    bench.ground_station = True
    bench.aloft()
    bench.run(1.0 - bench.t_s % 1.0)
    bench.ground_station = False
    ours_s = bench.until(Mode.RTL, 8.0)
    assert ours_s == pytest.approx(expected_s, abs=0.5)
    bench.ground_station = True
    bench.run(1.5)
    assert bench.texts()[-2:] == ["GCS Failsafe", "GCS Failsafe Cleared"]
    assert bench.mode is Mode.RTL


def test_rtl_climbs_as_high_as_recorded() -> None:
    theirs_m = max(-m.z for t, m in recorded(LINK, LOCAL) if 33.0 < t < 60.0)
    bench = quiet().aloft()
    assert bench.set_mode(Mode.RTL) == 0
    bench.run(9.0)
    assert -bench.vehicle.body.d == pytest.approx(theirs_m, abs=0.6)


def test_the_mode_switch_takes_over_as_fast_as_recorded() -> None:
    overrides = recorded(PILOT, 70, 190)
    switched_s = next(t for t, m in overrides if t > 30.0 and m.chan5_raw == 1200)
    loiter = [(t, m) for t, m in recorded(PILOT, HEARTBEAT) if m.custom_mode == Mode.LOITER]
    expected_s = first(loiter, switched_s, lambda m: True)
    slots = tuple((f"FLTMODE{i}", mode) for i, mode in enumerate((5, 5, 5, 4, 4, 9), 1))
    bench = quiet(parameters=slots)
    free, switched = (1500, 1500, 1500, 1500, 1650), (1500, 1500, 1500, 1500, 1200)
    bench.channels = (*free, 1000, 1500, 1500)
    bench.aloft()
    bench.channels = (*switched, 1000, 1500, 1500)
    ours_s = bench.until(Mode.LOITER, 2.0)
    assert ours_s <= expected_s + 0.1
    assert ours_s == pytest.approx(0.2, abs=0.1)


def test_takeoff_wants_guided_and_arms() -> None:
    bench = CopterBench()
    bench.get_ready()
    assert bench.command(TAKEOFF, *[0.0] * 6, 5.0) == 4


def test_after_a_landing_it_is_ready_to_arm_but_not_in_land() -> None:
    modes = recorded(NOMINAL, HEARTBEAT)
    landed_s = next(t_s for t_s, m in modes if m.custom_mode == Mode.LAND and not m.base_mode & 128)
    after = [m for t_s, m in recorded(NOMINAL, SYS_STATUS) if t_s > landed_s + 1.0]
    assert after
    assert all(m.onboard_control_sensors_health & PREARM for m in after)

    bench = quiet().aloft(4.0)
    assert bench.set_mode(Mode.LAND) == 0
    bench.run(25.0)
    assert not bench.vehicle.commander.armed
    assert bench.of("SYS_STATUS")[-1][1].onboard_control_sensors_health & PREARM
    assert bench.command(ARM, 1.0) == 4
    assert bench.texts()[-1] == "Arm: Land mode not armable"
    assert bench.set_mode(Mode.GUIDED) == 0
    bench.run(1.1)
    assert bench.command(ARM, 1.0) == 0
