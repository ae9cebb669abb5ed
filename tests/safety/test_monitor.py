from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vehicles import FLYING

from vwnav.safety.hierarchy import Action, Decision, Rank, as_markdown
from vwnav.safety.monitor import SafetyConfig, SafetyMonitor
from vwnav.types import Estimate
from vwnav.vehicle import FlightMode, Navigation, Order

CONFIG = SafetyConfig()
STEP_S = 0.1
VEHICLE = replace(FLYING, silence_s=0.3)


def estimate(t_s: float, sigma_m: float = 1.0, fix_age_s: float | None = 0.5) -> Estimate:
    return Estimate(
        t_s=t_s,
        position_ned_m=np.zeros(3),
        velocity_ned_m_s=np.zeros(3),
        covariance=np.diag(np.full(6, sigma_m**2)),
        quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]),
        sigma_yaw_rad=0.05,
        agl_m=50.0,
        sigma_agl_m=2.0,
        t_last_fix_s=None if fix_age_s is None else t_s - fix_age_s,
        reset_counter=0,
    )


class Flight:
    """A monitor and its clock; `fly` keeps one state of things for a time."""

    def __init__(self, config: SafetyConfig = CONFIG) -> None:
        self.monitor = SafetyMonitor(config, 8.0)
        self.t_s = 0.0

    def fly(
        self,
        seconds: float = STEP_S,
        sigma_m: float = 1.0,
        fix_age_s: float | None = 0.5,
        blind_s: float = 0.0,
        **vehicle,
    ) -> Decision:
        if "mode" in vehicle:  # the autopilot tells at once whose it is
            vehicle.setdefault("intended_mode", vehicle["mode"])
        for _ in range(max(round(seconds / STEP_S), 1)):
            self.t_s += STEP_S
            now = Navigation(estimate(self.t_s, sigma_m, fix_age_s), "", self.t_s - blind_s)
            decision = self.monitor.step(now, replace(VEHICLE, **vehicle), self.t_s)
        return decision


def test_all_well_means_navigate() -> None:
    assert Flight().fly(60.0) == Decision(Action.NAVIGATE, "")


def test_before_the_first_fix_there_is_no_travelling_but_also_no_alarm() -> None:
    decision = Flight().fly(60.0, sigma_m=500.0, fix_age_s=None)
    assert decision == Decision(Action.NAVIGATE, "")


@pytest.mark.parametrize(
    "mode",
    [mode for mode in FlightMode if mode not in (FlightMode.OFFBOARD, FlightMode.UNKNOWN)],
    ids=lambda m: m.value,
)
def test_any_other_mode_after_ours_releases_at_once(mode: FlightMode) -> None:
    flight = Flight()
    flight.fly()
    assert flight.fly(mode=mode).action is Action.RELEASE


def test_take_off_and_the_hold_after_it_are_ours() -> None:
    flight = Flight()
    for mode in (FlightMode.MANUAL, FlightMode.HOLD, FlightMode.TAKEOFF, FlightMode.HOLD):
        assert flight.fly(mode=mode, fix_age_s=None).action is Action.NAVIGATE
    assert flight.fly(mode=FlightMode.MANUAL, fix_age_s=None).action is Action.RELEASE


def test_a_mode_without_name_releases_only_when_it_stays() -> None:
    flight = Flight()
    flight.fly()
    assert flight.fly(0.5, mode=FlightMode.UNKNOWN).action is Action.YIELD
    assert flight.fly(0.5).action is Action.NAVIGATE
    assert flight.fly(2.0, mode=FlightMode.UNKNOWN).action is Action.RELEASE


def test_release_ends_with_the_word_of_the_pilot_alone() -> None:
    flight = Flight()
    flight.fly()
    flight.fly(mode=FlightMode.MANUAL)
    # PX4 goes back to Offboard by itself: that is nobody's word.
    assert flight.fly(30.0, mode=FlightMode.OFFBOARD).action is Action.RELEASE
    flight.monitor.resume()
    assert flight.fly(mode=FlightMode.MANUAL).action is Action.NAVIGATE
    assert flight.fly(mode=FlightMode.OFFBOARD).action is Action.NAVIGATE
    assert flight.fly(mode=FlightMode.HOLD).action is Action.RELEASE


@pytest.mark.parametrize(("silence_s", "stays"), [(0.9, False), (1.1, True)])
def test_who_asks_back_an_aircraft_and_is_not_answered_leaves_it_to_the_pilot(silence_s, stays):
    """Behind the cut he may have taken it again, and what is asked for now comes through late."""
    flight = Flight()
    flight.fly()
    flight.fly(mode=FlightMode.MANUAL)
    flight.monitor.resume()
    flight.fly(mode=FlightMode.MANUAL, rc_available=True)
    for tick in range(round(silence_s / STEP_S)):
        late = flight.fly(mode=FlightMode.MANUAL, rc_available=True, silence_s=tick * STEP_S + 0.1)
    assert (late.action is Action.RELEASE) == stays
    assert ("not heard while it was asked for Offboard" in late.reason) == stays
    assert (flight.fly(5.0).action is Action.RELEASE) == stays


def test_what_would_land_leaves_an_aircraft_with_the_pilot_until_offboard_is_accepted() -> None:
    flight = Flight()
    flight.fly()
    flight.fly(mode=FlightMode.MANUAL)
    for accepted, action in ((False, Action.RELEASE), (True, Action.LAND)):
        flight.monitor.resume()
        flight.fly(mode=FlightMode.OFFBOARD if accepted else FlightMode.MANUAL)
        lost = Navigation(None, "the filter diverged", flight.t_s)
        for _ in range(round(CONFIG.lost_land_s / STEP_S) + 2):
            flight.t_s += STEP_S
            mode = FlightMode.OFFBOARD if accepted else FlightMode.MANUAL
            vehicle = replace(VEHICLE, mode=mode, intended_mode=mode)
            decision = flight.monitor.step(lost, vehicle, flight.t_s, steers=accepted)
        assert decision.action is action, decision
        assert "the filter diverged" in decision.reason


def test_low_battery_returns_and_critical_lands_for_good() -> None:
    flight = Flight()
    assert flight.fly(60.0, battery_ratio=0.26).action is Action.NAVIGATE
    assert flight.fly(3.0, battery_ratio=0.2).action is Action.RETURN
    assert flight.fly(3.0, battery_ratio=0.5).action is Action.RETURN
    assert flight.fly(3.0, battery_ratio=0.1).action is Action.LAND
    assert flight.fly(60.0, battery_ratio=0.9).action is Action.LAND


def test_sagging_voltage_and_unknown_battery_change_nothing() -> None:
    flight = Flight()
    assert flight.fly(1.0, battery_ratio=0.05).action is Action.NAVIGATE
    assert flight.fly(1.0, battery_ratio=0.5).action is Action.NAVIGATE
    assert flight.fly(60.0, battery_ratio=None).action is Action.NAVIGATE


def test_low_battery_before_the_first_fix_lands_where_it_climbed() -> None:
    assert Flight().fly(5.0, battery_ratio=0.2, fix_age_s=None).action is Action.LAND


def test_silent_autopilot_holds_then_lands() -> None:
    flight = Flight()
    assert flight.fly(silence_s=1.5).action is Action.NAVIGATE
    assert flight.fly(4.0, silence_s=4.0).action is Action.HOLD
    assert flight.fly().action is Action.NAVIGATE
    assert flight.fly(connected=False).action is Action.HOLD
    assert flight.fly(11.0, silence_s=11.0).action is Action.LAND
    assert flight.fly().action is Action.LAND


@pytest.mark.parametrize("bad", [{"sigma_m": 12.0}, {"fix_age_s": 20.0}])
def test_poor_position_holds_then_climbs_then_returns_by_odometry(bad: dict[str, float]) -> None:
    flight = Flight()
    flight.fly()
    assert flight.fly(CONFIG.climb_after_s - 1.0, **bad).action is Action.HOLD
    assert flight.fly(2.0, **bad).action is Action.CLIMB
    assert flight.fly(CONFIG.hold_time_s - CONFIG.climb_after_s - 2.0, **bad).action is Action.CLIMB
    assert flight.fly(2.0, **bad).action is Action.RETURN
    assert flight.fly(30.0).action is Action.RETURN


@pytest.mark.parametrize("sigma_m", [40.0, np.nan, np.inf])
def test_lost_position_holds_then_lands(sigma_m: float) -> None:
    flight = Flight()
    flight.fly()
    assert flight.fly(CONFIG.hold_time_s - 1.0, sigma_m=sigma_m).action is Action.HOLD
    assert flight.fly(2.0, sigma_m=sigma_m).action is Action.LAND


def test_position_that_recovers_goes_on_with_the_route() -> None:
    flight = Flight()
    flight.fly()
    assert flight.fly(3.0, sigma_m=9.0).action is Action.HOLD
    # Not yet: it would fall back at once.
    assert flight.fly(1.0, sigma_m=7.0).action is Action.HOLD
    assert flight.fly(1.0, sigma_m=5.0).action is Action.SLOW
    assert flight.fly(1.0, sigma_m=2.5).action is Action.NAVIGATE


def test_a_return_whose_position_gets_lost_holds_then_lands() -> None:
    flight = Flight()
    flight.fly()
    assert flight.fly(20.0, sigma_m=12.0).action is Action.RETURN
    assert flight.fly(10.0, sigma_m=20.0).action is Action.RETURN
    assert flight.fly(30.0, sigma_m=50.0).action is Action.LAND


def test_old_estimate_is_no_estimate() -> None:
    flight = Flight()
    flight.fly()
    now = Navigation(estimate(flight.t_s), "", flight.t_s + 3.0)
    decision = flight.monitor.step(now, VEHICLE, flight.t_s + 3.0)
    assert decision == Decision(Action.HOLD, "no position estimate", Rank.POSITION)


def test_pilot_may_take_over_a_landing() -> None:
    flight = Flight()
    flight.fly(5.0, battery_ratio=0.05)
    assert flight.fly(5.0, mode=FlightMode.LAND, battery_ratio=0.05).action is Action.LAND
    assert flight.fly(mode=FlightMode.MANUAL, battery_ratio=0.05).action is Action.RELEASE


# A machine busy with other work is no failure of a law.
unhurried = settings(deadline=None, max_examples=min(40, settings.default.max_examples))
troubles = st.fixed_dictionaries(
    {
        "mode": st.sampled_from(FlightMode),
        "battery_ratio": st.one_of(st.none(), st.floats(0.0, 1.0)),
        "silence_s": st.one_of(st.floats(0.0, 30.0), st.just(float("nan"))),
        "connected": st.booleans(),
        "sigma_m": st.one_of(st.floats(0.0, 100.0), st.sampled_from([np.nan, np.inf])),
        "fix_age_s": st.one_of(st.none(), st.floats(0.0, 60.0)),
        "seconds": st.floats(0.5, 18.0),
    }
)


@unhurried
@given(st.lists(troubles, max_size=8), st.lists(troubles, min_size=1, max_size=8))
def test_release_is_never_left_by_itself(before: list[dict], after: list[dict]) -> None:
    flight = Flight()
    for trouble in before:
        flight.fly(**trouble)
    flight.fly(mode=FlightMode.OFFBOARD)
    flight.fly(mode=FlightMode.MANUAL)
    assert all(flight.fly(**trouble).action is Action.RELEASE for trouble in after)


@unhurried
@given(st.lists(troubles, max_size=8), troubles)
def test_the_higher_trouble_decides(before: list[dict], now: dict) -> None:
    flight = Flight()
    flight.fly()
    for trouble in [*before, now]:
        action = flight.fly(**trouble | {"mode": FlightMode.OFFBOARD}).action
    ratio = 1.0 if now["battery_ratio"] is None else now["battery_ratio"]
    # Silence is counted while we listen.
    unheard = not now["silence_s"] <= CONFIG.link_hold_s
    silent = not now["connected"] or (unheard and now["seconds"] > CONFIG.link_hold_s + 0.5)
    lost = not now["sigma_m"] <= CONFIG.return_sigma_m and now["fix_age_s"] is not None
    if ratio < CONFIG.battery_critical_ratio and now["seconds"] > 3.0:
        assert action is Action.LAND
    elif silent or lost:
        assert action in (Action.HOLD, Action.LAND)


@unhurried
@given(st.lists(troubles, min_size=1, max_size=10))
def test_landing_is_only_given_up_to_a_pilot(history: list[dict]) -> None:
    flight, landing = Flight(), False
    for trouble in history:
        action = flight.fly(**trouble).action
        assert not landing or action in (Action.LAND, Action.RELEASE)
        landing = landing or action is Action.LAND


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"hold_sigma_m": -1.0}, "hold_sigma_m"),
        ({"battery_critical_ratio": 0.5}, "battery_low_ratio"),
        ({"link_hold_s": 20.0}, "link_land_s"),
        ({"hold_time_s": float("nan")}, "hold_time_s"),
    ],
)
def test_senseless_thresholds_are_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SafetyConfig(**changes)


def test_a_navigator_that_slept_does_not_take_its_own_sleep_for_the_autopilots_silence() -> None:
    flight = Flight()
    flight.fly(5.0)
    flight.t_s += 20.0
    assert flight.fly(silence_s=20.0).action is Action.NAVIGATE
    assert flight.fly(2.0, silence_s=20.0).action is Action.NAVIGATE
    assert flight.monitor.gap_s >= 20.0
    assert flight.fly(12.0, silence_s=30.0).action is Action.LAND


def test_a_gap_is_remembered_for_a_while() -> None:
    flight = Flight()
    flight.fly(5.0)
    flight.fly(2.0, silence_s=2.0)
    flight.fly(5.0)
    assert flight.monitor.gap_s == pytest.approx(2.0, abs=0.2)
    flight.fly(10.0)
    assert flight.monitor.gap_s == 0.0


def test_without_images_it_stops_then_comes_down_while_it_still_knows_where() -> None:
    flight = Flight()
    flight.fly(5.0)
    assert flight.fly(blind_s=0.9).action is Action.NAVIGATE
    assert flight.fly(blind_s=1.5).action is Action.HOLD
    assert flight.fly().action is Action.NAVIGATE
    assert flight.fly(blind_s=6.1).action is Action.LAND


def test_without_an_estimate_it_stops_then_lands() -> None:
    flight = Flight()
    flight.fly(5.0)
    lost = Navigation(None, "velocity unknown", flight.t_s)
    decisions = []
    for _ in range(25):
        flight.t_s += STEP_S
        decisions.append(flight.monitor.step(lost, VEHICLE, flight.t_s))
    assert decisions[0].action is Action.HOLD
    assert "velocity unknown" in decisions[0].reason
    assert decisions[-1].action is Action.LAND


def test_our_own_mode_intended_by_the_autopilot_is_a_failsafe_and_a_persons_is_not() -> None:
    flight = Flight()
    flight.fly(intended_mode=FlightMode.OFFBOARD)
    ours = {"intended_mode": FlightMode.OFFBOARD}
    assert flight.fly(3.0, mode=FlightMode.DESCEND, **ours).action is Action.YIELD
    assert flight.fly(3.0, mode=FlightMode.LAND, **ours).action is Action.YIELD
    assert flight.fly(**ours).action is Action.NAVIGATE
    theirs = {"mode": FlightMode.LAND, "intended_mode": FlightMode.LAND}
    assert flight.fly(**theirs).action is Action.RELEASE


def test_a_mode_of_which_nobody_has_told_who_wanted_it_is_waited_on_for_a_second() -> None:
    flight = Flight()
    flight.fly(intended_mode=FlightMode.OFFBOARD)
    untold = {"mode": FlightMode.HOLD, "intended_mode": FlightMode.UNKNOWN}
    assert flight.fly(0.5, **untold).action is Action.YIELD
    assert flight.fly(1.5, **untold).action is Action.RELEASE


def test_a_poor_position_slows_down() -> None:
    flight = Flight()
    flight.fly()
    assert flight.fly(sigma_m=5.0).action is Action.SLOW
    assert flight.fly(sigma_m=3.5).action is Action.SLOW  # or it would be said again and again
    assert flight.fly().action is Action.NAVIGATE
    assert flight.fly(fix_age_s=10.0).action is Action.SLOW
    assert flight.fly().action is Action.NAVIGATE


def straight_to(home_ne_m: np.ndarray):
    return lambda now: np.array([[*home_ne_m, now.position_ned_m[2]]])


def test_whoever_is_off_the_route_goes_home() -> None:
    flight = Flight()
    far_m = CONFIG.fence_m + 5.0
    home = np.array([50.0, far_m])
    flight.monitor.fly_within(np.array([[100.0, far_m, -50.0]]), home, straight_to(home))
    decision = flight.fly()  # it flies at (0, 0)
    assert decision.action is Action.RETURN
    assert "off the route" in decision.reason


@pytest.mark.parametrize(
    ("lost", "seconds"),
    [("rc_available", CONFIG.radio_return_s), ("ground_station", CONFIG.ground_return_s)],
)
def test_a_radio_and_a_ground_station_that_were_heard_once_are_missed(
    lost: str, seconds: float
) -> None:
    flight = Flight()
    assert flight.fly(60.0, **{lost: False}).action is Action.NAVIGATE
    flight.fly(5.0, **{lost: True})
    assert flight.fly(seconds - 1.0, **{lost: False}).action is Action.NAVIGATE
    assert flight.fly(2.0, **{lost: False}).action is Action.RETURN


def test_what_a_ground_station_asks_for_comes_last() -> None:
    flight = Flight()
    flight.fly()
    flight.monitor.obey(Order.PAUSE)
    assert flight.fly().action is Action.HOLD
    assert flight.fly(30.0, sigma_m=20.0).action is Action.RETURN
    flight.monitor.obey(Order.LAND)
    assert flight.fly().action is Action.LAND
    flight.monitor.obey(Order.GO_ON)
    assert flight.fly(10.0).action is Action.LAND


def test_a_pause_ends_by_going_on() -> None:
    flight = Flight()
    flight.fly()
    flight.monitor.obey(Order.PAUSE)
    assert flight.fly(20.0).action is Action.HOLD
    flight.monitor.obey(Order.GO_ON)
    assert flight.fly().action is Action.NAVIGATE


@pytest.mark.parametrize(("wind_ne_m_s", "goes_home"), [((0.0, 0.0), False), ((-8.0, 0.0), True)])
def test_it_turns_back_while_the_battery_still_carries_it_home_in_the_wind(
    wind_ne_m_s: tuple[float, float], goes_home: bool
) -> None:
    """Home is 800 m north: 150 s with the height, in a wind from there 250 s; 1 % takes 6 s."""
    monitor = SafetyMonitor(CONFIG, 8.0)
    home = np.array([800.0, 0.0])
    monitor.fly_within(np.array([[0.0, 0.0, -50.0]]), home, straight_to(home))
    for i in range(600):
        t_s = STEP_S * i
        place = np.array([0.0, 0.0, -50.0])
        now = replace(estimate(t_s), position_ned_m=place, wind_ne_m_s=np.array(wind_ne_m_s))
        vehicle = replace(VEHICLE, in_air=True, battery_ratio=0.60 - t_s / 600.0)
        decision = monitor.step(Navigation(now, "", t_s), vehicle, t_s)
    assert (decision.action is Action.RETURN) == goes_home


def test_the_table_in_the_documentation_is_the_programs() -> None:
    page = Path(__file__).resolve().parents[2] / "docs" / "flying.md"
    assert as_markdown(CONFIG) in page.read_text(), "python -m vwnav.safety.hierarchy"


def test_what_nobody_watched_while_the_pilot_flew_is_no_gap_and_no_loss() -> None:
    flight = Flight()
    flight.fly(5.0, rc_available=True)
    flight.fly(mode=FlightMode.MANUAL, rc_available=True)
    flight.t_s += 60.0
    flight.monitor.resume()
    assert flight.fly(2.0, rc_available=False).action is Action.NAVIGATE
    assert flight.monitor.gap_s == 0.0


def test_who_is_asked_to_return_before_the_first_fix_is_above_home_and_lands() -> None:
    flight = Flight()
    flight.fly(fix_age_s=None)
    flight.monitor.obey(Order.RETURN)
    assert flight.fly(fix_age_s=None).action is Action.LAND
