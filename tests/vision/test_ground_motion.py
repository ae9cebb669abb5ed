"""How sure the way from tracks is: tracks that are wrong together count as one."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.geometry.rotations import skew
from vwnav.vision.odometry.ground_motion import Motion, MotionPrior, Sightings, fit_motion

LOOKS_DOWN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # upper edge north
WAY = np.array([0.08, -0.03, 0.01])
FOCAL_PX = 380.0
PRIOR = MotionPrior(
    tilt_increment_rad=0.003, slope_ne=np.zeros(2), slope=0.02, bend=0.03, pixel=0.55,
    readout_s=0.0, sigma_readout_s=0.015,
)  # fmt: skip
AT_ONCE = np.zeros((144, 3))
BRAKING = replace(PRIOR, slope=0.1)
CLIMB = np.array([0.0, 0.0, -0.1])


def moved(noise_px: np.ndarray, heights=lambda x, y: 0.0, bend: float = 0.03) -> Motion:
    """A grid of points seen before and after `WAY`, each off by its noise (12, 12, 2).

    `heights` over the plane, in those of the camera, by where on the plane the points are seen.
    """
    v, u = np.meshgrid(np.linspace(-0.6, 0.6, 12), np.linspace(-0.8, 0.8, 12), indexing="ij")
    rays = np.dstack([u, v, np.ones_like(u)]).reshape(-1, 3)
    rays0 = rays @ LOOKS_DOWN.T
    above = np.broadcast_to(heights(rays0[:, 0], rays0[:, 1]), len(rays0))
    rays1 = ((1.0 - above)[:, None] * rays0 - WAY) @ LOOKS_DOWN
    rays1 = rays1 / rays1[:, 2:]
    rays1[:, :2] += noise_px.reshape(-1, 2) / FOCAL_PX
    seen = Sightings(rays0, rays1, LOOKS_DOWN, FOCAL_PX, AT_ONCE, AT_ONCE)
    motion = fit_motion(seen, replace(PRIOR, bend=bend), 3.0)
    assert motion is not None
    return motion


def mean_nees(together: bool) -> float:
    """Of the way (3 degrees of freedom), noise of 0.8 pixels: each track's, or a region's."""
    squares = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        noise_px = 0.8 * rng.normal(size=(4, 4, 2) if together else (12, 12, 2))
        if together:
            noise_px = noise_px.repeat(3, axis=0).repeat(3, axis=1)
        motion = moved(noise_px)
        error = motion.way - WAY
        squares.append(error @ np.linalg.solve(motion.covariance[:3, :3], error))
    return float(np.mean(squares))


def test_independent_tracks_tell_the_way_as_surely_as_they_say():
    assert 1.5 < mean_nees(together=False) < 4.5


def test_tracks_that_are_off_together_do_not_make_it_surer():
    """Counted as independent, nine tracks a region, the NEES was 36."""
    assert mean_nees(together=True) < 6.0


def test_exact_tracks_stay_as_sure_as_their_least_noise():
    motion = moved(np.zeros((12, 12, 2)))
    assert motion.way == pytest.approx(WAY, abs=1e-5)
    assert motion.sigma_px == PRIOR.pixel


@pytest.mark.parametrize(
    "heights", [lambda x, y: 0.05 * x * x, lambda x, y: -0.06 * x * y, lambda x, y: 0.04 * y * y]
)
def test_ground_that_bends_turns_no_way(heights):
    noise_px = 0.3 * np.random.default_rng(1).normal(size=(12, 12, 2))
    motion, level = moved(noise_px, heights), moved(noise_px)
    sigmas = np.sqrt(np.diag(motion.covariance)[:3])
    assert np.all(np.abs(motion.way - level.way) < 0.5 * sigmas)
    assert motion.relief == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("high", [0.06, 0.12, 0.24])
def test_the_relief_of_woods_and_clearings_is_told_and_that_of_level_ground_is_none(high):
    def woods(x, y):
        return high * ((np.floor(3.0 * x) + np.floor(3.0 * y)) % 2.0)

    noise_px = 0.4 * np.random.default_rng(2).normal(size=(12, 12, 2))
    about = moved(noise_px, woods).relief
    assert about is not None
    assert 0.3 * high < about < high
    assert moved(noise_px).relief == pytest.approx(0.0, abs=0.012)


QUIET_PX = 0.3 * np.random.default_rng(3).normal(size=(144, 2))


def climbed(
    readout_s: float, told: bool, prior: MotionPrior = BRAKING, noise_px: np.ndarray = QUIET_PX
) -> Motion:
    """Over level ground, the keyframe taken in a brake, pitching, the image at rest and higher."""
    v, u = np.meshgrid(np.linspace(-0.6, 0.6, 12), np.linspace(-0.8, 0.8, 12), indexing="ij")
    rays = np.dstack([u, v, np.ones_like(u)]).reshape(-1, 3)
    pitching = skew(np.array([0.7, 0.0, 0.0]))  # about the image's right, rad/s
    per_s = (rays[:, 1:2] / 1.2) * (rays @ pitching.T)  # the first row half a read-out earlier
    rays1 = rays - CLIMB @ LOOKS_DOWN
    rays1 = rays1 / rays1[:, 2:]
    rays1[:, :2] += noise_px / FOCAL_PX
    skew0 = per_s @ LOOKS_DOWN.T if told else AT_ONCE
    seen0 = (rays - readout_s * per_s) @ LOOKS_DOWN.T
    motion = fit_motion(Sightings(seen0, rays1, LOOKS_DOWN, FOCAL_PX, skew0, AT_ONCE), prior, 3.0)
    assert motion is not None
    return motion


@pytest.mark.parametrize("readout_s", [0.0, 0.008, 0.02])
def test_rows_that_were_read_in_a_brake_are_no_slope_that_a_climb_goes_aside_by(readout_s):
    motion = climbed(readout_s, told=True)
    sigmas = np.sqrt(np.diag(motion.covariance)[:3])
    assert np.all(np.abs(motion.way - CLIMB) < 3.0 * sigmas)
    assert np.abs(motion.slope).max() < 0.03
    value_s, sigma_s = motion.readout_s
    assert abs(value_s - readout_s) < 3.0 * sigma_s
    assert sigma_s < 0.005


def test_where_nobody_tells_how_it_turned_they_are_taken_for_one():
    assert np.abs(climbed(0.02, told=False).slope).max() > 0.1


def test_a_read_out_that_is_known_is_taken_off_and_stays_known():
    known = replace(BRAKING, readout_s=0.02, sigma_readout_s=0.002)
    motion = climbed(0.02, told=True, prior=known)
    assert motion.way == pytest.approx(CLIMB, abs=0.001)
    assert motion.readout_s == pytest.approx((0.02, 0.001), abs=0.001)


@given(seed=st.integers(0, 2**32 - 1), together=st.booleans(), sigma_s=st.floats(0.001, 0.02))
def test_tracks_make_a_read_out_surer_and_never_less_sure_than_it_was(seed, together, sigma_s):
    rng, prior = np.random.default_rng(seed), replace(BRAKING, sigma_readout_s=sigma_s)
    noise_px = 2.0 * rng.normal(size=(4, 4, 2) if together else (12, 12, 2))
    if together:
        noise_px = noise_px.repeat(3, axis=0).repeat(3, axis=1)
    value_s, told_s = climbed(0.008, True, prior, noise_px.reshape(-1, 2)).readout_s
    assert value_s >= 0.0
    assert told_s <= sigma_s
