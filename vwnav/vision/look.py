"""One look: a picture rectified with a guess, put on one window of one map level."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from vwnav.geometry.camera import Camera
from vwnav.geometry.homography import transform_points
from vwnav.geometry.mercator import (
    ground_resolution_m_per_px,
    lat_lon_from_mercator_px,
    mercator_px,
)
from vwnav.geometry.rectify import Rectification
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.maps.pack import Level, MapFeatures, MapPack
from vwnav.maps.picture import Window
from vwnav.types import Array, FeatureExtractor, Prior, RejectReason
from vwnav.vision.correlation import decades_of_correlation, peak_sigmas
from vwnav.vision.guesses import Guess
from vwnav.vision.placing import (
    Misplaced,
    Placement,
    PlacingRules,
    match_view,
    may_be_chance,
    place,
)
from vwnav.vision.significance import decades_of_matches
from vwnav.vision.view import Undistorted, View, ViewMaker

MIN_VIEW_PX = 112  # of the longer side: a smaller view holds too little to be told apart
MAX_UPSAMPLING = 1.67  # a view much sharper than the picture shows blur the map does not have


class Stopwatch:
    """Milliseconds spent per stage."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self.ms: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of a block to a stage."""
        start = self._clock()
        try:
            yield
        finally:
            self.ms[name] = self.ms.get(name, 0.0) + 1e3 * (self._clock() - start)


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """A picture to be located.

    Attributes:
        picture: undistorted.
        prior: finite.
        seed: of every random choice.
        watch: counts the time.
        views: made so far, by heading and by height in pixels.
    """

    picture: Undistorted
    prior: Prior
    seed: int
    watch: Stopwatch
    views: dict[tuple[float, float], View] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """A believed placement and what it refers to.

    Attributes:
        guess: that the view was rectified with.
        zoom, origin_px: level, and global pixel (corner convention) that map pixels count from.
    """

    placement: Placement
    view: View
    guess: Guess
    zoom: int
    origin_px: Array

    def lat_lon(self, map_uv: Array) -> tuple[float, float]:
        """Of a pixel (2,) of the piece of map, centre convention."""
        x, y = self.origin_px + map_uv + 0.5
        return lat_lon_from_mercator_px(float(x), float(y), self.zoom)

    def lat_lon_of_view(self, view_uv: Array) -> tuple[float, float]:
        """Of a pixel (2,) of the view."""
        return self.lat_lon(transform_points(self.placement.H_map_view, view_uv)[0])


class Looker:
    """Makes views and puts them on the map; knows the camera, the features and the pack."""

    def __init__(self, pack: MapPack, extractor: FeatureExtractor, camera: Camera) -> None:
        self.pack = pack
        self.maker = ViewMaker(camera, extractor)
        self._extractor = extractor

    def footprint_m(self, job: Job, agl_m: float) -> tuple[float, float]:
        """Width and height of the ground that a level camera sees."""
        w, h = job.picture.size_wh
        return w * agl_m / job.picture.K[0, 0], h * agl_m / job.picture.K[1, 1]

    def fine_level(self, job: Job, agl_m: float, max_view_area_px: float) -> Level:
        """The sharpest level that the picture can fill and that the time allows."""
        width_m, height_m = self.footprint_m(job, agl_m)
        picture_m_per_px = width_m / job.picture.size_wh[0]
        for level in self.pack.levels:
            fits = width_m * height_m / level.m_per_px**2 <= max_view_area_px
            if fits and level.m_per_px * MAX_UPSAMPLING >= picture_m_per_px:
                return level
        return self.pack.levels[-1]

    def level_for_size(self, job: Job, agl_m: float, size_px: float) -> Level | None:
        """The level at which the view's longer side is nearest to a size; None if none is near."""
        long_m = max(self.footprint_m(job, agl_m))

        def off(level: Level) -> float:
            return abs(math.log(long_m / level.m_per_px / size_px))

        level = min(self.pack.levels, key=off)
        return level if off(level) <= math.log(2.0) else None

    def rectify(self, job: Job, guess: Guess, zoom: int, lat_deg: float) -> Rectification | None:
        """The view's geometry; None when the camera does not look down."""
        prior = job.prior
        R_ned_body = rotation_from_euler(
            prior.roll_rad or 0.0, prior.pitch_rad or 0.0, guess.yaw_rad
        )
        m_per_px = ground_resolution_m_per_px(lat_deg, zoom)
        return self.maker.rectify(job.picture, R_ned_body, guess.agl_m, m_per_px)

    def window_at(
        self, view: Rectification, zoom: int, lat_deg: float, lon_deg: float, radius_m: float
    ) -> Window:
        """The window in which the view must lie if the camera is within a radius of a place."""
        x, y = mercator_px(lat_deg, lon_deg, zoom)
        w, h = view.size_wh
        # A wrong guess of heading or height moves the view's far end about the nadir.
        slack = radius_m / view.m_per_px + 0.1 * max(w, h)
        left, top = x - view.nadir_uv[0] - 0.5, y - view.nadir_uv[1] - 0.5
        return Window(
            math.floor(left - slack),
            math.floor(top - slack),
            math.ceil(left + w + slack),
            math.ceil(top + h + slack),
        )

    def area_window(
        self,
        zoom: int,
        lat_deg: float | None,
        lon_deg: float | None,
        radius_m: float,
        view_px: int,
    ) -> Window:
        """The map, or the part of it that views within a radius of a place may show."""
        whole = self.pack.window(zoom)
        if lat_deg is None or lon_deg is None:
            return whole
        x, y = mercator_px(lat_deg, lon_deg, zoom)
        reach = math.ceil(radius_m / ground_resolution_m_per_px(lat_deg, zoom) + 0.7 * view_px)
        near = Window(int(x) - reach, int(y) - reach, int(x) + reach, int(y) + reach)
        return near.clipped(whole)

    def view(self, job: Job, guess: Guess, rectification: Rectification, keypoints: int) -> View:
        """The view with its features; kept, since levels of twice the size share it."""
        key = (round(guess.yaw_rad, 6), round(guess.agl_m / rectification.m_per_px, 1))
        if key not in job.views:
            with job.watch.stage("rectify"):
                gray = self.maker.warp(job.picture, rectification)
            with job.watch.stage("extract"):
                job.views[key] = self.maker.extract(job.picture, rectification, gray, keypoints)
        return replace(job.views[key], rectification=rectification)

    def map_features(self, job: Job, zoom: int, window: Window) -> MapFeatures:
        """Features of a window of the map."""
        with job.watch.stage("match"):
            return self.pack.features_in(zoom, *window, self._extractor)

    def confirm(self, job: Job, found: Found, min_decades: float) -> Found | Misplaced:
        """Weigh a placement; where the matches alone do not convince, the pictures must correlate.

        Args:
            job: the picture.
            found: what `look` found.
            min_decades: unrelated pictures may pass once in ten to this power.
        """
        placement = found.placement
        per_decade = self._extractor.log10_per_decade
        decades = decades_of_matches(placement.log10_false_alarms, per_decade)
        if decades < min_decades:
            with job.watch.stage("verify"):
                decades += decades_of_correlation(self._correlation(job, found))
        return found if decades >= min_decades else may_be_chance(placement)

    def _correlation(self, job: Job, found: Found) -> float:
        view, H = found.view, found.placement.H_map_view
        h, w = view.gray.shape
        corners = transform_points(H, np.array([[0, 0], [w, 0], [w, h], [0, h]]) - 0.5)
        low = np.floor(corners.min(axis=0) + found.origin_px).astype(np.int64) - 2
        high = np.ceil(corners.max(axis=0) + found.origin_px).astype(np.int64) + 2
        # Pixels of the piece of map that the matches refer to start at `origin_px`.
        shift = np.eye(3)
        shift[:2, 2] = found.origin_px - low
        gray, data = self.pack.image(found.zoom, *low.tolist(), *high.tolist())
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        on_view = cv2.warpPerspective(gray, shift @ H, (w, h), flags=flags)
        known = cv2.warpPerspective(data.astype(np.uint8), shift @ H, (w, h), flags=flags)
        seen = self.maker.seen(job.picture, view.rectification)
        return peak_sigmas(view.gray, seen, np.asarray(on_view, np.uint8), np.asarray(known) > 0)

    def look(
        self, job: Job, guess: Guess, view: View, map_: MapFeatures, rules: PlacingRules
    ) -> Found | Misplaced:
        """Put a view on a piece of map."""
        with job.watch.stage("match"):
            pairs = match_view(view, map_.features)
        if isinstance(pairs, Misplaced):
            return pairs
        with job.watch.stage("verify"):
            placed = place(view, map_.features, pairs, guess.bounds, rules, job.seed)
        if isinstance(placed, Misplaced):
            return placed
        return Found(placed, view, guess, map_.zoom, map_.origin_px.astype(np.float64))


def too_small(view: Rectification) -> Misplaced | None:
    """A refusal of a view that shows too few pixels of the map."""
    if max(view.size_wh) >= MIN_VIEW_PX:
        return None
    detail = f"the picture covers {max(view.size_wh)} px of a map of {view.m_per_px:.2f} m/px"
    return Misplaced(RejectReason.TOO_LOW, detail)
