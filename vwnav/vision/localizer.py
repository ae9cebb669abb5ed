"""Where an image was taken: registered on the map, candidate by candidate.

    candidates(prior) -> register(candidate) -> refine -> verify -> fix

With a prior there are few candidates, and the first registration that holds is the fix. Without one
the whole pack is searched coarsely; what is found is refined, and must have no rival.
"""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from vwnav.geometry.camera import Camera, cut_to_image
from vwnav.maps.image import MIN_VIEW_PX, MapReader
from vwnav.types import (
    FeatureExtractor,
    Frame,
    MapFix,
    MatchStats,
    Prior,
    Rejected,
    RejectReason,
    WeakFix,
)
from vwnav.vision.by_correlation import Edges, fix_by_correlation
from vwnav.vision.candidates import (
    PRIOR_SIGMAS,
    Acceptance,
    Candidate,
    Hypothesis,
    coarse_candidates,
    fine_level,
    hypotheses,
    is_finite,
    large_enough,
    thrifty_first,
)
from vwnav.vision.config import LocalizerConfig
from vwnav.vision.correlation import decades_of_correlation
from vwnav.vision.lever_arm import LeverArm
from vwnav.vision.query import Query, implausible
from vwnav.vision.registration import (
    MAX_RESCALE,
    Registration,
    ambiguous,
    fits_turned,
    fix_of,
    may_be_chance,
    register,
)
from vwnav.vision.rivals import NO_OTHER, best_apart, best_of, elsewhere_turned, fits_mirrored

CUT_MULTIPLE_PX = 32  # the models work on whole multiples
WORTH_LOG10_NFA = -4.0  # less is never believed alone
WEAK_LOG10_NFA = 2.0  # less is not even held against the image
WEAKEST_DECADES = 1.0  # with that: less says nothing of several images
WORTH_COARSE_LOG10_NFA = -0.5  # chance agreements, all candidates counted, that are worth refining
SURE_DECADES = 10.0  # so little chance that the rest need not be searched
# Of such an image nothing is kept: all of it looks alike, or the best may not have been seen.
SAID_NOTHING_OF = (*NO_OTHER, RejectReason.GIVEN_UP)
SETTLED = (*NO_OTHER, RejectReason.GEOMETRY, RejectReason.PRIOR)  # of a place found
ASIDE = "most of the picture lies over 60 degrees aside: is the mount as told, the lens no fisheye?"
HOPELESS = (RejectReason.NO_MAP, RejectReason.TILTED, RejectReason.TOO_LOW)


class Localizer:
    """Locates the images of one camera on one map with one kind of features.

    Prior and fix are of the body that the camera hangs on, turned, by its lever arm if it has one.
    """

    def __init__(
        self,
        pack: MapReader,
        extractor: FeatureExtractor,
        camera: Camera,
        config: LocalizerConfig | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Prepare for a camera.

        Args:
            pack: an open map.
            extractor: of the features; their set should be in the pack.
            camera: calibration for the images' size.
            config: defaults where not given.
            clock: seconds, for the times in `MatchStats` only.
        """
        self._config = config or LocalizerConfig()
        self._pack, self._camera = pack, camera
        self._extractor, self._clock = extractor, clock
        arm_m = camera.t_body_camera_m
        self._arm = LeverArm(arm_m) if np.any(arm_m) else None
        self._given_up = threading.Event()
        self._reached = 0  # by a search that was given up

    def give_up(self) -> None:
        """Let a search that runs in another thread end soon; the next one goes on from there."""
        self._given_up.set()

    def localize(self, frame: Frame, prior: Prior, seed: int) -> MapFix | Rejected:
        """Find where an image was taken.

        Args:
            frame: an image of the camera's size.
            prior: what is known; any field may be unknown. A prior with a NaN is refused.
            seed: of every random choice; equal input and seed give an equal fix.

        Returns:
            The fix, or why there is none, with what places the image may show all the same.

        Raises:
            CalibrationError: the image is not of the camera's size.
            ModelError: the pack holds features of another model, or the model fails.
        """
        self._given_up.clear()
        of_camera = self._arm.prior_of_camera(prior) if self._arm and is_finite(prior) else prior
        query = Query(self._camera, self._extractor, frame, of_camera, seed, self._clock)
        outcome = self._located(query)
        if isinstance(outcome, MapFix) and self._arm:
            outcome = self._arm.fix_of_body(outcome, prior)
        if isinstance(outcome, Rejected) and outcome.reason not in SAID_NOTHING_OF:
            outcome = replace(outcome, weak=self._weak(query, prior))
        seen = outcome.stats
        timed = MatchStats(seen.keypoints, seen.matches, seen.inliers, **query.ms)
        return replace(outcome, stats=timed)

    def _located(self, query: Query) -> MapFix | Rejected:
        """The way of an image: candidates, registered, refined, verified, one of them the fix."""
        candidates, begun, self._reached = self._candidates(query), self._reached, 0
        if isinstance(candidates, Rejected):
            return candidates
        refusal: Rejected | None = None
        coarse: list[Registration] = []
        first = candidates[int(candidates[0].thrifty)]  # of the whole image
        edges = Edges(self._pack, query, first)
        for made, candidate in enumerate(candidates):
            if self._given_up.is_set():
                self._reached = begun + made
                detail = f"after {made} of {len(candidates)} looks"
                return query.rejected(RejectReason.GIVEN_UP, detail)
            found = self._register(query, candidate)
            if isinstance(found, Registration) and candidate.coarse:
                coarse = best_apart([*coarse, found])
                if self._decades(found) < SURE_DECADES:
                    continue
            if isinstance(found, Registration):
                outcome = self._weighed(query, self._verified(query, edges, found))
                if isinstance(outcome, MapFix) and candidate.coarse and query.heading_open:
                    look = partial(self._register, query)
                    outcome = elsewhere_turned(query, found, candidates, look) or outcome
                if isinstance(outcome, MapFix):
                    return outcome
                if outcome.reason in SETTLED and not candidate.thrifty:
                    if candidate.coarse or outcome.reason is not RejectReason.AMBIGUOUS:
                        return outcome
                    refusal = outcome  # landmarks have their like: edges may single one out
                    break
                found = outcome
            if candidate.thrifty:
                continue
            refusal = refusal or found
            if found.reason in HOPELESS and not candidate.coarse:
                return refusal
        if candidates[0].coarse:
            best = best_of(query, coarse, len(candidates), partial(self._verified, query, edges))
            return self._weighed(query, best)
        accept, decades = self._acceptance(first), self._config.min_decades
        fix = fix_by_correlation(query, edges.best, accept, decades)
        refusal = refusal or query.rejected(RejectReason.NO_MAP, "no place to look at")
        return self._weighed(query, fix or refusal)

    def _weighed(self, query: Query, held: Registration | MapFix | Rejected) -> MapFix | Rejected:
        """The fix of what was verified, where the prior and its own sigma let it be."""
        if isinstance(held, Rejected):
            return held
        fix = fix_of(query, held) if isinstance(held, Registration) else held
        return implausible(query, fix, self._config.max_sigma_m, self._config.sigma_tilt_rad) or fix

    def _candidates(self, query: Query) -> list[Candidate] | Rejected:
        """What to try: around a prior at the sharpest level, else everywhere, coarsely."""
        prior, config, pack = query.prior, self._config, self._pack
        todo = hypotheses(prior, config.search_agl_m)
        if not todo:
            return query.rejected(RejectReason.PRIOR, "the prior holds no finite numbers")
        if query.image.contrast < config.min_contrast:
            detail = f"its gray values differ by {query.image.contrast:.1f} only"
            return query.rejected(RejectReason.TOO_DARK, detail)
        lat_deg, lon_deg = prior.lat_deg, prior.lon_deg
        if lat_deg is not None and lon_deg is not None and None not in (prior.yaw_rad, prior.agl_m):
            radius_m = PRIOR_SIGMAS * prior.sigma_m
            fine: list[Candidate] = []
            guesses = large_enough(pack, query, todo) if len(todo) > 1 else todo
            for tests, each in enumerate(guesses[: config.max_guesses], 1):
                fine.append(self._fine(query, each, (lat_deg, lon_deg), radius_m, tests))
            if radius_m <= config.max_track_radius_px * fine[0].level.m_per_px:
                return thrifty_first(pack, query, fine)
        coarse = coarse_candidates(pack, query, todo, self._reached)
        if not coarse:
            return query.rejected(RejectReason.NO_MAP, "the map has no level to search at")
        return coarse

    def _fine(
        self,
        query: Query,
        hypothesis: Hypothesis,
        lat_lon: tuple[float, float],
        radius_m: float,
        tests: int,
    ) -> Candidate:
        """A candidate at the sharpest level that the image can fill."""
        area_px = self._config.max_view_area_px
        return Candidate(
            hypothesis=hypothesis,
            level=fine_level(self._pack, query, hypothesis.agl_m, area_px),
            lat_deg=lat_lon[0],
            lon_deg=lat_lon[1],
            radius_m=radius_m,
            max_keypoints=self._config.max_keypoints,
            tests=tests,
        )

    def _acceptance(self, candidate: Candidate) -> Acceptance:
        coarse = WORTH_COARSE_LOG10_NFA - math.log10(candidate.tests)
        worth, weak = (coarse, coarse) if candidate.coarse else (WORTH_LOG10_NFA, WEAK_LOG10_NFA)
        return Acceptance(
            threshold_px=self._config.threshold_px,
            max_log10_nfa=worth,
            weak_log10_nfa=weak,
            sigma_tilt_rad=self._config.sigma_tilt_rad,
            sigma_georeference_m=self._pack.georeference_sigma_m,
        )

    def _register(self, query: Query, candidate: Candidate) -> Registration | Rejected:
        """Put the query on the map as a candidate has it; first what needs no features made."""
        hypothesis, zoom = candidate.hypothesis, candidate.level.zoom
        made = query.rectify(hypothesis.yaw_rad, hypothesis.agl_m, candidate.m_per_px)
        if made is None:
            return query.rejected(RejectReason.TILTED, ASIDE)
        if candidate.thrifty:
            made = cut_to_image(made, query.image.size_wh, CUT_MULTIPLE_PX)
        window, side_px = candidate.window(made), max(made.size_wh)
        if not candidate.coarse and side_px < MIN_VIEW_PX:
            detail = f"the picture covers {side_px} px of a map of {made.m_per_px:.2f} m/px"
            return query.rejected(RejectReason.TOO_LOW, detail)
        if not candidate.coarse and 0 in window.clipped(self._pack.window(zoom)).shape:
            place = f"{candidate.lat_deg:.5f}, {candidate.lon_deg:.5f}"
            return query.rejected(RejectReason.NO_MAP, f"{self._pack.name} does not cover {place}")
        if query.piece is None or query.piece[:2] != (zoom, window):
            with query.stage("match_ms"):
                query.piece = (zoom, window, self._pack.features_in(zoom, *window, self._extractor))
        map_ = query.piece[2]
        view = query.view(hypothesis.yaw_rad, made, candidate.max_keypoints)
        return register(query, candidate, view, map_, self._acceptance(candidate))

    def _refined(self, query: Query, found: Registration) -> Registration:
        """The same place registered again, with the heading and height that were found.

        A thrifty look stays, a fine one that is weak, sure or hardly turned, and what is not found.
        """
        weak = found.consensus.log10_nfa > WORTH_LOG10_NFA
        settled = weak or self._decades(found) >= SURE_DECADES or not found.is_turned
        if found.candidate.thrifty or (settled and not found.candidate.coarse):
            return found
        view = found.view.rectification
        radius_m = 6.0 * view.m_per_px + 0.05 * max(view.size_wh) * view.m_per_px
        nadir = found.lat_lon_of_view(view.nadir_uv)
        closer = self._fine(query, found.hypothesis, nadir, radius_m, found.candidate.tests)
        again = self._register(query, closer)
        enough = WEAK_LOG10_NFA if found.candidate.coarse else WORTH_LOG10_NFA
        if isinstance(again, Registration) and again.consensus.log10_nfa <= enough:
            return again
        return found

    def _verified(self, query: Query, edges: Edges, found: Registration) -> Registration | Rejected:
        """Refine and weigh a registration; where matches do not convince, images must correlate.

        A coarse one is not believed: what the sharpest level does not show again is not there.
        Nor is a thrifty one that is not sure: the whole image is there to be asked. Nor one that a
        look at the prior's place contradicts. What is too weak alone is kept.
        """
        found = self._refined(query, found)
        consensus, decades = found.consensus, self._decades(found)
        unsure = found.candidate.thrifty and decades < SURE_DECADES
        if found.candidate.coarse or unsure:
            return may_be_chance(query, consensus)
        needed = self._config.min_decades + math.log10(found.candidate.tests)
        if decades < needed:
            with query.stage("verify_ms"):
                decades += decades_of_correlation(found.correlation(self._pack, query)[0])
        chance = decades < needed or consensus.log10_nfa > WORTH_LOG10_NFA
        if chance and decades < WEAKEST_DECADES:
            return may_be_chance(query, consensus)
        agl_m, told_m = found.candidate.hypothesis.agl_m * found.pose.scale_ratio, query.prior.agl_m
        rescaled = abs(math.log(agl_m / (told_m or agl_m))) > math.log(MAX_RESCALE)
        if (rescaled or decades < SURE_DECADES) and self._contradicted(query, edges, found):
            return may_be_chance(query, consensus, "on a place that the edges contradict")
        with query.stage("verify_ms"):
            refusal = ambiguous(self._pack, self._extractor, query, found)
        # A dozen landmarks hardly alike, as of another season, have their like beside by chance.
        if refusal is not None and not query.heading_open and self._singled_out(edges, found):
            refusal = None
        if refusal is None and query.heading_open:
            refusal = fits_turned(query, found, partial(self._register, query))
        if refusal is None and not query.attitude_known:
            refusal = fits_mirrored(query, found, self._register)
        if not chance:
            return refusal or found
        if refusal is None:
            seen_m = max(query.footprint_m(found.hypothesis.agl_m))
            query.weak.append(WeakFix(fix_of(query, found), decades, needed, seen_m))
        return may_be_chance(query, consensus)

    def _contradicted(self, query: Query, edges: Edges, found: Registration) -> bool:
        """Whether matches agree on one place, and edges on another.

        Ground that repeats (slabs, rows of vines) has features that agree on the wrong one of them,
        mostly at another height than the prior's.
        """
        if (seen := edges.best) is None:
            return False
        nadir = found.lat_lon_of_view(found.view.rectification.nadir_uv)
        with query.stage("verify_ms"):
            return seen.contradicts(nadir, found.correlation(self._pack, query)[0])

    def _singled_out(self, edges: Edges, found: Registration) -> bool:
        nadir = found.lat_lon_of_view(found.view.rectification.nadir_uv)
        return edges.single_out(found.hypothesis, nadir, self._config.min_decades)

    def _weak(self, query: Query, prior: Prior) -> tuple[WeakFix, ...]:
        """What was kept that is certain and near enough to be a fix, if more spoke for it."""
        most_m = self._config.max_sigma_m
        return tuple(
            replace(each, fix=self._arm.fix_of_body(each.fix, prior)) if self._arm else each
            for each in query.weak
            if not implausible(query, each.fix, most_m, self._config.sigma_tilt_rad)
        )

    def _decades(self, found: Registration) -> float:
        """How rarely unrelated images agree so well, as a power of ten.

        The test takes matches for independent, which learned features, that see far around them,
        are least: `vwnav bench significance` measures how many of its powers of ten are a true one.
        """
        return max(0.0, -found.consensus.log10_nfa / self._extractor.log10_per_decade)
