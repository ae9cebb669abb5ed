"""The datagrams between the control loop and the watchdog."""

import math
import struct
from collections import deque
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.errors import LinkError
from vwnav.vehicle import FoundCamera, Learned
from vwnav.watchdog.keepalive import (
    Beat,
    GuardState,
    KeepAlive,
    UdpChannel,
    WatchdogReport,
)

FINITE = st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=80).map(tuple)
NUMBER = st.floats(allow_nan=False, allow_infinity=False)
CAMERAS = st.builds(FoundCamera, NUMBER, NUMBER, st.tuples(*[NUMBER] * 9), NUMBER)
BEATS = st.builds(
    Beat,
    st.booleans(),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**64 - 1),
    st.text("abc xyz", max_size=16),
    st.booleans(),
    st.none() | st.builds(Learned, st.floats(0.0, 1e9), FINITE, FINITE, st.none() | CAMERAS),
    st.integers(0, 255),
)
REPORTS = st.builds(
    WatchdogReport,
    st.sampled_from(GuardState),
    st.integers(0, 2**32 - 1),
    st.floats(0.0, 1e6, width=32),
    st.booleans(),
    st.integers(0, 2**32 - 1),
    st.booleans(),
)


@given(BEATS)
def test_a_beat_arrives_as_it_was_sent(beat):
    assert Beat.unpack(beat.pack()) == beat


def test_a_beat_tells_whom_the_navigator_follows(alive):
    keepalive, channel, _ = alive
    keepalive.beat(True)
    keepalive.system_id = 7
    keepalive.beat(True)
    assert [beat.system_id for beat in channel.sent] == [0, 7]


@given(REPORTS)
def test_a_report_arrives_as_it_was_sent(report):
    assert WatchdogReport.unpack(report.pack()) == report


@given(st.binary(max_size=60))
def test_what_is_no_datagram_of_ours_is_none(data):
    assert Beat.unpack(data) is None
    assert WatchdogReport.unpack(data) is None


def test_another_length_or_beginning_is_none():
    beat = Beat(True, 1, 2, "on route").pack()
    report = WatchdogReport(GuardState.RELAY, 1, 0.5).pack()
    for unpack, data in ((Beat.unpack, beat), (WatchdogReport.unpack, report)):
        assert unpack(data) is not None
        assert unpack(data[:-1]) is None
        assert unpack(data + b"\0") is None
        assert unpack(b"X" + data[1:]) is None


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_what_was_learned_costs_no_beat_where_it_is_no_number(number):
    beat = Beat(True, 1, 2, "on route", learned=Learned(5.0, (0.1, 0.2), (1.0, 0.0, 1.0)))
    whole = beat.pack()
    assert Beat.unpack(whole) == beat
    assert Beat.unpack(whole[:-1]) is None
    assert Beat.unpack(whole + b"\0") is None
    assert Beat.unpack(whole[:-8] + struct.pack("<d", number)) == replace(beat, learned=None)


def test_what_does_not_fit_into_a_beat_is_cut():
    beat = Beat.unpack(Beat(False, 2**32 + 5, 1, "waiting für a fix for long").pack())
    assert beat == Beat(False, 5, 1, "waiting f?r a fi")


class Channel:
    """Notes what is sent; answers what it is told to."""

    def __init__(self) -> None:
        self.sent: list[Beat | None] = []
        self.answers: deque[bytes] = deque()
        self.closed = False

    def send(self, data: bytes) -> None:
        self.sent.append(Beat.unpack(data))

    def receive(self) -> bytes:
        return self.answers.popleft() if self.answers else b""

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def alive():
    now = [100.0]
    channel = Channel()
    return KeepAlive(channel, lambda: now[0]), channel, now


def test_beats_are_counted_and_their_claim_grows_only_by_rejoining(alive):
    keepalive, channel, now = alive
    keepalive.beat(True, "climbing")
    keepalive.beat(False)
    now[0] = 99.0  # whatever the clock does
    keepalive.rejoin()
    keepalive.beat(True)
    first, second, third = channel.sent
    assert (first.sequence, second.sequence, third.sequence) == (1, 2, 3)
    assert (first.engaged, first.phase, second.engaged) == (True, "climbing", False)
    assert second.epoch == first.epoch == 100 * 10**9
    assert third.epoch == first.epoch + 1


def test_another_process_later_has_a_newer_claim(alive):
    keepalive, channel, now = alive
    keepalive.beat(True)
    now[0] = 101.0
    KeepAlive(channel, lambda: now[0]).beat(True)
    assert channel.sent[1].epoch == 101 * 10**9


def test_what_is_no_report_is_none(alive):
    keepalive, channel, _ = alive
    keepalive.beat(True)
    assert keepalive.report is None
    channel.answers.append(b"noise")
    assert keepalive.report is None
    report = WatchdogReport(GuardState.HOLDING, 2, 0.5, False)
    channel.answers.append(report.pack())
    assert keepalive.report == report


def test_an_answer_is_of_its_time(alive):
    """A mission that breaks beats no more; its last answer was held to be of now for good."""
    keepalive, channel, now = alive
    keepalive.beat(True)
    channel.answers.append(WatchdogReport(GuardState.RELAY, 1, 0.5, False).pack())
    assert keepalive.report is not None
    now[0] += 1.1
    assert keepalive.report is None
    assert keepalive.last_report is not None
    channel.answers.append(WatchdogReport(GuardState.RELAY, 2, 0.5).pack())
    assert keepalive.report is not None


def test_a_watchdog_is_blamed_for_many_beats_without_an_answer(alive):
    keepalive, channel, now = alive
    assert keepalive.unanswered_s == 0.0
    for _ in range(60):
        keepalive.beat(True)
        now[0] += 0.05
    assert keepalive.unanswered_s == pytest.approx(3.0)
    channel.answers.append(WatchdogReport(GuardState.RELAY, 60, 0.1, True).pack())
    keepalive.beat(True)
    assert keepalive.unanswered_s == 0.0


def test_a_loop_that_slept_does_not_blame_the_watchdog(alive):
    keepalive, _, now = alive
    keepalive.beat(True)
    now[0] += 60.0
    assert keepalive.unanswered_s == 0.0
    keepalive.beat(True)
    assert keepalive.unanswered_s == 0.0


def test_the_last_word_is_that_it_ends(alive):
    keepalive, channel, _ = alive
    keepalive.beat(True)
    keepalive.close()
    assert channel.sent[-1] == Beat(False, 2, channel.sent[0].epoch, "ended", ended=True)
    assert channel.closed


def test_the_watchdogs_end_answers_whoever_spoke_last_and_a_taken_port_is_said():
    listening = UdpChannel(0, listens=True)
    listening.send(b"to nobody yet")
    assert listening.receive() == b""
    one, other = (UdpChannel(listening.port, listens=False) for _ in range(2))
    for each in (one, other):
        each.send(b"beat")
        assert listening.receive() == b"beat"
        listening.send(b"report")
        assert each.receive() == b"report"
    assert one.receive() == b""
    with pytest.raises(LinkError, match=f"port {listening.port} of this machine"):
        UdpChannel(listening.port, listens=True)
    for each in (one, other, listening):
        assert each.fileno() >= 0
        each.close()
    assert listening.fileno() == -1


def test_a_beat_whose_phase_is_no_text_is_a_beat():
    data = Beat(True, 1, 2, "on route").pack().replace(b"route", b"\xff\xfe\xfd\xfc\xfb")
    beat = Beat.unpack(data)
    assert (beat.engaged, beat.sequence, beat.epoch) == (True, 1, 2)
    assert beat.phase.startswith("on ")
