"""What follows from ArduCopter's ways, without a recording to compare it with."""

import math

import pytest
from copter_bench import ARM, CopterBench

from vwnav.errors import ConfigError
from vwnav.sim.config import PilotPlan, VehicleConfig
from vwnav.sim.copter.modes import Mode
from vwnav.vehicle import FlightMode


def speed(bench: CopterBench) -> float:
    return math.hypot(bench.vehicle.body.vn, bench.vehicle.body.ve)


def test_wind_is_held_with_a_tilt_and_without_a_drift() -> None:
    bench = CopterBench(wind_m_s=5.0, gust_m_s=0.0).aloft(15.0)
    bench.run(5.0)
    roll, pitch, _ = bench.vehicle.body.euler_rad
    assert math.hypot(roll, pitch) == pytest.approx(0.384 * 5.0 / 9.81, rel=0.1)
    assert speed(bench) < 0.2


def test_a_jump_with_a_new_reset_counter_is_taken_at_once_and_without_one_refused() -> None:
    bench = CopterBench().aloft()
    bench.vision_jump_m = 5.0
    bench.run(1.0)
    north = bench.vehicle.estimator.north
    assert north.x - bench.vehicle.body.n < 1.0
    bench.reset_counter += 1
    bench.run(0.1)
    assert north.x - bench.vehicle.body.n == pytest.approx(5.0, abs=0.2)


def test_a_silent_jump_is_given_in_to_when_it_stays() -> None:
    bench = CopterBench().aloft()
    bench.vision_jump_m = 30.0
    bench.run(8.0)
    error_m = bench.vehicle.estimator.north.x - bench.vehicle.body.n
    assert error_m == pytest.approx(30.0, abs=1.0)


def test_guided_chases_what_vision_says() -> None:
    bench = CopterBench().aloft()
    bench.velocity = (0.0, 0.0, 0.0)
    bench.run(1.0)
    bench.vision_wrong_m_s, bench.vision_jump_m = 2.0, -2.0 * bench.t_s
    bench.reset_counter += 1
    bench.run(5.0)
    assert bench.vehicle.body.vn == pytest.approx(-2.0, abs=0.3)


def test_after_the_ekf_failsafe_a_wrong_acceleration_tilts_it() -> None:
    """LAND stays without a position to hold, but its horizon is the filter's."""
    bench = CopterBench().aloft(40.0)
    bench.vision = False
    bench.run(9.0)
    assert bench.mode is Mode.LAND
    bench.vision = True
    began_s = bench.t_s
    fastest = 0.0
    while bench.t_s - began_s < 12.0:
        wrong = 1.5 * (bench.t_s - began_s)
        bench.vision_wrong_m_s = wrong
        bench.vision_jump_m = 0.5 * wrong * (bench.t_s - began_s) - wrong * bench.t_s
        bench.run(0.1)
        fastest = max(fastest, speed(bench))
    assert bench.mode is Mode.LAND
    assert fastest > 1.0


def test_a_mode_that_needs_a_position_is_refused_without_one() -> None:
    bench = CopterBench().aloft()
    bench.vision = False
    bench.run(9.0)
    assert bench.set_mode(Mode.GUIDED) == 4
    assert bench.texts()[-1] == "Mode change to GUIDED failed: requires position"
    assert bench.set_mode(Mode.AUTO) == 4
    assert bench.mode is Mode.LAND


@pytest.mark.parametrize("height_m", [4.0, 12.0])
def test_a_takeoff_ends_at_the_height_asked_for(height_m: float) -> None:
    bench = CopterBench(baro_drift_m=0.0).hover(height_m)
    bench.run(5.0)
    assert -bench.vehicle.estimator.down.x == pytest.approx(height_m, abs=0.15)


def test_it_stays_where_it_is_when_the_estimate_jumps() -> None:
    bench = CopterBench().aloft()
    bench.set_mode(Mode.BRAKE)
    bench.run(2.0)
    bench.vision_jump_m, bench.reset_counter = 5.0, 1
    bench.run(6.0)
    assert abs(bench.vehicle.body.n) < 1.0


def test_in_land_the_ekf_failsafe_changes_no_mode_and_lets_the_place_go() -> None:
    bench = CopterBench(wind_m_s=4.0, gust_m_s=0.0).aloft(30.0)
    bench.set_mode(Mode.LAND)
    bench.run(2.0)
    assert speed(bench) < 0.5
    since_s, bench.vision = bench.t_s, False
    bench.run(12.0)
    assert bench.texts(since_s) == ["EKF variance"]
    assert speed(bench) > 2.0


def test_a_mode_is_refused_until_the_ekf_failsafe_is_cleared() -> None:
    bench = CopterBench().aloft()
    bench.vision = False
    bench.run(9.0)
    bench.vision = True
    bench.run(0.3)
    assert bench.set_mode(Mode.GUIDED) == 4
    bench.run(1.5)
    assert bench.set_mode(Mode.GUIDED) == 0


def test_brake_stops_and_stays() -> None:
    bench = CopterBench().aloft()
    bench.velocity = (4.0, 0.0, 0.0)
    bench.run(5.0)
    assert bench.set_mode(Mode.BRAKE) == 0
    bench.run(2.0)
    assert speed(bench) < 0.3
    bench.run(5.0)
    assert bench.mode is Mode.BRAKE


def test_rtl_lands_where_it_took_off() -> None:
    bench = CopterBench().aloft(15.0)
    bench.velocity = (4.0, 0.0, 0.0)
    bench.run(6.0)
    assert bench.set_mode(Mode.RTL) == 0
    bench.run(60.0)
    assert not bench.vehicle.commander.armed
    assert math.hypot(bench.vehicle.body.n, bench.vehicle.body.e) < 1.0


def test_armed_and_left_alone_it_disarms() -> None:
    bench = CopterBench()
    bench.get_ready()
    bench.set_mode(Mode.GUIDED)
    bench.run(1.1)
    assert bench.command(ARM, 1.0) == 0
    bench.run(10.0)
    assert bench.vehicle.commander.armed
    bench.run(4.0)
    assert not bench.vehicle.commander.armed


def test_a_lost_radio_returns_home() -> None:
    bench = CopterBench(pilot=PilotPlan(rc_on=True, rc_lost_at_s=4.0)).aloft()
    bench.run(4.0 - bench.t_s)
    assert bench.mode is Mode.GUIDED
    assert bench.until(Mode.RTL, 3.0) == pytest.approx(1.0, abs=0.1)


def test_a_reboot_keeps_the_parameters_and_forgets_the_origin() -> None:
    bench = CopterBench()
    bench.get_ready()
    bench.set_parameter("FS_GCS_TIMEOUT", 7.0)
    assert bench.command(246, 1.0) == 0
    bench.run(1.0)
    assert bench.vehicle.t_s < 1.1
    assert bench.vehicle.parameters["FS_GCS_TIMEOUT"] == 7.0
    assert bench.vehicle.estimator.origin is None


@pytest.mark.parametrize(
    ("mode", "custom_mode"),
    [(FlightMode.OFFBOARD, 4), (FlightMode.MANUAL, 5), (FlightMode.LAND, 9)],
)
def test_a_flight_may_begin_in_the_air(mode: FlightMode, custom_mode: int) -> None:
    bench = CopterBench()
    bench.run(2.0)
    bench.vehicle.begin_in_flight((10.0, 0.0, -30.0), (2.0, 0.0, 0.0), 0.0, mode)
    bench.vision = True
    bench.run(2.0)
    assert bench.vehicle.commander.mode == custom_mode
    assert bench.vehicle.flight_mode is mode
    assert -bench.vehicle.body.d > 26.0


def test_there_are_two_manners() -> None:
    with pytest.raises(ConfigError, match="manners"):
        VehicleConfig(manners="helicopter")  # type: ignore[arg-type]
