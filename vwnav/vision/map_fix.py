"""From a registration to a fix, and whether the fix is plausible."""

import math

from vwnav.geometry.geodesy import horizontal_distance_m
from vwnav.types import MapFix, MatchStats, Rejected, RejectReason
from vwnav.vision.query import Query
from vwnav.vision.registration import Registration

MAX_PRIOR_SIGMAS = 4.0
UNKNOWN_TILT = 0.3  # the image's centre may be so far off the nadir, in heights: 17 degrees
SYSTEMATIC_YAW_RAD = math.radians(0.3)
SYSTEMATIC_SCALE = 0.01


def fix_of(query: Query, found: Registration) -> MapFix:
    """The fix that a registration is."""
    pose, consensus = found.pose, found.consensus
    lat_deg, lon_deg = found.lat_lon(pose.nadir_px)
    return MapFix(
        t_s=query.t_s,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        covariance_ne_m2=pose.covariance_ne_m2,
        yaw_rad=found.hypothesis.yaw_rad,
        sigma_yaw_rad=math.hypot(pose.sigma_yaw_rad, SYSTEMATIC_YAW_RAD),
        agl_m=pose.agl_m,
        sigma_agl_m=math.hypot(pose.sigma_agl_m, SYSTEMATIC_SCALE * pose.agl_m),
        point="nadir" if query.attitude_known else "center",
        features=query.features,
        stats=MatchStats(
            keypoints=len(found.view.features),
            matches=consensus.matches,
            inliers=len(consensus.uv_view),
        ),
    )


def implausible(query: Query, fix: MapFix, max_sigma_m: float) -> Rejected | None:
    """A refusal of a fix that is too uncertain, or too far from the prior."""
    prior, sigma_m = query.prior, fix.sigma_m
    matches, inliers = fix.stats.matches, fix.stats.inliers
    if sigma_m > max_sigma_m:
        geometry = RejectReason.GEOMETRY
        detail = f"the matches fix the position to {sigma_m:.0f} m only"
        return query.rejected(geometry, detail, matches=matches, inliers=inliers)
    if prior.lat_deg is None or prior.lon_deg is None:
        return None
    off_m = horizontal_distance_m(prior.lat_deg, prior.lon_deg, fix.lat_deg, fix.lon_deg)
    allowed_m = MAX_PRIOR_SIGMAS * math.hypot(prior.sigma_m, sigma_m)
    if fix.point == "center" and fix.agl_m is not None:
        allowed_m += UNKNOWN_TILT * fix.agl_m
    if off_m <= allowed_m:
        return None
    detail = f"{off_m:.0f} m from the prior of {prior.sigma_m:.0f} m sigma"
    return query.rejected(RejectReason.PRIOR, detail, matches=matches, inliers=inliers)
