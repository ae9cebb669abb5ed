"""Laws of the simulated airframe, its wind, its sensors and its control."""

import math
import random
import statistics

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from px4_bench import Bench
from scipy.spatial.transform import Rotation

from vwnav.errors import ConfigError
from vwnav.sim.config import VehicleConfig
from vwnav.sim.multirotor.airframe import Airframe, rotation_of, turned
from vwnav.sim.multirotor.controller import quat_of_euler
from vwnav.sim.multirotor.sensors import QUIET, Sensors, pressure_hpa
from vwnav.sim.multirotor.wind import Wind
from vwnav.sim.px4.modes import NavState
from vwnav.sim.relief import Relief
from vwnav.vehicle import FlightMode

ANGLE = st.floats(-3.1, 3.1)
CALM = (0.0, 0.0, 0.0)


@given(ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_rotations_agree_with_scipy(roll: float, pitch: float, yaw: float) -> None:
    w, x, y, z = quat_of_euler(roll, pitch, yaw)
    theirs = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    assert rotation_of(w, x, y, z) == pytest.approx(theirs.as_matrix().ravel(), abs=1e-9)


@given(ANGLE, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_small_turns_agree_with_scipy(yaw: float, p: float, q: float, r: float) -> None:
    start = quat_of_euler(0.0, 0.0, yaw)
    w, x, y, z = turned(start, p, q, r, 0.004)
    theirs = Rotation.from_euler("z", yaw) * Rotation.from_rotvec([0.004 * v for v in (p, q, r)])
    assert rotation_of(w, x, y, z) == pytest.approx(theirs.as_matrix().ravel(), abs=1e-6)


def test_half_throttle_hovers() -> None:
    body = Airframe(0.0, 0.17, Relief().height_m)
    body.d = -10.0
    body.rotors = [0.5] * 4
    for _ in range(500):
        body.step((0.5, 0.5, 0.5, 0.5), CALM, 0.004)
    assert body.d == pytest.approx(-10.0, abs=1e-6)


def test_it_falls_to_the_ground_and_stays_there() -> None:
    body = Airframe(1.0, 0.17, Relief().height_m)
    body.d = -2.0
    for _ in range(500):
        body.step((0.0, 0.0, 0.0, 0.0), (5.0, 3.0, 0.0), 0.004)
    assert (body.d, body.vd) == (0.0, 0.0)
    assert body.on_ground
    assert body.azb == pytest.approx(-9.80665)


@pytest.mark.parametrize(("north_m", "east_m"), [(80.0, -40.0), (-60.0, 90.0), (700.0, 0.0)])
def test_on_a_hill_it_comes_to_rest_on_the_hill_and_its_rangefinder_meets_it(
    north_m: float, east_m: float
) -> None:
    relief = Relief(slope_ne=(0.05, -0.1), hills_m=4.0, seed=3)
    body = Airframe(0.0, 0.17, relief.height_m)
    body.n, body.e, body.d = north_m, east_m, -relief.height_m(north_m, east_m) - 30.0
    body.rotation = rotation_of(*quat_of_euler(0.2, -0.15, 1.0))
    distance_m = Sensors(random.Random(1), QUIET, 0.0, 0.0, 0.0).range_m(body)
    assert distance_m is not None
    north, east, down = (distance_m * body.rotation[i] for i in (2, 5, 8))
    assert -body.d - down == pytest.approx(relief.height_m(north_m + north, east_m + east), abs=0.1)
    body.d = -relief.height_m(north_m, east_m) - 2.0
    for _ in range(500):
        body.step((0.0, 0.0, 0.0, 0.0), CALM, 0.004)
    for _ in range(250):
        body.step((0.0, 0.0, 0.0, 0.0), (3.0, 0.0, 0.0), 0.004)
        assert body.on_ground
    assert -body.d == pytest.approx(relief.height_m(body.n, body.e), abs=0.01)


@pytest.mark.parametrize(
    ("rotors", "axis"),
    [((0.5, 0.6, 0.6, 0.5), "p"), ((0.6, 0.5, 0.6, 0.5), "q"), ((0.6, 0.6, 0.5, 0.5), "r")],
)
def test_rotors_turn_it_the_way_px4s_quad_x_does(
    rotors: tuple[float, float, float, float], axis: str
) -> None:
    body = Airframe(0.0, 0.17, Relief().height_m)
    body.d = -10.0
    for _ in range(20):
        body.step(rotors, CALM, 0.004)
    rates = {"p": body.p, "q": body.q, "r": body.r}
    assert rates.pop(axis) > 0.01
    assert max(map(abs, rates.values())) < 1e-9


def test_6_m_s_of_wind_is_held_with_about_5_5_degrees_of_tilt() -> None:
    bench = Bench(wind_m_s=6.0, gust_m_s=0.0).hover(15.0)
    bench.run(10.0)
    tilt_deg = math.degrees(math.acos(bench.vehicle.body.rotation[8]))
    assert 4.5 < tilt_deg < 6.5


@settings(max_examples=5, deadline=None)
@given(st.floats(-4, 4), st.floats(-4, 4), st.integers(0, 100))
def test_offboard_velocities_are_flown(vn: float, ve: float, seed: int) -> None:
    bench = Bench(seed=seed, gust_m_s=0.0, heading_deg=120.0).hover().offboard((vn, ve, 0.0))
    bench.run(8.0)
    body = bench.vehicle.body
    assert math.hypot(body.vn - vn, body.ve - ve) < 0.15 + 0.06 * math.hypot(vn, ve)
    assert abs(math.remainder(bench.vehicle.estimator.attitude.yaw_rad, math.tau)) < 0.05


def test_wind_blows_to_the_other_side_and_less_at_the_ground() -> None:
    wind = Wind(8.0, 270.0, 0.0, random.Random(1))
    wind.step(50.0, 0.0, 0.02)
    assert (wind.n_m_s, wind.e_m_s) == pytest.approx((0.0, 8.0), abs=1e-9)
    wind.step(1.0, 0.0, 0.02)
    assert 2.0 < wind.e_m_s < 5.0


def test_gusts_have_the_strength_asked_for() -> None:
    wind = Wind(0.0, 0.0, 1.5, random.Random(2))
    gusts = []
    for _ in range(100_000):
        wind.step(50.0, 5.0, 0.1)
        gusts.append(wind.n_m_s)
    assert statistics.pstdev(gusts) == pytest.approx(1.5, rel=0.1)
    assert statistics.fmean(gusts) == pytest.approx(0.0, abs=0.15)


def test_the_barometer_drifts_by_what_was_asked_in_ten_minutes() -> None:
    ends = []
    for seed in range(60):
        sensors = Sensors(random.Random(seed), QUIET, 0.0, 2.0, 0.0)
        body = Airframe(0.0, 0.17, Relief().height_m)
        ends.append([sensors.baro_height_m(body, 1.0) for _ in range(600)][-1])
    assert statistics.pstdev(ends) == pytest.approx(2.0, rel=0.25)


def test_the_pressure_at_sea_level_and_at_1000_m_is_the_standard_one() -> None:
    assert pressure_hpa(0.0) == pytest.approx(1013.25)
    assert pressure_hpa(1000.0) == pytest.approx(898.75, abs=0.1)  # ISO 2533


def test_the_same_seed_flies_the_same_flight() -> None:
    first, second = (Bench(seed=9, wind_m_s=4.0).hover().vehicle.body for _ in range(2))
    assert (first.n, first.e, first.d) == (second.n, second.e, second.d)


@pytest.mark.parametrize(
    "change", [{"speed": 0.0}, {"home_lat_deg": 95.0}, {"battery_start": 0.0}, {"wind_m_s": -1.0}]
)
def test_a_senseless_configuration_is_refused(change: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(change))):
        VehicleConfig(**change)


@pytest.mark.parametrize("wind_m_s", [0.0, 8.0])
def test_begun_in_the_air_it_flies_on_steadily(wind_m_s: float) -> None:
    bench = Bench(wind_m_s=wind_m_s)
    bench.run(2.0)
    vehicle, body = bench.vehicle, bench.vehicle.body
    vehicle.begin_in_flight((100.0, -50.0, -50.0), (4.0, -4.0, 0.0), 1.0, FlightMode.OFFBOARD)
    bench.vision, bench.velocity = True, (4.0, -4.0, 0.0)
    for second in range(1, 11):
        bench.run(1.0)
        assert bench.state is NavState.OFFBOARD
        assert math.hypot(body.vn - 4.0, body.ve + 4.0) < 1.5
        assert abs(body.d + 50.0) < 1.5
        assert math.hypot(body.n - 100 - 4 * second, body.e + 50 + 4 * second) < 5.0
        assert bench.position_error_m < 1.0
