"""Where a picture was taken: the room's front, which knows the map, the camera and the features.

With a prior the picture is rectified and put on the map around it at once. Without one the whole
pack is searched, coarse first, and what is found there is looked at again as with a prior.
"""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vwnav.geometry.camera import Camera
from vwnav.geometry.geodesy import horizontal_distance_m
from vwnav.geometry.homography import transform_points
from vwnav.geometry.mercator import mercator_px_per_m
from vwnav.geometry.pose import MapPose, PoseErrors, pose_from_rectified
from vwnav.geometry.rotations import wrap_pi
from vwnav.maps.pack import MapPack
from vwnav.types import (
    FeatureExtractor,
    Frame,
    MapFix,
    MatchStats,
    Prior,
    Rejected,
    RejectReason,
)
from vwnav.vision.guesses import Guess, guesses, is_finite
from vwnav.vision.hypotheses import SimilarityBounds
from vwnav.vision.look import Found, Job, Looker, Stopwatch, too_small
from vwnav.vision.placing import Misplaced, PlacingRules
from vwnav.vision.search import Area, coarse_tests, search
from vwnav.vision.shifting import Shifted, place_by_correlation

# A second look where the first had to turn or scale more than the features like.
MAX_TURN_RAD = math.radians(8.0)
MAX_RESCALE = 1.1
CLOSER_TURN_RAD = math.radians(8.0)  # what is left open then
CLOSER_SCALE = 1.12
PRIOR_SIGMAS = 3.0  # of the prior's position are looked at
MAX_PRIOR_SIGMAS = 4.0
UNKNOWN_TILT = 0.3  # the picture's centre may be so far off the nadir, in heights: 17 degrees
MAX_STRETCH = 1.25  # what hills and an error of attitude make of a similarity
MAX_STRETCH_UNKNOWN_TILT = 1.6
MIN_SIGMA_PX = 0.5
SYSTEMATIC_PX = 0.3  # errors that all matches share, map pixels
SIGMA_LEVEL_RAD = 0.09  # of the tilt where none is known, as odometry has it
SYSTEMATIC_YAW_RAD = math.radians(0.3)
SYSTEMATIC_SCALE = 0.01
WORTH_LOG10_FALSE_ALARMS = -4.0  # less is not looked at closer: see `Looker.confirm`
HOPELESS = (RejectReason.NO_MAP, RejectReason.TILTED, RejectReason.TOO_LOW)


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizerConfig:
    """How pictures are located.

    Attributes:
        max_keypoints: of a view.
        max_view_area_px: of a view; decides, with the height, which level of the map is used.
        max_guesses: headings and heights tried when a rough prior fails.
        threshold_px: largest error of an inlier, map pixels.
        min_decades: unrelated pictures may give a fix once in ten to this power.
        min_contrast: standard deviation of the gray values below which a picture is dark.
        search_agl_m: heights above ground that are tried when nothing is known of it.
        sigma_tilt_rad: of roll and pitch, when they are known.
        max_sigma_m: a fix that is less certain than this is none.
        max_track_radius_px: a prior that is wider than this on the map is searched coarse first.
    """

    max_keypoints: int = 1000
    max_view_area_px: float = 300_000.0
    max_guesses: int = 9
    threshold_px: float = 3.0
    min_decades: float = 5.0
    min_contrast: float = 2.5
    search_agl_m: tuple[float, float] = (20.0, 600.0)
    sigma_tilt_rad: float = math.radians(2.0)
    max_sigma_m: float = 20.0
    max_track_radius_px: float = 1500.0


class Localizer:
    """Locates the pictures of one camera on one map with one kind of features."""

    def __init__(
        self,
        pack: MapPack,
        extractor: FeatureExtractor,
        camera: Camera,
        config: LocalizerConfig | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Prepare for a camera.

        Args:
            pack: an open map.
            extractor: of the features; their set should be in the pack.
            camera: calibration for the pictures' size.
            config: defaults where not given.
            clock: seconds, for the times in `MatchStats` only.
        """
        self._config = config or LocalizerConfig()
        self._looker = Looker(pack, extractor, camera)
        self._features = extractor.name
        self._clock = clock
        self._given_up = threading.Event()

    def give_up(self) -> None:
        """Let a search that is running in another thread end at its next look."""
        self._given_up.set()

    def localize(self, frame: Frame, prior: Prior, seed: int) -> MapFix | Rejected:
        """Find where a picture was taken.

        Args:
            frame: a picture of the camera's size.
            prior: what is known; any field may be unknown. A prior with a NaN is refused.
            seed: of every random choice; equal input and seed give an equal fix.

        Returns:
            The fix, or why there is none.

        Raises:
            CalibrationError: the picture is not of the camera's size.
            ModelError: the pack holds features of another model, or the model fails.
        """
        watch = Stopwatch(self._clock)
        self._given_up.clear()
        if not is_finite(prior):
            return self._rejected(
                frame, watch, Misplaced(RejectReason.PRIOR, "the prior holds no finite numbers")
            )
        with watch.stage("rectify"):
            picture = self._looker.maker.picture(frame.image)
        job = Job(picture, prior, seed, watch)
        outcome = self._find(job)
        match outcome:
            case Misplaced():
                return self._rejected(frame, watch, outcome)
            case Shifted():
                stats = _stats(watch, 0, 0, 0)
                sigmas = (self._config.sigma_tilt_rad, self._looker.pack.georeference_sigma_m)
                fix = outcome.fix(frame.t_s, self._features, stats, *sigmas)
                return self._plausible(fix, frame, job)
            case Found():
                return self._fix(frame, job, outcome)

    def _find(self, job: Job) -> Found | Shifted | Misplaced:
        if job.picture.contrast < self._config.min_contrast:
            return Misplaced(
                RejectReason.TOO_DARK, f"its gray values differ by {job.picture.contrast:.1f} only"
            )
        prior = job.prior
        todo = guesses(prior, self._config.search_agl_m)
        radius_m = PRIOR_SIGMAS * prior.sigma_m
        if prior.agl_m is not None and None not in (prior.lat_deg, prior.lon_deg, prior.yaw_rad):
            level = self._looker.fine_level(job, prior.agl_m, self._config.max_view_area_px)
            if radius_m <= self._config.max_track_radius_px * level.m_per_px:
                return self._track(job, todo, radius_m)
        area = Area(prior.lat_deg, prior.lon_deg, radius_m)
        tests = coarse_tests(self._looker, job, todo, area)
        if not tests:
            return Misplaced(RejectReason.NO_MAP, "the map has no level at which to search there")
        return search(
            self._looker,
            job,
            tests,
            self._rules(prior).max_stretch,
            self._config.threshold_px,
            lambda found: self._closer(job, found, len(tests)),
            self._given_up.is_set,
        )

    def _track(self, job: Job, todo: list[Guess], radius_m: float) -> Found | Shifted | Misplaced:
        """Look around the prior's place, with the prior's heading and height first.

        A view that keypoints do not place may still correlate with the map: that wants the tilt,
        and a heading and a height that are nearly right to begin with.
        """
        lat_deg, lon_deg = job.prior.lat_deg, job.prior.lon_deg
        refusal = Misplaced(RejectReason.NO_MAP, "no place to look at")
        if lat_deg is None or lon_deg is None:
            return refusal
        todo = todo[: self._config.max_guesses]
        for i, guess in enumerate(todo):
            seen = self._look(job, guess, (lat_deg, lon_deg), radius_m, tests=i + 1)
            if isinstance(seen, Found):
                return self._straightened(job, seen)
            if i == 0:
                refusal = seen
            if seen.reason in HOPELESS:
                return refusal
        level = self._looker.fine_level(job, todo[0].agl_m, self._config.max_view_area_px)
        decades = self._config.min_decades
        shifted = place_by_correlation(self._looker, job, todo[0], level, radius_m, decades)
        return shifted or refusal

    def _look(
        self, job: Job, guess: Guess, lat_lon: tuple[float, float], radius_m: float, tests: int
    ) -> Found | Misplaced:
        """Look around a place at the sharpest level that the picture can fill."""
        level = self._looker.fine_level(job, guess.agl_m, self._config.max_view_area_px)
        rectification = self._looker.rectify(job, guess, level.zoom, lat_lon[0])
        if rectification is None:
            return Misplaced(RejectReason.TILTED, "the camera does not look down")
        if (refusal := too_small(rectification)) is not None:
            return refusal
        window = self._looker.window_at(rectification, level.zoom, *lat_lon, radius_m)
        if 0 in window.clipped(self._looker.pack.window(level.zoom)).shape:
            detail = f"{self._looker.pack.name} does not cover {lat_lon[0]:.5f}, {lat_lon[1]:.5f}"
            return Misplaced(RejectReason.NO_MAP, detail)
        map_ = self._looker.map_features(job, level.zoom, window)
        view = self._looker.view(job, guess, rectification, self._config.max_keypoints)
        seen = self._looker.look(job, guess, view, map_, self._rules(job.prior))
        if isinstance(seen, Misplaced):
            return seen
        return self._looker.confirm(job, seen, self._config.min_decades + math.log10(tests))

    def _rules(self, prior: Prior) -> PlacingRules:
        return PlacingRules(
            threshold_px=self._config.threshold_px,
            max_log10_false_alarms=WORTH_LOG10_FALSE_ALARMS,
            max_stretch=MAX_STRETCH if _attitude_known(prior) else MAX_STRETCH_UNKNOWN_TILT,
        )

    def _closer(self, job: Job, found: Found, tests: int) -> Found | Misplaced:
        """Look again at what was found, with its heading and height, at the sharpest level."""
        pose = self._pose(job, found)
        if pose is None:
            return Misplaced(RejectReason.GEOMETRY, "the matches do not fix a position")
        guess = Guess(
            wrap_pi(found.guess.yaw_rad + pose.yaw_correction_rad),
            found.guess.agl_m * pose.scale_ratio,
            SimilarityBounds(CLOSER_SCALE, CLOSER_TURN_RAD),
        )
        view = found.view.rectification
        radius_m = 6.0 * view.m_per_px + 0.05 * max(view.size_wh) * view.m_per_px
        nadir = found.lat_lon_of_view(view.nadir_uv)
        return self._look(job, guess, nadir, radius_m, tests)

    def _straightened(self, job: Job, found: Found) -> Found:
        """The same place seen again, where the first guess was far off in heading or height."""
        pose = self._pose(job, found)
        if pose is None:
            return found
        turned = abs(pose.yaw_correction_rad) > MAX_TURN_RAD
        if not turned and 1.0 / MAX_RESCALE <= pose.scale_ratio <= MAX_RESCALE:
            return found
        closer = self._closer(job, found, tests=1)
        return closer if isinstance(closer, Found) else found

    def _pose(self, job: Job, found: Found) -> MapPose | None:
        """Pose of the point that is reported: below the camera, or the picture's centre."""
        placement, view = found.placement, found.view
        known = _attitude_known(job.prior)
        point_uv = view.rectification.nadir_uv if known else view.center_uv
        lat_deg, _ = found.lat_lon_of_view(point_uv)
        error = transform_points(placement.H_map_view, placement.uv_view) - placement.uv_map
        scatter_px = max(MIN_SIGMA_PX, math.sqrt(float(np.mean(error**2))))
        # Neighbours err alike: only as many are independent as there are cells with an inlier.
        repeats = len(placement.uv_view) / placement.witnesses
        errors = PoseErrors(
            sigma_px=scatter_px * math.sqrt(repeats),
            sigma_tilt_rad=self._config.sigma_tilt_rad if known else 0.0,
            sigma_lean_rad=self._config.sigma_tilt_rad if known else SIGMA_LEVEL_RAD,
            sigma_georeference_m=math.hypot(
                self._looker.pack.georeference_sigma_m,
                SYSTEMATIC_PX * view.rectification.m_per_px,
            ),
        )
        return pose_from_rectified(
            placement.H_map_view,
            replace(view.rectification, nadir_uv=point_uv),
            placement.uv_view,
            placement.uv_map,
            mercator_px_per_m(lat_deg, found.zoom),
            errors,
        )

    def _fix(self, frame: Frame, job: Job, found: Found) -> MapFix | Rejected:
        prior, pose = job.prior, self._pose(job, found)
        if pose is None:
            refusal = Misplaced(RejectReason.GEOMETRY, "the matches do not fix a position")
            return self._rejected(frame, job.watch, refusal)
        lat_deg, lon_deg = found.lat_lon(pose.nadir_px)
        fix = MapFix(
            t_s=frame.t_s,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            covariance_ne_m2=pose.covariance_ne_m2,
            yaw_rad=wrap_pi(found.guess.yaw_rad + pose.yaw_correction_rad),
            sigma_yaw_rad=math.hypot(pose.sigma_yaw_rad, SYSTEMATIC_YAW_RAD),
            agl_m=pose.agl_m,
            sigma_agl_m=math.hypot(pose.sigma_agl_m, SYSTEMATIC_SCALE * pose.agl_m),
            point="nadir" if _attitude_known(prior) else "center",
            features=self._features,
            stats=_stats(
                job.watch,
                len(found.view.features),
                found.placement.matches,
                len(found.placement.uv_view),
            ),
        )
        return self._plausible(fix, frame, job)

    def _plausible(self, fix: MapFix, frame: Frame, job: Job) -> MapFix | Rejected:
        doubt = self._implausible(fix, job.prior)
        return fix if doubt is None else self._rejected(frame, job.watch, doubt)

    def _implausible(self, fix: MapFix, prior: Prior) -> Misplaced | None:
        counts = (fix.stats.matches, fix.stats.inliers)
        if fix.sigma_m > self._config.max_sigma_m:
            detail = f"the matches fix the position to {fix.sigma_m:.0f} m only"
            return Misplaced(RejectReason.GEOMETRY, detail, *counts)
        if prior.lat_deg is None or prior.lon_deg is None:
            return None
        off_m = horizontal_distance_m(prior.lat_deg, prior.lon_deg, fix.lat_deg, fix.lon_deg)
        allowed_m = MAX_PRIOR_SIGMAS * math.hypot(prior.sigma_m, fix.sigma_m)
        if fix.point == "center" and fix.agl_m is not None:
            allowed_m += UNKNOWN_TILT * fix.agl_m
        if off_m <= allowed_m:
            return None
        detail = f"{off_m:.0f} m from the prior of {prior.sigma_m:.0f} m sigma"
        return Misplaced(RejectReason.PRIOR, detail, *counts)

    def _rejected(self, frame: Frame, watch: Stopwatch, why: Misplaced) -> Rejected:
        stats = _stats(watch, why.keypoints, why.matches, why.inliers)
        return Rejected(frame.t_s, why.reason, why.detail, self._features, stats)


def _attitude_known(prior: Prior) -> bool:
    return prior.roll_rad is not None and prior.pitch_rad is not None


def _stats(watch: Stopwatch, keypoints: int, matches: int, inliers: int) -> MatchStats:
    times = {f"{name}_ms": ms for name, ms in watch.ms.items()}
    return MatchStats(keypoints=keypoints, matches=matches, inliers=inliers, **times)
