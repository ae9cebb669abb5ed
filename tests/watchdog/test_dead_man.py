"""The sequence of the dead-man, without processes: silence, zero velocity, Hold, Land."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.vehicle import FlightMode
from vwnav.watchdog.dead_man import DeadMan, DeadManAction, VehicleView
from vwnav.watchdog.keepalive import Beat, GuardState

OFFBOARD = VehicleView(FlightMode.OFFBOARD, True, True)


def beating(mode: FlightMode = FlightMode.OFFBOARD, engaged: bool = True) -> DeadMan:
    guard = DeadMan()
    guard.handle_vehicle(VehicleView(mode, True, True))
    guard.handle_beat(Beat(engaged, 1, 100), 0.0)
    return guard


def run(guard: DeadMan, start_s: float, end_s: float) -> list[tuple[float, DeadManAction]]:
    done = []
    for i in range(int(start_s * 50), int(end_s * 50)):
        action = guard.step(i / 50)
        if action is DeadManAction.HOLD:
            guard.handle_vehicle(VehicleView(FlightMode.HOLD, True, guard.vehicle.position_ok))
        elif action is DeadManAction.LAND:
            guard.handle_vehicle(VehicleView(FlightMode.LAND, True, guard.vehicle.position_ok))
        if action is not None:
            done.append((i / 50, action))
    return done


def test_silence_leads_to_zero_velocity_then_hold_then_land_then_quiet():
    done = run(beating(), 0.0, 20.0)
    kinds = list(dict.fromkeys(action for _, action in done))
    assert kinds == [DeadManAction.ZERO_VELOCITY, DeadManAction.HOLD, DeadManAction.LAND]
    assert 0.5 < done[0][0] < 0.6
    assert [t for t, a in done if a is DeadManAction.HOLD] == [pytest.approx(1.54, abs=0.03)]
    assert done[-1] == (pytest.approx(4.04, abs=0.03), DeadManAction.LAND)


def test_a_beating_navigator_is_left_alone():
    guard = beating()
    for i in range(100):
        guard.handle_beat(Beat(True, i, 100), i * 0.1)
        assert guard.step(i * 0.1 + 0.05) is None


@given(st.sampled_from(FlightMode), st.booleans(), st.booleans())
def test_nothing_is_done_for_a_navigator_that_does_not_claim_the_aircraft(mode, armed, position):
    guard = beating(engaged=False)
    guard.handle_vehicle(VehicleView(mode, armed, position))
    assert run(guard, 0.0, 5.0) == []


@given(st.sampled_from([FlightMode.MANUAL, FlightMode.RETURN, FlightMode.MISSION]), st.floats(0, 8))
def test_whoever_else_takes_the_aircraft_keeps_it(mode, when_s):
    guard = beating()
    run(guard, 0.0, when_s)
    guard.handle_vehicle(VehicleView(mode, True, True))
    assert run(guard, when_s, when_s + 10.0) == []


def test_a_pilot_who_chose_hold_is_not_landed_under():
    guard = beating()
    guard.handle_vehicle(VehicleView(FlightMode.HOLD, True, True))
    assert run(guard, 0.0, 10.0) == []


def test_a_takeoff_without_navigator_is_held_and_landed():
    done = run(beating(FlightMode.TAKEOFF), 0.0, 10.0)
    assert [action for _, action in done] == [DeadManAction.HOLD, DeadManAction.LAND]


def test_a_hold_that_the_navigator_asked_for_ends_in_a_landing():
    done = run(beating(FlightMode.HOLD), 0.0, 10.0)
    assert [action for _, action in done] == [DeadManAction.LAND]


def test_without_a_position_it_lands_at_once():
    guard = beating()
    guard.handle_vehicle(VehicleView(FlightMode.OFFBOARD, True, False))
    assert DeadManAction.HOLD not in [action for _, action in run(guard, 0.0, 3.0)]
    assert guard.state is GuardState.LANDING


def test_a_refused_hold_becomes_a_landing():
    guard = beating()
    actions = {guard.step(i / 50) for i in range(78)}
    assert DeadManAction.HOLD in actions
    guard.handle_answer(False, 1.6)
    assert guard.step(1.6) is DeadManAction.LAND


def test_a_command_without_effect_is_repeated_twice_a_second():
    guard = beating()
    holds = [i / 50 for i in range(200) if guard.step(i / 50) is DeadManAction.HOLD]
    assert holds == pytest.approx([1.54, 2.04, 2.54, 3.04, 3.54], abs=0.05)


def test_a_late_beat_does_not_regain_the_aircraft_but_a_new_claim_does():
    guard = beating()
    run(guard, 0.0, 1.0)
    guard.handle_beat(Beat(True, 2, 100), 1.0)
    assert guard.has_taken_over
    guard.handle_beat(Beat(False, 3, 101), 1.0)
    assert guard.has_taken_over
    guard.handle_beat(Beat(True, 4, 101), 1.0)
    assert guard.state is GuardState.RELAY


def test_on_the_ground_silence_means_nothing():
    guard = beating()
    guard.handle_vehicle(VehicleView(FlightMode.OFFBOARD, False, True))
    assert run(guard, 0.0, 5.0) == []


def in_mode(guard: DeadMan, mode: FlightMode, armed: bool = True, landed: bool = False) -> None:
    guard.handle_vehicle(VehicleView(mode, armed, True, landed))


def test_a_navigator_that_ends_is_braked_for_at_once():
    guard = beating()
    guard.handle_end()
    done = run(guard, 0.0, 20.0)
    assert done[0] == (0.0, DeadManAction.ZERO_VELOCITY)
    assert list(dict.fromkeys(a for _, a in done))[1:] == [DeadManAction.HOLD, DeadManAction.LAND]


def test_a_word_of_ending_ends_no_guard():
    guard = beating()
    guard.handle_beat(Beat(False, 2, 100, ended=True), 0.1)
    assert not guard.is_handed_over
    assert DeadManAction.LAND in [action for _, action in run(guard, 0.1, 10.0)]


def test_after_its_end_nobody_beats_or_claims():
    guard = beating()
    guard.handle_end()
    run(guard, 0.0, 1.5)
    guard.handle_beat(Beat(True, 9, 999), 1.5)
    assert guard.state is GuardState.HOLDING
    assert guard.has_taken_over


def test_an_aircraft_in_offboard_cannot_be_disclaimed():
    guard = beating()
    guard.handle_beat(Beat(False, 2, 100), 0.1)
    assert DeadManAction.LAND in [action for _, action in run(guard, 0.1, 10.0)]


def test_nor_one_in_the_landing_that_was_asked_for():
    guard = beating(FlightMode.LAND)
    guard.handle_beat(Beat(False, 2, 100), 0.1)
    guard.handle_end()
    assert run(guard, 0.1, 3.0) == []
    assert not guard.is_handed_over
    in_mode(guard, FlightMode.HOLD)  # a person's
    assert run(guard, 3.0, 9.0) == []
    assert guard.is_handed_over


def test_an_aircraft_that_somebody_else_took_can():
    guard = beating()
    in_mode(guard, FlightMode.MANUAL)
    guard.handle_beat(Beat(False, 2, 100), 0.1)
    in_mode(guard, FlightMode.OFFBOARD)
    guard.handle_end()
    assert run(guard, 0.1, 10.0) == []
    assert guard.is_handed_over


def test_a_landing_that_is_under_way_is_watched_to_its_end():
    guard = beating(FlightMode.LAND)
    guard.handle_end()
    assert run(guard, 0.0, 3.0) == []
    assert not guard.is_handed_over
    in_mode(guard, FlightMode.OFFBOARD)  # PX4 goes back by itself when setpoints return
    assert run(guard, 3.0, 4.0) == [(3.0, DeadManAction.LAND)]


@pytest.mark.parametrize("mode", FlightMode)
def test_once_it_is_down_nothing_is_commanded_whatever_mode_follows(mode):
    guard = beating()
    run(guard, 0.0, 5.0)
    in_mode(guard, FlightMode.LAND, landed=True)
    assert run(guard, 5.0, 6.0) == []
    in_mode(guard, mode)
    assert run(guard, 6.0, 8.0) == []


@pytest.mark.parametrize("mode", FlightMode)
def test_at_the_moment_of_disarming_nothing_is_commanded(mode):
    guard = beating()
    run(guard, 0.0, 5.0)
    in_mode(guard, mode, armed=False)
    assert run(guard, 5.0, 8.0) == []


@pytest.mark.parametrize("mode", [FlightMode.TAKEOFF, FlightMode.OFFBOARD], ids=["px4", "copter"])
@pytest.mark.parametrize(
    ("lifts_off_s", "position_ok"),
    [(1.0, True), (4.0, True), (8.0, True), (1.0, False), (2.0, False)],
)
def test_a_take_off_that_lifts_off_without_its_navigator_is_landed(mode, lifts_off_s, position_ok):
    guard = DeadMan()
    stands = VehicleView(mode, True, position_ok, landed=True)
    guard.handle_vehicle(stands)
    guard.handle_beat(Beat(True, 1, 100), 0.0)
    guard.handle_vehicle(stands)
    guard.handle_end()
    assert run(guard, 0.0, lifts_off_s) == []
    guard.handle_vehicle(VehicleView(mode, True, position_ok, landed=False))
    done = run(guard, lifts_off_s, lifts_off_s + 5.0)
    assert done[-1][1] is DeadManAction.LAND
    in_mode(guard, FlightMode.LAND, landed=True)
    assert run(guard, lifts_off_s + 5.0, lifts_off_s + 6.0) == []
    in_mode(guard, FlightMode.OFFBOARD)
    assert run(guard, lifts_off_s + 6.0, lifts_off_s + 8.0) == []


def test_an_aircraft_that_has_flown_is_down_once_it_stands_in_whatever_mode():
    guard = beating()
    in_mode(guard, FlightMode.OFFBOARD, landed=False)
    assert DeadManAction.LAND in [action for _, action in run(guard, 0.0, 5.0)]
    in_mode(guard, FlightMode.OFFBOARD, landed=True)
    assert run(guard, 5.0, 6.0) == []
    in_mode(guard, FlightMode.OFFBOARD, landed=False)  # it bounces
    assert run(guard, 6.0, 8.0) == []


def test_a_hold_after_the_landing_began_is_somebody_elses():
    guard = beating()
    run(guard, 0.0, 5.0)
    in_mode(guard, FlightMode.HOLD)
    assert run(guard, 5.0, 9.0) == []
    assert guard.state is GuardState.STOOD_DOWN


def test_a_descend_of_the_autopilots_own_that_ends_is_landed_again():
    guard = beating()
    run(guard, 0.0, 2.0)
    in_mode(guard, FlightMode.DESCEND)
    run(guard, 2.0, 5.0)
    in_mode(guard, FlightMode.HOLD)
    assert DeadManAction.LAND in [action for _, action in run(guard, 5.0, 6.0)]


def test_a_hold_that_was_asked_for_but_not_seen_yet_is_the_navigators_own():
    guard = beating()
    guard.handle_mode_asked(FlightMode.HOLD, 0.0)
    guard.handle_end()
    in_mode(guard, FlightMode.HOLD)
    assert DeadManAction.LAND in [action for _, action in run(guard, 0.0, 10.0)]


def test_what_the_navigator_asks_for_as_well_is_not_asked_for_twice():
    """One that wakes up while it is landed asks for Land by itself, four times a second."""
    guard = beating()
    run(guard, 0.0, 4.0)
    asked = []
    for i in range(200, 400):
        guard.handle_vehicle(OFFBOARD)
        if i < 300 and i % 12 == 0:
            guard.handle_mode_asked(FlightMode.LAND, i / 50)
        if guard.step(i / 50) is DeadManAction.LAND:
            asked.append(i / 50)
    assert [t_s for t_s in asked if t_s < 6.2] == [4.04]
    assert len(asked) >= 4  # and goes on where the other one has stopped


FELL_BACK = VehicleView(FlightMode.HOLD, True, True, fell_back=True)
ALTITUDE = VehicleView(FlightMode.MANUAL, True, False, fell_back=True)


def settled(view: VehicleView, beats: int = 10) -> DeadMan:
    """Its navigator steered, and waits now for the failsafe to end."""
    guard = beating()
    for i in range(beats):
        guard.handle_vehicle(
            replace(view, fell_back=False, is_choice_untold=True) if i < 2 else view
        )
        guard.handle_beat(Beat(i < 1, 1, 100), 0.1 * i)
        assert guard.step(0.1 * i) is None
    return guard


@pytest.mark.parametrize("view", [FELL_BACK, ALTITUDE])
@pytest.mark.parametrize("beats", [1, 2, 10])
def test_a_failsafe_that_stays_up_is_landed_out_of_when_the_navigator_dies_in_it(view, beats):
    guard = settled(view, beats)
    guard.handle_end()
    done = run(guard, 0.1 * beats, 0.1 * beats + 0.5)
    assert done == []  # who chose the mode is told in this moment
    guard.handle_vehicle(view)
    assert DeadManAction.LAND in [action for _, action in run(guard, 0.1 * beats + 0.5, 10.0)]


def test_a_hold_that_a_person_chose_out_of_a_failsafe_is_his():
    guard = settled(FELL_BACK)
    guard.handle_end()
    run(guard, 1.0, 1.5)
    assert guard.state is GuardState.BRAKING
    guard.handle_vehicle(replace(FELL_BACK, fell_back=False))
    assert run(guard, 1.5, 10.0) == []
    assert guard.state is GuardState.STOOD_DOWN


def test_a_failsafe_while_it_acts_does_not_end_its_landing():
    guard = beating()
    guard.handle_end()
    run(guard, 0.0, 0.3)
    guard.handle_vehicle(replace(FELL_BACK, fell_back=False, is_choice_untold=True))
    assert run(guard, 0.3, 0.5) == []
    guard.handle_vehicle(FELL_BACK)
    assert [action for _, action in run(guard, 0.5, 8.0)] == [DeadManAction.LAND]


def test_nothing_is_commanded_until_it_is_told_who_chose_the_mode_that_came_while_it_lands():
    guard = beating()
    guard.handle_vehicle(VehicleView(FlightMode.OFFBOARD, True, False))
    guard.handle_end()
    for t_s in (0.0, 1.1, 1.12):
        guard.step(t_s)
    assert guard.state is GuardState.LANDING
    guard.handle_vehicle(replace(ALTITUDE, fell_back=False, is_choice_untold=True))
    assert run(guard, 1.2, 3.0) == []
    guard.handle_vehicle(ALTITUDE)
    assert guard.step(3.0) is DeadManAction.LAND


PERSONS = {FlightMode.MANUAL, FlightMode.RETURN, FlightMode.MISSION, FlightMode.UNKNOWN}
EVENT = st.tuples(
    st.sampled_from(FlightMode),
    st.sampled_from([True, True, True, False]),  # armed
    st.sampled_from([False, False, False, True]),  # landed
    st.sampled_from(["engaged", "idle", "silent", "silent", "claims", "ends"]),
    st.sampled_from([0.02, 0.3, 0.6, 2.0]),  # for how long
    st.sampled_from(["", "", "fell_back", "is_choice_untold"]),
)


@given(st.lists(EVENT, max_size=25))
def test_whatever_happens_nobody_is_commanded_against_and_nobody_is_left_alone(events):
    guard, t_s, epoch = DeadMan(), 0.0, 100
    for mode, armed, landed, navigator, seconds, choice in events:
        in_mode(guard, mode, armed, landed)
        stays_up = mode in (FlightMode.HOLD, FlightMode.MANUAL)
        if choice and stays_up:
            guard.handle_vehicle(replace(guard.vehicle, **{choice: True}))
        persons = PERSONS - {FlightMode.MANUAL} if choice == "fell_back" else PERSONS
        epoch += navigator == "claims"
        for _ in range(round(seconds / 0.02)):
            t_s += 0.02
            if navigator in ("engaged", "idle", "claims"):
                guard.handle_beat(Beat(navigator != "idle", 1, epoch), t_s)
            elif navigator == "ends":
                guard.handle_end()
            action = guard.step(t_s)
            assert action is None or (armed and not landed and mode not in persons)
    if guard.navigator_ended or guard.state is not GuardState.RELAY:
        return
    in_mode(guard, FlightMode.OFFBOARD)
    guard.handle_beat(Beat(True, 1, epoch), t_s)
    guard.handle_end()
    done = [action for _, action in run(guard, t_s, t_s + 5.0)]
    assert done[0] is DeadManAction.ZERO_VELOCITY
    assert done[-1] is DeadManAction.LAND


def landing_blind() -> DeadMan:
    """It lands, the navigator is gone, and there was no position until now."""
    guard = beating()
    run(guard, 0.0, 8.0)
    assert guard.vehicle.mode is FlightMode.LAND
    guard.handle_vehicle(replace(guard.vehicle, lands_blind=True))
    return guard


def test_one_that_lands_blind_is_held_once_it_can_be_and_landed_again():
    """Of a second navigator's estimates it made nothing: 211 m with the wind."""
    guard = landing_blind()
    assert [action for _, action in run(guard, 8.0, 30.0)] == [
        DeadManAction.HOLD,
        DeadManAction.LAND,
    ]
    assert guard.state is GuardState.LANDING


def test_an_operator_reads_why_it_leaves_its_landing():
    guard = landing_blind()
    guard.step(8.0)
    assert guard.words(GuardState.LANDING, 8.0) == "drifts as it lands: holding, then landing again"
    run(guard, 8.02, 10.0)
    guard.handle_vehicle(VehicleView(FlightMode.HOLD, True, True))
    assert guard.words(GuardState.HOLDING, 10.0) == "holds its place: landing again"


def test_nobody_reads_that_it_holds_its_place_when_it_has_not_taken_the_hold():
    guard, told = landing_blind(), []
    for i in range(8 * 50, 13 * 50):
        before = guard.state
        guard.step(i / 50)
        if guard.state is not before:
            told.append(guard.words(before, i / 50))
    assert told[0].startswith("drifts as it lands")
    assert not [each for each in told if "holds its place" in each]
    assert len(told) == 2


@given(
    state=st.sampled_from(GuardState), before=st.sampled_from(GuardState),
    ended=st.booleans(), knows=st.sampled_from([True, False, None]), t_s=st.floats(0.0, 1e6),
)  # fmt: skip
def test_what_an_operator_reads_fits_one_text(state, before, ended, knows, t_s):
    view = VehicleView(FlightMode.OFFBOARD, True, knows)
    guard = DeadMan(state=state, vehicle=view, _ended=ended)
    words = guard.words(before, t_s)
    assert 0 < len(words.encode("ascii")) <= 50


def test_a_hold_that_such_a_one_does_not_take_is_asked_for_again_later():
    guard, asked = landing_blind(), []
    for i in range(8 * 50, 16 * 50):
        if (action := guard.step(i / 50)) is not None:
            asked.append((i / 50, action))
    assert {action for _, action in asked} == {DeadManAction.HOLD}
    times = [t_s for t_s, _ in asked]
    assert [t_s for t_s in times if 10.1 < t_s < 13.9] == []
    assert [t_s for t_s in times if t_s >= 13.9]
    assert not guard.is_handed_over


@given(st.floats(0.1, 5.5))
def test_a_hold_that_such_a_one_takes_late_is_still_landed(shows_s):
    """Told late by a slow link, when Land is waited for again: nobody would ever end it."""
    guard, asked = landing_blind(), []
    for i in range(8 * 50, 20 * 50):
        if i / 50 >= 8.0 + shows_s and guard.vehicle.mode is FlightMode.LAND and not asked:
            guard.handle_vehicle(VehicleView(FlightMode.HOLD, True, True))
        action = guard.step(i / 50)
        if action is DeadManAction.LAND:
            asked.append(i / 50)
            guard.handle_vehicle(VehicleView(FlightMode.LAND, True, True))
    assert len(asked) == 1
    assert guard.state is GuardState.LANDING


@given(st.sampled_from([FlightMode.MANUAL, FlightMode.RETURN, FlightMode.MISSION]), st.floats(0, 6))
def test_whoever_takes_it_out_of_a_blind_landing_keeps_it(mode, when_s):
    guard = landing_blind()
    run(guard, 8.0, 8.0 + when_s)
    guard.handle_vehicle(VehicleView(mode, True, True))
    assert run(guard, 8.0 + when_s, 20.0) == []
