"""What a drone's camera writes into its images: EXIF (place, lens) and XMP (attitude, height).

Sources: Exif 2.32 (CIPA DC-008) for the tags, DJI's `drone-dji` XMP name space. Files are hostile
until read: what is damaged or of another type counts as absent.
"""

import math
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any

from PIL import ExifTags, Image

from vwnav.errors import SourceError
from vwnav.geometry.rotations import euler_from_rotation, rotation_from_euler

MAX_BYTES = 1 << 20  # XMP stands at the start of the file
FULL_FRAME_DIAGONAL_MM = 43.27  # 36 x 24 mm, what "35 mm equivalent" refers to
WIDE_ASPECT = 1.6  # wider images are cut out of the height of a 4:3 or 3:2 sensor

# Tags of IFD0, the Exif IFD and the GPS IFD that matter here.
_IMAGE_WIDTH, _IMAGE_LENGTH, _PIXEL_X, _PIXEL_Y = 0x0100, 0x0101, 0xA002, 0xA003
_FOCAL_LENGTH, _FOCAL_LENGTH_35MM = 0x920A, 0xA405
_FOCAL_PLANE_X, _FOCAL_PLANE_UNIT = 0xA20E, 0xA210
_LAT_REF, _LAT, _LON_REF, _LON, _ALT_REF, _ALT = 1, 2, 3, 4, 5, 6
_DIRECTION = 17
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0}  # inch, centimetre, millimetre

Tags = Mapping[int, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageMetadata:
    """What one image says about itself; None where it is silent.

    Attributes:
        lat_deg, lon_deg, alt_amsl_m: of the camera, by its GPS.
        height_above_home_m: above the place of take-off (this is not the height above ground).
        yaw_rad, roll_rad, pitch_rad: attitude of a body that carries the camera looking down, the
            image's upper edge forward: a gimbal pitch of -90 degrees is level here. `yaw_rad`
            alone may be known, from the image's direction.
        focal_ratio: focal length over image width; the field of view without distortion.
    """

    lat_deg: float | None = None
    lon_deg: float | None = None
    alt_amsl_m: float | None = None
    height_above_home_m: float | None = None
    yaw_rad: float | None = None
    roll_rad: float | None = None
    pitch_rad: float | None = None
    focal_ratio: float | None = None

    @property
    def hfov_deg(self) -> float | None:
        """Horizontal field of view, degrees."""
        if self.focal_ratio is None:
            return None
        return math.degrees(2.0 * math.atan(0.5 / self.focal_ratio))


def read_image_metadata(path: Path, width_px: int, height_px: int) -> ImageMetadata:
    """Read what the camera wrote into an image.

    Args:
        path: JPEG or TIFF; other kinds have no metadata here.
        width_px: of the image as it is now (it may have been reduced since).
        height_px: of it.

    Raises:
        SourceError: the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            head = file.read(MAX_BYTES)
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror}") from error
    tags, gps = _read_exif(path)
    xmp = _read_xmp(head)
    lat_deg, lon_deg = _position(gps, xmp)
    yaw_rad, roll_rad, pitch_rad = _attitude(gps, xmp)
    return ImageMetadata(
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_amsl_m=_altitude(gps),
        height_above_home_m=xmp.get("RelativeAltitude"),
        yaw_rad=yaw_rad,
        roll_rad=roll_rad,
        pitch_rad=pitch_rad,
        focal_ratio=_plausible(_focal_ratio(tags, xmp, width_px / height_px)),
    )


def _read_exif(path: Path) -> tuple[Tags, Tags]:
    """Tags of IFD0 with the Exif IFD, and tags of the GPS IFD."""
    try:
        with (
            warnings.catch_warnings(action="ignore"),
            Image.open(path, formats=("JPEG", "TIFF")) as image,
        ):
            exif = image.getexif()
            return dict(exif) | exif.get_ifd(ExifTags.IFD.Exif), exif.get_ifd(ExifTags.IFD.GPSInfo)
    except Exception:  # of a damaged file: Pillow names no class for all that it may raise
        return {}, {}


def _number(tags: Tags, tag: int) -> float | None:
    value = tags.get(tag)
    first = value[0] if isinstance(value, tuple | bytes) and value else value
    if not isinstance(first, Real) or not math.isfinite(first):
        return None
    return float(first)


_XMP_VALUE = re.compile(
    rb"""drone-dji:(\w{1,40})\s*(?:=\s*["']|>)\s*([+-]?\d{1,9}(?:\.\d{0,12})?)\s*["'<]"""
)


def _read_xmp(head: bytes) -> dict[str, float]:
    """Numbers of DJI's name space, written as attributes or as elements."""
    return {name.decode(): float(text) for name, text in _XMP_VALUE.findall(head)}


def _position(gps: Tags, xmp: Mapping[str, float]) -> tuple[float | None, float | None]:
    lat_deg = _angle_deg(gps.get(_LAT), gps.get(_LAT_REF) == "S")
    lon_deg = _angle_deg(gps.get(_LON), gps.get(_LON_REF) == "W")
    if lat_deg is None or lon_deg is None:
        # DJI writes "GpsLongtitude" in some firmwares.
        lat_deg = xmp.get("GpsLatitude")
        lon_deg = xmp.get("GpsLongitude", xmp.get("GpsLongtitude"))
    if lat_deg is None or lon_deg is None or abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0:
        return None, None
    if lat_deg == 0.0 and lon_deg == 0.0:  # what is written before GPS has a position
        return None, None
    return lat_deg, lon_deg


def _angle_deg(value: Any, negative: bool) -> float | None:
    if not isinstance(value, tuple) or len(value) != 3:
        return None
    angle_deg = float(value[0] + value[1] / 60.0 + value[2] / 3600.0)
    if not math.isfinite(angle_deg):
        return None
    return -angle_deg if negative else angle_deg


def _altitude(gps: Tags) -> float | None:
    altitude_m = _number(gps, _ALT)
    below_sea = _number(gps, _ALT_REF) == 1.0
    return -altitude_m if altitude_m is not None and below_sea else altitude_m


def _attitude(
    gps: Tags, xmp: Mapping[str, float]
) -> tuple[float | None, float | None, float | None]:
    """Yaw, roll and pitch of the body that carries the camera looking down."""
    names = ("GimbalYawDegree", "GimbalPitchDegree", "GimbalRollDegree")
    if not all(name in xmp for name in names):
        direction_deg = _number(gps, _DIRECTION)
        return None if direction_deg is None else math.radians(direction_deg), None, None
    yaw_rad, pitch_rad, roll_rad = (math.radians(xmp[name]) for name in names)
    # A gimbal at zero looks forward; the body of a down-looking camera has that axis down.
    R_gimbal_body = rotation_from_euler(0.0, math.pi / 2.0, 0.0)
    R_ned_body = rotation_from_euler(roll_rad, pitch_rad, yaw_rad) @ R_gimbal_body
    body_roll_rad, body_pitch_rad, body_yaw_rad = euler_from_rotation(R_ned_body)
    return body_yaw_rad, body_roll_rad, body_pitch_rad


def _focal_ratio(tags: Tags, xmp: Mapping[str, float], aspect: float) -> float | None:
    """Focal length over image width, from the best source there is."""
    width_px = _width_px(tags, _PIXEL_X, _PIXEL_Y, aspect) or _width_px(
        tags, _IMAGE_WIDTH, _IMAGE_LENGTH, aspect
    )
    calibrated_px = xmp.get("CalibratedFocalLength")
    if calibrated_px and width_px:
        return calibrated_px / width_px
    focal_mm = _number(tags, _FOCAL_LENGTH)
    per_unit = _number(tags, _FOCAL_PLANE_X)
    unit_mm = _UNIT_MM.get(int(_number(tags, _FOCAL_PLANE_UNIT) or 2.0))
    if focal_mm and per_unit and unit_mm and width_px:
        return focal_mm * per_unit / unit_mm / width_px
    equivalent_mm = _number(tags, _FOCAL_LENGTH_35MM)
    if not equivalent_mm:
        return None
    diagonal_mm = FULL_FRAME_DIAGONAL_MM * (focal_mm or 0.0) / equivalent_mm
    native = _native_aspect(diagonal_mm, aspect)
    return equivalent_mm / FULL_FRAME_DIAGONAL_MM * math.hypot(1.0, 1.0 / native)


def _width_px(tags: Tags, across: int, down: int, aspect: float) -> float | None:
    """The tagged side that lies along the width of the picture as it is now.

    Programs turn pictures upright and leave the sides in their EXIF as they were.
    """
    width_px, height_px = _number(tags, across), _number(tags, down)
    if width_px and height_px and (width_px - height_px) * (aspect - 1.0) < 0.0:
        return height_px
    return width_px


def _plausible(focal_ratio: float | None) -> float | None:
    """None for lenses beyond 130 degrees, or narrower than 3, over the width."""
    if focal_ratio is None or not 0.23 < focal_ratio < 20.0:
        return None
    return focal_ratio


def _native_aspect(diagonal_mm: float, aspect: float) -> float:
    """Aspect of the whole sensor, whose diagonal the equivalent focal length refers to.

    Wide images are cut from it at full width. One-inch sensors (15.9 mm), APS-C and full frame
    are 3:2; the small ones of most drones, and four thirds (21.6 mm), are 4:3.
    """
    if aspect < WIDE_ASPECT:
        return aspect
    is_3_to_2 = 14.0 < diagonal_mm < 18.0 or diagonal_mm > 25.0
    return 3.0 / 2.0 if is_3_to_2 else 4.0 / 3.0
