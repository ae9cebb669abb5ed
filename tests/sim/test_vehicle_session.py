"""What the simulated PX4 answers, message by message, and that no message can hurt it."""

import math
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as mavlink

from vwnav.errors import ConfigError
from vwnav.sim.config import VehicleConfig
from vwnav.sim.core import PX4_BUILDERS
from vwnav.sim.mavlink.link import parse_url
from vwnav.sim.mavlink.timesync import TimesyncFilter
from vwnav.sim.px4.px4 import SimulatedPx4
from vwnav.sim.px4.session import Px4Session
from vwnav.sim.px4.streams import COMPANION_RATES, schedule_of

FLOAT = st.floats(width=32) | st.sampled_from([0.0, 1.0, math.nan, math.inf, 3.4e38, -3.4e38])
COMMANDS = [16, 17, 20, 21, 22, 176, 178, 179, 192, 246, 300, 400, 410, 510, 511, 512, 520, 611]


class FakeLink:
    """Packs what is sent, as the real one does, and keeps it."""

    def __init__(self) -> None:
        self.gcs_heard_s = -math.inf
        self.inbox: list[Any] = []
        self.sent: list[Any] = []
        self._packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)

    def receive(self, t_s: float) -> list[Any]:
        messages, self.inbox = self.inbox, []
        return messages

    def send(self, message: Any) -> None:
        message.pack(self._packer)
        self.sent.append(message)


class Talk:
    """A vehicle with one link, stepped by hand."""

    def __init__(self, **config: Any) -> None:
        self.vehicle = SimulatedPx4(VehicleConfig(**config))
        self.link = FakeLink()
        schedule = schedule_of(COMPANION_RATES, PX4_BUILDERS)
        clock = self.now_s
        self.session = Px4Session(self.link, self.vehicle, schedule, clock, True)
        self._client = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)

    def now_s(self) -> float:
        return self.vehicle.t_s

    def hear(self, message: Any) -> None:
        """Over the wire and back, so that it is what a parser makes of it."""
        self.link.inbox = mavlink.MAVLink(None).parse_buffer(message.pack(self._client)) or []
        self.session.hear()

    def run(self, seconds: float) -> list[Any]:
        self.link.sent.clear()
        for _ in range(round(seconds / 0.004)):
            self.vehicle.step()
            self.session.say()
        return self.link.sent

    def command(self, number: int, *parameters: float) -> int:
        values = [*parameters, *([0.0] * (7 - len(parameters)))]
        self.hear(mavlink.MAVLink_command_long_message(1, 1, number, 0, *values))
        acks = [m for m in self.run(0.02) if m.get_type() == "COMMAND_ACK"]
        return int(acks[0].result)


@pytest.fixture
def talk() -> Talk:
    return Talk()


def kinds(messages: list[Any]) -> list[str]:
    return [message.get_type() for message in messages]


@pytest.mark.parametrize(
    ("number", "parameters", "result"),
    [
        (400, (1.0,), 1),  # no position
        (400, (0.0,), 0),
        (22, (0.0,), 0),  # accepted though disarmed, as recorded in px4-1.18_late_origin
        (512, (148.0,), 0),
        (512, (9999.0,), 2),
        (511, (9999.0, 1e5), 4),  # README of the recordings, point 13
        (511, (30.0, 1e5), 0),
        (511, (0.0, 1e5), 4),  # its heartbeat takes no rate (mavlink_receiver.cpp)
        (31000, (), 3),
        (176, (1.0, 4.0, 3.0), 0),
        (176, (1.0, 9.0, 0.0), 1),
        (179, (1.0,), 1),  # no global position
        (246, (1.0,), 0),
    ],
)
def test_a_command_gets_px4s_result(
    talk: Talk, number: int, parameters: tuple[float, ...], result: int
) -> None:
    assert talk.command(number, *parameters) == result


def test_an_acknowledgement_takes_8_ms_and_names_its_asker(talk: Talk) -> None:
    talk.hear(mavlink.MAVLink_command_long_message(1, 1, 512, 0, 148, *([0] * 6)))
    assert "COMMAND_ACK" not in kinds(talk.run(0.008))
    acks = [m for m in talk.run(0.008) if m.get_type() == "COMMAND_ACK"]
    assert (acks[0].target_system, acks[0].target_component) == (1, 191)


def test_a_message_for_another_system_is_not_ours(talk: Talk) -> None:
    talk.hear(mavlink.MAVLink_command_long_message(7, 1, 400, 0, 1, 21196, *([0] * 5)))
    talk.run(0.02)
    assert not talk.vehicle.commander.armed


def test_force_arms_without_checks(talk: Talk) -> None:
    assert talk.command(400, 1.0, 21196.0) == 0
    assert talk.vehicle.commander.armed


def test_an_origin_that_comes_while_vision_is_fused_throws_the_position_away(talk: Talk) -> None:
    """Stepped by hand: vision that pauses for 0.2 s is not fused, and a busy machine pauses."""
    nothing, covariance = (math.nan,) * 3, [0.25] + [0.0] * 20
    for _ in range(120):
        talk.hear(
            mavlink.MAVLink_vision_position_estimate_message(0, 0, 0, 0, *nothing, covariance, 0)
        )
        talk.run(1 / 30)
    talk.hear(mavlink.MAVLink_set_gps_global_origin_message(1, 411000000, 290000000, 40000))
    told = [m for m in talk.run(0.5) if m.get_type() == "LOCAL_POSITION_NED"]
    assert abs(told[-1].x) > 1e6
    assert talk.command(400, 1.0) == 1


def test_current_mode_comes_twice_a_second_and_when_it_changes(talk: Talk) -> None:
    """With a new vehicle_status, however often it is asked for."""
    assert talk.command(511, 436, 1e5) == 0
    assert kinds(talk.run(4.0)).count("CURRENT_MODE") == pytest.approx(8, abs=1)
    assert kinds(talk.run(4.0)).count("HEARTBEAT") == pytest.approx(4, abs=1)
    talk.command(176, 1.0, 3.0)
    assert "CURRENT_MODE" in kinds(talk.run(0.1))


@pytest.mark.parametrize(("interval_us", "rate"), [(4000, 250), (5000, 125), (100, 250), (-1, 0)])
def test_rates_are_divided_from_250_hz(talk: Talk, interval_us: float, rate: int) -> None:
    assert talk.command(511, 105, interval_us) == 0
    assert kinds(talk.run(1.0)).count("HIGHRES_IMU") == pytest.approx(rate, abs=1)


def test_interval_0_is_the_default_rate_again(talk: Talk) -> None:
    talk.command(511, 30, 1e6)
    talk.command(511, 30, 0)
    assert kinds(talk.run(1.0)).count("ATTITUDE") == pytest.approx(100, abs=1)


def test_texts_wait_for_a_ground_station_and_long_ones_come_in_chunks(talk: Talk) -> None:
    talk.command(400, 1.0)
    assert "STATUSTEXT" not in kinds(talk.run(0.1))
    talk.link.gcs_heard_s = talk.vehicle.t_s
    texts = [m for m in talk.run(0.1) if m.get_type() == "STATUSTEXT"]
    assert [m.text for m in texts] == ["Arming denied: Resolve system health failures firs", "t"]
    assert [m.chunk_seq for m in texts] == [0, 1]
    assert texts[0].id == texts[1].id > 0


def test_it_answers_and_asks_timesync(talk: Talk) -> None:
    talk.run(1.0)
    talk.link.sent.clear()
    talk.hear(mavlink.MAVLink_timesync_message(0, 12345))
    answer = talk.link.sent[0]
    assert (answer.ts1, answer.tc1) == (12345, round(talk.vehicle.t_s * 1e9))
    asked = [m for m in talk.run(1.0) if m.get_type() == "TIMESYNC"]
    assert len(asked) == pytest.approx(10, abs=1)


def test_all_parameters_come_once_and_end_with_the_hash(talk: Talk) -> None:
    talk.hear(mavlink.MAVLink_param_request_list_message(1, 1))
    values = [m for m in talk.run(1.0) if m.get_type() == "PARAM_VALUE"]
    count = len(talk.vehicle.parameters)
    assert [m.param_index for m in values] == [*range(count), 65535]
    assert values[-1].param_id.rstrip("\0") == "_HASH_CHECK"
    assert {m.param_count for m in values} == {count}


def test_a_parameter_is_read_by_name_and_by_index_and_set(talk: Talk) -> None:
    index = talk.vehicle.parameters.names.index("MIS_TAKEOFF_ALT")
    for name, wanted in ((b"MIS_TAKEOFF_ALT", -1), (b"", index)):
        talk.hear(mavlink.MAVLink_param_request_read_message(1, 1, name, wanted))
    talk.hear(mavlink.MAVLink_param_set_message(1, 1, b"MIS_TAKEOFF_ALT", 7.5, 9))
    talk.hear(mavlink.MAVLink_param_set_message(1, 1, b"NO_SUCH_THING", 7.5, 9))
    values = [m.param_value for m in talk.link.sent if m.get_type() == "PARAM_VALUE"]
    assert values == [2.5, 2.5, 7.5]


def test_a_reboot_keeps_parameters_and_waits_for_its_acknowledgement(talk: Talk) -> None:
    talk.hear(mavlink.MAVLink_command_long_message(1, 1, 246, 0, 1, *([0] * 6)))
    assert not talk.session.reboot_wanted
    talk.run(0.02)
    assert talk.session.reboot_wanted


def test_the_stamps_of_a_synchronised_companion_are_believed() -> None:
    sync = TimesyncFilter()
    for i in range(30):
        now_ns = 1_000_000_000 + 100_000_000 * i
        sync.handle_answer(now_ns - 200_000, now_ns + 5_000_000_000, now_ns)
    now_s = 4.0
    assert sync.own_s(round((now_s - 0.08 + 5.0) * 1e6), now_s) == pytest.approx(3.92, abs=1e-3)
    assert sync.own_s(0, now_s) == now_s
    assert TimesyncFilter().own_s(1, now_s) == now_s


@pytest.mark.parametrize("url", ["", "udpin", "serial:/dev/x", "udpin:host", "udpout:h:99999"])
def test_a_url_that_is_none_is_refused(url: str) -> None:
    with pytest.raises(ConfigError):
        parse_url(url)


def command_messages() -> st.SearchStrategy[Any]:
    values = st.lists(FLOAT, min_size=7, max_size=7)
    place = st.integers(-(2**31), 2**31 - 1)
    number = st.sampled_from(COMMANDS)
    return st.one_of(
        st.builds(
            lambda n, v: mavlink.MAVLink_command_long_message(1, 1, n, 0, *v), number, values
        ),
        st.builds(
            lambda n, v, x, y: mavlink.MAVLink_command_int_message(
                1, 1, 0, n, 0, 0, *v[:4], x, y, v[4]
            ),
            number,
            values,
            place,
            place,
        ),
    )


def data_messages() -> st.SearchStrategy[Any]:
    def f(count: int) -> st.SearchStrategy[list[float]]:
        return st.lists(FLOAT, min_size=count, max_size=count)

    small, byte = st.integers(-(2**15), 2**15 - 1), st.integers(0, 255)
    names = st.sampled_from([b"MPC_THR_HOVER", b"EKF2_EVP_GATE", b"RTL_CONE_ANG", b"EKF2_EV_CTRL"])
    return st.one_of(
        st.builds(
            lambda frame, mask, v: mavlink.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, frame, mask, *v
            ),
            st.sampled_from([1, 7, 8, 9, 20]),
            st.integers(0, 65535),
            f(11),
        ),
        st.builds(
            lambda v, c, r: mavlink.MAVLink_vision_position_estimate_message(0, *v, c, r),
            f(6), f(21), byte,
        ),
        st.builds(
            lambda v, q, w, c: mavlink.MAVLink_odometry_message(
                0, 20, 12, *v, q, *w, c, c, 0, 0, 50
            ),
            f(3), f(4), f(6), f(21),
        ),
        st.builds(lambda v: mavlink.MAVLink_manual_control_message(1, *v, 0),
                  st.lists(small, min_size=4, max_size=4)),
        st.builds(
            lambda v: mavlink.MAVLink_rc_channels_override_message(1, 1, *v),
            st.lists(st.integers(0, 65535), min_size=8, max_size=8),
        ),
        st.builds(
            lambda n, v, k: mavlink.MAVLink_param_set_message(1, 1, n, v, k),
            names, FLOAT, st.sampled_from([6, 9]),
        ),
        st.builds(
            lambda a, b, c: mavlink.MAVLink_set_gps_global_origin_message(1, a, b, c),
            *([st.integers(-(2**31), 2**31 - 1)] * 3),
        ),
    )  # fmt: skip


@settings(
    max_examples=40,
    deadline=None,
    phases=(Phase.generate,),
    suppress_health_check=list(HealthCheck),
)
@given(st.lists(command_messages() | data_messages(), min_size=5, max_size=40))
def test_no_message_can_bring_it_down(messages: list[Any]) -> None:
    talk = Talk()
    talk.command(400, 1.0, 21196.0)
    for message in messages:
        talk.hear(message)
        talk.run(0.06)
    for build in PX4_BUILDERS.values():
        built = build(talk.vehicle)
        if built is not None:
            talk.link.send(built)
