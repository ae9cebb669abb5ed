"""The watchdog over links in memory, step by step, with a clock that the test owns."""

import math
import pickle
from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link_peer import (
    COPTER_GUIDED,
    COPTER_LAND,
    COPTER_LOITER,
    IN_AIR,
    PX4_LAND,
    PX4_OFFBOARD,
    PX4_POSITION,
)
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.watchdog.keepalive import GuardState, KeepAlive
from vwnav.watchdog.loop import Known, Watchdog, WatchdogConfig, WatchdogLinks
from vwnav.watchdog.successor import Resume

AUTOPILOT = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
NAVIGATOR = mavlink.MAVLink(None, srcSystem=7, srcComponent=191)
PX4, COPTER = mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
TICK_S = 0.02


class Memory:
    """One end of a link, or of the beats."""

    def __init__(self) -> None:
        self.arriving: deque[bytes] = deque()
        self.written: list[bytes] = []
        self.closed, self.room = False, True

    def fileno(self) -> int:
        return -1

    def read(self) -> bytes:
        return self.arriving.popleft() if self.arriving else b""

    def has_room(self) -> bool:
        return self.room

    def write(self, data: bytes) -> None:
        self.written.append(data)

    receive, send = read, write

    def close(self) -> None:
        self.closed = True


class Stand:
    """A watchdog, an autopilot that says what it is told to say, and a navigator."""

    def __init__(self, kind: int = PX4, successor=None, config=None) -> None:
        self.t_s, self.kind = 100.0, kind
        self.autopilot, self.navigator, self.observer = Memory(), Memory(), Memory()
        self.beats, self.loop = Memory(), Memory()
        self.loop.arriving, self.loop.written = self.beats.written, self.beats.arriving
        self.beats.written = self.loop.arriving = deque()
        self.keepalive = KeepAlive(self.loop, lambda: self.t_s)
        self._config, self._successor = config or WatchdogConfig(), successor
        self.watchdog = self._watchdog(None)
        self.mode = PX4_OFFBOARD if kind == PX4 else COPTER_GUIDED
        self.armed, self.landed, self.beating, self.engaged = True, False, True, True
        self._heard = 0
        self.speaks = True

    def _watchdog(self, known: Known | None) -> Watchdog:
        links = WatchdogLinks(self.autopilot, self.navigator, self.observer, self.beats)
        return Watchdog(links, self._config, self._successor, known=known)

    def replace(self) -> None:
        """By a spare one, as a process is told what the one before knew."""
        known = pickle.loads(pickle.dumps(self.watchdog.known))
        self.watchdog = self._watchdog(known.pass_on(self.t_s))

    def say(self, message) -> None:
        self.autopilot.arriving.append(bytes(message.pack(AUTOPILOT)))

    def send(self, message) -> None:
        self.navigator.arriving.append(bytes(message.pack(NAVIGATOR)))

    def run(self, seconds: float, each=lambda stand: None) -> list:
        """What reaches the autopilot meanwhile; `each` is called before every step."""
        start = len(self.autopilot.written)
        for i in range(round(seconds / TICK_S)):
            self.t_s += TICK_S
            if i % 10 == 0 and self.speaks:
                self._speak()
            if self.beating:
                self.keepalive.beat(self.engaged, "on route")
            each(self)
            self.watchdog.step(self.t_s)
            self._obey()
        return parsed(self.autopilot.written[start:])

    def _speak(self) -> None:
        mode = 1 | (128 if self.armed else 0)
        self.say(mavlink.MAVLink_heartbeat_message(2, self.kind, mode, self.mode, 4, 3))
        state = 1 if self.landed else IN_AIR
        self.say(mavlink.MAVLink_extended_sys_state_message(0, state))

    def _obey(self) -> None:
        news, self._heard = self.autopilot.written[self._heard :], len(self.autopilot.written)
        for message in parsed(news):
            if message.get_type() != "COMMAND_LONG" or message.command != 176:
                continue
            main, sub = message.param2, message.param3
            if 0.0 <= main <= 255.0 and 0.0 <= sub <= 255.0:  # no NaN either
                px4 = int(main) << 16 | int(sub) << 24
                self.mode = px4 if self.kind == PX4 else int(main)


def parsed(packets) -> list:
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    return [m for p in packets for m in parser.parse_buffer(p) or []]


def names(messages) -> list[str]:
    return [m.get_type() for m in messages]


def setpoint(north_m_s: float):
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, 7, 1, 1, 2503, 0, 0, 0, north_m_s, *[0] * 7
    )


def estimate(t_s: float, north_m: float = 0.0, counter: int = 0, sigma_m: float = 0.5):
    usec = int(t_s * 1e6)
    place, covariance = (north_m, 0.0, -50.0, 0.0, 0.0, 0.0), [sigma_m**2] * 21
    return mavlink.MAVLink_vision_position_estimate_message(usec, *place, covariance, counter)


def land(kind: int):
    numbers = (4.0, 6.0) if kind == PX4 else (float(COPTER_LAND), 0.0)
    return mavlink.MAVLink_command_long_message(7, 1, 176, 0, 1.0, *numbers, *[0.0] * 4)


def engaged(kind: int = PX4, successor=None) -> Stand:
    stand = Stand(kind, successor)
    stand.run(1.0, lambda s: s.send(estimate(s.t_s, 8.0 * s.t_s)))
    return stand


def spare() -> Stand:
    """In the place of one that died in flight; the autopilot is silent."""
    stand = engaged()
    stand.speaks = False
    stand.replace()
    return stand


def fly(stand: Stand) -> None:
    stand.send(estimate(stand.t_s, 8.0 * stand.t_s))
    stand.send(setpoint(3.0))


def test_it_hands_on_both_ways():
    stand = engaged()
    passed = stand.run(0.1, lambda s: s.send(setpoint(3.0)))
    assert [m.vx for m in passed] == [3.0] * 5
    assert set(names(parsed(stand.navigator.written))) == {"HEARTBEAT", "EXTENDED_SYS_STATE"}


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_silence_ends_in_a_landing_and_the_word_of_ending_changes_nothing_of_it(kind):
    stand = engaged(kind)
    stand.beating = False
    stand.keepalive.close()
    sent = stand.run(6.0)
    assert names(sent)[0] == "SET_POSITION_TARGET_LOCAL_NED"
    assert [m for m in sent if m.get_type() == "COMMAND_LONG"][-1].param2 == land(kind).param2
    assert not stand.watchdog.finished
    stand.armed = False
    stand.run(1.0)
    assert stand.watchdog.finished


def texts(messages) -> list[str]:
    return [m.text for m in messages if m.get_type() == "STATUSTEXT"]


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_an_operator_reads_what_it_does_without_the_navigator(kind):
    """Of a navigator that was killed nobody else would tell."""
    stand = engaged(kind)
    stand.beating = False
    stand.watchdog.handle_navigator_end(stand.t_s)
    assert texts(stand.run(4.0)) == [
        "vwnav ended: braking",
        "vwnav ended: holding, then landing",
        "vwnav ended: landing",
    ]
    stand.mode = PX4_POSITION if kind == PX4 else COPTER_LOITER
    assert texts(stand.run(1.0)) == ["vwnav ended: another mode flies"]


def test_what_happens_to_it_on_the_ground_is_not_told():
    stand = engaged()
    stand.beating = False
    told = texts(stand.run(5.0))
    assert told[0] == "vwnav is silent: braking"
    stand.landed = True
    stand.run(1.0)
    stand.mode = PX4_POSITION
    assert texts(stand.run(1.0)) == []


def test_it_leaves_when_the_navigator_has_ended_and_a_person_flies():
    stand = engaged()
    stand.mode = PX4_POSITION
    stand.run(0.4)
    stand.keepalive.close()
    stand.beating = False
    sent = stand.run(1.0)
    assert (names(sent), texts(sent)) == (["STATUSTEXT"], ["vwnav ended: another mode flies"])
    assert stand.watchdog.finished


def test_it_does_not_leave_on_the_word_of_a_heartbeat_from_before_the_end():
    stand = Stand()
    stand.armed = False
    stand.run(1.0)
    stand.armed = True
    stand.beating = False
    stand.watchdog.handle_navigator_end(stand.t_s)
    stand.watchdog.step(stand.t_s)
    assert not stand.watchdog.finished
    stand.run(1.0)
    assert not stand.watchdog.finished


def test_it_leaves_at_once_where_no_autopilot_was_ever_heard():
    stand = Stand()
    stand.watchdog.handle_navigator_end(stand.t_s)
    stand.watchdog.step(stand.t_s)
    assert stand.watchdog.finished


def test_nobody_that_never_engaged_is_landed():
    stand = Stand()
    stand.engaged = False
    stand.run(1.0)
    stand.beating = False
    stand.watchdog.handle_navigator_end(stand.t_s)
    assert stand.run(1.0) == []
    assert stand.watchdog.finished


def test_good_estimates_go_on_after_a_takeover_and_setpoints_do_not():
    stand = engaged()
    stand.beating = False

    def flies_on(s: Stand) -> None:
        s.send(setpoint(3.0))
        s.send(estimate(s.t_s, 8.0 * s.t_s))

    stand.run(1.0, flies_on)
    assert stand.watchdog.state is GuardState.BRAKING
    passed = names(m for m in stand.run(0.4, flies_on) if not getattr(m, "vx", 0.0))
    assert passed.count("VISION_POSITION_ESTIMATE") == 20


def test_a_navigator_that_slept_for_20_s_streams_nothing_into_the_autopilot():
    stand = engaged()
    stand.beating = False
    stand.run(20.0)
    stand.beating = True
    passed = stand.run(10.0, lambda s: s.send(estimate(s.t_s, 8.0 * s.t_s)))
    assert "VISION_POSITION_ESTIMATE" not in names(passed)
    assert not stand.keepalive.report.relays_estimates
    passed = stand.run(2.0, lambda s: s.send(estimate(s.t_s, 3.0, counter=1)))
    assert names(passed).count("VISION_POSITION_ESTIMATE") > 70
    assert stand.keepalive.report.relays_estimates


def test_after_a_cut_of_the_link_an_estimate_has_to_come_as_a_new_one():
    stand = engaged()
    stand.speaks = False
    passed = stand.run(5.0, lambda s: s.send(estimate(s.t_s, 8.0 * s.t_s)))
    assert 40 < names(passed).count("VISION_POSITION_ESTIMATE") < 70  # 1.2 s of 5 s
    stand.speaks = True
    passed = stand.run(3.0, lambda s: s.send(estimate(s.t_s, 8.0 * s.t_s)))
    assert "VISION_POSITION_ESTIMATE" not in names(passed)
    assert "VISION_POSITION_ESTIMATE" in names(
        stand.run(1.0, lambda s: s.send(estimate(s.t_s, 3.0, counter=1)))
    )


def steering(kind: int):
    """A navigator that flies on, and wants to land."""

    def each(stand: Stand) -> None:
        stand.send(setpoint(3.0))
        stand.send(land(kind))

    return each


def steered(messages) -> list[str]:
    return [n for n in names(messages) if n in ("SET_POSITION_TARGET_LOCAL_NED", "COMMAND_LONG")]


@pytest.mark.parametrize("kind", [PX4, COPTER])
@pytest.mark.parametrize("cut_s", [1.4, 5.0])
def test_after_a_cut_nobody_steers_until_the_mode_is_known_again(kind, cut_s):
    stand = engaged(kind)
    stand.speaks = False
    stand.run(cut_s, steering(kind))
    stand.mode = PX4_POSITION if kind == PX4 else 5  # Loiter: a person took it meanwhile
    stand.say(mavlink.MAVLink_attitude_message(1, *[0.0] * 6))
    assert steered(stand.run(0.4, steering(kind))) == []
    stand.speaks = True

    def sees_it(s: Stand) -> None:  # the navigator has heard it too, and takes a moment
        if s.t_s < heard_s + 0.4:
            steering(kind)(s)

    heard_s = stand.t_s
    assert steered(stand.run(3.0, sees_it)) == []
    assert stand.mode in (PX4_POSITION, 5)


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_after_a_cut_it_steers_on_in_the_mode_that_was_flown_before(kind):
    stand = engaged(kind)
    stand.speaks = False
    stand.run(3.0, lambda s: s.send(setpoint(3.0)))
    stand.speaks = True
    assert steered(stand.run(0.2, lambda s: s.send(setpoint(3.0))))


@pytest.mark.parametrize("kind", [PX4, COPTER])
def test_a_navigator_that_ends_in_a_cut_leaves_the_aircraft_to_the_person_who_took_it(kind):
    stand = engaged(kind)
    stand.speaks = stand.beating = False
    stand.watchdog.handle_navigator_end(stand.t_s)
    stand.run(4.0)
    taken = PX4_POSITION if kind == PX4 else 5
    stand.mode, stand.speaks = taken, True
    assert steered(stand.run(8.0)) == []
    assert stand.mode == taken


def test_an_observer_may_not_tell_the_autopilot_where_it_is():
    stand = engaged()
    for message in (estimate(stand.t_s), setpoint(9.0), land(PX4)):
        stand.observer.arriving.append(bytes(message.pack(NAVIGATOR)))
    assert stand.run(0.1) == []


def test_rtl_on_arducopter_passes_from_a_navigator_that_lost_the_aircraft():
    stand = engaged(COPTER)
    stand.beating = False
    stand.run(0.8)
    rtl = mavlink.MAVLink_command_long_message(7, 1, 176, 0, 1.0, 6.0, *[0.0] * 5)
    stand.send(rtl)
    passed = [m for m in stand.run(0.1) if m.get_type() == "COMMAND_LONG"]
    assert [m.param2 for m in passed] == [6.0]
    stand.run(3.0)
    assert stand.watchdog.state is GuardState.STOOD_DOWN


def test_after_touch_down_no_second_land_is_asked_for():
    stand = engaged()
    stand.beating = False
    stand.run(5.0)
    assert stand.mode == PX4_LAND
    stand.landed = True
    stand.run(0.4)
    stand.mode = (4 << 16) | (3 << 24)  # PX4 goes to Hold before it disarms
    assert stand.run(2.0) == []
    stand.armed = False
    assert stand.run(1.0) == []


def test_a_full_link_keeps_the_newest_and_the_land_goes_first():
    stand = engaged()
    stand.autopilot.room = False
    stand.run(3.0, lambda s: s.send(setpoint(s.t_s)))
    stand.send(land(PX4))
    stand.run(0.1, lambda s: s.send(setpoint(s.t_s)))
    stand.autopilot.room = True
    sent = stand.run(TICK_S)
    assert names(sent) == ["COMMAND_LONG", "SET_POSITION_TARGET_LOCAL_NED"]
    assert sent[1].vx == pytest.approx(stand.t_s, abs=0.03)


class Second:
    """A successor that notes when it is needed."""

    def __init__(self) -> None:
        self.steps: list[Resume | None] = []
        self.closed, self.stands_by = False, True
        self.beats = 0

    def handle_beat(self) -> None:
        self.beats += 1

    def step(self, resume, t_s) -> None:
        self.steps.append(resume)

    def close(self) -> None:
        self.closed = True


def test_a_successor_is_kept_ready_and_woken_with_the_last_good_estimate():
    second = Second()
    stand = engaged(successor=second)
    stand.say(mavlink.MAVLink_gps_global_origin_message(411000000, 290000000, 40000))
    stand.run(0.5, lambda s: s.send(estimate(s.t_s, 8.0 * s.t_s, sigma_m=0.7)))
    assert second.steps[-1] is None
    stand.beating = False
    stand.watchdog.handle_navigator_end(stand.t_s)
    stand.run(TICK_S)
    resume = second.steps[-1]
    assert resume.position.t_s == pytest.approx(stand.t_s, abs=0.03)
    assert resume.position.position_ned_m[0] == pytest.approx(8.0 * stand.t_s, abs=0.4)
    assert resume.position.sigma_m == pytest.approx(0.7)
    assert resume.velocity_ne_m_s == pytest.approx((8.0, 0.0), abs=0.1)
    assert resume.origin.lat_deg == pytest.approx(41.1)


def test_the_successor_gives_estimates_and_never_flies():
    stand = engaged(successor=Second())
    stand.beating = False
    stand.watchdog.handle_navigator_end(stand.t_s)
    stand.run(2.0)

    def succeeds(s: Stand) -> None:
        s.send(estimate(s.t_s, 3.0, counter=1))
        for message in (setpoint(5.0), mavlink.MAVLink_set_mode_message(7, 1, PX4_OFFBOARD)):
            s.send(message)

    passed = stand.run(5.0, succeeds)
    assert names(passed).count("VISION_POSITION_ESTIMATE") > 200
    assert {m.vx for m in passed if m.get_type().startswith("SET_POSITION")} <= {0.0}
    assert "SET_MODE" not in names(passed)
    assert stand.mode == PX4_LAND


def test_with_a_successor_it_stays_while_a_person_flies_on_its_estimates():
    second = Second()
    stand = engaged(successor=second)
    stand.mode = PX4_POSITION
    stand.run(0.4)
    stand.beating = False
    stand.watchdog.handle_navigator_end(stand.t_s)
    stand.run(5.0)
    assert not stand.watchdog.finished
    assert second.steps[-1] is not None
    stand.armed = False
    stand.run(0.5)
    assert stand.watchdog.finished
    stand.watchdog.close()
    assert second.closed


VALUES = st.floats(width=32) | st.just(math.nan)
HOSTILE = st.one_of(
    st.binary(max_size=300),
    st.builds(lambda x: bytes(setpoint(x).pack(NAVIGATOR)), VALUES),
    st.builds(lambda x, t: bytes(estimate(abs(t), x).pack(NAVIGATOR)), VALUES, st.floats(0, 1e9)),
    st.builds(
        lambda number, p: bytes(
            mavlink.MAVLink_command_long_message(7, 1, number, 0, *[p] * 7).pack(NAVIGATOR)
        ),
        st.integers(0, 65535),
        VALUES,
    ),
    st.builds(
        lambda mode, armed: bytes(
            mavlink.MAVLink_heartbeat_message(2, 12, armed, mode, 4, 3).pack(AUTOPILOT)
        ),
        st.integers(0, 2**32 - 1),
        st.sampled_from([1, 129]),
    ),
)


@given(
    st.lists(st.tuples(st.sampled_from(["autopilot", "navigator", "observer", "beats"]), HOSTILE))
)
def test_nothing_that_arrives_can_stop_it(traffic):
    stand = engaged()
    for end, data in traffic:
        getattr(stand, end).arriving.append(data)
        stand.t_s += TICK_S
        stand.watchdog.step(stand.t_s)
    stand.beating = False
    stand.mode = PX4_OFFBOARD
    stand.run(1.0)


def test_an_autopilot_that_was_switched_off_is_not_waited_for():
    stand = engaged()
    stand.beating = False
    stand.watchdog.handle_navigator_end(stand.t_s)
    for _ in range(59):
        stand.t_s += 1.0
        stand.watchdog.step(stand.t_s)
        assert not stand.watchdog.finished
    stand.t_s += 2.0
    stand.watchdog.step(stand.t_s)
    assert stand.watchdog.finished


def spare_without_navigator():
    stand = spare()
    stand.run(0.3)
    stand.beating = False
    stand.watchdog.handle_navigator_end(stand.t_s)
    return stand


def test_a_spare_one_stays_when_the_navigator_ends_before_the_autopilot_is_heard():
    """As where memory is short: both are ended within a second, and the aircraft flies."""
    stand = spare_without_navigator()
    stand.run(10.0)
    assert not stand.watchdog.finished
    stand.speaks = True
    stand.run(2.0)
    assert stand.watchdog.state is GuardState.LANDING
    assert stand.mode == PX4_LAND


def test_a_spare_one_that_never_hears_an_autopilot_leaves_after_a_minute():
    stand = spare_without_navigator()
    stand.run(61.0)
    assert stand.watchdog.finished


@pytest.mark.parametrize(("silent_s", "passes"), [(1.0, True), (8.0, False)])
def test_a_spare_one_that_comes_up_without_the_link_takes_that_for_a_cut(silent_s, passes):
    """What was made while the autopilot heard nothing is not to be the first that it hears."""
    stand = spare()
    stand.autopilot.room = False
    stand.run(silent_s, fly)
    stand.autopilot.room = stand.speaks = True
    heard = names(stand.run(0.4, fly))
    assert ("VISION_POSITION_ESTIMATE" in heard) is passes
    assert ("SET_POSITION_TARGET_LOCAL_NED" in heard) is passes


def test_a_spare_one_knows_no_cut_while_the_autopilot_says_anything():
    """Of two heartbeats one may be lost."""
    stand = spare()
    stand.run(3.0, lambda s: [s.say(mavlink.MAVLink_attitude_message(0, *[0.0] * 6)), fly(s)])
    assert len(names(stand.run(0.4, fly))) == 40


def test_in_the_place_of_one_that_hung_nobody_steers_before_the_mode_is_heard():
    """For two seconds the navigator heard nothing: a pilot may have taken the aircraft."""
    stand = engaged()
    stand.t_s += 2.3
    stand.replace()
    stand.speaks = False
    attitude = mavlink.MAVLink_attitude_message(0, *[0.0] * 6)
    heard = names(stand.run(0.4, lambda s: [s.say(attitude), fly(s)]))
    assert "SET_POSITION_TARGET_LOCAL_NED" not in heard
    stand.speaks, stand.mode = True, PX4_POSITION
    heard = names(stand.run(0.4, fly))  # and half a second, in which the navigator hears it too
    assert "SET_POSITION_TARGET_LOCAL_NED" not in heard
    assert "SET_POSITION_TARGET_LOCAL_NED" in names(stand.run(0.4, fly))


def test_that_nobody_listened_for_long_is_no_silence_of_the_navigators():
    """A watchdog hung for 2 s: the one after it landed an aircraft whose navigator was alive."""
    stand = engaged()
    stand.t_s += 2.3
    stand.replace()
    stand.watchdog.step(stand.t_s)
    assert stand.watchdog.state is GuardState.RELAY
    stand.beating = False
    stand.run(0.4)
    assert stand.watchdog.state is GuardState.RELAY
    stand.run(0.2)
    assert stand.watchdog.state is GuardState.BRAKING


EVENTS = st.lists(
    st.tuples(
        st.floats(0.1, 3.0),
        st.sampled_from(["silent", "beats", "ends", "pilot", "deaf", "heard", "estimates", "down"]),
    ),
    max_size=6,
)


def after(stand: Stand, event: str) -> None:
    match event:
        case "silent" | "beats":
            stand.beating = event == "beats"
        case "ends":
            stand.beating = False
            stand.watchdog.handle_navigator_end(stand.t_s)
        case "pilot":
            stand.mode = PX4_POSITION
        case "deaf" | "heard":
            stand.speaks = event == "heard"
        case "down":
            stand.landed = True


@given(EVENTS, st.integers(0, 5))
def test_a_spare_one_does_what_the_one_before_would_have_done(events, replaced_at):
    """Whatever has happened until then: to the message, and to the state."""
    lives, replaced = engaged(), engaged()
    for number, (seconds, event) in enumerate(events):
        # What a cut has hidden has to sink in, and a silence begins anew.
        is_heard = replaced.speaks and event != "deaf"
        is_heard = is_heard and (replaced.beating or replaced.watchdog.is_acting)
        if number == replaced_at and is_heard:
            replaced.replace()
        told = []
        for stand in lives, replaced:
            after(stand, event)
            each = fly if event == "estimates" else lambda stand: None
            told.append([m.to_dict() for m in stand.run(seconds, each)])
            told.append([stand.watchdog.state, stand.mode, stand.watchdog.finished])
        assert told[:2] == told[2:]
