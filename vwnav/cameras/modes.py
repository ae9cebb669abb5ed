"""Which mode of its sensor a live camera is in, where its driver says so."""

import logging
from typing import Protocol, runtime_checkable

from vwnav.geometry.camera import Camera
from vwnav.geometry.sensor_mode import SensorMode

_log = logging.getLogger(__name__)


@runtime_checkable
class TellsMode(Protocol):
    """A camera, or a source of its images, that knows."""

    @property
    def sensor_mode(self) -> SensorMode | None:
        """Of the newest image; None where the driver does not say."""
        ...


def mode_of(camera: object) -> SensorMode | None:
    """That of a camera or a source; None of what is not live, or does not tell."""
    try:
        mode = camera.sensor_mode if isinstance(camera, TellsMode) else None
        return mode if mode is not None and mode.told() else None
    except Exception as error:  # whatever a driver says that makes no mode
        _log.debug("the camera's mode is not known: %s", error)
        return None


def trouble_with_mode(source: object, calibration: Camera) -> str:
    """Why a source's images are not those that were calibrated, whatever their size; "" or so."""
    calibrated = calibration.sensor_mode
    return "" if calibrated is None else calibrated.trouble_with(mode_of(source))
