"""A lens that is wrong by a share is told from ground that is wrong by as many metres."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.estimation.beginning.lens import LensCheck
from vwnav.estimation.beginning.other_camera import LENS_DOUBT, apply_lens_doubted
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import CameraReturned, NedFix, Recalibrated
from vwnav.estimation.inertial.attitudes import GRAVITY_M_S2
from vwnav.estimation.inputs import decode, encode
from vwnav.estimation.states import FilterState, RangeTrust, States, TrustedPosition, Verdict
from vwnav.types import Attitude, Estimate, Height, ImuSample, MapFix, OdometryMotion

SEEDS = st.integers(0, 2**32 - 1)
CLIMB_M = np.arange(22.0, 48.0, 1.2)


def believed(agl_m: float, sigma_m: float = 0.2, above_start_m: float | None = None) -> Estimate:
    down_m = -(agl_m if above_start_m is None else above_start_m)
    return Estimate(
        0.0, np.array([0.0, 0.0, down_m]), np.zeros(3), np.eye(6), np.array([1.0, 0.0, 0.0, 0.0]),
        0.02, agl_m, sigma_m, None, 0,
    )  # fmt: skip


def fix(agl_m: float | None) -> MapFix:
    return MapFix(
        t_s=0.0, lat_deg=60.4, lon_deg=22.5, covariance_ne_m2=np.eye(2), agl_m=agl_m,
        sigma_agl_m=0.5, yaw_rad=0.0, sigma_yaw_rad=0.02, point="nadir", features="learned",
    )  # fmt: skip


def of_filter(ranged: bool) -> FilterState:
    trust = RangeTrust((0.0, 0.0) if ranged else None)
    unit = np.eye(States.SIZE)
    return FilterState(0.0, np.zeros(States.SIZE), unit, True, True, 0.0, 0.0, range_trust=trust)


def climbed(check: LensCheck, by_map_m, heights_m=CLIMB_M, ranged=False):
    """By what the focal length is to be multiplied, or None, and how many heights were withheld."""
    withheld = 0
    for height_m, seen_m in zip(heights_m, by_map_m, strict=True):
        then = believed(height_m)
        if not (check.is_open and check.is_off(fix(seen_m), then, of_filter(ranged))):
            continue
        withheld += 1
        if check.told_by_fix():
            return check.focal_ratio, withheld
    return None, withheld


def test_a_fix_that_is_off_is_believed_once_others_before_it_in_a_row_were():
    """Of twelve looks at slabs one passed for a fix, 11 m beside home and a tenth out of scale."""
    check, lone = LensCheck(is_open=True), []
    for height_m, found in zip(CLIMB_M.tolist(), "xxxx.xx.xxxxxx", strict=False):
        if found == ".":
            check.missed()
            continue
        assert check.is_off(fix(0.89 * height_m), believed(height_m), of_filter(ranged=True))
        lone.append(check.is_lone())
    assert lone == 10 * [True] + 2 * [False]


@given(st.sampled_from([0.65, 0.75, 0.8, 0.85, 1.18, 1.25, 1.4]), SEEDS)
def test_a_lens_that_is_wrong_by_a_share_is_told_within_the_climb(focal_ratio: float, seed: int):
    noise = np.random.default_rng(seed).normal(0.0, 0.01, len(CLIMB_M))
    noise = 1.0 + np.clip(noise, -0.019, 0.019)  # no height is further off than what is allowed
    check = LensCheck(is_open=True)
    ratio, _ = climbed(check, CLIMB_M / focal_ratio * noise)
    assert ratio == pytest.approx(focal_ratio, rel=0.02)
    assert not check.is_open  # it is told once


@given(st.floats(7.0, 14.0), SEEDS)
def test_woods_under_which_the_ground_lies_are_no_lens(high_m: float, seed: int):
    noise = 1.0 + np.random.default_rng(seed).normal(0.0, 0.01, len(CLIMB_M))
    assert climbed(LensCheck(is_open=True), (CLIMB_M - high_m) * noise)[0] is None


def test_who_hovers_learns_nothing_and_does_not_ask_for_ever():
    check = LensCheck(is_open=True)
    ratio, withheld = climbed(check, np.full(100, 38.0), np.full(100, 30.0))
    assert ratio is None
    assert not check.is_open
    assert withheld < 30  # after that the map's height is for the filter again


@given(st.sampled_from([0.8, 0.9, 1.12, 1.25]), SEEDS)
def test_beside_a_rangefinder_who_hovers_learns_it_too(focal_ratio: float, seed: int):
    """It sees the same ground as the camera."""
    noise = 1.0 + np.random.default_rng(seed).normal(0.0, 0.01, 24)
    ratio, withheld = climbed(
        LensCheck(is_open=True), 30.0 / focal_ratio * noise, np.full(24, 30.0), ranged=True
    )
    assert ratio == pytest.approx(focal_ratio, rel=0.03)
    assert withheld < 12


def test_three_fixes_that_agree_end_the_question():
    check = LensCheck(is_open=True)
    for height_m in (30.0, 31.0, 32.0):
        assert not check.is_off(fix(height_m), believed(height_m), of_filter(True))
    assert not check.is_open


@pytest.mark.parametrize(
    ("seen_m", "then"),
    [
        (40.0, believed(30.0, sigma_m=4.0)),  # the filter's own height is not sure
        (40.0, believed(32.0, above_start_m=40.0)),  # the rangefinder is short, the map not
        (40.0, believed(40.0, above_start_m=32.0)),  # the ground falls away
        (33.0, believed(30.0)),  # cold air, or what the filter learns by itself
        (None, believed(30.0)),
        (0.0, believed(30.0)),
        (-40.0, believed(30.0)),
        (math.nan, believed(30.0)),
        (40.0, None),
    ],
)
def test_what_others_explain_is_left_to_the_filter(seen_m, then):
    assert not LensCheck(is_open=True).is_off(fix(seen_m), then, of_filter(False))


def test_other_heights_are_looked_at_after_some_looks_in_vain():
    check = LensCheck(is_open=True)
    assert check.least_agl_ratio < 0.05
    for _ in range(4):
        check.missed()
    assert check.least_agl_ratio > 0.15
    for _ in range(3):
        check.is_off(fix(30.0), believed(30.0), of_filter(True))
    assert check.least_agl_ratio < 0.05


def test_a_focal_length_that_the_ways_of_another_mount_had_told_is_forgotten_with_it():
    check = LensCheck(is_open=True)
    assert check.told_by_ways(with_focal(0.2, 0.04))
    check.mount_turned()
    assert (check.focal_ratio, check.is_open) == (1.0, True)


@pytest.mark.parametrize(("bias_m", "is_lens"), [(0.0, True), (1.0, True), (-3.0, False)])
def test_a_rangefinder_that_fix_and_barometer_contradict_alike_is_no_lens(bias_m, is_lens):
    """10 % long, it had drawn the barometer's bias along: a right lens was taken for another."""
    state = of_filter(ranged=True)
    x = state.x.copy()
    x[States.BARO] = bias_m  # of what the barometer says, 30 m and this
    found = LensCheck(is_open=True).is_off(fix(27.0), believed(30.0), state._replace(x=x))
    assert found is is_lens


def with_focal(off: float, sigma: float) -> FilterState:
    state = of_filter(ranged=True)
    x, P = state.x.copy(), state.P.copy()
    x[States.FOCAL], P[States.FOCAL, States.FOCAL] = off, sigma**2
    return state._replace(x=x, P=P)


def test_what_the_filter_has_learned_of_ways_makes_another_camera_and_fixes_tell_the_rest():
    check = LensCheck(is_open=True)
    assert not check.told_by_ways(with_focal(0.2, 0.1))  # not sure enough
    assert not check.told_by_ways(with_focal(0.03, 0.01))  # not worth it
    assert check.told_by_ways(with_focal(0.2, 0.04))
    assert check.focal_ratio == pytest.approx(0.8)
    assert check.is_open
    ratio, _ = climbed(check, CLIMB_M / 0.9, ranged=True)
    assert ratio == pytest.approx(0.72)


@pytest.mark.parametrize("off", [-3.0, 0.6, 0.99, 1.0, 1.7, math.inf, math.nan])
def test_a_lens_that_cannot_be_is_not_flown_with(off):
    check = LensCheck(is_open=True)
    assert not check.told_by_ways(with_focal(off, 0.04))
    assert check.focal_ratio == 1.0


def test_a_lens_that_is_doubted_opens_what_its_ways_have_told():
    """Fixes and ways that tell the focal length tell then how far it was too."""
    state = of_filter(ranged=True)
    x = state.x.copy()
    x[States.POSITION_NE], x[States.VELOCITY_NE] = (10.0, -4.0), (2.0, 0.0)
    trusted = TrustedPosition(0.0, np.zeros(2), 1.0)
    x[States.TIME_OFFSET] = 0.07
    before = state._replace(x=x, P=1e-4 * state.P, trusted=trusted)
    after = apply_lens_doubted(before, EkfConfig())
    assert after.x[States.TIME_OFFSET] == 0.0
    assert after.P[States.TIME_OFFSET, States.TIME_OFFSET] == EkfConfig().time_offset_sigma_s ** 2
    north, focal = States.POSITION_NE.start, States.FOCAL
    assert after.P[focal, focal] == pytest.approx(LENS_DOUBT**2, rel=0.01)
    assert after.P[north, focal] == pytest.approx(10.0 * LENS_DOUBT**2)
    assert np.diag(after.P)[States.POSITION_NE] == pytest.approx([4.0, 0.64], rel=0.01)
    assert np.linalg.eigvalsh(after.P).min() > -1e-12


@given(st.sampled_from([0.6, 0.75, 1.0, 1.1, 1.3, 1.75]), SEEDS)
@pytest.mark.long
def test_ways_tell_the_focal_length_of_a_camera_that_was_gone_and_velocity_and_place_stay(
    focal_ratio, seed
):
    """At 8 m/s, without a fix since."""
    rng, level = np.random.default_rng(seed), np.array([1.0, 0.0, 0.0, 0.0])
    ekf = Ekf(EkfConfig())
    place_m, velocity_m_s = np.array([0.0, 0.0, -50.0]), np.array([8.0, 0.0, 0.0])
    ekf.initialise(Start(t_s=0.0, position_ned_m=place_m, agl_m=50.0, sigma_velocity_m_s=10.0))
    check = LensCheck(is_open=True)
    for i in range(1, 81):
        t_s, at_rest = 0.1 * i, np.array([0.0, 0.0, -GRAVITY_M_S2])
        for felt_s in (t_s - 0.09 + 0.01 * np.arange(10)).tolist():
            ekf.handle(Attitude(felt_s, level))
            ekf.handle(ImuSample(felt_s, at_rest, np.zeros(3)))
        ekf.handle(Height(t_s, 50.0))
        if i == 41:
            check.ask_again()
            assert ekf.handle(CameraReturned(t_s)).accepted
        way_m = (1.0 if i <= 40 else focal_ratio) * 0.1 * velocity_m_s + 0.02 * rng.normal(size=3)
        ekf.handle(OdometryMotion(t_s - 0.1, t_s, way_m, 4e-4 * np.eye(3), 0.0, 0.01, 50.0, 80))
    assert ekf.state is not None
    assert check.told_by_ways(ekf.state) is (focal_ratio != 1.0)
    assert check.focal_ratio == pytest.approx(focal_ratio, rel=0.12)
    assert ekf.state.x[States.VELOCITY] == pytest.approx(velocity_m_s, abs=0.9)


@pytest.mark.parametrize("ratio", [0.8, 0.95, 1.05, 1.1, 1.3])
def test_a_view_that_grows_or_shrinks_at_once_is_no_way_and_the_lens_is_asked_for(ratio):
    """From one image to the next; those after it are as long as the lens makes them."""
    ekf, verdict = hovering_with_a_leap(50.0 * (1.0 - 1.0 / ratio))
    assert verdict is Verdict.IMPOSSIBLE
    assert ekf.state is not None
    assert abs(ekf.state.x[States.DOWN] + 50.0) < 0.3
    assert ekf.state.P[States.FOCAL, States.FOCAL] > 0.2**2


@pytest.mark.parametrize("leap_m", [-1.1, -0.5, 0.5, 1.1])
def test_what_a_climb_can_be_is_no_lens(leap_m):
    """11 m/s, all at once."""
    ekf, verdict = hovering_with_a_leap(leap_m)
    assert verdict is not Verdict.IMPOSSIBLE
    assert ekf.state is not None
    assert ekf.state.P[States.FOCAL, States.FOCAL] < 0.05**2


def test_before_a_first_fix_the_height_is_not_known_well_enough_to_tell():
    _, verdict = hovering_with_a_leap(10.0, had_fix=False)
    assert verdict is Verdict.GATED


def hovering_with_a_leap(leap_m: float, had_fix: bool = True) -> tuple[Ekf, Verdict]:
    """50 m up for 4 s, ten images a second; the last one as if it had sunk by so much at once."""
    ekf, level = Ekf(EkfConfig()), np.array([1.0, 0.0, 0.0, 0.0])
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -50.0]), agl_m=50.0))
    verdict = Verdict.NOT_STARTED
    for i in range(1, 41):
        t_s = 0.1 * i
        for felt_s in (t_s - 0.09 + 0.01 * np.arange(10)).tolist():
            ekf.handle(Attitude(felt_s, level))
            ekf.handle(ImuSample(felt_s, np.array([0.0, 0.0, -GRAVITY_M_S2]), np.zeros(3)))
        ekf.handle(Height(t_s, 50.0))
        if i == 20 and had_fix:
            told = NedFix(t_s=t_s, position_ne_m=np.zeros(2), covariance_ne_m2=np.eye(2))
            assert ekf.handle(told).accepted
        way_m = np.array([0.0, 0.0, leap_m if i == 40 else 0.0])
        way = OdometryMotion(0.1, t_s, way_m, 4e-4 * np.eye(3), 0.0, 0.01, 50.0, 80)
        verdict = ekf.handle(way).verdict if i > 1 else verdict
    return ekf, verdict


def test_a_filter_that_is_told_of_another_camera_is_open_to_it_and_remembers_being_told():
    ekf, config = Ekf(EkfConfig()), EkfConfig()
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -50.0]), agl_m=50.0))
    told = decode(encode(Recalibrated(0.1, 0.0)))
    assert told == Recalibrated(0.1)
    assert isinstance(told, Recalibrated)
    assert ekf.handle(told).accepted
    assert ekf.state is not None
    sigma = math.sqrt(float(ekf.state.P[States.FOCAL, States.FOCAL]))
    assert sigma > 10.0 * config.focal_sigma_ratio
    assert ekf.state.x[States.FOCAL] == 0.0
