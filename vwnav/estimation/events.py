"""What may happen to the filter: the measurements, and what it makes of them itself."""

from dataclasses import dataclass

from vwnav.types import Array, Height, OdometryMotion, Range, Stationary


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NedFix:
    """A map fix in the filter's own frame.

    Attributes:
        t_s: exposure of the image.
        position_ne_m: (2,) north and east of the camera. covariance_ne_m2: (2, 2).
        yaw_rad: true heading; None when the fix has none. agl_m: likewise.
        sigma_tilt_rad: the attitude error that `covariance_ne_m2` contains. It moves the fix by
            AGL times tilt, slowly: the filter carries it as a state, so it is taken out.
        sigma_map_m: likewise what all fixes of a place share: the map's own error.
    """

    t_s: float
    position_ne_m: Array
    covariance_ne_m2: Array
    yaw_rad: float | None = None
    sigma_yaw_rad: float | None = None
    agl_m: float | None = None
    sigma_agl_m: float | None = None
    sigma_tilt_rad: float = 0.0
    sigma_map_m: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """Odometry between its keyframe and an image, at that image's exposure."""

    t_s: float
    motion: OdometryMotion


@dataclass(frozen=True, slots=True, eq=False)
class NewKeyframe:
    """Odometry starts a keyframe: the position is cloned.

    The clone is where the keyframe *seems* to have been taken: `covariance_ned_m2` and
    `sigma_yaw_rad` are what the keyframe itself adds to every displacement measured from it.
    """

    t_s: float
    covariance_ned_m2: Array
    sigma_yaw_rad: float


@dataclass(frozen=True, slots=True)
class Exposed:
    """An image was taken that is now being matched to the map: its pose is cloned.

    However long the search takes, its fix meets the clone.
    """

    t_s: float


@dataclass(frozen=True, slots=True)
class Untracked:
    """An image of a video alone could not be followed: how it came there nobody knows."""

    t_s: float


@dataclass(frozen=True, slots=True)
class Recalibrated:
    """From then on images are seen with the focal length, mount or dates that they have shown.

    Attributes:
        turned_rad, sigma_turned_rad: by how much the mount is turned for that, clockwise as seen
            from above.
        forward_rad, right_rad: by how much it is tilted for that, about the body's axes.
        knocked: it has turned just then; else it was so from the start, or nobody knows since when.
        mirrored: they are left to right, or not any more: taken the other way round from then on.
        redated_s: what is added to their dates.
    """

    t_s: float
    turned_rad: float = 0.0
    sigma_turned_rad: float = 0.0
    forward_rad: float = 0.0
    right_rad: float = 0.0
    knocked: bool = False
    mirrored: bool = False
    redated_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class LateFix:
    """The fix of the image whose pose is cloned, older than the history that begins at `t_s`."""

    t_s: float
    fix: NedFix


@dataclass(frozen=True, slots=True)
class Drag:
    """The IMU has felt for a while what the air does to the aircraft."""

    t_s: float


@dataclass(frozen=True, slots=True)
class Misled:
    """The ways that images told since then were not the aircraft's, and no fix had said so."""

    t_s: float
    since_s: float


@dataclass(frozen=True, slots=True)
class CameraReturned:
    """It had shown nothing for a while, or was zoomed: it may be in another mode from now on."""

    t_s: float


@dataclass(frozen=True, slots=True)
class LensDoubted:
    """The ways that images told so far may be those of another lens than was calibrated."""

    t_s: float


@dataclass(frozen=True, slots=True)
class MountDoubted:
    """The camera hangs otherwise than it is taken to: from then on, or from the start."""

    t_s: float


@dataclass(frozen=True, slots=True)
class MapStepped:
    """Another piece of the map begins, which is off otherwise: by so much from the one before."""

    t_s: float
    by_m: float


@dataclass(frozen=True, slots=True)
class RangeDoubted:
    """From then on the rangefinder is not believed, nor is what it told in the history.

    Before that it may have drawn the height by so much.
    """

    t_s: float
    drawn_m: float


Told = (
    NedFix
    | Height
    | Range
    | Stationary
    | Displacement
    | Exposed
    | Untracked
    | Recalibrated
    | CameraReturned
)
Event = (
    Told
    | NewKeyframe
    | LateFix
    | Drag
    | Misled
    | LensDoubted
    | MountDoubted
    | MapStepped
    | RangeDoubted
)  # the others are the filter's own
