import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from vision_scenes import CAMERA, GROUND_PX, HOME, M_PER_PX, frame_at, ground_pack, texture

from vwnav.errors import CalibrationError, ModelError
from vwnav.geometry.camera import Camera
from vwnav.geometry.rotations import rotation_from_euler, wrap_pi
from vwnav.maps.pack import MapPack
from vwnav.types import Features, Frame, MapFix, Prior, Rejected, RejectReason
from vwnav.vision.config import LocalizerConfig
from vwnav.vision.features.opencv import no_features
from vwnav.vision.localizer import Localizer

AGL_M = 60.0


def prior_at(north_m: float, east_m: float, *, yaw_deg: float = 0.0, **known) -> Prior:
    """A good prior at a place of the ground, changed as told."""
    lat_deg, lon_deg, _ = HOME.to_geodetic(np.array([north_m, east_m, 0.0]))
    sharp = {"sigma_m": 8.0, "sigma_yaw_rad": 0.05, "sigma_agl_ratio": 0.05}
    level = {"roll_rad": 0.0, "pitch_rad": 0.0, "agl_m": AGL_M}
    place = {"lat_deg": float(lat_deg), "lon_deg": float(lon_deg)}
    return Prior(**{**place, "yaw_rad": math.radians(yaw_deg), **sharp, **level, **known})


def error_ne_m(fix: MapFix, north_m: float, east_m: float) -> np.ndarray:
    ned = HOME.to_ned(fix.lat_deg, fix.lon_deg, HOME.alt_amsl_m)
    return np.array([ned[0] - north_m, ned[1] - east_m])


def test_a_fix_is_where_the_image_was_taken(pack, ground, extractor):
    frame = frame_at(ground, 20.0, -15.0, AGL_M, rpy_deg=(0, 0, 35), rng=np.random.default_rng(0))
    fix = Localizer(pack, extractor, CAMERA).localize(frame, prior_at(24, -10, yaw_deg=38), 0)
    assert isinstance(fix, MapFix)
    assert np.linalg.norm(error_ne_m(fix, 20.0, -15.0)) < 0.4
    assert math.degrees(fix.yaw_rad) == pytest.approx(35.0, abs=0.6)
    assert fix.agl_m == pytest.approx(AGL_M, rel=0.02)
    assert (fix.point, fix.features) == ("nadir", extractor.name)
    assert fix.stats.inliers > 30


def test_what_the_attitude_leaves_open_is_no_fault_of_the_matches(pack, ground, learned):
    """From 600 m up 2 degrees are 21 m, and every fix was refused; so would these 2 m be."""
    frame = frame_at(ground, 20.0, -15.0, AGL_M, rng=np.random.default_rng(0))
    localizer = Localizer(pack, learned, CAMERA, LocalizerConfig(max_sigma_m=1.0))
    fix = localizer.localize(frame, prior_at(20, -15), 0)
    assert isinstance(fix, MapFix)
    assert fix.sigma_m > 1.5
    strict = Localizer(pack, learned, CAMERA, LocalizerConfig(max_sigma_m=0.01))
    assert isinstance(strict.localize(frame, prior_at(20, -15), 0), Rejected)


def test_the_errors_are_those_of_the_covariance(pack, ground, learned):
    """Tilt that is not told makes most of the error; its share in the covariance is 2 degrees."""
    rng, squared = np.random.default_rng(1), []
    localizer = Localizer(pack, learned, CAMERA)
    for _ in range(25):
        north_m, east_m = rng.uniform(-45, 45, 2)
        true_deg = (*rng.normal(0, 2.0, 2), rng.uniform(-180, 180))
        frame = frame_at(ground, north_m, east_m, AGL_M, rpy_deg=true_deg, rng=rng)
        fix = localizer.localize(frame, prior_at(north_m, east_m, yaw_deg=true_deg[2]), 0)
        error = error_ne_m(fix, north_m, east_m)
        squared.append(error @ np.linalg.solve(fix.covariance_ne_m2, error))
    assert 0.8 < np.mean(squared) < 3.6  # two degrees of freedom: 2, and 0.57 sigma of this mean
    assert max(squared) < 20.0


def test_a_known_tilt_is_taken_out(pack, ground, extractor):
    frame = frame_at(ground, 0.0, 10.0, AGL_M, rpy_deg=(9, -7, 80))
    tilted = {"roll_rad": math.radians(9), "pitch_rad": math.radians(-7)}
    prior = prior_at(0.0, 10.0, yaw_deg=80.0, **tilted)
    fix = Localizer(pack, extractor, CAMERA).localize(frame, prior, 0)
    assert np.linalg.norm(error_ne_m(fix, 0.0, 10.0)) < 0.6


def test_a_view_that_leans_tells_the_height_below_it_less_surely(pack, ground, learned):
    """What is seen aside may lie higher or lower: by a tenth of how far, one sigma."""
    localizer, sigma_m = Localizer(pack, learned, CAMERA), []
    for lean_deg in (0.0, 12.0):
        frame = frame_at(ground, 0.0, 0.0, AGL_M, rpy_deg=(lean_deg, 0, 0))
        prior = prior_at(0.0, 0.0, roll_rad=math.radians(lean_deg))
        sigma_m.append(localizer.localize(frame, prior, 0).sigma_agl_m)
    aside_m = AGL_M * math.tan(math.radians(12.0))
    assert sigma_m[0] < 0.03 * AGL_M
    assert sigma_m[1] ** 2 - sigma_m[0] ** 2 > (0.1 * aside_m) ** 2  # the fit's own grows too


@pytest.mark.parametrize("yaw_off_deg", [0.0, 12.0])
def test_a_camera_on_an_arm_is_found_and_its_body_is_told(pack, ground, sift, yaw_off_deg):
    """The compass may be off: the heading that was found says to which side the camera sits."""
    rpy_deg, arm_m = (9.0, -7.0, 80.0), np.array([0.9, -0.6, 0.4])
    at_m = rotation_from_euler(*np.radians(rpy_deg)) @ arm_m
    camera = replace(CAMERA, t_body_camera_m=arm_m)
    frame = frame_at(ground, at_m[0], 10.0 + at_m[1], AGL_M - at_m[2], rpy_deg=rpy_deg)
    tilted = {"roll_rad": math.radians(9), "pitch_rad": math.radians(-7)}
    prior = prior_at(0.0, 10.0, yaw_deg=80.0 + yaw_off_deg, **tilted)
    of_body = Localizer(pack, sift, camera).localize(frame, prior, 0)
    of_camera = Localizer(pack, sift, camera.without_arm()).localize(frame, prior, 0)
    apart_m = error_ne_m(of_camera, 0.0, 10.0) - error_ne_m(of_body, 0.0, 10.0)
    assert np.abs(apart_m - at_m[:2]).max() < 0.05
    assert np.linalg.norm(error_ne_m(of_body, 0.0, 10.0)) < 0.5
    assert of_body.agl_m - of_camera.agl_m == pytest.approx(at_m[2], abs=0.2)


def test_without_attitude_the_fix_is_of_the_images_centre(pack, ground, extractor):
    frame = frame_at(ground, 0.0, 0.0, AGL_M, rpy_deg=(0, 6, 0))
    prior = replace(prior_at(0.0, 0.0), roll_rad=None, pitch_rad=None)
    fix = Localizer(pack, extractor, CAMERA).localize(frame, prior, 0)
    assert fix.point == "center"
    center_north_m = AGL_M * math.tan(math.radians(6))  # nose up: the image looks ahead
    assert np.linalg.norm(error_ne_m(fix, center_north_m, 0.0)) < 1.0


@pytest.mark.parametrize("yaw_off_deg", [-15.0, 15.0])
@pytest.mark.parametrize("agl_factor", [0.85, 1.15])
@pytest.mark.parametrize("north_off_m", [-60.0, 60.0])
def test_a_rough_prior_is_enough(pack, ground, learned, yaw_off_deg, agl_factor, north_off_m):
    frame = frame_at(ground, 5.0, 30.0, AGL_M, rpy_deg=(0, 0, -70), rng=np.random.default_rng(2))
    rough = {"sigma_m": 50.0, "sigma_yaw_rad": 0.26, "sigma_agl_ratio": 0.15}
    place = prior_at(5.0 + north_off_m, 30.0, yaw_deg=-70 + yaw_off_deg, **rough)
    fix = Localizer(pack, learned, CAMERA).localize(
        frame, replace(place, agl_m=agl_factor * AGL_M), 0
    )
    assert isinstance(fix, MapFix)
    assert np.linalg.norm(error_ne_m(fix, 5.0, 30.0)) < 0.5


@pytest.mark.parametrize(
    "unknown",
    [
        ("yaw_rad",),
        ("lat_deg", "lon_deg"),
        pytest.param(("lat_deg", "lon_deg", "yaw_rad"), marks=pytest.mark.long),
        ("lat_deg", "lon_deg", "yaw_rad", "agl_m", "roll_rad", "pitch_rad"),
    ],
)
def test_what_is_not_known_is_searched(pack, ground, extractor, unknown):
    frame = frame_at(ground, -22.0, 31.0, 90.0, rpy_deg=(0, 0, 151), rng=np.random.default_rng(3))
    prior = prior_at(-22.0, 31.0, yaw_deg=151.0, agl_m=90.0)
    prior = replace(prior, **dict.fromkeys(unknown))
    fix = Localizer(pack, extractor, CAMERA).localize(frame, prior, 0)
    assert isinstance(fix, MapFix)
    assert np.linalg.norm(error_ne_m(fix, -22.0, 31.0)) < 0.6
    assert abs(wrap_pi(fix.yaw_rad - math.radians(151.0))) < math.radians(1.0)
    assert fix.agl_m == pytest.approx(90.0, rel=0.03)


def test_an_unrelated_map_gives_no_fix(pack, extractor):
    localizer = Localizer(pack, extractor, CAMERA)
    seeds = {"learned": range(100, 160), "sift": range(200, 225), "orb": range(300, 415)}
    for seed in seeds[extractor.name]:
        scene = texture(seed, 320)
        frame = frame_at(scene, 0.0, 0.0, 50.0, rng=np.random.default_rng(seed))
        outcome = localizer.localize(frame, prior_at(0, 0, agl_m=50.0, sigma_m=20.0), seed)
        assert isinstance(outcome, Rejected)
        assert outcome.reason in (RejectReason.FEW_INLIERS, RejectReason.AMBIGUOUS)


def test_an_unrelated_map_gives_no_fix_to_a_search_either(pack, learned):
    frame = frame_at(texture(77), 0.0, 0.0, 80.0, rng=np.random.default_rng(0))
    assert isinstance(Localizer(pack, learned, CAMERA).localize(frame, Prior(), 0), Rejected)


@pytest.mark.parametrize("prior", [prior_at(0.0, 0.0), Prior()], ids=["prior", "none"])
def test_black_and_white_images_are_too_dark(pack, extractor, prior):
    for value in (0, 255):
        frame = Frame(1.5, np.full((360, 480), value, np.uint8), 3)
        outcome = Localizer(pack, extractor, CAMERA).localize(frame, prior, 0)
        assert (outcome.t_s, outcome.reason) == (1.5, RejectReason.TOO_DARK)


def test_noise_gives_no_fix(pack, extractor):
    noise = np.random.default_rng(0).integers(0, 256, (360, 480, 3), np.uint8)
    outcome = Localizer(pack, extractor, CAMERA).localize(
        Frame(0.0, noise, 0), prior_at(0.0, 0.0), 0
    )
    assert isinstance(outcome, Rejected)


def test_a_tiny_image_gives_no_fix(pack, ground, extractor):
    camera = Camera.from_hfov(12, 9, 70.0)
    frame = frame_at(ground, 0.0, 0.0, AGL_M, camera=camera)
    outcome = Localizer(pack, extractor, camera).localize(frame, prior_at(0.0, 0.0), 0)
    assert isinstance(outcome, Rejected)


@pytest.mark.parametrize("name", ["lat_deg", "yaw_rad", "agl_m", "sigma_m", "roll_rad"])
def test_a_prior_with_a_nan_is_refused_and_nothing_is_raised(pack, ground, orb, name):
    prior = replace(prior_at(0.0, 0.0), **{name: math.nan})
    outcome = Localizer(pack, orb, CAMERA).localize(frame_at(ground, 0, 0, AGL_M), prior, 0)
    assert outcome.reason is RejectReason.PRIOR


@pytest.mark.parametrize(
    ("known", "reason"),
    [
        ({"lat_deg": 47.5}, RejectReason.NO_MAP),
        ({"agl_m": 6.0}, RejectReason.TOO_LOW),
        ({"pitch_rad": 1.4}, RejectReason.TILTED),
    ],
)
def test_a_hopeless_prior_is_refused_with_its_reason(pack, ground, orb, known, reason):
    frame = frame_at(ground, 0.0, 0.0, AGL_M)
    outcome = Localizer(pack, orb, CAMERA).localize(frame, prior_at(0.0, 0.0, **known), 0)
    assert outcome.reason is reason
    assert outcome.detail


def test_a_lens_told_far_too_wide_is_named_where_a_level_camera_sees_too_far_aside(
    pack, ground, orb
):
    """140 degrees of a fisheye given as --hfov-deg: the camera was said not to look down."""
    frame = frame_at(ground, 0.0, 0.0, AGL_M)
    camera = Camera.from_hfov(CAMERA.width_px, CAMERA.height_px, 140.0)
    outcome = Localizer(pack, orb, camera).localize(frame, prior_at(0.0, 0.0), 0)
    assert outcome.reason is RejectReason.TILTED
    assert "fisheye" in outcome.detail


@pytest.mark.parametrize(
    ("agl_m", "ratio", "true_m"), [(40.0, 0.5, 70.0), (12.0, 4.0, 45.0), (2.2, 13.6, 60.0)]
)
def test_a_height_that_shows_too_little_does_not_hide_greater_ones(
    pack, ground, sift, agl_m, ratio, true_m
):
    """Of a height that is open: the lower guess was tried first, and was too low for any fix."""
    localizer = Localizer(pack, sift, CAMERA)
    prior = prior_at(12.0, -22.0, agl_m=agl_m, sigma_agl_ratio=ratio)
    fix = localizer.localize(frame_at(ground, 10.0, -20.0, true_m), prior, 0)
    assert isinstance(fix, MapFix)
    assert np.linalg.norm(error_ne_m(fix, 10.0, -20.0)) < 1.0


def test_a_search_that_is_given_up_is_gone_on_with_by_the_next(pack, ground, sift, monkeypatch):
    """On a map of some square kilometres the same corner was looked at every twenty seconds."""
    localizer, looks = Localizer(pack, sift, CAMERA), []
    register = localizer._register

    def counted(query, candidate):
        looks.append((candidate.hypothesis, candidate.area))
        if len(looks) % 3 == 0:
            localizer.give_up()
        return register(query, candidate)

    monkeypatch.setattr(localizer, "_register", counted)
    nowhere = np.random.default_rng(0).integers(0, 255, (360, 480), dtype=np.uint8)
    prior = prior_at(0.0, 0.0, lat_deg=None, lon_deg=None, yaw_rad=None, agl_m=None)
    for seed in range(4):
        outcome = localizer.localize(Frame(0.0, nowhere, 0), prior, seed)
        assert outcome.reason is RejectReason.GIVEN_UP
    assert len(set(looks)) == len(looks) == 12


@pytest.mark.parametrize("name", ["lat_deg", "yaw_rad", "roll_rad"])
def test_with_a_lever_arm_a_prior_that_is_not_finite_is_refused_too(pack, ground, orb, name):
    camera = replace(CAMERA, t_body_camera_m=np.array([0.3, 0.0, 0.1]))
    prior = prior_at(0.0, 0.0, **{name: math.inf})
    outcome = Localizer(pack, orb, camera).localize(frame_at(ground, 0.0, 0.0, AGL_M), prior, 0)
    assert outcome.reason is RejectReason.PRIOR


def test_a_map_without_features_gives_no_fix(tmp_path, ground, orb):
    flat = np.full((600, 600), 120, np.uint8)
    with MapPack.open(ground_pack(tmp_path / "flat.mbtiles", flat, (orb,))) as flat_pack:
        outcome = Localizer(flat_pack, orb, CAMERA).localize(
            frame_at(ground, 0.0, 0.0, AGL_M), prior_at(0.0, 0.0), 0
        )
    assert outcome.reason is RejectReason.FEW_KEYPOINTS


def test_a_map_that_repeats_itself_is_ambiguous(tmp_path, orb):
    tile = texture(5, 210)
    ground = np.tile(tile, (4, 4))
    with MapPack.open(ground_pack(tmp_path / "tiled.mbtiles", ground, (orb,))) as tiled:
        outcome = Localizer(tiled, orb, CAMERA).localize(
            frame_at(ground, 0.0, 0.0, AGL_M), prior_at(0.0, 0.0, sigma_m=30.0), 0
        )
    assert isinstance(outcome, Rejected)


@pytest.fixture(scope="module")
def half_turned(tmp_path_factory, orb):
    """A map that is the same turned by a half: a runway, a crossing."""
    ground = texture(5)
    ground[GROUND_PX // 2 :] = np.rot90(ground, 2)[GROUND_PX // 2 :]
    path = tmp_path_factory.mktemp("turned") / "turned.mbtiles"
    with MapPack.open(ground_pack(path, ground, (orb,))) as pack:
        yield ground, pack


def test_a_map_that_looks_the_same_turned_by_a_half_is_ambiguous_to_a_search(half_turned, orb):
    ground, pack = half_turned
    frame = frame_at(ground, 30.0, -20.0, AGL_M, rng=np.random.default_rng(0))
    outcome = Localizer(pack, orb, CAMERA).localize(frame, Prior(), 0)
    assert outcome.reason is RejectReason.AMBIGUOUS


def test_with_a_heading_it_is_not(half_turned, orb):
    ground, pack = half_turned
    frame = frame_at(ground, 30.0, -20.0, AGL_M, rng=np.random.default_rng(0))
    fix = Localizer(pack, orb, CAMERA).localize(frame, prior_at(24.0, -24.0, sigma_m=20.0), 0)
    assert np.linalg.norm(error_ne_m(fix, 30.0, -20.0)) < 2 * M_PER_PX


class Blind:
    """An extractor that finds nothing in an image."""

    def __init__(self, extractor) -> None:
        self.name, self.feature_set_id = extractor.name, extractor.feature_set_id
        self.log10_per_decade = extractor.log10_per_decade

    def extract(self, gray, max_keypoints):
        return no_features(32, np.uint8)


def test_a_view_without_keypoints_is_placed_by_correlation_which_tells_a_position_alone(
    pack, ground, orb
):
    frame = frame_at(ground, 20.0, -15.0, 36.0, rng=np.random.default_rng(0))
    prior = prior_at(24.0, -12.0, agl_m=36.0, sigma_m=3.0)
    fix = Localizer(pack, Blind(orb), CAMERA).localize(frame, prior, 0)
    assert isinstance(fix, MapFix)
    assert (fix.placed_by, fix.point) == ("correlation", "nadir")
    assert np.linalg.norm(error_ne_m(fix, 20.0, -15.0)) < 0.4
    assert fix.yaw_rad is fix.sigma_yaw_rad is fix.agl_m is fix.sigma_agl_m is None


def test_a_leaning_view_placed_by_correlation_is_as_unsure_as_height_and_heading(pack, ground, orb):
    """It shows ground aside: how far aside they tell, and no match corrects them."""
    rng, squared = np.random.default_rng(1), []
    localizer = Localizer(pack, Blind(orb), CAMERA, LocalizerConfig(sigma_tilt_rad=0.0))
    for north_m, east_m in rng.uniform(-30, 30, (25, 2)):
        yaw_deg, agl_m = rng.uniform(-180, 180), 36.0 * math.exp(rng.normal(0, 0.06))
        frame = frame_at(ground, north_m, east_m, 36.0, rpy_deg=(18, -20, yaw_deg), rng=rng)
        told_deg = yaw_deg + math.degrees(rng.normal(0, 0.05))
        lean = {"roll_rad": math.radians(18), "pitch_rad": math.radians(-20)}
        known = {"agl_m": agl_m, "sigma_agl_ratio": 0.06, "sigma_m": 3.0, **lean}
        fix = localizer.localize(frame, prior_at(north_m, east_m, yaw_deg=told_deg, **known), 0)
        if isinstance(fix, MapFix):
            error = error_ne_m(fix, north_m, east_m)
            squared.append(error @ np.linalg.solve(fix.covariance_ne_m2, error))
    assert len(squared) > 12
    assert np.mean(squared) < 3.0  # two degrees of freedom; 4.5 without height and heading


@pytest.mark.parametrize(
    "known", [{"roll_rad": None}, {"yaw_deg": 20.0}, {"sigma_m": 30.0}], ids=str
)
def test_without_tilt_heading_or_a_good_place_nothing_is_placed_by_correlation(
    pack, ground, orb, known
):
    frame = frame_at(ground, 20.0, -15.0, 36.0, rng=np.random.default_rng(0))
    prior = prior_at(24.0, -12.0, **{"agl_m": 36.0, "sigma_m": 3.0, **known})
    assert isinstance(Localizer(pack, Blind(orb), CAMERA).localize(frame, prior, 0), Rejected)


@pytest.mark.parametrize(("sigma_m", "placed"), [(3.0, True), (30.0, False)])
def test_what_landmarks_leave_open_is_placed_by_correlation_where_its_place_is_known_well(
    pack, ground, orb, sigma_m, placed, monkeypatch
):
    """From 25 m two of five pictures without a fix had been refused for landmarks alone."""

    def have_their_like(pack, extractor, query, found):
        return query.rejected(RejectReason.AMBIGUOUS, "all of it is beside it too")

    monkeypatch.setattr("vwnav.vision.localizer.ambiguous", have_their_like)
    # As where the place that was found is another's, or was found not quite to scale.
    monkeypatch.setattr(Localizer, "_singled_out", lambda *_: False)
    frame = frame_at(ground, 20.0, -15.0, 36.0, rng=np.random.default_rng(0))
    prior = prior_at(24.0, -12.0, agl_m=36.0, sigma_m=sigma_m)
    outcome = Localizer(pack, orb, CAMERA).localize(frame, prior, 0)
    if placed:
        assert outcome.placed_by == "correlation"
        assert np.linalg.norm(error_ne_m(outcome, 20.0, -15.0)) < 0.4
    else:
        assert outcome.reason is RejectReason.AMBIGUOUS


def test_unrelated_ground_is_not_placed_by_correlation_either(pack, orb):
    localizer = Localizer(pack, Blind(orb), CAMERA)
    for seed in range(400, 430):
        frame = frame_at(texture(seed, 320), 0.0, 0.0, 36.0, rng=np.random.default_rng(seed))
        outcome = localizer.localize(frame, prior_at(0, 0, agl_m=36.0, sigma_m=3.0), seed)
        assert isinstance(outcome, Rejected)


def test_the_same_image_gives_the_same_fix(pack, ground, extractor):
    frame = frame_at(ground, 3.0, 4.0, AGL_M, rng=np.random.default_rng(4))
    first, second = (
        Localizer(pack, extractor, CAMERA).localize(frame, prior_at(0.0, 0.0), 5) for _ in range(2)
    )
    assert (first.lat_deg, first.lon_deg, first.yaw_rad) == (
        second.lat_deg,
        second.lon_deg,
        second.yaw_rad,
    )
    assert np.array_equal(first.covariance_ne_m2, second.covariance_ne_m2)


def test_the_times_come_from_the_clock_that_is_handed_in(pack, ground, orb):
    ticks = iter(range(100))
    localizer = Localizer(pack, orb, CAMERA, clock=lambda: next(ticks) * 0.001)
    fix = localizer.localize(frame_at(ground, 0.0, 0.0, AGL_M), prior_at(0.0, 0.0), 0)
    assert fix.stats.extract_ms == pytest.approx(1.0)


def test_a_calibration_for_another_size_is_an_error(pack, orb):
    frame = Frame(0.0, np.zeros((720, 1280), np.uint8), 0)
    with pytest.raises(CalibrationError, match="480 x 360"):
        Localizer(pack, orb, CAMERA).localize(frame, Prior(), 0)


class OtherModel:
    """Features of the pack's name but of another model."""

    name, feature_set_id, log10_per_decade = "orb", "orb-of-someone-else", 2.0

    def extract(self, gray: np.ndarray, max_keypoints: int) -> Features:
        raise AssertionError("a pack of another model must be refused before")


def test_a_pack_of_another_model_is_an_error(pack, ground):
    with pytest.raises(ModelError, match="vwnav map build"):
        Localizer(pack, OtherModel(), CAMERA).localize(
            frame_at(ground, 0.0, 0.0, AGL_M), prior_at(0.0, 0.0), 0
        )


def test_an_image_covered_in_part_is_still_found(pack, ground, extractor):
    """A logo, a propeller: what does not move with the ground is outvoted."""
    frame = frame_at(ground, 12.0, 8.0, AGL_M, rng=np.random.default_rng(6))
    logo = cv2.resize(texture(9, 320), (150, 110))
    frame.image[:110, :150] = logo
    fix = Localizer(pack, extractor, CAMERA).localize(frame, prior_at(10.0, 10.0), 0)
    assert isinstance(fix, MapFix)
    assert np.linalg.norm(error_ne_m(fix, 12.0, 8.0)) < 2 * M_PER_PX


class Watched:
    """Features that note of what size the views were, and see nothing in the first `blind` ones."""

    def __init__(self, extractor, blind: int = 0) -> None:
        self.name, self.feature_set_id = extractor.name, extractor.feature_set_id
        self.log10_per_decade = extractor.log10_per_decade
        self._extractor, self._blind = extractor, blind
        self.sizes_px: list[int] = []

    def extract(self, gray, max_keypoints):
        self.sizes_px.append(gray.size)
        seen = gray if len(self.sizes_px) > self._blind else np.zeros_like(gray)
        return self._extractor.extract(seen, max_keypoints)


def turned_look(pack, ground, extractor, yaw_off_deg: float = 0.0):
    frame = frame_at(ground, 10.0, -15.0, 90.0, rpy_deg=(0, 0, 40), rng=np.random.default_rng(3))
    prior = prior_at(12, -11, yaw_deg=40 + yaw_off_deg, agl_m=92.0)
    return Localizer(pack, extractor, CAMERA).localize(frame, prior, 0)


def test_what_shows_no_image_is_not_looked_at(pack, ground, learned):
    watched = Watched(learned)
    fix = turned_look(pack, ground, watched)
    assert np.linalg.norm(error_ne_m(fix, 10.0, -15.0)) < 0.5
    corner_to_corner_px = (2 * 90.0 * math.tan(math.radians(35)) / 0.407) ** 2 * 0.75 * 2.1
    assert len(watched.sizes_px) == 1
    assert watched.sizes_px[0] < 0.55 * corner_to_corner_px


def test_an_image_that_a_part_does_not_place_is_looked_at_as_a_whole(pack, ground, learned):
    watched = Watched(learned, blind=1)
    fix = turned_look(pack, ground, watched)
    assert np.linalg.norm(error_ne_m(fix, 10.0, -15.0)) < 0.5
    assert len(watched.sizes_px) == 2
    assert watched.sizes_px[1] > 1.5 * watched.sizes_px[0]


def test_what_is_sure_is_not_looked_at_twice(pack, ground, learned):
    watched = Watched(learned)
    fix = turned_look(pack, ground, watched, yaw_off_deg=10.0)
    assert np.linalg.norm(error_ne_m(fix, 10.0, -15.0)) < 0.5
    assert len(watched.sizes_px) == 1
