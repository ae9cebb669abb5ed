"""What a flight tells of the mount, over flights whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from mount_flights import CX, CY, K1, F, H, Truth, W, fly

from vwnav.calibration.mount.history import FlownAttitudes, camera_heights_at, heights_at
from vwnav.calibration.mount.solve import fit_mount
from vwnav.calibration.mount.verdict import judge
from vwnav.errors import CalibrationError
from vwnav.geometry.camera import Camera
from vwnav.geometry.rotations import vector_from_rotation
from vwnav.types import Attitude, Range

CAMERA = Camera(
    width_px=W, height_px=H, K=np.array([[F, 0, CX], [0, F, CY], [0, 0, 1]]),
    distortion=(K1, 0.0, 0.0, 0.0),
)  # fmt: skip


def fit(truth: Truth, seed: int, focal: bool = False, spoil=lambda seen: seen):
    """The fit, and (6,) its errors over its sigmas, and the errors themselves."""
    flight = fly(truth, seed)
    flight.sightings = [spoil(each) for each in flight.sightings]
    history = FlownAttitudes(flight.attitudes)
    times = np.array([s.t_s for s in flight.sightings])
    heights = heights_at(flight.ranges, history, times + truth.offset_s)
    seen = [replace(s, height_m=float(h)) for s, h in zip(flight.sightings, heights, strict=True)]
    found = fit_mount(CAMERA, history, seen, focal)
    turned = vector_from_rotation(flight.R_body_camera @ found.R_body_camera.T)
    errors = np.array(
        [
            *turned, truth.offset_s - found.offset_s, truth.readout_s - found.readout_s,
            np.log(truth.focal / found.focal_ratio),
        ]
    )  # fmt: skip
    sigmas = np.array(
        [
            *found.sigmas_rad, found.sigma_offset_s, found.sigma_readout_s,
            found.sigma_focal_ratio,
        ]
    )  # fmt: skip
    return found, errors, sigmas


SEEDS = 20
ASKED = np.array([*np.radians([0.2, 0.2]), np.inf, 0.002, 0.002])


@pytest.fixture(scope="module")
def trials():
    """Errors and sigmas (20, 6) of flights with a rangefinder, the focal length asked."""
    found = [fit(Truth(focal=1.02), seed, focal=True)[1:] for seed in range(SEEDS)]
    return np.array([e for e, _ in found]), np.array([s for _, s in found])


@pytest.mark.long
def test_mount_lateness_and_readout_are_found_to_what_is_asked(trials):
    errors, _ = trials
    assert (np.abs(errors[:, :5]) < ASKED).mean(axis=0).min() >= 0.95
    assert (np.abs(errors[:, 5]) < 0.003).mean() >= 0.95


@pytest.mark.long
def test_the_truth_lies_within_three_sigmas_in_nineteen_of_twenty(trials):
    errors, sigmas = trials
    within = (np.abs(errors) < 3.0 * sigmas).sum(axis=0)
    assert within.min() >= 19
    # Sigmas that are honest are no excuse either: most errors are of their size.
    assert (np.abs(errors) < 0.05 * sigmas).mean() < 0.5


@pytest.mark.long
@pytest.mark.parametrize("carried", [True, False])
def test_the_time_offset_is_as_sure_as_it_says_whether_the_level_turns_with_the_nose(carried):
    """Where the level errs with the nose, a turn looked like lateness (six others: 1.4 sigmas)."""
    found = [fit(Truth(carried=carried, sigma_px=2.0), seed)[1:] for seed in range(SEEDS)]
    sigmas = np.array([errors[3] / sigma[3] for errors, sigma in found])
    assert np.sqrt(np.mean(sigmas**2)) < 1.3


@pytest.mark.long
def test_banked_turns_tell_the_focal_length_without_a_rangefinder():
    for seed in range(4):
        _, errors, sigmas = fit(Truth(focal=0.98, rangefinder=False), seed, focal=True)
        assert abs(errors[5]) < min(0.01, 3.0 * sigmas[5])


def test_one_flight_tells_the_mount_to_a_fifth_of_a_degree():
    _, errors, sigmas = fit(Truth(images=60, seconds=70.0), 3)
    assert np.all(np.abs(errors[:2]) < np.radians(0.2))
    assert np.all(np.abs(errors[3:5]) < 0.002)
    assert np.all(np.abs(errors[:5]) < 3.0 * sigmas[:5])


def test_matches_that_are_wrong_and_too_far_in_make_no_smaller_focal_length():
    """One of seven, by 12 to 20 px: wrong ones lie within the image, so more are inwards."""

    def spoil(seen):
        rng = np.random.default_rng(int(1e3 * seen.t_s))
        out = seen.uv - [CX, CY]
        inward = out / np.linalg.norm(out, axis=1, keepdims=True)
        wrong = rng.uniform(12.0, 20.0, (len(out), 1)) * (rng.random((len(out), 1)) < 0.15)
        return replace(seen, uv=seen.uv - wrong * inward)

    _, errors, _ = fit(Truth(images=60, seconds=70.0, sigma_px=2.0), 3, True, spoil)
    assert abs(errors[5]) < 0.002


def test_a_camera_below_the_autopilot_is_lower_than_the_rangefinder_says():
    """0.2 m are 0.4 % of focal length at 50 m."""
    nose_up = np.array([np.cos(0.05), 0.0, np.sin(0.05), 0.0])
    history = FlownAttitudes([Attitude(t, nose_up) for t in (0.0, 0.4, 0.8)])
    ranges = [Range(t, 50.0 / np.cos(0.1)) for t in (0.0, 0.4, 0.8)]
    arm_m, at_s = np.array([0.3, 0.1, 0.2]), np.array([0.2, 0.5])
    below_m = 0.2 * np.cos(0.1) - 0.3 * np.sin(0.1)
    heights_m = camera_heights_at(ranges, history, at_s, arm_m)
    assert heights_m == pytest.approx(np.full(2, 50.0 - below_m))


def test_a_brisk_turn_is_followed_between_attitudes():
    """Of 600 degrees per second squared; turning evenly between them cuts 0.07 degrees off."""
    told_s = np.arange(0.0, 0.31, 0.03)

    def turn_rad(t_s):
        return np.radians(300.0) * t_s**2

    quats = [np.array([np.cos(a / 2), 0.0, 0.0, np.sin(a / 2)]) for a in turn_rad(told_s)]
    history = FlownAttitudes([Attitude(t, q) for t, q in zip(told_s, quats, strict=True)])
    at_s = np.linspace(0.06, 0.24, 13)
    turned = history.at(at_s)
    yaw = np.arctan2(turned.R_ned_body[:, 1, 0], turned.R_ned_body[:, 0, 0])
    assert yaw == pytest.approx(turn_rad(at_s), abs=np.radians(0.002))
    assert turned.rates_rad_s[:, 2] == pytest.approx(np.radians(600.0) * at_s, abs=0.01)


def test_straight_and_level_tells_neither_the_time_offset_nor_the_focal_length():
    calm = Truth(images=50, seconds=60.0, turns=False, rangefinder=False, focal=0.98)
    found, _, _ = fit(calm, 1, focal=True)
    verdict = judge(CAMERA, found, True, False, np.radians(4.0))
    why = {each.name: each.refused for each in verdict.told}
    assert why["time offset, this flight's"] == "the aircraft hardly turned"
    assert why["focal length"].startswith("no rangefinder or GPS height, and no turn")
    assert "look alike" in why["mount: yaw"]
    assert "GPS of a flight with turns in hover" in why["lever arm"]
    assert verdict.camera.K[0, 0] == F
    assert verdict.camera.time_offset_s == 0.0


def test_a_mount_that_is_hardly_told_is_refused_as_a_whole():
    found, _, _ = fit(Truth(images=30, seconds=40.0), 1)
    with pytest.raises(CalibrationError, match=r"tells the mount to 2\.0 degrees only"):
        judge(CAMERA, replace(found, sigmas_rad=np.radians([2.0, 0.1, 0.1])), False, True, 0.5)
