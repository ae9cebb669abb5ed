"""A navigator that lives and is of no use is ended where a second one stands by; nobody else is."""

import pytest
from link_peer import PX4_POSITION
from test_loop import TICK_S, Memory, Second, Stand, estimate, names, setpoint, texts

from vwnav.machine.silence import Silence
from vwnav.watchdog.loop import Watchdog, WatchdogConfig, WatchdogLinks


class Process:
    """Of the navigator."""

    def __init__(self) -> None:
        self.ended = False

    def end(self) -> None:
        self.ended = True


def flying(second: Second | None = None, mode: int | None = None) -> tuple[Stand, Process]:
    """A flight with estimates and a successor, whose navigator can be ended."""
    stand, process = Stand(), Process()
    links = WatchdogLinks(stand.autopilot, stand.navigator, stand.observer, stand.beats)
    second = second if second is not None else Second()
    stand.watchdog = Watchdog(links, WatchdogConfig(), second, process)
    stand.run(1.0, lambda s: s.send(estimate(s.t_s, 8.0 * s.t_s)))
    stand.mode = stand.mode if mode is None else mode
    stand.run(0.4, lambda s: s.send(estimate(s.t_s, 8.0 * s.t_s)))
    return stand, process


def hang(stand: Stand, seconds: float) -> list:
    stand.beating = False
    return stand.run(seconds)


def test_it_is_ended_while_the_aircraft_is_held_and_the_operator_reads_it():
    stand, process = flying()
    hang(stand, 2.9)
    assert not process.ended
    told = [m for m in hang(stand, 0.3) if m.get_type() == "STATUSTEXT"]
    assert [(m.get_srcSystem(), m.text) for m in told] == [
        (7, "vwnav hangs: ended, a second one gives estimates")
    ]
    assert process.ended


@pytest.mark.parametrize("mode", [None, PX4_POSITION])
def test_its_successor_is_woken_then_whoever_flies(mode):
    second = Second()
    stand, process = flying(second, mode)
    hang(stand, 3.2)
    assert process.ended
    stand.watchdog.handle_navigator_end(stand.t_s)
    assert second.steps[-1] is None
    hang(stand, TICK_S)
    assert second.steps[-1] is not None


def test_a_navigator_that_beats_without_estimates_knows_why():
    stand, process = flying()
    stand.run(20.0)
    assert not process.ended


def test_one_whose_mission_broke_is_needed_for_its_estimates():
    stand, process = flying()
    stand.beating = False
    stand.run(20.0, lambda s: s.send(estimate(s.t_s, 8.0 * s.t_s)))
    assert not process.ended


def test_other_messages_are_no_sign_of_life():
    stand, process = flying()
    stand.beating = False
    stand.run(3.2, lambda s: s.send(setpoint(3.0)))
    assert process.ended


def test_on_the_ground_or_disarmed_or_not_heard_nobody_is_ended():
    for change in ("landed", "disarmed", "silent"):
        stand, process = flying()
        stand.landed, stand.armed = change == "landed", change != "disarmed"
        stand.speaks = change != "silent"
        stand.run(4.0)
        hang(stand, 20.0)
        assert not process.ended, change


def test_a_navigator_that_nobody_could_follow_is_left_as_it_is():
    second = Second()
    second.stands_by = False
    stand, process = flying(second)
    hang(stand, 20.0)
    assert not process.ended
    second.stands_by = True
    hang(stand, 3.2)
    assert process.ended


def test_the_watchdogs_own_sleep_is_not_the_navigators_silence():
    """The machine was suspended, or starved: the navigator gets its turn after it."""
    stand, process = flying()
    stand.t_s += 30.0
    stand.speaks = True
    stand.beating = False
    stand.run(2.0)
    stand.beating = True
    stand.run(0.1)
    assert not process.ended


def test_a_watchdog_that_never_heard_a_beat_ends_nobody():
    stand, process = Stand(), Process()
    links = WatchdogLinks(stand.autopilot, stand.navigator, stand.observer, Memory())
    stand.watchdog = Watchdog(links, WatchdogConfig(), Second(), process)
    hang(stand, 20.0)
    assert not process.ended


def test_a_successors_beats_are_told_from_the_navigators():
    second = Second()
    stand, _ = flying(second)
    assert second.beats == 0
    stand.watchdog.handle_navigator_end(stand.t_s)
    passed = stand.run(1.0, lambda s: s.send(setpoint(3.0)))
    assert second.beats == 50
    assert {m.vx for m in passed if "vx" in m.get_fieldnames()} == {0.0}
    assert "VISION_POSITION_ESTIMATE" not in names(passed)


def test_silence_is_counted_awake():
    silence = Silence()
    for t_s in (5.0, 5.1, 5.2, 35.2, 35.3):
        silence.listen(t_s)
    assert silence.waking_s == pytest.approx(0.5)
    silence.end()
    assert silence.waking_s == 0.0


def test_one_that_says_that_it_ends_and_stays_is_ended_after_a_second():
    """It has the camera. The second one has been woken by then."""
    stand, process = flying()
    stand.keepalive.leave()
    hang(stand, 0.9)
    assert not process.ended
    hang(stand, 0.2)
    assert process.ended


def test_one_that_ends_as_it_says_is_not_ended_by_others():
    stand, process = flying()
    stand.keepalive.leave()
    hang(stand, 0.5)
    stand.watchdog.handle_navigator_end(stand.t_s)
    told = hang(stand, 5.0)
    assert not process.ended
    # And not that it hangs.
    assert texts(told) == ["vwnav ended: holding, then landing", "vwnav ended: landing"]
