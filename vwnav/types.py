"""The values that travel between rooms, and the protocols at the seams.

SI and radians unless a name says otherwise; `docs/conventions.md` holds the table. Times `t_s` are
seconds on one monotonic clock, at exposure for images. NaN never means "unknown": that is None.
"""

from dataclasses import dataclass, field
from enum import Enum
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

FeatureName = Literal["learned", "sift", "orb"]
FEATURE_NAMES: tuple[FeatureName, ...] = ("learned", "sift", "orb")
PlacedBy = Literal["keypoints", "correlation", "sequence"]
PointKind = Literal["nadir", "center"]
Array = NDArray[np.float64]
Gray = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image of the camera.

    Attributes:
        t_s: time of exposure.
        image: (h, w) gray or (h, w, 3) BGR, uint8.
        index: number of the frame in its source, from 0.
        rates_rad_s, velocity_body_m_s: (3,) about and along the body's axes, for a rolling shutter.
    """

    t_s: float
    image: NDArray[np.uint8]
    index: int
    rates_rad_s: Array | None = None
    velocity_body_m_s: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Keypoints with descriptors, strongest first.

    Attributes:
        uv: (n, 2) float32, pixels, centres at integers.
        descriptors: (n, d) float32 of unit length, or (n, 32) uint8 for binary ones.
        scores: (n,) float32, larger is better.
    """

    uv: NDArray[np.float32]
    descriptors: NDArray[np.float32] | NDArray[np.uint8]
    scores: NDArray[np.float32]

    def __post_init__(self) -> None:
        n = len(self.uv)
        if self.uv.shape != (n, 2) or self.descriptors.ndim != 2:
            raise ValueError(
                f"expected uv (n, 2) and descriptors (n, d), got {self.uv.shape} "
                f"and {self.descriptors.shape}"
            )
        if len(self.descriptors) != n or self.scores.shape != (n,):
            raise ValueError(
                f"expected {n} descriptors and scores, got {self.descriptors.shape} "
                f"and {self.scores.shape}"
            )

    def __len__(self) -> int:
        return len(self.uv)

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> "Features":
        """Those chosen by index (n,) or by mask, in that order."""
        return Features(self.uv[index], self.descriptors[index], self.scores[index])


class FeatureExtractor(Protocol):
    """A detector with its descriptor. Equal `feature_set_id` means descriptors can be compared."""

    @property
    def name(self) -> FeatureName:
        """One of `FEATURE_NAMES`."""
        ...

    @property
    def feature_set_id(self) -> str:
        """Identifies what the descriptors can be compared with."""
        ...

    @property
    def log10_per_decade(self) -> float:
        """By how much its matches overrate themselves: see `vwnav.vision.matching`."""
        ...

    def extract(self, gray: Gray, max_keypoints: int) -> Features:
        """The strongest keypoints of an image (h, w)."""
        ...


class RejectReason(Enum):
    """Why no position came out of an image."""

    NO_MAP = "no map under the prior"
    TOO_DARK = "picture without contrast"
    TOO_LOW = "too close to the ground for the map"
    TILTED = "camera does not look down"
    FEW_KEYPOINTS = "too few keypoints"
    FEW_MATCHES = "too few matches"
    FEW_INLIERS = "too few inliers"
    AMBIGUOUS = "a second place fits as well"
    MIRRORED = "left and right are exchanged in the picture"
    GEOMETRY = "the homography is not that of level ground"
    PRIOR = "too far from the prior"
    UNCONFIRMED = "no second picture agrees yet"
    NO_FRAME = "no picture"
    NOT_TRIED = "not tried on this frame"
    GIVEN_UP = "the search took too long"
    BROKEN = "the localizer failed"


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known before an image is matched; every field may be unknown.

    Attributes:
        lat_deg, lon_deg: where the body is thought to be; sigma_m: one sigma, per horizontal axis.
        yaw_rad: heading of the body (of the image's upper edge for an image alone).
        agl_m: height of the body above the ground, `sigma_agl_ratio` its relative sigma.
        roll_rad, pitch_rad: attitude of the body; unknown is taken as level.
        slope_ne: rise of the ground per metre. readout_s: what rows were seen to take, one sigma.
    """

    lat_deg: float | None = None
    lon_deg: float | None = None
    sigma_m: float = 50.0
    yaw_rad: float | None = None
    sigma_yaw_rad: float = 0.26
    agl_m: float | None = None
    sigma_agl_ratio: float = 0.15
    roll_rad: float | None = None
    pitch_rad: float | None = None
    slope_ne: tuple[float, float] = (0.0, 0.0)
    readout_s: tuple[float, float] = (0.0, np.inf)


@dataclass(frozen=True, slots=True)
class MatchStats:
    """Counts and times of one attempt, for fixes and rejections alike (milliseconds)."""

    keypoints: int = 0
    matches: int = 0
    inliers: int = 0
    rectify_ms: float = 0.0
    extract_ms: float = 0.0
    match_ms: float = 0.0
    verify_ms: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class MapFix:
    """Where an image was taken.

    Attributes:
        lat_deg, lon_deg: of the body ("nadir"), or of the image centre ("center") when the
            attitude is unknown.
        covariance_ne_m2: (2, 2) of north and east.
        yaw_rad: heading of the body, 0 = true north, clockwise positive.
        agl_m: height above ground from the scale.
        features: the set that made it, or that was tried before.
        placed_by: correlation tells a position alone; a sequence is several images, joined.
    """

    t_s: float
    lat_deg: float
    lon_deg: float
    covariance_ne_m2: Array
    yaw_rad: float | None
    sigma_yaw_rad: float | None
    agl_m: float | None
    sigma_agl_m: float | None
    point: PointKind
    features: FeatureName
    stats: MatchStats = field(default_factory=MatchStats)
    placed_by: PlacedBy = "keypoints"

    @property
    def sigma_m(self) -> float:
        """Root mean of the two variances: one sigma per horizontal axis."""
        return float(np.sqrt(np.trace(self.covariance_ne_m2) / 2.0))


@dataclass(frozen=True, slots=True, eq=False)
class WeakFix:
    """A place for which too little speaks to believe it alone.

    Attributes:
        fix: as it would be, with heading and height.
        decades, needed: chance agrees as well once in ten to this power; so many are believed.
        seen_m: longer side of the ground that the image shows.
    """

    fix: MapFix
    decades: float
    needed: float
    seen_m: float


@dataclass(frozen=True, slots=True)
class Rejected:
    """No fix, and why: a result, not an error. `weak`: places that the image may show."""

    t_s: float
    reason: RejectReason
    detail: str = ""
    features: FeatureName | None = None
    stats: MatchStats = field(default_factory=MatchStats)
    weak: tuple[WeakFix, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class OdometryMotion:
    """Motion of the body over the ground between two exposures.

    Attributes:
        t0_s, t1_s: the two exposures.
        displacement_ned_m: (3,), scaled with the AGL that was handed in.
        covariance_ned_m2: (3, 3), without the error of that AGL.
        yaw_increment_rad: clockwise positive; `sigma_yaw_rad` its sigma.
        agl_m: the AGL that scaled it (displacement is proportional to it).
        tracks: inliers that carried it.
        tilt_share: of a change of the attitude's tilt error between the two, how much was taken
            for motion, 0 to 1: images tell tilting from moving only as well as they can.
        tilts_along: log-likelihood ratio of what the image itself shows of tilting: as much as
            its attitudes tell, against nothing. Negative of a camera that is mounted upside down.
        slope_ne: (2,) by how much the ground below rises per metre north and east, as the attitude
            of the keyframe has it; None where the way is too short to tell.
        slope_covariance: (2, 2).
        relief: one sigma of the heights over that slope of what was seen, trees and houses too, as
            a share of the height; None where the way is too short to tell.
        tilts_turned: (5,) the same as `tilts_along` of a camera that is turned on its mount by 90,
            180 and 270 degrees from how it is told to hang, clockwise as seen from above; of one
            whose images are mirrored left to right, and is turned by 0 and 90 degrees besides.
    """

    t0_s: float
    t1_s: float
    displacement_ned_m: Array
    covariance_ned_m2: Array
    yaw_increment_rad: float
    sigma_yaw_rad: float
    agl_m: float
    tracks: int
    tilt_share: float = 0.0
    tilts_along: float = 0.0
    slope_ne: Array | None = None
    slope_covariance: Array | None = None
    relief: float | None = None
    tilts_turned: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Attitude:
    """Attitude of the body as the autopilot sees it: quat_wxyz (4,) of R_ned_body."""

    t_s: float
    quat_wxyz: Array


@dataclass(frozen=True, slots=True, eq=False)
class ImuSample:
    """One sample of the autopilot's IMU: (3,) each, forward, right, down.

    Attributes:
        specific_force_m_s2: what the accelerometers feel: (0, 0, -9.8) at rest and level.
        rates_rad_s: body rates.
        span_s: since the sample before by the sensor's own clock, which no correction of ours
            makes jump; None where that is not known.
    """

    t_s: float
    specific_force_m_s2: Array
    rates_rad_s: Array
    span_s: float | None = None


@dataclass(frozen=True, slots=True)
class Height:
    """Barometric height above the place where the link came up."""

    t_s: float
    height_m: float


@dataclass(frozen=True, slots=True)
class Range:
    """Distance to the ground along the body's down axis."""

    t_s: float
    distance_m: float


@dataclass(frozen=True, slots=True)
class Stationary:
    """The aircraft stands on the ground."""

    t_s: float


Telemetry = Attitude | ImuSample | Height | Range | Stationary


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What the filter believes at `t_s`, in NED about the run's origin.

    Attributes:
        position_ned_m, velocity_ned_m_s: (3,).
        covariance: (6, 6) of position and velocity.
        quat_wxyz: (4,) of R_ned_body, heading bias removed.
        agl_m: height above the ground below.
        t_last_fix_s: exposure of the last map fix that was fused, None before the first.
        reset_counter: counts re-localisations (jumps), nothing else.
        map_sigma_m: of the map's error from place to place, per axis, as flight has shown it; a
            shift of the whole map is neither in it nor in the covariance.
        camera_turn_rad: by how much the camera is turned on its mount from what it is taken for,
            clockwise seen from above, as far as is known: images show the heading for so much more.
        sigma_seen_yaw_rad: of the heading that images show; None as that of the heading.
        wind_ne_m_s: (2,) where it blows to; None while it is not known.
        slope_ne: rise of the ground below per metre north and east.
    """

    t_s: float
    position_ned_m: Array
    velocity_ned_m_s: Array
    covariance: Array
    quat_wxyz: Array
    sigma_yaw_rad: float
    agl_m: float
    sigma_agl_m: float
    t_last_fix_s: float | None
    reset_counter: int
    map_sigma_m: float = 0.0
    camera_turn_rad: float = 0.0
    sigma_seen_yaw_rad: float | None = None
    wind_ne_m_s: Array | None = None
    slope_ne: tuple[float, float] = (0.0, 0.0)

    @property
    def sigma_horizontal_m(self) -> float:
        """The larger semi-axis of the one-sigma ellipse."""
        (nn, _), (ne, ee) = self.covariance[:2, :2].tolist()
        return float(np.sqrt(0.5 * (nn + ee) + np.hypot(0.5 * (nn - ee), ne)))
