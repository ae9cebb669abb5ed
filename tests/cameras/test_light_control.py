"""Laws of the exposure's controller, and the controller against cameras that are simulated."""

import itertools
import math
from collections import deque

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.cameras.light.control import TARGET_LEVEL, Light, LightControl, LightRange, shared_out

SPAN = LightRange(
    shortest_s=1e-4, longest_s=1.0 / 30.0, step_s=1e-4, least_gain=1.0, most_gain=16.0
)
levels = st.floats(0.0, 255.0)
totals_s = st.floats(1e-6, 10.0)
limits_s = st.one_of(st.floats(1e-6, 1.0), st.just(math.inf))
lights = st.builds(Light, st.floats(1e-4, 0.1), st.floats(1.0, 16.0))


@given(totals_s, limits_s)
def test_the_exposure_comes_first_and_gain_after_it(total_s, most_s):
    light = shared_out(total_s, SPAN, most_s)
    longest_s = max(min(most_s, SPAN.longest_s), SPAN.shortest_s)
    assert SPAN.shortest_s <= light.exposure_s <= longest_s + 1e-9
    assert 1.0 <= light.gain <= 16.0
    lacks = light.exposure_s < longest_s - SPAN.step_s - 1e-9
    assert not lacks or light.gain <= 1.0 + SPAN.step_s / light.exposure_s + 1e-6
    if SPAN.shortest_s <= total_s <= 16.0 * light.exposure_s:
        assert light.total_s == pytest.approx(total_s)


@given(st.lists(st.tuples(levels, lights, limits_s), min_size=1, max_size=12))
def test_whatever_is_seen_a_command_is_possible_and_does_not_blur(looks):
    control, told_s = LightControl(SPAN), math.inf
    for number, (level, now, most_s) in enumerate(looks):
        then = control.next(0.1 * number, level, now, most_s)
        if then is not None:
            assert then.exposure_s <= max(most_s, SPAN.shortest_s) + 1e-9
            assert SPAN.shortest_s <= then.exposure_s <= SPAN.longest_s + 1e-9
            assert 1.0 <= then.gain <= 16.0
            assert then.total_s <= max(2.0 * now.total_s, SPAN.shortest_s) + 1e-9
            told_s = then.exposure_s
        elif number:
            is_told = told_s <= max(most_s, SPAN.shortest_s + SPAN.step_s)
            assert is_told or now.exposure_s <= max(most_s, SPAN.shortest_s + SPAN.step_s)


@given(st.floats(0.85, 1.15))
def test_what_is_bright_enough_is_left_alone(ratio):
    control, now = LightControl(SPAN), Light(0.005, 2.0)
    control.next(0.0, TARGET_LEVEL, now, 0.0055)
    told = [control.next(0.1 * i, ratio * TARGET_LEVEL, now, 0.0055) for i in range(1, 60)]
    assert told == [None] * 59


@given(levels, st.integers(0, 2))
def test_one_image_unlike_the_others_moves_nothing(level, which):
    control, now = LightControl(SPAN), Light(0.005, 2.0)
    control.next(-1.0, TARGET_LEVEL, now, 0.0055)
    for number in range(6):
        seen = level if number == which else TARGET_LEVEL
        assert control.next(0.1 * number, seen, now, 0.0055) is None


def test_a_faster_flight_shortens_at_once_and_keeps_the_brightness():
    control, now = LightControl(SPAN), Light(0.01, 1.0)
    control.next(0.0, TARGET_LEVEL, now, math.inf)
    then = control.next(0.1, TARGET_LEVEL, now, 0.004)
    assert then.exposure_s <= 0.004
    assert then.total_s == pytest.approx(now.total_s, rel=0.01)


class Sensor:
    """A camera whose images show a command some looks later, and whose gain is its own affair."""

    def __init__(self, gamma, gain_of, late, exposure_of=lambda exposure_s: exposure_s) -> None:
        self.gamma, self.gain_of, self.exposure_of = gamma, gain_of, exposure_of
        self.light = Light(0.02, 1.0)
        self.coming = deque([self.light] * (late + 1), late + 1)

    def level(self, scene):
        self.coming.append(self.light)
        seen = self.coming[0]
        linear = scene * self.exposure_of(seen.exposure_s) * self.gain_of(seen.gain)
        return 255.0 * min(linear, 1.0) ** (1.0 / self.gamma)


def fly(sensor, scenes, most_s):
    """Levels and commands of looks, ten a second."""
    control, levels, told = LightControl(SPAN), [], []
    for number, (scene, limit_s) in enumerate(zip(scenes, itertools.cycle(most_s), strict=False)):
        level = sensor.level(scene)
        then = control.next(0.1 * number, level, sensor.light, limit_s)
        sensor.light = then or sensor.light
        levels.append(level)
        told.append(then)
    return levels, told


GAINS = {
    "as told": lambda gain: gain,
    "in stops": lambda gain: 2.0 ** (4.0 * (gain - 1.0) / 15.0),
    "less": lambda gain: gain**0.5,
    "more": lambda gain: gain**1.5,
}


@pytest.mark.parametrize("late", [0, 3])
@pytest.mark.parametrize("gamma", [1.0, 2.2])
@pytest.mark.parametrize("gain", GAINS)
@pytest.mark.parametrize("change", [0.1, 0.3, 3.0, 10.0])
def test_light_that_changes_is_followed_and_then_left_alone(late, gamma, gain, change):
    """Bright enough 6 s after it changed, and no command in the 10 s after that."""
    before, after = 150.0 / math.sqrt(change), 150.0 * math.sqrt(change)
    before, after = min(before, 400.0), min(after, 400.0)
    scenes = [before] * 80 + [after] * 160
    levels, told = fly(Sensor(gamma, GAINS[gain], late), scenes, [0.004])
    assert 0.7 < levels[60] / TARGET_LEVEL < 1.4
    assert 0.7 < levels[140] / TARGET_LEVEL < 1.4
    assert told[60:80] == [None] * 20
    assert told[140:] == [None] * 100


def test_a_covered_lens_ends_at_the_limits_and_is_left_within_seconds():
    sensor = Sensor(2.2, GAINS["as told"], 1)
    levels, told = fly(sensor, [150.0] * 60 + [0.0] * 50 + [150.0] * 60, [0.004])
    assert all(then is None or then.exposure_s <= 0.004 for then in told)
    assert max(then.gain for then in told if then) <= SPAN.most_gain
    assert 0.7 < levels[-20] / TARGET_LEVEL < 1.4


def test_a_lens_covered_for_a_moment_changes_nothing():
    scenes = [150.0] * 60 + [0.0] + [150.0] * 30
    _, told = fly(Sensor(2.2, GAINS["as told"], 0), scenes, [0.004])
    assert told[40:] == [None] * 51


@pytest.mark.parametrize("gain", GAINS)
def test_a_limit_that_jumps_with_the_gusts_keeps_no_image_dark(gain):
    sensor = Sensor(2.2, GAINS[gain], 1)
    levels, _ = fly(sensor, [150.0] * 20 + [30.0] * 100, [0.008, 0.004, 0.002])
    assert min(levels[80:]) > 0.6 * TARGET_LEVEL


def test_who_may_expose_longer_does():
    sensor = Sensor(2.2, GAINS["as told"], 0)
    fly(sensor, [30.0] * 60, [0.002])
    assert sensor.light.gain > 1.5
    fly(sensor, [30.0] * 60, [0.02])
    assert sensor.light.gain < 1.1


@pytest.mark.parametrize("scene", [11.0, 13.0, 15.0, 17.0, 19.0, 21.0, 35.0, 60.0])
@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_a_camera_that_rounds_exposures_to_octaves_is_left_alone_in_the_end(scene, gamma):
    """As a kind of USB camera does, without a word: no exposure of it may be the right one."""

    def octave_s(exposure_s):
        return 1e-4 * 2.0 ** round(math.log2(exposure_s / 1e-4))

    sensor = Sensor(gamma, GAINS["as told"], 1, octave_s)
    levels, told = fly(sensor, [scene] * 300, [0.03])
    assert 0.45 < levels[-1] / TARGET_LEVEL < 2.1
    assert told[150:] == [None] * 150
    levels, _ = fly(sensor, [4.0 * scene] * 100, [0.03])
    assert 0.45 < levels[-1] / TARGET_LEVEL < 2.1


ROUNDS_UP = {
    "to octaves": lambda exposure_s: 1e-4 * 2.0 ** round(math.log2(exposure_s / 1e-4)),
    "to its least": lambda exposure_s: max(exposure_s, 0.008),
    "to the one it has": lambda _: 0.02,
}


@pytest.mark.parametrize("late", [0, 3])
@pytest.mark.parametrize("rounded_s", ROUNDS_UP.values(), ids=ROUNDS_UP)
@pytest.mark.parametrize("most_s", [0.0028, 0.0055, 0.006])
def test_a_camera_that_tells_a_longer_exposure_than_may_be_is_not_amplified_to_white(
    late, rounded_s, most_s
):
    """And its brightness is held by the gain alone."""
    sensor, control, levels, told = Sensor(2.2, GAINS["as told"], late), LightControl(SPAN), [], []
    for number in range(200):
        scene = 4.0 if number < 100 else 2.0
        levels.append(sensor.level(scene))
        limit_s = most_s * (1.0 - 0.001 * (number % 7))
        told.append(control.next(0.1 * number, levels[-1], sensor.light, limit_s))
        if told[-1]:
            sensor.light = Light(rounded_s(told[-1].exposure_s), told[-1].gain)
    assert max(levels[30:]) < 1.4 * TARGET_LEVEL
    for end in (100, 200):
        assert 0.7 < levels[end - 1] / TARGET_LEVEL < 1.4
        assert told[end - 30 : end] == [None] * 30


def test_a_camera_that_tells_no_exposure_in_its_own_automatic_is_held_all_the_same():
    assert LightControl(SPAN).next(0.0, TARGET_LEVEL, Light(0.0, 1.0), 0.004) is not None


def test_a_light_that_comes_and_goes_all_day_is_followed_as_well_as_at_first():
    """With a camera whose gain takes steps that go too far."""
    day = ([30.0] * 60 + [50.0] * 60) * 20
    levels, _ = fly(Sensor(1.0, GAINS["in stops"], 3), day, [0.002])
    for end in range(60, len(day) + 1, 60):
        assert 0.7 < levels[end - 1] / TARGET_LEVEL < 1.4
