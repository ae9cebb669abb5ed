"""What the simulated ArduCopter answers, message by message, and that no message can hurt it."""

from typing import Any

import pytest
from copter_bench import CopterBench
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from px4_client import make_config
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from test_vehicle_session import FLOAT, command_messages, data_messages

from vwnav.sim.copter.messages import BUILDERS
from vwnav.sim.truth import TruthReader
from vwnav.sim.vehicle import start_vehicle
from vwnav.vehicle import FlightMode

PARAMETERS = [b"WPNAV_ACCEL", b"WPNAV_ACCEL_Z", b"EK3_ALT_M_NSE", b"VISO_POS_M_NSE", b"FLTMODE_CH"]


@pytest.mark.parametrize(
    ("number", "parameters", "result"),
    [
        (400, (1.0,), 4),  # no position
        (400, (0.0,), 0),
        (22, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 5.0), 4),  # disarmed
        (512, (148.0,), 0),
        (512, (9999.0,), 4),
        (511, (9999.0, 1e5), 2),
        (511, (30.0, 1e5), 0),
        (31000, (), 3),
        (176, (1.0, 17.0), 0),
        (176, (1.0, 99.0), 4),
        (176, (1.0, 3.0), 4),  # AUTO without a mission
        (179, (1.0,), 4),  # no global position
        (246, (1.0,), 0),
    ],
)
def test_a_command_gets_arducopters_result(
    number: int, parameters: tuple[float, ...], result: int
) -> None:
    assert CopterBench().command(number, *parameters) == result


def test_timesync_is_answered_6_ms_later() -> None:
    bench = CopterBench()
    bench.run(1.0)
    bench.send(mavlink.MAVLink_timesync_message(0, 123))
    asked_s = bench.t_s
    bench.run(0.05)
    answered_s, answer = bench.of("TIMESYNC")[0]
    assert answer.ts1 == 123
    assert answer.tc1 == pytest.approx(1e9 * asked_s, abs=1e7)
    assert answered_s - asked_s == pytest.approx(0.006, abs=0.007)


def test_every_parameter_is_told_as_a_number() -> None:
    bench = CopterBench()
    bench.send(mavlink.MAVLink_param_request_list_message(1, 1))
    bench.run(0.3)
    told = {m.param_id: m for _, m in bench.of("PARAM_VALUE")}
    assert len(told) == told["VISO_TYPE"].param_count
    assert (told["VISO_TYPE"].param_value, told["VISO_TYPE"].param_type) == (1.0, 2)
    assert told["GUID_TIMEOUT"].param_type == 9


def test_an_origin_is_set_once() -> None:
    bench = CopterBench()
    bench.run(1.0)
    bench.set_origin()
    bench.send(mavlink.MAVLink_set_gps_global_origin_message(1, 100000000, 100000000, 0))
    bench.run(0.1)
    assert [m.latitude for _, m in bench.of("GPS_GLOBAL_ORIGIN")] == [604030000]


def own_messages() -> st.SearchStrategy[Any]:
    three, nine = (st.lists(FLOAT, min_size=n, max_size=n) for n in (3, 9))
    return st.one_of(
        st.builds(
            lambda v, c, r: mavlink.MAVLink_vision_speed_estimate_message(0, *v, c, r),
            three, nine, st.integers(0, 255),
        ),
        st.builds(
            lambda n, v: mavlink.MAVLink_param_set_message(1, 1, n, v, 9),
            st.sampled_from(PARAMETERS), FLOAT,
        ),
    )  # fmt: skip


@settings(
    max_examples=30,
    deadline=None,
    phases=(Phase.generate,),
    suppress_health_check=list(HealthCheck),
)
@given(st.lists(command_messages() | data_messages() | own_messages(), min_size=5, max_size=40))
def test_no_message_can_bring_it_down(messages: list[Any]) -> None:
    bench = CopterBench()
    bench.run(0.1)
    bench.vehicle.begin_in_flight((0.0, 0.0, -20.0), (0.0, 0.0, 0.0), 0.0, FlightMode.OFFBOARD)
    for message in messages:
        bench.send(message)
        bench.run(0.06)
    for build in BUILDERS.values():
        built = build(bench.vehicle)
        if built is not None:
            bench.send(built)


def test_as_a_process_it_tells_the_truth_by_sim_state() -> None:
    config = make_config(manners="copter")
    with start_vehicle(config):
        reader = TruthReader(config.truth_url.replace("udpin", "udpout"), 50.0)
        try:
            state = reader.wait(20.0)
        finally:
            reader.close()
    assert state is not None
    assert (state.lat_deg, state.lon_deg) == pytest.approx((41.1, 29.0), abs=1e-6)
