"""Finding a picture on a whole map: coarse views in every heading and height left open."""

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from vwnav.geometry.geodesy import horizontal_distance_m
from vwnav.geometry.mercator import lat_lon_from_mercator_px
from vwnav.maps.pack import Level, MapFeatures
from vwnav.maps.picture import Window
from vwnav.types import RejectReason
from vwnav.vision.guesses import Guess
from vwnav.vision.look import Found, Job, Looker
from vwnav.vision.placing import MAX_RIVALRY, Misplaced, PlacingRules

VIEW_PX = 300.0  # of the longer side of a coarse view
KEYPOINTS = 600
WINDOW_PX = 1280  # of a piece of map that is matched at once, and half more where it must be
SECOND_LOOKS = 3
SURE_LOG10 = -20.0  # so little chance that the rest need not be searched
WORTH_LOG10 = -0.5  # chance agreements, all tests counted, that are worth a second look


@dataclass(frozen=True, slots=True)
class Area:
    """Where to search: the whole map, or a circle on it."""

    lat_deg: float | None
    lon_deg: float | None
    radius_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Test:
    """A coarse look that will be made."""

    guess: Guess
    level: Level
    window: Window


def search(
    looker: Looker,
    job: Job,
    tests: list[Test],
    max_stretch: float,
    threshold_px: float,
    second_look: Callable[[Found], Found | Misplaced],
    given_up: Callable[[], bool],
) -> Found | Misplaced:
    """Make all the coarse looks and look again at the best of what they find.

    Args:
        looker: makes the looks.
        job: the picture.
        tests: the looks to make, the likeliest first.
        max_stretch: as in `PlacingRules`.
        threshold_px: as in `PlacingRules`.
        second_look: a closer look at what a coarse one found.
        given_up: asked before each look whether to leave it.
    """
    worth = WORTH_LOG10 - math.log10(max(1, len(tests)))
    rules = PlacingRules(
        threshold_px=threshold_px, max_log10_false_alarms=worth, max_stretch=max_stretch
    )
    hits: list[Found] = []
    on_table: tuple[Level, Window] | None = None
    for made, test in enumerate(tests):
        if given_up():
            return Misplaced(RejectReason.GIVEN_UP, f"after {made} of {len(tests)} looks")
        if on_table != (test.level, test.window):
            on_table = (test.level, test.window)
            map_ = looker.map_features(job, test.level.zoom, test.window)
        seen = _coarse_look(looker, job, test, map_, rules)
        if isinstance(seen, Misplaced):
            continue
        hits.append(seen)
        if seen.placement.log10_false_alarms < SURE_LOG10:
            closer = second_look(seen)
            if isinstance(closer, Found):
                return closer
    return _best_confirmed(hits, second_look, len(tests))


def _coarse_look(
    looker: Looker, job: Job, test: Test, map_: MapFeatures, rules: PlacingRules
) -> Found | Misplaced:
    x = (test.window.x0 + test.window.x1) / 2.0
    y = (test.window.y0 + test.window.y1) / 2.0
    lat_deg, _ = lat_lon_from_mercator_px(x, y, test.level.zoom)
    rectification = looker.rectify(job, test.guess, test.level.zoom, lat_deg)
    if rectification is None:
        return Misplaced(RejectReason.TILTED, "the camera does not look down")
    view = looker.view(job, test.guess, rectification, KEYPOINTS)
    return looker.look(job, test.guess, view, map_, rules)


def _best_confirmed(
    hits: list[Found], second_look: Callable[[Found], Found | Misplaced], tests: int
) -> Found | Misplaced:
    refusal = Misplaced(RejectReason.FEW_INLIERS, f"nothing like it on the map ({tests} looks)")
    confirmed: list[Found] = []
    tried: list[Found] = []
    for hit in sorted(hits, key=lambda hit: hit.placement.log10_false_alarms):
        if any(_same_place(hit, other) for other in tried):
            continue
        tried.append(hit)
        closer = second_look(hit)
        if isinstance(closer, Found):
            confirmed.append(closer)
        elif len(tried) == 1:
            refusal = closer
        if len(tried) == SECOND_LOOKS:
            break
    confirmed.sort(key=lambda found: found.placement.log10_false_alarms)
    if not confirmed:
        return refusal
    best = confirmed[0]
    for rival in confirmed[1:]:
        strong = rival.placement.witnesses >= MAX_RIVALRY * best.placement.witnesses
        if strong and not _same_place(best, rival):
            return Misplaced(RejectReason.AMBIGUOUS, "two places on the map fit as well")
    return best


def _same_place(a: Found, b: Found) -> bool:
    """Whether two looks put the picture's centre within a tenth of a view of each other."""
    place_a, place_b = (found.lat_lon_of_view(found.view.center_uv) for found in (a, b))
    apart_m = horizontal_distance_m(*place_a, *place_b)
    view = a.view.rectification
    return bool(apart_m <= 0.1 * max(view.size_wh) * view.m_per_px)


def coarse_tests(looker: Looker, job: Job, todo: list[Guess], area: Area) -> list[Test]:
    """Every guess at the level where its view is small, on every window of the area."""
    tests: list[Test] = []
    for agl_m in dict.fromkeys(guess.agl_m for guess in todo):
        level = looker.level_for_size(job, agl_m, VIEW_PX)
        if level is None:
            continue
        long_px = math.ceil(max(looker.footprint_m(job, agl_m)) / level.m_per_px)
        whole = looker.area_window(level.zoom, area.lat_deg, area.lon_deg, area.radius_m, long_px)
        # What covers less than half a view cannot be it.
        if max(whole.shape) < long_px / 2:
            continue
        # All headings on one window, then the next: its features are fetched once.
        same_height = [guess for guess in todo if guess.agl_m == agl_m]
        tests += [
            Test(guess, level, window)
            for window in _pieces(whole, long_px)
            for guess in same_height
        ]
    return tests


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
