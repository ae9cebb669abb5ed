"""What a prior leaves open, as candidates to try, the likeliest first.

A candidate is a heading and a height to rectify the query with, and a window of one level of the
map. With a prior of place, heading and height they are few and fine; else the area is searched
with small views in every heading and height left open.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from vwnav.geometry.camera import Rectification
from vwnav.geometry.geodesy import (
    Window,
    ground_resolution_m_per_px,
    lat_lon_from_mercator_px,
    mercator_px,
)
from vwnav.geometry.rotations import wrap_pi
from vwnav.maps.image import MIN_VIEW_PX, Level, MapReader
from vwnav.types import Prior
from vwnav.vision.consensus import SimilarityBounds
from vwnav.vision.query import Query

YAW_REACH_RAD = math.radians(16.0)  # descriptors are upright and bear so much rotation
SCALE_REACH = 1.18  # and so much difference of scale
YAW_STEPS = 14  # of a full turn, 26 degrees each
SCALE_STEP = 1.33
SIGMAS = 2.5
LOOSE_YAW_RAD = math.radians(9.0)
LOOSE_SCALE = 1.08
MAX_YAW_BOUND_RAD = math.radians(50.0)
MAX_SCALE_BOUND = 1.6
PRIOR_SIGMAS = 3.0  # of the prior's position are looked at
MAX_UPSAMPLING = 1.67  # a view much sharper than the image shows blur the map does not have
COARSE_VIEW_PX = 300.0  # of the longer side of a coarse view
COARSE_KEYPOINTS = 600
THRIFTY_VIEW_AREA_PX = 130_000.0  # of a first look: decides, with the height, which level it is at
WORTH_THRIFT_PX = 32_000.0  # of an image on the map: less is cheap, and has none to lose
WINDOW_PX = 1280  # of a piece of map that is matched at once, and half more where it must be
MAX_RIVALRY = 0.7  # of the best place's occupied cells for another place: neither is believed


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One heading and height to rectify a query with.

    Attributes:
        yaw_rad, agl_m: taken as true.
        bounds: how far from them the truth may be.
    """

    yaw_rad: float
    agl_m: float
    bounds: SimilarityBounds


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """One registration to try.

    Attributes:
        hypothesis: heading and height of the view.
        level: of the map.
        lat_deg, lon_deg: where the camera may be.
        radius_m: how far from there.
        coarse: a registration is to be looked at again at the sharpest level.
        area: the window of a coarse candidate; None where the place and the view make it.
        max_keypoints: of the view.
        tests: how many candidates there are until a registration of this one is weighed.
        thrifty: a first look, at the part of the view that is worth its pixels.
    """

    hypothesis: Hypothesis
    level: Level
    lat_deg: float
    lon_deg: float
    radius_m: float = 0.0
    coarse: bool = False
    area: Window | None = None
    max_keypoints: int
    tests: int = 1
    thrifty: bool = False

    @property
    def m_per_px(self) -> float:
        """Ground resolution of the level there."""
        return ground_resolution_m_per_px(self.lat_deg, self.level.zoom)

    def window(self, view: Rectification) -> Window:
        """The window in which the view must lie."""
        if self.area is not None:
            return self.area
        x, y = mercator_px(self.lat_deg, self.lon_deg, self.level.zoom)
        w, h = view.size_wh
        # A wrong heading or height moves the view's far end about the nadir.
        slack = self.radius_m / view.m_per_px + 0.1 * max(w, h)
        left, top = x - view.nadir_uv[0] - 0.5, y - view.nadir_uv[1] - 0.5
        return Window(
            math.floor(left - slack),
            math.floor(top - slack),
            math.ceil(left + w + slack),
            math.ceil(top + h + slack),
        )


def is_finite(prior: Prior) -> bool:
    """Whether every number of a prior is one, and makes sense."""
    numbers = (
        prior.lat_deg,
        prior.lon_deg,
        prior.sigma_m,
        prior.yaw_rad,
        prior.sigma_yaw_rad,
        prior.agl_m,
        prior.sigma_agl_ratio,
        prior.roll_rad,
        *prior.slope_ne,
        prior.pitch_rad,
    )
    sigmas = (prior.sigma_m, prior.sigma_yaw_rad, prior.sigma_agl_ratio)
    finite = all(map(math.isfinite, filter(None, numbers)))
    return finite and min(sigmas) >= 0.0 and (prior.agl_m is None or prior.agl_m > 0.0)


def hypotheses(prior: Prior, agl_range_m: tuple[float, float]) -> list[Hypothesis]:
    """Headings and heights that cover what the prior leaves open.

    Args:
        prior: one that is not finite gives none.
        agl_range_m: heights to try where it says none.
    """
    if not is_finite(prior):
        return []
    yaws, yaw_bound_rad = _yaws(prior)
    agls, scale_bound = _agls(prior, agl_range_m)
    bounds = SimilarityBounds(scale_bound, yaw_bound_rad)
    found: list[tuple[float, Hypothesis]] = []
    for (yaw_rad, yaw_cost), (agl_m, agl_cost) in itertools.product(yaws, agls):
        found.append((yaw_cost + agl_cost, Hypothesis(yaw_rad, agl_m, bounds)))
    return list(map(itemgetter(1), sorted(found, key=itemgetter(0))))


def _yaws(prior: Prior) -> tuple[list[tuple[float, float]], float]:
    """Headings with their squared distance from the prior in sigmas, and how far each reaches."""
    step_rad = 2.0 * math.pi / YAW_STEPS
    if prior.yaw_rad is None or SIGMAS * prior.sigma_yaw_rad >= math.pi:
        yaws = [(wrap_pi(i * step_rad), 0.0) for i in range(YAW_STEPS)]
        return yaws, step_rad / 2.0 + LOOSE_YAW_RAD
    open_rad = SIGMAS * prior.sigma_yaw_rad
    bound_rad = min(open_rad + LOOSE_YAW_RAD, MAX_YAW_BOUND_RAD)
    count = math.ceil(max(0.0, open_rad - YAW_REACH_RAD) / step_rad)
    if count == 0:
        return [(prior.yaw_rad, 0.0)], bound_rad
    away_rad = [i * step_rad for i in range(-count, count + 1)]
    yaws = [(wrap_pi(prior.yaw_rad + a), (a / prior.sigma_yaw_rad) ** 2) for a in away_rad]
    return yaws, bound_rad


def _agls(
    prior: Prior, agl_range_m: tuple[float, float]
) -> tuple[list[tuple[float, float]], float]:
    """Heights with their cost, as `_yaws`, and by which factor each reaches."""
    if prior.agl_m is None:
        low_m, high_m = agl_range_m
        count = max(1, math.ceil(math.log(high_m / low_m) / math.log(SCALE_STEP)))
        heights = np.geomspace(low_m, high_m, count + 1)
        middle = math.sqrt(low_m * high_m)
        agls = [(float(agl_m), math.log(agl_m / middle) ** 2) for agl_m in heights]
        return agls, math.sqrt(SCALE_STEP) * LOOSE_SCALE
    opened = 1.0 + SIGMAS * prior.sigma_agl_ratio
    bound = min(opened * LOOSE_SCALE, MAX_SCALE_BOUND)
    count = math.ceil(max(0.0, math.log(opened / SCALE_REACH)) / math.log(SCALE_STEP))
    if count == 0:
        return [(prior.agl_m, 0.0)], bound
    sigma = math.log1p(prior.sigma_agl_ratio)
    agls = [
        (prior.agl_m * SCALE_STEP**i, (i * math.log(SCALE_STEP) / sigma) ** 2 if i else 0.0)
        for i in range(-count, count + 1)
    ]
    return agls, bound


def fine_level(pack: MapReader, query: Query, agl_m: float, max_view_area_px: float) -> Level:
    """The sharpest level that the image can fill and that the time allows."""
    width_m, height_m = query.footprint_m(agl_m)
    image_m_per_px = agl_m / query.image.K[0, 0]
    for level in pack.levels:
        fits = width_m * height_m / level.m_per_px**2 <= max_view_area_px
        if fits and level.m_per_px * MAX_UPSAMPLING >= image_m_per_px:
            return level
    return pack.levels[-1]


def thrifty_first(pack: MapReader, query: Query, fine: list[Candidate]) -> list[Candidate]:
    """Before others a look at no more pixels than most images need, where that saves any.

    Args:
        pack: the map.
        query: whose view is looked at.
        fine: the likeliest first; what a thrifty look does not tell is left to them.
    """
    first = fine[0]
    width_m, height_m = query.footprint_m(first.hypothesis.agl_m)
    if width_m * height_m / first.level.m_per_px**2 < WORTH_THRIFT_PX:
        return fine
    level = fine_level(pack, query, first.hypothesis.agl_m, THRIFTY_VIEW_AREA_PX)
    coarser = level if level.m_per_px > first.level.m_per_px else first.level
    looks = [replace(first, level=coarser, thrifty=True)]
    for each in fine:
        looks.append(replace(each, tests=each.tests + 1))
    return looks


def large_enough(pack: MapReader, query: Query, todo: list[Hypothesis]) -> list[Hypothesis]:
    """The likeliest that show enough of the map; all of them where none does.

    A height that shows too little says nothing of greater ones.
    """
    least_m = MIN_VIEW_PX * pack.levels[0].m_per_px
    seen = [each for each in todo if max(query.footprint_m(each.agl_m)) >= least_m]
    return seen or todo


def coarse_candidates(
    pack: MapReader, query: Query, todo: list[Hypothesis], begin: int
) -> list[Candidate]:
    """Every hypothesis at the level where its view is small, on every window of the prior's area.

    Args:
        pack: the map.
        query: with its prior; without a place in it the area is the whole map.
        todo: the likeliest first.
        begin: so many were looked at by a search that was given up: they come last.
    """
    found: list[tuple[Hypothesis, Level, Window]] = []
    for agl_m in dict.fromkeys(each.agl_m for each in todo):
        long_m = max(query.footprint_m(agl_m))
        level = _level_for_size(pack, long_m, COARSE_VIEW_PX)
        if level is None:
            continue
        long_px = math.ceil(long_m / level.m_per_px)
        area = _area(pack, level.zoom, query.prior, long_px)
        # What covers less than half a view cannot be it.
        if max(area.shape) < long_px / 2:
            continue
        # All headings on one window, then the next: its features are fetched once.
        same_height = [each for each in todo if each.agl_m == agl_m]
        found += [
            (each, level, window) for window in _pieces(area, long_px) for each in same_height
        ]
    made = [_coarse(*each, tests=len(found)) for each in found]
    turn = begin % len(made) if made else 0
    return made[turn:] + made[:turn]


def _coarse(hypothesis: Hypothesis, level: Level, window: Window, tests: int) -> Candidate:
    x, y = (window.x0 + window.x1) / 2.0, (window.y0 + window.y1) / 2.0
    lat_deg, lon_deg = lat_lon_from_mercator_px(x, y, level.zoom)
    return Candidate(
        hypothesis=hypothesis,
        level=level,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        coarse=True,
        area=window,
        max_keypoints=COARSE_KEYPOINTS,
        tests=tests,
    )


def _level_for_size(pack: MapReader, long_m: float, size_px: float) -> Level | None:
    """The level at which a length is nearest to a size in pixels; None if none is near."""

    def off(level: Level) -> float:
        return abs(math.log(long_m / level.m_per_px / size_px))

    level = min(pack.levels, key=off)
    return level if off(level) <= math.log(2.0) else None


def _area(pack: MapReader, zoom: int, prior: Prior, view_px: int) -> Window:
    """The map, or the part of it that views about the prior's place may show."""
    whole = pack.window(zoom)
    if prior.lat_deg is None or prior.lon_deg is None:
        return whole
    x, y = mercator_px(prior.lat_deg, prior.lon_deg, zoom)
    radius_m = PRIOR_SIGMAS * prior.sigma_m
    reach = math.ceil(radius_m / ground_resolution_m_per_px(prior.lat_deg, zoom) + 0.7 * view_px)
    near = Window(int(x) - reach, int(y) - reach, int(x) + reach, int(y) + reach)
    return near.clipped(whole)


def _pieces(whole: Window, view_px: int) -> Iterator[Window]:
    """Windows that overlap by a view, so that each view lies in one of them as a whole."""
    for y0, y1 in _spans(whole.y0, whole.y1, view_px):
        for x0, x1 in _spans(whole.x0, whole.x1, view_px):
            yield Window(x0, y0, x1, y1)


def _spans(start: int, end: int, overlap: int) -> list[tuple[int, int]]:
    length = max(WINDOW_PX, 2 * overlap)
    count = max(1, math.ceil((end - start - overlap) / (1.5 * length - overlap)))
    if count == 1:
        return [(start, end)]
    step = (end - start - overlap) / count
    edges = [start + round(i * step) for i in range(count + 1)]
    return [(low, high + overlap) for low, high in itertools.pairwise(edges)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Acceptance:
    """What makes a registration worth keeping, and the errors behind its pose.

    Attributes:
        threshold_px: largest error of an inlier, map pixels.
        max_log10_nfa: expected chance agreements, log10.
        weak_log10_nfa: the same of what may be kept to be joined with other images.
        sigma_tilt_rad: of roll and pitch, when they are known.
        sigma_georeference_m: of the map, per axis.
    """

    threshold_px: float
    max_log10_nfa: float
    weak_log10_nfa: float
    sigma_tilt_rad: float
    sigma_georeference_m: float
