"""A camera that is turned or tilted on its mount is told from a compass or a place that errs."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.quick import first_quick
from vwnav.estimation.beginning.mount import tilted
from vwnav.estimation.beginning.other_camera import apply_mount_doubted, apply_recalibrated
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import NedFix, Recalibrated
from vwnav.estimation.fixes import apply_agl
from vwnav.estimation.inertial.attitudes import GRAVITY_M_S2, AttitudeHistory
from vwnav.estimation.inputs import decode, encode
from vwnav.estimation.odometry_gate import MountCheck
from vwnav.estimation.states import (
    HEADINGS,
    FilterState,
    Innovation,
    States,
    TrustedPosition,
    Verdict,
)
from vwnav.geometry.rotations import quat_from_vector, wrap_pi
from vwnav.types import Attitude, Height, ImuSample, OdometryMotion

SEEDS = st.integers(0, 2**32 - 1)
AGREES = Innovation(Verdict.FUSED)
TURNED = Recalibrated(0.0, 0.3, 0.09)
AGL_M, FIX_SIGMA_M = 50.0, 0.3


def of_filter() -> FilterState:
    return FilterState(0.0, np.zeros(States.SIZE), np.eye(States.SIZE), True, True, 0.0, 0.0)


def told_level(has_gyro: bool = True, jump_rad: float = 0.0) -> AttitudeHistory:
    """Attitudes of an aircraft that does not turn, whose heading jumps after 0.05 s."""
    attitudes = AttitudeHistory(length_s=100.0)
    for i in range(-20, 620):
        heading_rad = jump_rad if i > 0 else 0.0
        attitudes.add(Attitude(0.1 * i, quat_from_vector(np.array([0.0, 0.0, heading_rad]))))
        if has_gyro and i == -20:
            attitudes.gyro.begin(0.1 * i)
        elif has_gyro:
            attitudes.gyro.turn(0.1 * i, np.zeros(3), 0.1)
    return attitudes


LEVEL = told_level()
MIRROR = np.array([-1.0, 1.0])  # of a turn seen heading north in an image mirrored left to right


def shown(t_s: float, tilt_rad: np.ndarray, seen_rad: np.ndarray, sigma_rad: float):
    """A way whose attitudes tell a tilt (2,), and whose image shows another.

    What `ground_motion.tilt_seen` makes of it: logarithms of N(z; Rz(-a) w, V) / N(z; 0, V) for
    a of 0, 90, 180 and 270 degrees, and of N(z; S Rz(-a) w, V) / N(z; 0, V) for 0 and 90.
    """
    ratios = []
    for quarters, mirror in ((0, 1.0), (1, 1.0), (2, 1.0), (3, 1.0), (0, MIRROR), (1, MIRROR)):
        c, s = math.cos(0.5 * math.pi * quarters), math.sin(0.5 * math.pi * quarters)
        w = mirror * (np.array([[c, s], [-s, c]]) @ tilt_rad)
        ratios.append(float(w @ seen_rad - 0.5 * w @ w) / sigma_rad**2)
    return OdometryMotion(
        t_s - 0.1, t_s, np.zeros(3), np.eye(3), 0.0, 0.01, 30.0, 99,
        tilts_along=ratios[0], tilts_turned=np.array(ratios[1:]),
    )  # fmt: skip


def turns_told(seed: int, seen_of, sigma_rad=0.01, seconds=60.0, had_fix=False) -> list[float]:
    """What is told while it tilts this way and that, an image ten times a second."""
    rng, check, told = np.random.default_rng(seed), MountCheck(True, LEVEL), [0.0]
    for i in range(round(10.0 * seconds)):
        tilt_rad = 0.03 * rng.normal(size=2)
        seen_rad = seen_of(tilt_rad, told[-1]) + sigma_rad * rng.normal(size=2)
        turn = check.turned(shown(0.1 * i, tilt_rad, seen_rad, sigma_rad), AGREES, had_fix)
        if turn is not None:
            assert not turn.mirrored
            told.append(told[-1] + turn.turned_rad)
    return told[1:]


def turned_by(turn_rad: float, overstated: float = 1.25):
    """What an image of a camera shows that is turned by so much, and is thought to be by less.

    It overstates by how much it contradicts the attitudes.
    """

    def seen(tilt_rad: np.ndarray, known_rad: float) -> np.ndarray:
        c, s = math.cos(turn_rad - known_rad), math.sin(turn_rad - known_rad)
        return tilt_rad + overstated * (np.array([[c, s], [-s, c]]) @ tilt_rad - tilt_rad)

    return seen


@given(
    st.sampled_from([-170.0, -120.0, -35.0, -12.0, 10.0, 25.0, 45.0, 75.0, 90.0, 180.0]),
    st.floats(1.1, 1.5),
    SEEDS,
)
def test_a_camera_that_is_turned_on_its_mount_is_told_to_a_few_degrees(degrees, overstated, seed):
    told = turns_told(seed, turned_by(math.radians(degrees), overstated))
    assert told
    assert abs(math.degrees(wrap_pi(told[-1] - math.radians(degrees)))) < 7.0


def test_a_turn_of_8_degrees_the_least_of_those_is_told_in_nearly_all_draws():
    """In 3 of 250 it is not, where images overstate by a tenth."""
    told = [turns_told(seed, turned_by(math.radians(8.0), 1.1)) for seed in range(90, 130)]
    turns_deg = [math.degrees(each[-1]) for each in told if each]
    assert len(turns_deg) >= 38
    assert turns_deg == pytest.approx([8.0] * len(turns_deg), abs=7.0)


@given(st.sampled_from([0.0, 40.0, 90.0, 135.0, 180.0, -90.0]), st.booleans(), st.booleans(), SEEDS)
def test_mirrored_images_are_told_once_it_tilts_about_both_axes_and_how_the_camera_hangs(
    degrees, had_fix, breaks, seed
):
    """After a fix only where the camera was gone, so that its first image could not be followed.

    For the first 3 s it tilts about one axis: then they show what those of a camera show that is
    turned, and that is told; it is put right later.
    """
    rng, check, told = np.random.default_rng(seed), MountCheck(True, LEVEL), []
    if breaks:
        check.broke(0.0)
    for i in range(90):
        tilt_rad = 0.03 * rng.normal(size=2) * (1.0, 0.0 if i < 30 else 1.0)
        mirrored = any(turn.mirrored for turn in told)
        off_rad = math.radians(degrees) - sum(turn.turned_rad for turn in told)
        c, s = math.cos(off_rad), math.sin(off_rad)
        seen_rad = (1.0 if mirrored else MIRROR) * (np.array([[c, s], [-s, c]]) @ tilt_rad)
        seen_rad += 0.01 * rng.normal(size=2)
        turn = check.turned(shown(0.1 * i, tilt_rad, seen_rad, 0.01), AGREES, had_fix)
        told += [] if turn is None else [turn]
        assert i >= 30 or not mirrored
    assert sum(turn.mirrored for turn in told) == (1 if breaks or not had_fix else 0)
    if breaks or not had_fix:
        assert abs(wrap_pi(off_rad)) < 3.0 * told[-1].sigma_turned_rad


@given(SEEDS)
def test_a_camera_that_was_not_gone_does_not_begin_to_mirror_its_images(seed):
    """Images half a second late, of which one could not be followed, were taken for mirrored."""
    rng, check = np.random.default_rng(seed), MountCheck(True, LEVEL)
    for i in range(90):
        tilt_rad = 0.03 * rng.normal(size=2)
        seen_rad = (MIRROR if i > 20 else 1.0) * tilt_rad + 0.01 * rng.normal(size=2)
        if i == 20:
            check.broke(0.1 * i)
        else:
            told = check.turned(shown(0.1 * i, tilt_rad, seen_rad, 0.01), AGREES, True)
            assert told is None or not told.mirrored


@given(SEEDS)
def test_a_camera_whose_images_the_map_bears_is_not_mirrored_whatever_smoke_shows(seed):
    """Patches of it drifted by below, and every fix meanwhile was of the camera as it was."""
    rng, check = np.random.default_rng(seed), MountCheck(True, LEVEL)
    check.broke(0.0)
    for i in range(2, 90):
        tilt_rad = 0.03 * rng.normal(size=2)
        seen_rad = MIRROR * tilt_rad + 0.01 * rng.normal(size=2)
        told = check.turned(shown(0.1 * i, tilt_rad, seen_rad, 0.01), AGREES, True, borne_s=0.1)
        assert told is None or not told.mirrored


@given(st.floats(-3.0, 3.0), SEEDS)
def test_one_that_hangs_as_told_but_for_some_degrees_is_left_alone(degrees, seed):
    assert not turns_told(seed, turned_by(math.radians(degrees)))


@given(SEEDS)
def test_images_that_show_no_tilting_or_that_of_another_moment_tell_no_turn(seed):
    assert not turns_told(seed, lambda *_: np.zeros(2))
    other = np.random.default_rng([seed, 1])
    assert not turns_told(seed, lambda *_: 0.03 * other.normal(size=2), had_fix=True)


@given(st.floats(0.02, 0.04), st.floats(-math.pi, math.pi), SEEDS)
def test_a_keyframe_whose_attitude_is_off_turns_no_mount_however_long_it_is_hovered_on(
    off_rad, way_rad, seed
):
    """In 23 s above one place it had turned a right mount by 9 degrees.

    One that is off by more than the aircraft tilts may show 45 degrees still: those are believed
    after half a second, for they cost a take-off.
    """
    rng, check = np.random.default_rng(seed), MountCheck(True, LEVEL)
    off = off_rad * np.array([math.cos(way_rad), math.sin(way_rad)])
    for i in range(1, 400):
        tilt_rad = 0.01 * rng.normal(size=2) + 0.06
        motion = shown(0.1 * i, tilt_rad + off, tilt_rad + 0.01 * rng.normal(size=2), 0.01)
        motion = replace(motion, t0_s=0.0)
        assert check.turned(motion, AGREES, had_fix=False) is None


def way(t0_s: float, t1_s: float) -> OdometryMotion:
    return OdometryMotion(t0_s, t1_s, np.zeros(3), np.eye(3), 0.0, 0.01, 30.0, 99)


def heading(verdict: Verdict, residual_rad: float) -> Innovation:
    part = Innovation(verdict, residual=np.array([residual_rad]))
    return Innovation(verdict, parts=(part,))


def knock_told(residuals_rad, keyframe_s=None, attitudes=LEVEL) -> list[Recalibrated]:
    """Of images of one keyframe each, or all of one of before."""
    check, told = MountCheck(True, attitudes), []
    for i, residual_rad in enumerate(residuals_rad):
        t_s = 0.1 * i
        verdict = Verdict.FUSED if abs(residual_rad) < 0.01 else Verdict.GATED
        motion = way(t_s - 0.1 if keyframe_s is None else keyframe_s, t_s)
        turn = check.turned(motion, heading(verdict, residual_rad), had_fix=True)
        told += [] if turn is None else [turn]
    return told


@given(st.floats(0.12, 3.0), st.sampled_from([-1.0, 1.0]))
def test_one_image_that_turned_as_no_gyro_felt_is_that_of_a_camera_that_was_knocked(by_rad, sign):
    (turn,) = knock_told([0.0, 0.0, -sign * by_rad, 0.0, 0.0, 0.0, 0.0])
    assert turn.t_s == pytest.approx(0.2)
    assert turn.turned_rad == pytest.approx(sign * by_rad)
    assert turn.knocked


def test_a_turn_between_two_quarters_is_told_in_the_end_and_not_one_of_them_in_turns():
    """One by 45 degrees was a quarter turn, none, and a quarter turn again: landed 16 m off."""
    turn_rad = math.radians(135.0)
    for seed in range(40):
        told_rad = turns_told(seed, turned_by(turn_rad), sigma_rad=0.03)[-1]
        assert abs(math.remainder(told_rad - turn_rad, 2.0 * math.pi)) < 0.3, seed


@pytest.mark.parametrize(("again", "turns"), [(False, [0.3]), (True, [])])
def test_a_way_that_no_aircraft_flies_shows_a_knock_as_well_unless_the_next_image_does(
    again, turns
):
    """One knocked aslant at 50 m seemed to fly 4 m in a tenth of a second, 5.7 sigmas off."""
    check, told = MountCheck(True, LEVEL), []
    for i in range(1, 8):
        leaps = i == 2 or (again and i == 3)
        turned_rad = (0.3 if i == 2 else -0.3) if leaps else 0.0
        motion = replace(way(0.1 * i - 0.1, 0.1 * i), yaw_increment_rad=turned_rad)
        agrees = heading(Verdict.FUSED, 0.0)
        turn = check.turned(motion, Innovation(Verdict.IMPOSSIBLE) if leaps else agrees, True)
        told += [] if turn is None else [turn.turned_rad]
    assert told == pytest.approx(turns)


@pytest.mark.parametrize(
    ("residuals_rad", "keyframe_s", "attitudes"),
    [
        ([0.0, 0.05, 0.0, 0.0, 0.0, 0.0], None, LEVEL),  # less than is worth another camera
        ([0.0, 0.4, 0.4, 0.4, 0.4, 0.4], None, LEVEL),  # again and again: not by a knock
        ([0.0, 0.4, 0.0, 0.0, 0.0, 0.0], -0.1, LEVEL),  # those after it agree with one of before it
        ([0.0, 0.4, 0.0, 0.0, 0.0, 0.0], None, told_level(has_gyro=False)),  # by the compass?
        ([0.0, 0.4, 0.0, 0.0, 0.0, 0.0], None, told_level(jump_rad=-0.4)),  # the compass it was
    ],
)
def test_what_else_turns_an_image_moves_no_mount(residuals_rad, keyframe_s, attitudes):
    assert not knock_told(residuals_rad, keyframe_s, attitudes)


def test_what_was_seen_before_an_image_that_cannot_be_followed_is_no_witness_of_the_mount():
    """A quarter turn after a fix is believed only then, and counts from there."""
    rng, check, told = np.random.default_rng(1), MountCheck(True, LEVEL), []
    for i in range(400):
        tilt_rad = 0.03 * rng.normal(size=2)
        if i == 300:
            check.broke(30.0)
        as_told = turned_by(0.0 if i < 300 else 0.5 * math.pi)
        known_rad = sum(turn.turned_rad for turn in told)
        seen_rad = as_told(tilt_rad, known_rad) + 0.01 * rng.normal(size=2)
        turn = check.turned(shown(0.1 * i, tilt_rad, seen_rad, 0.01), AGREES, had_fix=True)
        told += [] if turn is None else [turn]
    assert [turn.t_s for turn in told] == [30.0]
    assert told[0].turned_rad == pytest.approx(0.5 * math.pi)


@given(SEEDS)
def test_one_keyframe_whose_images_tilt_the_wrong_way_turns_no_camera_that_was_gone(seed):
    """One that came back zoomed was taken for one upside down by its first keyframe, 0.9 s long."""
    rng, check = np.random.default_rng(seed), MountCheck(True, LEVEL)
    check.broke(0.0)
    for i in range(1, 60):
        way_rad = rng.uniform(0.0, 2.0 * math.pi)
        tilt_rad = 0.06 * np.array([math.cos(way_rad), math.sin(way_rad)])
        seen_rad = (-1.5 if 5 < i <= 15 else 1.0) * tilt_rad + 0.01 * rng.normal(size=2)
        motion = shown(0.1 * i, tilt_rad, seen_rad, 0.01)
        motion = replace(motion, t0_s=0.0) if i <= 15 else motion
        turn = check.turned(motion, AGREES, had_fix=True)
        assert turn is None or turn.mirrored


@pytest.mark.parametrize("overstated", [1.0, 1.1, 1.25, 1.5])
def test_half_a_turn_is_told_however_much_fits_overstate_it(overstated):
    """By nothing where they know the camera's read-out."""
    for seed in range(20):
        rng, check = np.random.default_rng(seed), MountCheck(True, LEVEL)
        seen_of, told = turned_by(math.pi, overstated), None
        for i in range(1, 40):
            tilt_rad = 0.03 * rng.normal(size=2)
            seen_rad = seen_of(tilt_rad, 0.0) + 0.01 * rng.normal(size=2)
            told = told or check.turned(shown(0.1 * i, tilt_rad, seen_rad, 0.01), AGREES, False)
        assert told is not None
        assert abs(told.turned_rad) == pytest.approx(math.pi)


def test_a_filter_that_is_told_of_a_turned_mount_takes_it_out_of_the_compass():
    """And of the velocity, and of the way since the last fix that is trusted."""
    state = of_filter()
    x = state.x.copy()
    x[States.POSITION_NE], x[States.VELOCITY_NE], x[States.TILT] = (10.0, 0.0), (8.0, 0.0), 0.02
    x[HEADINGS] = -0.3
    trusted = TrustedPosition(0.0, np.zeros(2), 1.0)
    before = state._replace(x=x, P=1e-4 * state.P, trusted=trusted)
    config = EkfConfig()
    fixed = apply_recalibrated(before._replace(t_last_fix_s=-1.0), TURNED, config)
    assert fixed.x[HEADINGS] == pytest.approx(np.zeros(3))
    assert math.sqrt(fixed.P[States.HEADING_BIAS, States.HEADING_BIAS]) > 0.05
    east = States.POSITION_NE.start + 1
    assert math.sqrt(fixed.P[east, east]) == pytest.approx(3.0, rel=0.01)
    assert np.all(fixed.x[States.TILT] == 0.0)
    assert np.linalg.eigvalsh(fixed.P).min() > -1e-12
    unfixed = apply_recalibrated(before, TURNED, config)
    assert unfixed.x[HEADINGS] == pytest.approx([-0.3] * 3)  # what the compass says of itself


def test_a_mount_that_was_knocked_just_now_was_not_the_compass_error():
    state = of_filter()._replace(t_last_fix_s=-1.0)
    after = apply_recalibrated(state, replace(TURNED, knocked=True), EkfConfig())
    assert np.all(after.x == state.x)
    assert after.P[States.VELOCITY, States.VELOCITY] == pytest.approx(np.eye(3))


def tilt_of(event: Recalibrated) -> np.ndarray:
    return np.array([event.forward_rad, event.right_rad])


class Hover:
    """Hovers, or flies north, turns by and by, and is told where its camera looks.

    A tilted one looks beside it, and a late one behind it.
    """

    def __init__(self, seed: int, yaw_rad: float, speed_m_s: float = 0.0) -> None:
        self.velocity_m_s = np.array([speed_m_s, 0.0])
        self.rng, self.yaw_rad, self.t_s = np.random.default_rng(seed), yaw_rad, 0.0
        self.said: list[str] = []
        self.worst_sigmas = 0.0
        self.ekf = Ekf(EkfConfig())
        self.ekf.on_event(self.said.append)
        self.ekf.initialise(
            Start(
                t_s=0.0,
                position_ned_m=np.array([0.0, 0.0, -AGL_M]),
                agl_m=AGL_M,
                sigma_m=2.0,
                sigma_velocity_m_s=max(speed_m_s, 0.1),
            )
        )

    def fly(
        self, seconds: float, tilt_rad: np.ndarray, turns_rad_s: float = 0.0, late_s: float = 0.0
    ) -> None:
        """With a camera that hangs tilted about forward and right, and images dated that late."""
        for _ in range(round(50.0 * seconds)):
            self.t_s, self.yaw_rad = self.t_s + 0.02, self.yaw_rad + 0.02 * turns_rad_s
            self.ekf.handle(Attitude(self.t_s, quat_from_vector([0.0, 0.0, self.yaw_rad])))
            felt = np.array([0.0, 0.0, -GRAVITY_M_S2]) + 0.05 * self.rng.normal(size=3)
            self.ekf.handle(ImuSample(self.t_s, felt, np.array([0.0, 0.0, turns_rad_s])))
            if round(50.0 * self.t_s) % 5 == 0:
                self.ekf.handle(Height(self.t_s, AGL_M + 0.1 * self.rng.normal()))
            if round(50.0 * self.t_s) % 20 == 0:
                self._fix(tilt_rad, late_s)

    def _fix(self, tilt_rad: np.ndarray, late_s: float) -> None:
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        ahead_m, right_m = AGL_M * np.array([-tilt_rad[1], tilt_rad[0]])
        place = np.array([c * ahead_m - s * right_m, s * ahead_m + c * right_m])
        place = place + (self.t_s - late_s) * self.velocity_m_s
        seen = place + FIX_SIGMA_M * self.rng.normal(size=2)
        covariance = FIX_SIGMA_M**2 * np.eye(2)
        self.ekf.handle(NedFix(t_s=self.t_s, position_ne_m=seen, covariance_ne_m2=covariance))
        estimate = self.ekf.estimate(self.t_s)
        assert estimate is not None
        off_m = estimate.position_ned_m[:2] - self.t_s * self.velocity_m_s
        P = estimate.covariance[:2, :2]
        sigmas = math.sqrt(float(off_m @ np.linalg.solve(P, off_m)))
        self.worst_sigmas = max(self.worst_sigmas, sigmas)


@pytest.mark.parametrize("followed", [True, False])
def test_images_that_were_followed_and_are_not_any_more_are_no_camera_that_hangs_otherwise(
    followed,
):
    """Frozen ones whose exposure hunts; one that is knocked is followed again at once."""
    hover = Hover(1, 0.0)
    hover.fly(5.9, np.zeros(2))
    if followed:
        hover.fly(0.1, np.zeros(2))
        way_m = np.zeros(3)
        hover.ekf.handle(OdometryMotion(5.9, 6.0, way_m, np.eye(3), 0.0, 0.01, AGL_M, 99))
    hover.fly(6.0, np.array([-math.radians(8.0), 0.0]))
    assert any("hangs otherwise" in each for each in hover.said) is not followed


@settings(max_examples=20)
@given(SEEDS, st.floats(-3.1, 3.1), st.floats(-3.1, 3.1), st.floats(6.0, 13.0))
def test_a_camera_that_is_knocked_aslant_moves_no_place_and_is_known_once_it_has_turned(
    seed, yaw_rad, towards_rad, degrees
):
    off_rad = math.radians(degrees) * np.array([math.cos(towards_rad), math.sin(towards_rad)])
    hover = Hover(seed, yaw_rad)
    hover.fly(6.0, np.zeros(2))
    hover.fly(6.0, -off_rad)
    assert any("hangs otherwise" in each for each in hover.said)
    hover.fly(8.0, -off_rad, turns_rad_s=0.4)
    assert hover.worst_sigmas < 4.5
    told = tilted(hover.ekf.state)
    assert told is not None
    assert np.degrees(tilt_of(told) - off_rad) == pytest.approx(np.zeros(2), abs=2.5)


@pytest.mark.parametrize("late_s", first_quick([0.45, 0.5, 0.6]))
def test_fixes_that_lie_behind_as_those_of_late_pictures_doubt_a_mount_later(late_s):
    """Ways tell meanwhile; a camera that shows as much to one side is doubted at once.

    But for a few draws of their noise: one or two of sixty.
    """
    off_rad = math.atan(10.0 * late_s / AGL_M)
    doubted = {}
    for late, tilt_rad in ((late_s, np.zeros(2)), (0.0, np.array([off_rad, 0.0]))):
        doubted[late] = 0
        for seed in range(20):
            flight = Hover(seed, 0.0, speed_m_s=10.0)
            flight.fly(6.0, np.zeros(2))
            flight.fly(2.1, tilt_rad, late_s=late)
            doubted[late] += any("hangs otherwise" in each for each in flight.said)
    assert doubted[late_s] == 0
    assert doubted[0.0] >= 18


@settings(max_examples=20)
@given(SEEDS, st.floats(-3.1, 3.1), st.floats(0.0, 1.0))
def test_a_camera_that_hangs_as_told_is_not_doubted(seed, yaw_rad, turns_rad_s):
    hover = Hover(seed, yaw_rad)
    hover.fly(20.0, np.zeros(2), turns_rad_s)
    assert hover.said == []
    assert tilted(hover.ekf.state) is None


def test_a_mount_that_is_tilted_as_the_filter_had_it_is_not_tilted_any_more():
    state = of_filter()
    x = state.x.copy()
    x[States.CAMERA_TILT] = -0.1, 0.05
    before = state._replace(x=x, P=1e-5 * state.P)
    event = tilted(before)
    assert event is not None
    assert tilt_of(event) == pytest.approx([0.1, -0.05])
    after = apply_recalibrated(before, event, EkfConfig())
    assert after.x[States.CAMERA_TILT] == pytest.approx(np.zeros(2))
    assert tilted(after) is None
    assert tilted(before._replace(P=state.P)) is None  # that is not sure


@given(st.floats(-3.1, 3.1))
def test_a_mount_that_is_doubted_leaves_the_level_velocity_as_sure_as_it_was(yaw_rad):
    """Opened by 2 m/s it was not sent any more, and the aircraft came down blind."""
    state = of_filter()
    x = state.x.copy()
    x[States.VELOCITY_NE], x[States.DOWN] = (8.0, 0.0), -AGL_M
    before = state._replace(x=x, P=1e-2 * state.P)
    after = apply_mount_doubted(before, yaw_rad)
    level = States.VELOCITY_NE
    assert after.P[level, level] == pytest.approx(before.P[level, level])
    assert np.diag(after.P)[States.CAMERA_TILT].min() > 0.1**2
    place_m = np.sqrt(np.diag(after.P)[States.POSITION_NE])
    assert np.all((place_m > 0.1 * AGL_M) & (place_m < 0.15 * AGL_M))
    assert np.linalg.eigvalsh(after.P).min() > -1e-12


def test_what_is_told_of_a_mount_is_remembered_as_it_was():
    told = Recalibrated(0.1, 0.3, 0.09, -0.1, 0.05, knocked=True)
    assert decode(encode(told)) == told


def test_a_height_by_the_map_is_as_unsure_as_the_square_of_a_tilt_makes_it():
    """By 9 degrees 1.2 m of 50; a rangefinder that was right was blamed for them."""
    x = np.zeros(States.SIZE)
    x[States.DOWN] = -AGL_M
    P = 1e-8 * np.eye(States.SIZE)
    P[States.DOWN, States.DOWN] = 0.25
    told = {}
    for tilt_rad in (0.0, 0.155):
        tilted_x = x.copy()
        tilted_x[States.CAMERA_TILT] = tilt_rad, 0.0
        state = of_filter()._replace(x=tilted_x, P=P)
        for by_map in (False, True):
            fused, _ = apply_agl(state, AGL_M + 1.2, 0.5, EkfConfig(), by_map)
            told[by_map, tilt_rad] = fused.agl_m - AGL_M
    assert told[True, 0.155] < 0.3 * told[True, 0.0]
    assert told[False, 0.155] == told[False, 0.0]
