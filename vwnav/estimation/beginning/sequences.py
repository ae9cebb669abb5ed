"""Places that single images show too weakly, joined through odometry.

A right place is found again where the way leads from it, a wrong one is not. So a handful of
hypotheses are kept: each is a pose on the map, carried along the way, that weak places of later
images agree with. Evidence is a power of ten (see `vwnav.vision.matching`), and powers of
images add up where the images are independent: that is on ground that none of the others has
shown. Another look at the same ground matches the same features of the map, whatever it is.

That a wrong place agrees with where the way leads is rare besides: one of hundreds does on open
ground. Above a road that looks alike all along it may be one of ten, so that counts half a decade,
and no image tells more than a third of what is needed: it takes several.

What is believed must have as much evidence as one image alone must have, and lead every other
hypothesis: ground that repeats is found at several places. An image that shows other places only
speaks against it as much as it would have spoken for it.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vwnav.estimation.beginning.way import WayCounted, WayPose
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import euler_from_rotation, rotation_from_quat, wrap_pi
from vwnav.types import Array, Attitude, MapFix, OdometryMotion, Rejected, WeakFix

MOST = 5  # hypotheses
MOST_POSES = 1000  # images that come while one is searched for
MOST_OF_NEEDED = 1.0 / 3.0  # that one image tells, however much it seems to say
AGREEING_DECADES = 0.5  # what it says besides that an image agrees
LEAD_DECADES = 2.0  # of the best before the next
NEW_GROUND = 0.5  # of an image, that no other one has shown: less is another look at the same
CHI_SQUARE_4 = 18.467  # 99.9 %
MOST_SIGMA_M = 20.0  # carried so far, it says nothing any more
# A few inliers err by more than they spread: shares of what is seen, radians, logarithm of height.
SIGMA_SEEN, SIGMA_YAW_RAD, SIGMA_LOG_AGL = 0.01, math.radians(1.0), 0.02
# What a way errs by of its length, besides what odometry says; heights in what it passes over.
WAY_RATIO, SLOPE = 0.02, 0.03


@dataclass(frozen=True, slots=True)
class ShownGround:
    """A square of ground that an image showed: metres; and what it said of the place."""

    north_m: float
    east_m: float
    side_m: float
    decades: float

    def overlap(self, other: "ShownGround") -> float:
        """Share of the smaller one that both show."""
        apart_m = abs(self.north_m - other.north_m), abs(self.east_m - other.east_m)
        smaller_m, larger_m = sorted((self.side_m, other.side_m))
        shared_m = (min(smaller_m, 0.5 * (smaller_m + larger_m) - off_m) for off_m in apart_m)
        return math.prod(max(0.0, each_m) / smaller_m for each_m in shared_m)


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """One hypothesis: where the camera was at an exposure.

    Attributes:
        pose: (4,) north, east in metres, heading, logarithm of the height above ground in metres.
        covariance: (4, 4) of that.
        at: the exposure on the way.
        ground: that its images have shown.
        needed: decades that are believed.
        against: ground whose images have shown other places only.
    """

    pose: Array
    covariance: Array
    at: WayPose
    ground: tuple[ShownGround, ...]
    needed: float
    against: tuple[ShownGround, ...] = ()

    @property
    def decades(self) -> float:
        """All the evidence."""
        pro, contra = (sum(e.decades for e in shown) for shown in (self.ground, self.against))
        return pro - contra

    def distance2(self, other: "Carried") -> float:
        """Squared distance (Mahalanobis) to another hypothesis of the same exposure."""
        off = _difference(other.pose, self.pose)
        return float(off @ np.linalg.solve(self.covariance + other.covariance, off))

    def to(self, at: WayPose) -> "Carried | None":
        """Carried along the way to a later exposure; None where that leads nowhere."""
        if at.way != self.at.way or at.t_s < self.at.t_s:
            return None
        metres = math.exp(self.pose[3]) / self.at.agl  # a unit of the way
        turn_rad = self.pose[2] - self.at.yaw_rad
        c, s = math.cos(turn_rad), math.sin(turn_rad)
        north_m, east_m = metres * np.array([[c, -s], [s, c]]) @ (at.place - self.at.place)
        turned_rad = wrap_pi(at.yaw_rad - self.at.yaw_rad)
        step = np.array([north_m, east_m, turned_rad, math.log(at.agl / self.at.agl)])
        # The way is turned with the heading and stretched with the height that it began with.
        F = np.eye(4)
        F[:2, 2], F[:2, 3] = (-east_m, north_m), (north_m, east_m)
        length_m = math.hypot(north_m, east_m)
        variance_m2 = metres**2 * (at.variance - self.at.variance) + (WAY_RATIO * length_m) ** 2
        slope = SLOPE * length_m / math.exp(self.pose[3])
        Q = np.diag((variance_m2, variance_m2, at.yaw_variance - self.at.yaw_variance, slope**2))
        covariance = F @ self.covariance @ F.T + Q
        return replace(self, pose=self.pose + step, covariance=covariance, at=at)

    def joined(self, other: "Carried") -> "Carried":
        """With another image's place at the same exposure.

        Both may err alike, by the map and by what they match, and by how much is not known:
        covariance intersection (Julier and Uhlmann 1997), weighted as Niehsen 2002 does, which is
        right whatever they share.
        """
        spreads = [float(np.trace(each.covariance[:2, :2])) for each in (self, other)]
        weight = spreads[1] / sum(spreads)
        own, its = np.linalg.inv(self.covariance), np.linalg.inv(other.covariance)
        covariance = np.linalg.inv(weight * own + (1.0 - weight) * its)
        step = (1.0 - weight) * covariance @ its @ _difference(other.pose, self.pose)
        return replace(
            self,
            pose=self.pose + step,
            covariance=0.5 * (covariance + covariance.T),
            ground=_with_ground(self.ground, other.ground[0]),
            needed=max(self.needed, other.needed),
        )

    def contradicted(self, found: Sequence["Carried"]) -> "Carried":
        """After an image that shows other places."""
        seen = max((each.ground[0] for each in found), key=lambda ground: ground.decades)
        north_m, east_m = self.pose[:2].tolist()
        here = replace(seen, north_m=north_m, east_m=east_m)
        return replace(self, against=_with_ground(self.against, here))


def begun(weak: WeakFix, at: WayPose, frame: LocalFrame) -> Carried | None:
    """The hypothesis of one image's weak place; None where it has no heading or height."""
    fix = weak.fix
    if fix.yaw_rad is None or fix.sigma_yaw_rad is None:
        return None
    if fix.agl_m is None or fix.sigma_agl_m is None:
        return None
    north_m, east_m, _ = frame.to_ned(fix.lat_deg, fix.lon_deg, frame.alt_amsl_m).tolist()
    covariance = np.zeros((4, 4))
    covariance[:2, :2] = fix.covariance_ne_m2 + (SIGMA_SEEN * weak.seen_m) ** 2 * np.eye(2)
    covariance[2, 2] = fix.sigma_yaw_rad**2 + SIGMA_YAW_RAD**2
    covariance[3, 3] = (fix.sigma_agl_m / fix.agl_m) ** 2 + SIGMA_LOG_AGL**2
    pose = np.array([north_m, east_m, fix.yaw_rad, math.log(fix.agl_m)])
    decades = min(weak.decades, MOST_OF_NEEDED * weak.needed)
    ground = ShownGround(north_m, east_m, weak.seen_m, decades)
    return Carried(pose, covariance, at, (ground,), weak.needed)


def advanced(kept: Iterable[Carried], found: Sequence[Carried], at: WayPose) -> list[Carried]:
    """The hypotheses after another image, most evidence first.

    Args:
        kept: before it.
        found: what the image alone shows, at its exposure.
        at: that exposure.
    """
    carried = (each.to(at) for each in kept)
    old = [each for each in carried if each is not None and _is_known(each)]
    joined = [_joined_nearest(each, found) for each in old]
    taken = [each for each in found if all(each.distance2(o) > CHI_SQUARE_4 for o in old)]
    return _apart([*joined, *taken])[:MOST]


def leader(hypotheses: Sequence[Carried]) -> Carried | None:
    """The one that is believed, of those with most evidence first."""
    if not hypotheses or hypotheses[0].decades < hypotheses[0].needed:
        return None
    best, rivals = hypotheses[0], hypotheses[1:]
    if rivals and best.decades - rivals[0].decades < LEAD_DECADES:
        return None
    return best


def _joined_nearest(carried: Carried, found: Sequence[Carried]) -> Carried:
    if not found:
        return carried
    nearest = min(found, key=carried.distance2)
    agrees = carried.distance2(nearest) <= CHI_SQUARE_4
    return carried.joined(nearest) if agrees else carried.contradicted(found)


def _is_known(carried: Carried) -> bool:
    return float(np.trace(carried.covariance[:2, :2])) <= 2.0 * MOST_SIGMA_M**2


def _apart(hypotheses: Iterable[Carried]) -> list[Carried]:
    """The best of each place, most evidence first."""
    kept: list[Carried] = []
    for each in sorted(hypotheses, key=lambda one: -one.decades):
        if all(each.distance2(other) > CHI_SQUARE_4 for other in kept):
            kept.append(each)
    return kept


def _with_ground(known: tuple[ShownGround, ...], seen: ShownGround) -> tuple[ShownGround, ...]:
    """Count what an image shows for the first time; what was seen before is told by the best."""
    overlaps = [each.overlap(seen) for each in known]
    if (new := 1.0 - sum(overlaps)) >= NEW_GROUND:
        return (*known, replace(seen, decades=new * (seen.decades + AGREEING_DECADES)))
    again = int(np.argmax(overlaps))
    elsewhere = sum(overlaps) - overlaps[again]
    decades = max(known[again].decades, max(0.0, 1.0 - elsewhere) * seen.decades)
    return (*known[:again], replace(known[again], decades=decades), *known[again + 1 :])


def _difference(pose: Array, other: Array) -> Array:
    """(4,) the first less the second."""
    off = pose - other
    off[2] = wrap_pi(float(off[2]))
    return off


class Sequences:
    """The hypotheses of a run while nothing that is believed says where it is."""

    def __init__(self, frame: LocalFrame) -> None:
        """Prepare; north and east are counted in `frame`."""
        self._frame = frame
        self._way = WayCounted()
        self._poses: deque[WayPose] = deque(maxlen=MOST_POSES)
        self._kept: list[Carried] = []

    def follow(self, motion: OdometryMotion | Rejected, attitude: Attitude) -> None:
        """Take the next image: how it was reached, and the attitude that odometry had of it."""
        yaw_rad = euler_from_rotation(rotation_from_quat(attitude.quat_wxyz))[2]
        self._poses.append(self._way.follow(motion, yaw_rad))

    def join(self, image: Rejected) -> MapFix | Rejected:
        """Take the weak places of an image; where it was not followed they come to nothing.

        Returns:
            The fix that it is with those before, else the image without them.
        """
        at = next((each for each in self._poses if each.t_s == image.t_s), None)
        fix = None if at is None else self._joined(image, at)
        return replace(image, weak=()) if fix is None else fix

    def _joined(self, image: Rejected, at: WayPose) -> MapFix | None:
        begun_at = ((begun(each, at, self._frame), each.fix) for each in image.weak)
        found = [(hypothesis, fix) for hypothesis, fix in begun_at if hypothesis is not None]
        self._kept = advanced(self._kept, [hypothesis for hypothesis, _ in found], at)
        best = leader(self._kept)
        if best is None or not found:
            return None
        own, fix = min(found, key=lambda each: best.distance2(each[0]))
        return self._fix(best, fix) if best.distance2(own) <= CHI_SQUARE_4 else None

    def _fix(self, best: Carried, last: MapFix) -> MapFix:
        """The place of a hypothesis at the image that was joined last."""
        lat_deg, lon_deg, _ = self._frame.to_geodetic((*best.pose[:2], 0.0))
        agl_m = math.exp(best.pose[3])
        sigmas = np.sqrt(np.diag(best.covariance))
        return replace(
            last,
            lat_deg=float(lat_deg),
            lon_deg=float(lon_deg),
            covariance_ne_m2=best.covariance[:2, :2],
            yaw_rad=wrap_pi(float(best.pose[2])),
            sigma_yaw_rad=float(sigmas[2]),
            agl_m=agl_m,
            sigma_agl_m=float(sigmas[3]) * agl_m,
            placed_by="sequence",
        )
