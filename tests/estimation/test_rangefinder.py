"""A rangefinder is one witness of the height: it is heard, corrected, and outvoted."""

import numpy as np
import pytest

from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import NedFix
from vwnav.estimation.states import States, Verdict
from vwnav.types import Attitude, Height, ImuSample, OdometryMotion, Range, Stationary

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
AGL_M = 50.0


class Flight:
    """Level at 50 m, northwards, with barometer, ways and, while `seen`, fixes; knows the truth."""

    def __init__(self, speed_m_s: float = 0.0) -> None:
        self.t_s, self.speed_m_s, self.seen = 0.0, speed_m_s, True
        self.map_times, self.sinks_m_s, self.sunk_m = 1.0, 0.0, 0.0
        self.said: list[str] = []
        self.verdicts: list[Verdict] = []
        self.ekf = Ekf(EkfConfig())
        self.ekf.on_event(self.said.append)
        self.ekf.handle(Attitude(0.0, LEVEL))
        place = np.array([0.0, 0.0, -AGL_M])
        start = Start(
            t_s=0.0, position_ned_m=place, sigma_m=1.0, agl_m=AGL_M, sigma_agl_m=0.5,
            sigma_velocity_m_s=0.1 + speed_m_s,
        )  # fmt: skip
        self.ekf.initialise(start)

    def fly(self, seconds: float, says, agl_m: float = AGL_M) -> "Flight":
        """Go on; the rangefinder says `says(true distance)`."""
        for _ in range(round(seconds * 50.0)):
            t_s = self.t_s = round(self.t_s + 0.02, 6)
            n = round(t_s * 50.0)
            self.sunk_m += 0.02 * self.sinks_m_s
            height_m, above_m = AGL_M - self.sunk_m, agl_m - self.sunk_m
            place = np.array([self.speed_m_s * t_s, 0.0, -height_m])
            self.ekf.handle(Attitude(t_s, LEVEL))
            if n % 5 == 0:
                self.ekf.handle(Height(t_s, height_m))
                self.verdicts.append(self.ekf.handle(Range(t_s, says(above_m))).verdict)
            if n % 10 == 0:
                way = 0.2 * np.array([self.speed_m_s, 0.0, self.sinks_m_s])
                seen = OdometryMotion(
                    round(t_s - 0.2, 6), t_s, way, 0.05**2 * np.eye(3), 0.0, 0.003, above_m, 99
                )
                self.ekf.handle(seen)
            if n % 20 == 0 and self.seen:
                seen_m = self.map_times * above_m
                fix = NedFix(
                    t_s=t_s, position_ne_m=place[:2], covariance_ne_m2=0.5**2 * np.eye(2),
                    yaw_rad=0.0, sigma_yaw_rad=0.01, agl_m=seen_m, sigma_agl_m=0.5,
                )  # fmt: skip
                self.ekf.handle(fix)
            self.ekf.estimate(t_s)
        return self

    @property
    def agl_m(self) -> float:
        return self.ekf.estimate(self.t_s).agl_m


@pytest.mark.parametrize("stuck_m", [0.2, 3.0, 25.0, 80.0])
@pytest.mark.parametrize("speed_m_s", [0.0, 8.0])
@pytest.mark.parametrize("seen", [True, False])
def test_one_that_is_stuck_is_doubted_and_said_and_moves_nothing(stuck_m, speed_m_s, seen):
    flight = Flight(speed_m_s).fly(5.0, lambda m: m)
    flight.seen = seen
    flight.fly(8.0, lambda _: stuck_m)
    assert flight.verdicts[-1] is Verdict.DOUBTED
    assert flight.said == ["the rangefinder contradicts map and barometer: it is not believed"]
    assert abs(flight.agl_m - AGL_M) < 1.5
    assert np.all(np.abs(flight.ekf.state.x[States.VELOCITY_NE] - [speed_m_s, 0.0]) < 1.0)


def test_one_that_was_doubted_is_heard_again_when_it_has_agreed_for_seconds():
    flight = Flight().fly(5.0, lambda m: m).fly(3.0, lambda _: 3.0).fly(2.0, lambda m: m)
    assert flight.verdicts[-1] is Verdict.DOUBTED
    flight.fly(2.0, lambda m: m)
    assert flight.verdicts[-1] is Verdict.FUSED
    assert flight.said[-1] == "the rangefinder agrees with map and barometer again: it is believed"


@pytest.mark.parametrize("times", [0.98, 1.02])
def test_one_that_is_two_per_cent_off_is_borne(times):
    flight = Flight(8.0).fly(30.0, lambda m: times * m)
    assert not flight.said
    assert abs(flight.agl_m - AGL_M) < 0.03 * AGL_M


@pytest.mark.parametrize("times", [0.92, 0.94, 1.06, 1.08, 1.1])
def test_one_whose_scale_is_off_is_not_made_true_by_a_map_out_of_scale(times):
    """Inside of their gate heights by the map gave way a little each time: 6 % in 10 s."""
    flight = Flight(8.0).fly(5.0, lambda m: m).fly(12.0, lambda m: times * m)
    assert flight.said[0] == "the rangefinder contradicts map and barometer: it is not believed"
    assert abs(flight.ekf.state.x[States.MAP_SCALE]) < 0.033
    assert abs(flight.agl_m - AGL_M) < 2.0


@pytest.mark.parametrize("times", [0.87, 0.94, 0.96, 1.04, 1.06])
@pytest.mark.parametrize("sinks_m_s", [0.0, 1.5])
def test_matches_over_one_place_that_are_out_of_scale_are_one_witness_against_two(times, sinks_m_s):
    """A rendered hover showed 3 to 5 % of the height less, and the rangefinder was blamed.

    A descent over slabs 13 %.
    """
    flight = Flight().fly(5.0, lambda m: m)
    flight.sinks_m_s, flight.map_times = sinks_m_s, times
    flight.fly(15.0, lambda m: m)
    assert flight.said == []
    assert abs(flight.agl_m - (AGL_M - flight.sunk_m)) < 1.0


def test_a_house_below_is_believed_of_its_word_where_no_fix_tells_and_only_on_the_way():
    flown = Flight(8.0).fly(5.0, lambda m: m)
    flown.seen = False
    flown.fly(6.0, lambda m: m).fly(4.0, lambda m: m, agl_m=AGL_M - 4.0)
    assert Verdict.RELOCATED in flown.verdicts
    assert flown.agl_m == pytest.approx(AGL_M - 4.0, abs=1.0)
    hovering = Flight().fly(5.0, lambda m: m)
    hovering.seen = False
    hovering.fly(6.0, lambda m: m).fly(4.0, lambda m: m - 4.0)
    assert Verdict.RELOCATED not in hovering.verdicts
    assert hovering.agl_m == pytest.approx(AGL_M, abs=1.0)


@pytest.mark.parametrize("climb_m_s2", [0.3, 0.6, 0.9, 2.0])
def test_one_that_is_stuck_does_not_draw_a_slow_climb_along(climb_m_s2):
    """Each that says too little is inside its gate: 1 m of 2 was lost so, and the rest freed."""
    ekf, said, speed_m_s, height_m = Ekf(EkfConfig()), [], 0.0, 0.0
    ekf.on_event(said.append)
    ekf.handle(Attitude(0.0, LEVEL))
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.zeros(3), sigma_m=1.0, agl_m=0.2))
    for n in range(1, 701):
        t_s = round(0.02 * n, 6)
        rises_m_s2 = climb_m_s2 if t_s > 5.0 and speed_m_s < 1.5 else 0.0
        height_m += 0.02 * speed_m_s + 0.5 * 0.02**2 * rises_m_s2
        speed_m_s += 0.02 * rises_m_s2
        ekf.handle(Attitude(t_s, LEVEL))
        ekf.handle(ImuSample(t_s, np.array([0.0, 0.0, -9.80665 - rises_m_s2]), np.zeros(3)))
        if t_s < 5.0:
            ekf.handle(Stationary(t_s))
        if n % 5 == 0:
            ekf.handle(Height(t_s, height_m))
            ekf.handle(Range(t_s, 0.2))
        ekf.estimate(t_s)
    assert said == ["the rangefinder contradicts map and barometer: it is not believed"]
    assert ekf.estimate(t_s).agl_m == pytest.approx(0.2 + height_m, abs=1.0)


def climb(times: float, fixes_above_m: float):
    """From the ground at 2 m/s for 25 s, with a rangefinder that says so many `times` the distance.

    Yields the filter, true height above ground and what was said, ten times a second.
    """
    ekf, said, speed_m_s, height_m = Ekf(EkfConfig()), [], 0.0, 0.2
    ekf.on_event(said.append)
    ekf.handle(Attitude(0.0, LEVEL))
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.zeros(3), sigma_m=1.0, agl_m=0.2))
    before_m = height_m
    for n in range(1, 1501):
        t_s = round(0.02 * n, 6)
        rises_m_s2 = 1.0 if t_s > 5.0 and speed_m_s < 2.0 else 0.0
        height_m += 0.02 * speed_m_s + 0.5 * 0.02**2 * rises_m_s2
        speed_m_s += 0.02 * rises_m_s2
        ekf.handle(Attitude(t_s, LEVEL))
        ekf.handle(ImuSample(t_s, np.array([0.0, 0.0, -9.80665 - rises_m_s2]), np.zeros(3)))
        if t_s < 5.0:
            ekf.handle(Stationary(t_s))
        if n % 5 == 0:
            ekf.handle(Height(t_s, height_m - 0.2))
            ekf.handle(Range(t_s, times * height_m))
        if n % 10 == 0:
            believed_m = max(ekf.estimate(t_s).agl_m, 0.3)
            way = np.array([0.0, 0.0, -(height_m - before_m) / height_m * believed_m])
            noise = (0.003 * believed_m) ** 2 * np.eye(3)
            since_s = round(t_s - 0.2, 6)
            if height_m > 1.0:
                ekf.handle(OdometryMotion(since_s, t_s, way, noise, 0.0, 0.003, believed_m, 99))
            before_m = height_m
        if n % 20 == 0 and height_m > fixes_above_m:
            fix = NedFix(
                t_s=t_s, position_ne_m=np.zeros(2), covariance_ne_m2=0.5**2 * np.eye(2),
                yaw_rad=0.0, sigma_yaw_rad=0.01, agl_m=height_m, sigma_agl_m=0.5,
            )  # fmt: skip
            ekf.handle(fix)
        if n % 5 == 0:
            yield ekf, height_m, said


def test_one_that_is_short_is_doubted_and_the_height_comes_back_from_barometer_and_images_alone():
    """It was believed anew every few seconds of the climb: 12 m of 61, and no fix found there.

    While it is the only one to contradict the barometer, the height is as unsure as they are apart.
    """
    for ekf, height_m, said in climb(0.8, fixes_above_m=np.inf):
        if said and height_m > 15.0:
            estimate = ekf.estimate(ekf.state.t_s)
            sigma_m = float(np.sqrt(ekf.state.P[States.DOWN, States.DOWN]))
            assert abs(estimate.agl_m - height_m) < 5.0 * max(0.3, sigma_m), height_m
    assert said == ["the rangefinder contradicts map and barometer: it is not believed"]
    assert estimate.agl_m == pytest.approx(height_m, rel=0.05)


@pytest.mark.parametrize("times", [0.88, 1.1])
def test_a_height_that_it_has_drawn_along_with_the_barometer_is_given_up_to_fixes(times):
    """Fixes were refused and then borne for a moment: the map's scale was taken for 6 % off."""
    *_, (ekf, height_m, said) = climb(times, fixes_above_m=20.0)
    assert said == ["the rangefinder contradicts map and barometer: it is not believed"]
    assert ekf.estimate(ekf.state.t_s).agl_m == pytest.approx(height_m, rel=0.025)
    assert abs(ekf.state.x[States.MAP_SCALE]) < 0.03


@pytest.mark.parametrize("sinks_m_s", [0.4, 0.75, 1.0])
def test_the_touch_of_the_ground_which_no_imu_hears_is_not_held_against_it(sinks_m_s):
    """The filter sank on to 0.7 m below the ground, and did not believe the rangefinder."""
    ekf, said, lowest_m, touch_s = Ekf(EkfConfig()), [], 0.0, 8.0 / sinks_m_s
    ekf.on_event(said.append)
    ekf.handle(Attitude(0.0, LEVEL))
    place = np.array([0.0, 0.0, -8.0])
    ekf.initialise(
        Start(t_s=0.0, position_ned_m=place, sigma_m=1.0, agl_m=8.1, sigma_velocity_m_s=1.0)
    )
    for n in range(1, round(50.0 * (touch_s + 3.0))):
        t_s = round(0.02 * n, 6)
        height_m = max(8.0 - sinks_m_s * t_s, 0.0)
        ekf.handle(Attitude(t_s, LEVEL))
        ekf.handle(ImuSample(t_s, np.array([0.0, 0.0, -9.80665]), np.zeros(3)))
        if n % 5 == 0:
            ekf.handle(Height(t_s, height_m))
            if not touch_s < t_s < touch_s + 1.2:  # it is too near for its pulses, mostly
                ekf.handle(Range(t_s, height_m + 0.1))
        lowest_m = min(lowest_m, ekf.estimate(t_s).agl_m)
    assert not said
    assert lowest_m > -0.3
    assert ekf.estimate(t_s).agl_m == pytest.approx(0.1, abs=0.1)
