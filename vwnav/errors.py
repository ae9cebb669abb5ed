"""Errors a person can act on: each message says what is wrong and what to do about it."""


class VwnavError(Exception):
    """Base of every error that ends a command with one line and exit code 1."""


class ConfigError(VwnavError):
    """A setting, an option or a configuration file is wrong."""


class CalibrationError(VwnavError):
    """A camera calibration cannot be read or does not fit the images."""


class OtherSizeError(CalibrationError):
    """A calibration is for images of (width, height) in pixels, and these have another size."""

    def __init__(self, calibrated_wh: tuple[int, int], given_wh: tuple[int, int]) -> None:
        (width, height), (given_width, given_height) = calibrated_wh, given_wh
        is_of_its_shape = width * given_height == height * given_width
        super().__init__(
            f"the calibration is for pictures of {width} x {height} px but they are {given_width} "
            f"x {given_height} px{'' if is_of_its_shape else ', of another shape'}: another mode "
            "of the camera, which may see more or less; set the camera to the first size, or "
            "calibrate at that size"
        )


class MapError(VwnavError):
    """A map source or a map pack is missing, damaged or does not fit."""


class ModelError(VwnavError):
    """The network file is missing, damaged or not ours."""


class SourceError(VwnavError):
    """Images, video or telemetry cannot be read."""


class RouteError(VwnavError):
    """A route file cannot be read or makes no sense."""


class LinkError(VwnavError):
    """There is no autopilot on the link, or it refused what flight needs."""


class PreflightError(VwnavError):
    """Not safe to fly: ends a command with exit code 3."""


class FlightError(VwnavError):
    """A flight ended otherwise than by its route: which no service starts anew."""
