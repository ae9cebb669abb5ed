"""Placing a view by correlation alone, where its keypoints do not.

From 25 m a map of 0.3 m/px shows a view of 140 x 107 pixels. A season later some four of its fifty
matches are right, which may be chance; its edges together still lie as they do on the map.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from vwnav.geometry.mercator import lat_lon_from_mercator_px, mercator_px
from vwnav.geometry.rectify import Rectification
from vwnav.geometry.rotations import wrap_pi
from vwnav.maps.pack import Level
from vwnav.types import FeatureName, MapFix, MatchStats
from vwnav.vision.correlation import RING_PX, Peak, best_shift, decades_of_shift
from vwnav.vision.guesses import Guess
from vwnav.vision.look import Job, Looker
from vwnav.vision.placing import MAX_RIVALRY

YAW_STEP_RAD = math.radians(2.0)  # a view of 140 px turned by half of it is 1 px off at its ends
MAX_YAW_STEPS = 3  # to either side
YAW_SIGMAS = 2.0
MAX_REACH_PX = 64  # a place that is known worse is not looked for by correlation alone
SIGMA_PX = 1.5  # of a place, per axis


@dataclass(frozen=True, slots=True, eq=False)
class Shifted:
    """A view that lies where it correlates best with the map.

    Attributes:
        guess, view: that it was made with; heading and height are not measured.
        nadir_lat_lon: degrees.
    """

    guess: Guess
    view: Rectification
    nadir_lat_lon: tuple[float, float]

    def fix(
        self,
        t_s: float,
        features: FeatureName,
        stats: MatchStats,
        sigma_tilt_rad: float,
        sigma_georeference_m: float,
    ) -> MapFix:
        """A position alone: what heading and height the view was made with is no measurement."""
        tilt_m = self.guess.agl_m * sigma_tilt_rad
        sigma_m = math.hypot(SIGMA_PX * self.view.m_per_px, tilt_m, sigma_georeference_m)
        return MapFix(
            t_s=t_s,
            lat_deg=self.nadir_lat_lon[0],
            lon_deg=self.nadir_lat_lon[1],
            covariance_ne_m2=sigma_m**2 * np.eye(2),
            yaw_rad=None,
            sigma_yaw_rad=None,
            agl_m=None,
            sigma_agl_m=None,
            point="nadir",
            features=features,
            stats=stats,
            placed_by="correlation",
        )


def place_by_correlation(
    looker: Looker,
    job: Job,
    guess: Guess,
    level: Level,
    radius_m: float,
    min_decades: float,
) -> Shifted | None:
    """Look for a view within a radius of the prior's place; None where no shift stands out.

    Headings that the prior leaves open are tried. Each is a test more, but none is measured: the
    best one is only good to a step.

    Args:
        looker: makes the view.
        job: the picture, with a prior that holds place and tilt; else None comes back.
        guess: heading and height; no other height is tried.
        level: of the map.
        radius_m: about the prior's place.
        min_decades: unrelated pictures may pass once in ten to this power.
    """
    prior = job.prior
    if prior.roll_rad is None or prior.pitch_rad is None:
        return None
    open_steps = math.floor(YAW_SIGMAS * prior.sigma_yaw_rad / YAW_STEP_RAD + 0.5)
    steps = min(open_steps, MAX_YAW_STEPS)
    yaws_rad = [guess.yaw_rad + i * YAW_STEP_RAD for i in range(-steps, steps + 1)]
    turned = [replace(guess, yaw_rad=wrap_pi(yaw_rad)) for yaw_rad in yaws_rad]
    found = [look for each in turned if (look := _correlate(looker, job, each, level, radius_m))]
    if not found:
        return None
    peak, shifted = max(found, key=lambda look: look[0].sigmas)
    if peak.rival_sigmas > MAX_RIVALRY * peak.sigmas:
        return None
    reach_px = math.ceil(radius_m / shifted.view.m_per_px)
    decades = decades_of_shift(peak.sigmas, reach_px) - math.log10(len(turned))
    return shifted if decades >= min_decades else None


def _correlate(
    looker: Looker, job: Job, guess: Guess, level: Level, radius_m: float
) -> tuple[Peak, Shifted] | None:
    """The best shift with one heading; None where there is too little to compare."""
    prior = job.prior
    if prior.lat_deg is None or prior.lon_deg is None:
        return None
    view = looker.rectify(job, guess, level.zoom, prior.lat_deg)
    if view is None:
        return None
    reach_px = math.ceil(radius_m / view.m_per_px)
    if not RING_PX[0] < reach_px <= MAX_REACH_PX:
        return None
    nadir_px = np.array(mercator_px(prior.lat_deg, prior.lon_deg, level.zoom))
    corner_px = nadir_px - view.nadir_uv - 0.5
    low = np.floor(corner_px).astype(np.int64) - reach_px
    high = low + np.array(view.size_wh) + 2 * reach_px
    with job.watch.stage("rectify"):
        gray = looker.maker.warp(job.picture, view)
        seen = looker.maker.seen(job.picture, view)
    with job.watch.stage("verify"):
        map_, known = looker.pack.image(level.zoom, *low.tolist(), *high.tolist())
        peak = best_shift(gray, seen, map_, known, reach_px)
    if peak is None:
        return None
    # The map was cut at whole pixels: what was cut off counts as shift.
    x, y = nadir_px + peak.shift_uv - (corner_px - np.floor(corner_px))
    return peak, Shifted(guess, view, lat_lon_from_mercator_px(float(x), float(y), level.zoom))
