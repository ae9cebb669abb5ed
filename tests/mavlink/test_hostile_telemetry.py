"""Whatever an autopilot says, duplicates, disorder and nonsense: no measurement is made of it."""

import math

import numpy as np
import pytest
from autopilot_links import PX4, Bench
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from vwnav.mavlink.telemetry.status_text import StatusTexts
from vwnav.mavlink.telemetry.telemetry_state import TelemetryState
from vwnav.types import Attitude, Height, ImuSample, Range, Stationary

ANSWERS = ("COMMAND_ACK", "PARAM_VALUE", "TIMESYNC")
UNDERSTOOD = [
    kind
    for kind in mavlink.mavlink_map.values()
    if kind.msgname in (*TelemetryState().messages, *ANSWERS)
]
PAYLOADS = st.tuples(st.sampled_from(UNDERSTOOD), st.binary(min_size=255, max_size=255))


def message(kind, payload: bytes):
    """A message of `kind` out of any bytes."""
    values = list(kind.unpacker.unpack(payload[: kind.unpacker.size]))
    ordered, at = [], 0
    for length, field in zip(kind.array_lengths, kind.ordered_fieldnames, strict=True):
        is_text = kind.fieldtypes[kind.fieldnames.index(field)] == "char"
        count = 1 if is_text or not length else length
        taken = values[at : at + count]
        ordered.append(taken[0] if count == 1 and (is_text or not length) else taken)
        at += count
    by_name = dict(zip(kind.ordered_fieldnames, ordered, strict=True))
    return kind(*[by_name[name] for name in kind.fieldnames])


def numbers(measured) -> list[float]:
    match measured:
        case Attitude():
            return [measured.t_s, *measured.quat_wxyz]
        case ImuSample():
            return [measured.t_s, *measured.specific_force_m_s2, *measured.rates_rad_s]
        case Height():
            return [measured.t_s, measured.height_m]
        case Range():
            return [measured.t_s, measured.distance_m]
        case Stationary():
            return [measured.t_s]


@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(PAYLOADS, min_size=1, max_size=30))
def test_nothing_that_is_not_finite_or_of_another_time_comes_out(payloads):
    bench = Bench(settle_s=1.0)
    for kind, payload in payloads:
        bench.peer.send(message(kind, payload))
        bench.run(0.03)
    for measured in bench.autopilot.take_measurements():
        assert all(math.isfinite(number) for number in numbers(measured)), measured
        assert measured.t_s <= bench.clock() + 0.5
    bench.autopilot.state()
    bench.run(1.0)
    bench.autopilot.take_measurements()
    bench.run(1.0)
    attitudes = [m for m in bench.autopilot.take_measurements() if isinstance(m, Attitude)]
    assert len(attitudes) > 40  # and what is sensible is heard on
    assert attitudes[-1].t_s == pytest.approx(bench.clock(), abs=0.05)


def test_nothing_is_measured_of_what_is_not_known():
    """NaN is no attitude, no pressure and no IMU."""
    bench = Bench()
    bench.peer.speaks = False
    bench.run(0.1)
    bench.autopilot.take_measurements()
    ms, nan = int(bench.peer.boot_s() * 1e3), math.nan
    bench.peer.send(mavlink.MAVLink_attitude_message(ms, nan, 0.0, 0.0, 0.0, 0.0, 0.0))
    bench.peer.send(mavlink.MAVLink_attitude_message(ms, 0.0, 0.0, 0.0, nan, 0.0, 0.0))
    bench.peer.send(mavlink.MAVLink_scaled_pressure_message(ms, nan, 0.0, 1500))
    bench.peer.send(mavlink.MAVLink_scaled_pressure_message(ms, 0.0, 0.0, 1500))
    felt = (0.0, 0.0, -9.8, 0.0, nan, 0.0)
    bench.peer.send(mavlink.MAVLink_highres_imu_message(ms * 1000, *felt, *[nan] * 7, 63))
    bench.run(0.1)
    assert bench.autopilot.take_measurements() == ()


def test_duplicates_and_what_was_overtaken_are_not_measured_again():
    bench = Bench()
    bench.peer.speaks = False
    bench.run(0.1)
    bench.autopilot.take_measurements()
    ms = int(bench.peer.boot_s() * 1e3)
    for late_ms in (0, 0, 20, 0, 40, 20, 40):
        stamp = ms + late_ms
        bench.clock.t_s += 0.001
        bench.peer.send(mavlink.MAVLink_attitude_message(stamp, 0.1, -0.2, 0.5, 0, 0, 0))
        bench.peer.send(mavlink.MAVLink_scaled_pressure_message(stamp, 1008.0, 0.0, 1500))
        felt = (-1.95, -0.96, -9.56, 0, 0, 0.1)
        bench.peer.send(mavlink.MAVLink_highres_imu_message(stamp * 1000, *felt, *[0.0] * 7, 63))
    bench.run(0.1)
    taken = bench.autopilot.take_measurements()
    for kind in (Attitude, ImuSample, Height):
        times_s = [each.t_s for each in taken if isinstance(each, kind)]
        assert len(times_s) == 3
        assert np.all(np.diff(times_s) > 0.0)


@pytest.mark.parametrize("stamp_ms", [0, 1, 4_000_000_000])
def test_a_pressure_with_a_stamp_that_cannot_be_is_no_height(stamp_ms):
    bench = Bench()
    bench.autopilot.take_measurements()
    for _ in range(20):
        bench.peer.send(mavlink.MAVLink_scaled_pressure_message(stamp_ms, 1008.0, 0.0, 1500))
        fields = (0.0, 0.0, -9.8, *[0.0] * 6, 1008.0, 0.0, 0.0, 20.0, 63)
        bench.peer.send(mavlink.MAVLink_highres_imu_message(stamp_ms * 1000, *fields))
        bench.run(0.05)
    taken = bench.autopilot.take_measurements()
    assert all(abs(each.t_s - bench.clock()) < 1.2 for each in taken)
    assert sum(isinstance(each, Height) for each in taken) == pytest.approx(10, abs=1)


def test_what_nobody_takes_is_bounded():
    bench = Bench()
    bench.run(60.0)
    taken = bench.autopilot.take_measurements()
    assert 1000 < len(taken) <= 4000
    assert taken[-1].t_s > bench.clock() - 0.1


def test_before_an_autopilot_is_known_nothing_is_asked_and_nothing_stands_still():
    bench = Bench(round_trip_s=0.0, settle_s=0.0)
    bench.peer.speaks = False
    bench.run(1.0)
    request = bench.autopilot.land()
    assert (request.done, request.refused) == (True, "the autopilot is not heard")
    assert bench.autopilot.take_measurements() == ()
    assert [m.get_type() for _, m in bench.peer.heard] == ["HEARTBEAT"]


def test_an_aircraft_whose_arming_is_not_known_does_not_stand():
    telemetry = TelemetryState()
    for i in range(50):
        ms = 1000 + 20 * i
        telemetry.handle("ATTITUDE", attitude_fields(ms), 10.0 + 0.02 * i)
        fields = {"time_boot_ms": ms, "press_abs": 1008.0}
        telemetry.handle("SCALED_PRESSURE", fields, 10.0 + 0.02 * i)
    kinds = {type(each) for each in telemetry.take_measurements()}
    assert kinds == {Attitude, Height}


def attitude_fields(ms: int) -> dict[str, float]:
    names = ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")
    return {"time_boot_ms": ms, **dict.fromkeys(names, 0.0)}


def test_a_jump_of_the_autopilots_clock_to_zero_in_the_air_is_followed():
    bench = Bench()
    bench.peer.armed = True
    bench.run(1.0)
    bench.peer.boot_at_s = bench.clock()
    bench.run(0.1)
    bench.autopilot.take_measurements()
    bench.run(1.0)
    for each in bench.autopilot.take_measurements():
        assert bench.clock() - 1.2 < each.t_s < bench.clock() + 0.01
    assert bench.autopilot.state().height_m is not None


def test_texts_whose_end_never_comes_are_bounded():
    texts = StatusTexts()
    for number in range(1, 2000):
        for sequence in (0, 1, 1, 1, 7, 255):
            fields = {"text": "x" * 50, "id": number, "chunk_seq": sequence, "severity": 2}
            assert texts.handle(fields, 1.0) is None
    assert len(texts._chunks) <= 50
    assert all(len(chunks) <= 256 for chunks in texts._chunks.values())


@pytest.mark.parametrize("kind", [PX4])
def test_a_second_aircraft_with_the_same_firmware_changes_nothing(kind):
    bench = Bench(kind)
    other = mavlink.MAVLink(None, srcSystem=9, srcComponent=1)
    bench.autopilot.take_measurements()
    for _ in range(20):
        bench.peer.send(mavlink.MAVLink_attitude_message(5, 1.0, 1.0, 1.0, 0, 0, 0), other)
        bench.peer.send(
            mavlink.MAVLink_param_value_message(b"MIS_TAKEOFF_ALT", 99.0, 9, 1, 0), other
        )
        bench.peer.send(mavlink.MAVLink_gps_global_origin_message(1, 1, 1), other)
        bench.peer.beat(system_id=9)
        bench.run(0.02)
    assert bench.autopilot._parameters.values["MIS_TAKEOFF_ALT"] == 2.5
    assert bench.autopilot.state().armed is False
    attitudes = [m for m in bench.autopilot.take_measurements() if isinstance(m, Attitude)]
    assert len(attitudes) == pytest.approx(20, abs=2)
