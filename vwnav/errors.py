"""Errors a person can act on: each message says what is wrong and what to do about it."""


class VwnavError(Exception):
    """Base of every error that ends a command with one line and exit code 1."""


class ConfigError(VwnavError):
    """A setting, an option or a configuration file is wrong."""


class CalibrationError(VwnavError):
    """A camera calibration cannot be read or does not fit the images."""


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
    """A flight ended otherwise than by its route: exit code 4, which no service starts anew."""
