"""Correlating a view with the map: alone, where keypoints do not place it, and against them.

From 25 m a map of 0.3 m/px shows a view of 140 x 107 pixels. A season later some four of its fifty
matches are right, which may be chance; its edges together still lie as they do on the map. Of slabs
and rows a dozen matches agree on another of them: there the edges contradict.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vwnav.geometry.camera import Rectification
from vwnav.geometry.geodesy import (
    horizontal_distance_m,
    lat_lon_from_mercator_px,
    mercator_px,
)
from vwnav.geometry.homography import transform_points
from vwnav.geometry.rotations import wrap_pi
from vwnav.maps.image import MapReader
from vwnav.types import Array, MapFix
from vwnav.vision.candidates import MAX_RIVALRY, Acceptance, Candidate, Hypothesis
from vwnav.vision.correlation import RING_PX, Peak, best_shift, decades_of_shift
from vwnav.vision.query import Query

YAW_STEP_RAD = math.radians(2.0)  # a view of 140 px turned by half of it is 1 px off at its ends
MAX_YAW_STEPS = 3  # to either side
YAW_SIGMAS = 2.0
MAX_REACH_PX = 64  # a place that is known worse is not looked for by correlation alone ...
MAX_WIDE_REACH_PX = 256  # ... nor held against all that is open
SIGMA_PX = 1.5  # of the middle of what is seen, per axis
CONTRADICTS_DECADES = 1.0  # that a look must have to speak against matches


@dataclass(frozen=True, slots=True, eq=False)
class Correlated:
    """A view that lies where it correlates best with the map.

    Attributes:
        peak: of its shifts.
        view: how it was made.
        nadir_lat_lon: of the camera, degrees.
        decades: how rarely unrelated images correlate so well, as a power of ten.
    """

    peak: Peak
    view: Rectification
    nadir_lat_lon: tuple[float, float]
    decades: float

    def stands_out(self, min_decades: float) -> bool:
        """Whether unrelated images hardly correlate so well, and no other shift nearly does."""
        alone = self.peak.rival_sigmas <= MAX_RIVALRY * self.peak.sigmas
        return alone and self.decades >= min_decades

    def is_at(self, lat_lon: tuple[float, float]) -> bool:
        """Whether it is this place, degrees, that it shows."""
        apart_m = horizontal_distance_m(*lat_lon, *self.nadir_lat_lon)
        return apart_m <= RING_PX[0] * self.view.m_per_px

    def contradicts(self, lat_lon: tuple[float, float], sigmas: float) -> bool:
        """Whether it speaks for another place than one that correlates by so many deviations.

        It is turned and scaled as the prior has it, which what was found need not be: so it may
        correlate somewhat less.
        """
        strong = self.decades >= CONTRADICTS_DECADES and self.peak.sigmas > MAX_RIVALRY * sigmas
        return strong and not self.is_at(lat_lon)


@dataclass(eq=False)
class Edges:
    """What a view's edges say of the places that a candidate leaves open; made when asked for.

    Attributes:
        pack: the map.
        query: with a prior of place and tilt, else they say nothing.
        candidate: place, radius, level, heading and height; a coarse one leaves open too much.
    """

    pack: MapReader
    query: Query
    candidate: Candidate

    @cached_property
    def best(self) -> Correlated | None:
        """The best look at the candidate's height; None where nothing can be compared.

        Headings that the prior leaves open are tried. Each is a test more, but none is measured:
        the best one is only good to a step.
        """
        open_steps = YAW_SIGMAS * self.query.prior.sigma_yaw_rad / YAW_STEP_RAD
        steps = min(math.floor(open_steps + 0.5), MAX_YAW_STEPS)
        assumed = self.candidate.hypothesis
        yaws_rad = [wrap_pi(assumed.yaw_rad + i * YAW_STEP_RAD) for i in range(-steps, steps + 1)]
        turned = [replace(assumed, yaw_rad=each) for each in yaws_rad]
        looks = [self._look(each, MAX_REACH_PX) for each in turned]
        found = [look for look in looks if look is not None]
        if not found:
            return None
        best = max(found, key=lambda look: look.peak.sigmas)
        return replace(best, decades=best.decades - math.log10(len(yaws_rad)))

    def single_out(
        self, hypothesis: Hypothesis, lat_lon: tuple[float, float], min_decades: float
    ) -> bool:
        """Whether they tell a place (degrees) apart, the view turned and scaled as was found."""
        seen = self._look(hypothesis, MAX_WIDE_REACH_PX)
        return seen is not None and seen.stands_out(min_decades) and seen.is_at(lat_lon)

    def _look(self, hypothesis: Hypothesis, most_px: int) -> Correlated | None:
        if self.candidate.coarse or not self.query.attitude_known:
            return None
        candidate = replace(self.candidate, hypothesis=hypothesis)
        return _correlate(self.pack, self.query, candidate, most_px)


def fix_by_correlation(
    query: Query, look: Correlated | None, accept: Acceptance, min_decades: float
) -> MapFix | None:
    """The fix that a look is; None where no shift stands out.

    It is a position alone: what heading and height the view was made with is no measurement.

    Args:
        query: what was looked for.
        look: the best one.
        accept: holds the errors behind a position.
        min_decades: unrelated images may pass once in ten to this power.
    """
    if look is None or not look.stands_out(min_decades):
        return None
    return _fix(query, look, accept)


def _correlate(
    pack: MapReader, query: Query, candidate: Candidate, most_px: int
) -> Correlated | None:
    """The best shift within a candidate's radius; None where there is too little to compare."""
    lat_deg, lon_deg, zoom = candidate.lat_deg, candidate.lon_deg, candidate.level.zoom
    hypothesis = candidate.hypothesis
    view = query.rectify(hypothesis.yaw_rad, hypothesis.agl_m, candidate.m_per_px)
    if view is None:
        return None
    reach_px = math.ceil(candidate.radius_m / view.m_per_px)
    if not RING_PX[0] < reach_px <= most_px:
        return None
    nadir_px = np.array(mercator_px(lat_deg, lon_deg, zoom))
    corner_px = nadir_px - view.nadir_uv - 0.5
    low = np.floor(corner_px).astype(np.int64) - reach_px
    high = low + np.array(view.size_wh) + 2 * reach_px
    with query.stage("rectify_ms"):
        gray, shown = query.warp(view), query.seen(view)
    with query.stage("verify_ms"):
        map_, known = pack.image(zoom, *low.tolist(), *high.tolist())
        peak = best_shift(gray, shown, map_, known, reach_px)
    if peak is None:
        return None
    # The map was cut at whole pixels: what was cut off counts as shift.
    x, y = nadir_px + peak.shift_uv - (corner_px - np.floor(corner_px))
    decades = decades_of_shift(peak.sigmas, reach_px)
    return Correlated(peak, view, lat_lon_from_mercator_px(float(x), float(y), zoom), decades)


def _fix(query: Query, best: Correlated, accept: Acceptance) -> MapFix:
    view = best.view
    tilt_m = view.agl_m * accept.sigma_tilt_rad
    sigma_m = math.hypot(SIGMA_PX * view.m_per_px, tilt_m, accept.sigma_georeference_m)
    return MapFix(
        t_s=query.t_s,
        lat_deg=best.nadir_lat_lon[0],
        lon_deg=best.nadir_lat_lon[1],
        covariance_ne_m2=sigma_m**2 * np.eye(2) + _aside_covariance(query, view),
        yaw_rad=None,
        sigma_yaw_rad=None,
        agl_m=None,
        sigma_agl_m=None,
        point="nadir",
        features=query.features,
        placed_by="correlation",
    )


def _aside_covariance(query: Query, view: Rectification) -> Array:
    """Covariance (2, 2) in m^2 of north and east by the heading and the height that were told.

    A shift places the middle of what is seen. From there to the nadir it is as far as the view was
    made to be: of a wrong height by as much of it less, of a wrong heading to one side.
    """
    w, h = query.image.size_wh
    middle_uv = transform_points(view.H_rect_frame, np.array([w - 1.0, h - 1.0]) / 2.0)[0]
    east_m, south_m = view.m_per_px * (view.nadir_uv - middle_uv)
    along_m = query.prior.sigma_agl_ratio * np.array([-south_m, east_m])
    # The best of the headings that were tried is good to a step.
    sigma_yaw_rad = min(query.prior.sigma_yaw_rad, YAW_STEP_RAD)
    across_m = sigma_yaw_rad * np.array([-east_m, -south_m])
    return np.outer(along_m, along_m) + np.outer(across_m, across_m)
