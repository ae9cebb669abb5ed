"""Where a flight that begins anywhere begins: what a search found, once a second image agrees.

One image of ground that repeats may be found at a wrong place with as much agreement as at the
right one. The next image shows other ground; around what was found it is found again, or nothing
was. A beginning that finds nothing more soon after is doubted, and searched for again. So is a
place of a video that broke off: it may go on anywhere, where its recording was paused or cut.
"""

import math
from dataclasses import replace

import numpy as np

from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.inertial.attitudes import yaw_of
from vwnav.geometry.geodesy import LocalFrame, horizontal_distance_m
from vwnav.geometry.rotations import wrap_pi
from vwnav.types import Array, Estimate, MapFix, Prior

FASTEST_M_S = 30.0
UNKNOWN_AGL_M = 50.0
AIRBORNE_VELOCITY_SIGMA_M_S = 15.0
FASTEST_TURN_RAD_S = math.radians(75.0)
SIGMA_M = 5.0  # of a place that one image alone told
SIGMA_YAW_RAD = 0.1
SIGMA_AGL_RATIO = 0.1
WAY_RATIO = 0.2  # one sigma of a way in an unknown place: its heading is the compass'
UNTOLD_BARO_M = 100.0  # of a barometer that was zeroed nobody knows how high
PRIOR_SIGMAS = 3.0  # that are looked at around a prior
MISSES = 2  # then what was found is dropped
DOUBTED_AFTER = 4  # images in a row without a fix, of a beginning that ...
TRUSTED_AFTER = 12  # ... has not had so many fixes yet


class FirstFix:
    """The search for the beginning, and the doubt in it.

    Attributes:
        doubted: whether a beginning that a search found is searched for again.
        young: whether it has had too few fixes since to be trusted.
    """

    def __init__(self) -> None:
        self._found: MapFix | None = None
        self._then: Estimate | None = None  # at its exposure
        self._misses = 0
        self._fixes = 0  # since a beginning that a search found
        self._trusted = False  # it has had enough of them, once
        self.doubted = False
        self.young = False

    def prior(self, prior: Prior, t_s: float, now: Estimate | None) -> Prior:
        """Around what was found, moved on by the way since; else without a place.

        Where nobody tells the way, it is as far around as an aircraft comes: a search takes long.

        Args:
            prior: of the filter; of one that is doubted the attitude alone counts.
            t_s: of the image.
            now: the filter's estimate at its exposure.
        """
        found = self._found
        if found is None and self.doubted:
            return Prior(roll_rad=prior.roll_rad, pitch_rad=prior.pitch_rad)
        if found is None:
            return replace(prior, lat_deg=None, lon_deg=None)
        since_s = max(t_s - found.t_s, 0.0)
        reach_m = FASTEST_M_S / PRIOR_SIGMAS * since_s
        around = replace(
            prior,
            lat_deg=found.lat_deg,
            lon_deg=found.lon_deg,
            sigma_m=math.hypot(SIGMA_M, found.sigma_m) + reach_m,
            yaw_rad=found.yaw_rad,
            sigma_yaw_rad=SIGMA_YAW_RAD + FASTEST_TURN_RAD_S / PRIOR_SIGMAS * since_s,
            agl_m=found.agl_m,
            sigma_agl_ratio=SIGMA_AGL_RATIO,
        )
        if now is None or self._then is None or self.doubted:
            return around
        return _moved_on(around, found, self._then, now)

    def confirmed(self, fix: MapFix, then: Estimate | None) -> bool:
        """Take what a search found: whether it agrees with what the one before found.

        Args:
            fix: what it found.
            then: the filter's estimate at its exposure.
        """
        before, self._found, self._misses = self._found, fix, 0
        self._then = then
        if before is None or not _agree(before, fix):
            return False
        self._found = None
        return True

    def began(self) -> None:
        """A filter began at what was confirmed: nothing else says where it is."""
        self._fixes, self.doubted, self.young, self._trusted = 0, False, True, False

    def fused(self) -> None:
        """A fix was fused by a filter whose beginning is young."""
        self._misses = 0
        self._fixes += 1
        self.young = self._fixes < TRUSTED_AFTER
        self._trusted = self._trusted or not self.young

    def broke(self) -> None:
        """An image of a video alone could not be followed: what is seen since may be anywhere.

        It is as if it had begun there; as long as none can be followed none is held against it.
        """
        if self._trusted:
            self._fixes, self._misses, self.young = 0, 0, True

    def missed(self) -> None:
        """An image gave no fix."""
        self._misses += 1
        if self._found is not None and self._misses >= MISSES:
            self._found = None
        self.doubted = self.doubted or (self.young and self._misses >= DOUBTED_AFTER)


def _agree(before: MapFix, fix: MapFix) -> bool:
    """Whether an aircraft comes from one to the other in the time between."""
    since_s = abs(fix.t_s - before.t_s)
    apart_m = horizontal_distance_m(before.lat_deg, before.lon_deg, fix.lat_deg, fix.lon_deg)
    sigma_m = math.hypot(SIGMA_M, before.sigma_m, fix.sigma_m)
    if apart_m > FASTEST_M_S * since_s + PRIOR_SIGMAS * sigma_m:
        return False
    if before.yaw_rad is None or fix.yaw_rad is None:
        return True
    turn_rad = abs(wrap_pi(fix.yaw_rad - before.yaw_rad))
    return bool(turn_rad <= FASTEST_TURN_RAD_S * since_s + PRIOR_SIGMAS * SIGMA_YAW_RAD)


def _moved_on(around: Prior, found: MapFix, then: Estimate, now: Estimate) -> Prior:
    """A prior around what was found `then`, by the way that the filter tells since."""
    way_ned_m = now.position_ned_m - then.position_ned_m
    frame = LocalFrame(found.lat_deg, found.lon_deg, 0.0)
    lat_deg, lon_deg, _ = frame.to_geodetic(np.array([*way_ned_m[:2], 0.0]))
    variance = max(np.max(np.diag(each.covariance)[3:5]) for each in (then, now))
    unsure_m = math.sqrt(variance) * (now.t_s - then.t_s)
    unsure_m += WAY_RATIO * float(np.hypot(*way_ned_m[:2]))
    turn_rad = yaw_of(now.quat_wxyz) - yaw_of(then.quat_wxyz)
    return replace(
        around,
        lat_deg=float(lat_deg),
        lon_deg=float(lon_deg),
        sigma_m=min(around.sigma_m, math.hypot(SIGMA_M, found.sigma_m) + unsure_m),
        yaw_rad=None if found.yaw_rad is None else wrap_pi(found.yaw_rad + turn_rad),
        sigma_yaw_rad=SIGMA_YAW_RAD,
        agl_m=None if found.agl_m is None else found.agl_m - float(way_ned_m[2]),
    )


def start_at(fix: MapFix, ned_m: Array) -> Start:
    """The start of a filter at a fix in the air; `ned_m` (3,) is its place in the run's frame."""
    agl_m = fix.agl_m if fix.agl_m is not None else UNKNOWN_AGL_M
    return Start(
        t_s=fix.t_s,
        position_ned_m=np.array([ned_m[0], ned_m[1], -agl_m]),
        sigma_m=max(fix.sigma_m, 1.0),
        agl_m=agl_m,
        sigma_agl_m=fix.sigma_agl_m or 0.3 * agl_m,
        sigma_velocity_m_s=AIRBORNE_VELOCITY_SIGMA_M_S,
        sigma_baro_m=max(UNTOLD_BARO_M, agl_m),
    )
