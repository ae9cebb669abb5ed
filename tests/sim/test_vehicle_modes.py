"""What the simulated PX4 does when something goes wrong, against PX4 as measured."""

import copy
import math

import pytest
from px4_bench import Bench

from vwnav.sim.config import PilotPlan
from vwnav.sim.mavlink.command import Result
from vwnav.sim.multirotor.setpoint import Setpoint
from vwnav.sim.px4.modes import NavState


@pytest.fixture(scope="module")
def hovering_once() -> Bench:
    return Bench(wind_m_s=3.0).hover()


@pytest.fixture
def hovering(hovering_once: Bench) -> Bench:
    return copy.deepcopy(hovering_once)


def set_parameter(bench: Bench, name: str, value: float) -> None:
    bench.vehicle.parameters._values[name] = value
    bench.vehicle.handle_parameter()


def test_it_does_not_arm_without_a_position() -> None:
    bench = Bench()
    bench.run(3.0)
    assert bench.arm() is Result.TEMPORARILY_REJECTED
    assert "Arming denied: Resolve system health failures first" in bench.texts


def test_px4s_own_defaults_ignore_vision() -> None:
    bench = Bench(autopilot_defaults=True)
    bench.get_ready()
    assert not bench.vehicle.estimator.fusing
    assert bench.arm() is Result.TEMPORARILY_REJECTED


def test_the_heading_settles_for_13_s_after_the_origin() -> None:
    bench = Bench()
    bench.get_ready()
    ready = bench.vehicle.health.heading_ok
    bench.vehicle.estimator.set_origin(41.1, 29.0, 40.0)
    bench.run(0.1)
    assert ready
    assert not bench.vehicle.health.heading_ok


def test_it_disarms_itself_when_it_does_not_take_off() -> None:
    bench = Bench()
    bench.get_ready()
    assert bench.arm() is Result.ACCEPTED
    bench.run(10.5)
    assert not bench.vehicle.commander.armed


def test_takeoff_ends_in_hold_at_the_height(hovering: Bench) -> None:
    assert hovering.state is NavState.HOLD
    assert -hovering.vehicle.body.d == pytest.approx(10.0, abs=0.8)


def test_it_does_not_disarm_in_the_air_but_by_force(hovering: Bench) -> None:
    commander, health = hovering.vehicle.commander, hovering.vehicle.health
    assert commander.disarm(health, forced=False) is Result.TEMPORARILY_REJECTED
    assert commander.disarm(health, forced=True) is Result.ACCEPTED


def test_offboard_is_refused_without_setpoints(hovering: Bench) -> None:
    assert hovering.ask(NavState.OFFBOARD) is Result.TEMPORARILY_REJECTED


@pytest.mark.parametrize(
    ("action", "state"), [(0, NavState.RETURN), (4, NavState.LAND), (5, NavState.HOLD)]
)
def test_setpoints_that_stop_end_offboard_after_a_second(
    hovering: Bench, action: int, state: NavState
) -> None:
    set_parameter(hovering, "COM_OBL_RC_ACT", action)
    hovering.offboard()
    hovering.velocity = None
    assert hovering.run_until_state(state, 5.0) == pytest.approx(1.0, abs=0.15)
    assert "Failsafe activated" in hovering.texts


def test_a_gap_of_900_ms_in_the_setpoints_passes(hovering: Bench) -> None:
    hovering.offboard()
    hovering.velocity = None
    hovering.run(0.9)
    hovering.velocity = (0.0, 0.0, 0.0)
    hovering.run(1.0)
    assert hovering.state is NavState.OFFBOARD


def test_offboard_comes_back_by_itself_with_the_setpoints(hovering: Bench) -> None:
    hovering.offboard()
    hovering.velocity = None
    hovering.run(3.0)
    hovering.velocity = (0.0, 0.0, 0.0)
    assert hovering.run_until_state(NavState.OFFBOARD, 3.0) < 0.9


def test_offboard_stays_away_once_the_user_chose_hold(hovering: Bench) -> None:
    hovering.offboard()
    hovering.velocity = None
    hovering.run(3.0)
    assert hovering.ask(NavState.HOLD) is Result.ACCEPTED
    hovering.velocity = (0.0, 0.0, 0.0)
    hovering.run(3.0)
    assert hovering.state is NavState.HOLD


def test_vision_that_stops_ends_in_descend_after_5_s_and_offboard_returns(
    hovering: Bench,
) -> None:
    hovering.offboard()
    hovering.vision = False
    assert hovering.run_until_state(NavState.DESCEND, 8.0) == pytest.approx(5.0, abs=0.4)
    hovering.run(2.0)
    assert hovering.vehicle.body.vd == pytest.approx(0.7, abs=0.15)
    hovering.vision = True
    assert 1.0 < hovering.run_until_state(NavState.OFFBOARD, 4.0) < 2.0


def test_hold_too_descends_without_a_position(hovering: Bench) -> None:
    hovering.vision = False
    hovering.run(6.0)
    assert hovering.state is NavState.DESCEND
    assert hovering.ask(NavState.HOLD) is Result.TEMPORARILY_REJECTED


def test_a_descent_ends_on_the_ground_disarmed(hovering: Bench) -> None:
    hovering.vision = False
    hovering.run(25.0)
    assert not hovering.vehicle.commander.armed
    assert hovering.vehicle.body.d == 0.0


def test_moving_sticks_take_over_within_400_ms(hovering: Bench) -> None:
    hovering.offboard((2.0, 0.0, 0.0))
    hovering.sticks = (0, 0, 500, 0)
    hovering.run(1.0)
    for i in range(1, 11):
        hovering.sticks = (40 * i, 0, 500, 0)
        hovering.run(0.04)
    assert hovering.state is NavState.POSITION
    assert "Pilot took over using sticks" in hovering.texts


def test_a_step_of_one_stick_does_not_take_over(hovering: Bench) -> None:
    hovering.offboard()
    hovering.sticks = (0, 0, 500, 0)
    hovering.run(1.0)
    hovering.sticks = (0, 900, 500, 0)
    hovering.run(1.0)
    assert hovering.state is NavState.OFFBOARD


def test_position_mode_flies_where_the_stick_points(hovering: Bench) -> None:
    hovering.sticks = (0, 0, 500, 0)
    hovering.run(0.2)
    assert hovering.ask(NavState.POSITION) is Result.ACCEPTED
    hovering.sticks = (500, 0, 500, 0)
    hovering.run(5.0)
    assert hovering.vehicle.body.vn == pytest.approx(0.5 * 10.0, abs=0.8)
    hovering.sticks = (0, 0, 500, 0)
    hovering.run(5.0)
    assert math.hypot(hovering.vehicle.body.vn, hovering.vehicle.body.ve) < 0.5


def test_sticks_that_vanish_in_offboard_hold_then_return(hovering: Bench) -> None:
    hovering.sticks = (0, 0, 500, 0)
    hovering.offboard()
    hovering.sticks = None
    assert hovering.run_until_state(NavState.HOLD, 3.0) == pytest.approx(1.0, abs=0.15)
    assert hovering.run_until_state(NavState.RETURN, 8.0) == pytest.approx(5.0, abs=0.15)
    hovering.sticks = (0, 0, 500, 0)
    hovering.run(1.0)
    assert hovering.state is NavState.RETURN


def test_the_radios_switch_selects_position_and_its_loss_returns() -> None:
    plan = PilotPlan(rc_on=True, switch_at_s=40.0, rc_lost_at_s=45.0)
    bench = Bench(pilot=plan).hover().offboard()
    bench.run(39.0 - bench.vehicle.t_s)
    assert bench.state is NavState.OFFBOARD
    bench.run(1.5)
    assert bench.state is NavState.POSITION
    bench.run(6.0)
    assert bench.state is NavState.HOLD
    bench.run(5.0)
    assert bench.state is NavState.RETURN


def test_the_scripted_pilot_takes_over_with_the_stick() -> None:
    plan = PilotPlan(rc_on=True, takes_over_at_s=40.0)
    bench = Bench(pilot=plan).hover().offboard()
    bench.run(39.9 - bench.vehicle.t_s)
    before = bench.state
    bench.run(0.6)
    assert (before, bench.state) == (NavState.OFFBOARD, NavState.POSITION)
    bench.run(2.0)
    assert bench.vehicle.body.vn > 1.0


def test_an_empty_battery_holds_returns_and_lands(hovering: Bench) -> None:
    for name, value in {"COM_LOW_BAT_ACT": 3, "BAT_CRIT_THR": 0.3, "SIM_BAT_DRAIN": 100}.items():
        set_parameter(hovering, name, value)
    hovering.offboard().vehicle.battery.remaining = 0.31
    assert hovering.run_until_state(NavState.HOLD, 3.0) < 2.0
    assert hovering.run_until_state(NavState.RETURN, 8.0) == pytest.approx(5.0, abs=0.15)
    hovering.vehicle.battery.remaining = 0.04
    assert hovering.run_until_state(NavState.LAND, 1.0) < 0.1


def test_a_low_battery_only_warns_by_default(hovering: Bench) -> None:
    hovering.vehicle.battery.remaining = 0.06
    hovering.run(1.0)
    assert hovering.state is NavState.HOLD
    assert "Critical battery" in hovering.texts


def test_a_lost_ground_station_holds_then_returns_when_told_to(hovering: Bench) -> None:
    hovering.vehicle.gcs_heard_s = hovering.vehicle.t_s + 1.0
    set_parameter(hovering, "NAV_DLL_ACT", 2)
    hovering.offboard()
    hovering.vehicle.gcs_heard_s = hovering.vehicle.t_s
    assert hovering.run_until_state(NavState.HOLD, 15.0) == pytest.approx(10.0, abs=0.2)
    assert hovering.run_until_state(NavState.RETURN, 8.0) == pytest.approx(5.0, abs=0.2)


def test_the_fence_holds(hovering: Bench) -> None:
    set_parameter(hovering, "GF_MAX_HOR_DIST", 20.0)
    hovering.offboard((3.0, 0.0, 0.0))
    hovering.run_until_state(NavState.HOLD, 15.0)
    hovering.run(5.0)
    assert 20.0 < hovering.vehicle.body.n < 26.0


def test_return_climbs_flies_home_and_lands(hovering: Bench) -> None:
    hovering.offboard((4.0, 3.0, 0.0))
    hovering.run(8.0)
    assert hovering.ask(NavState.RETURN) is Result.ACCEPTED
    hovering.run(8.0)
    assert -hovering.vehicle.body.d > 28.0
    hovering.run(60.0)
    assert not hovering.vehicle.commander.armed
    assert math.hypot(hovering.vehicle.body.n, hovering.vehicle.body.e) < 2.0


def test_return_is_refused_without_an_origin() -> None:
    bench = Bench()
    bench.vision = True
    bench.run(3.0)
    assert bench.arm() is Result.ACCEPTED
    assert bench.ask(NavState.RETURN) is Result.TEMPORARILY_REJECTED


def test_a_zero_setpoint_does_not_lift_it_off_the_ground() -> None:
    bench = Bench()
    bench.get_ready()
    bench.arm()
    bench.offboard()
    bench.run(3.0)
    assert bench.vehicle.body.d == 0.0
    bench.vehicle.set_target(Setpoint(vn_m_s=0.0, ve_m_s=0.0, vd_m_s=-1.0))
    bench.velocity = (0.0, 0.0, -1.0)
    bench.run(4.0)
    assert bench.vehicle.body.d < -1.0


def test_it_does_not_arm_before_a_ground_station_was_heard_where_its_loss_acts() -> None:
    bench = Bench(parameters=(("NAV_DLL_ACT", 2),))
    bench.get_ready()
    assert bench.arm() is Result.TEMPORARILY_REJECTED
    bench.vehicle.gcs_heard_s = bench.vehicle.t_s
    bench.run(0.1)
    assert bench.arm() is Result.ACCEPTED
