"""Raspberry Pi cameras by picamera2, which comes with the Pi's own operating system.

When a row is read: each sensor's driver has, for each of its modes, the pixel clocks of a line
(`line_length_pix`, for IMX219 `IMX219_PPL_DEFAULT`) and their rate (`pixel_rate`), in
drivers/media/i2c/imx219.c, imx477.c and imx708.c of https://github.com/raspberrypi/linux.
"""

import importlib
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vwnav.cameras import SILENT_S
from vwnav.cameras.light.control import Light, LightRange
from vwnav.errors import SourceError
from vwnav.geometry.sensor_mode import SensorMode

# From a row to the next, by sensor and rows of its mode; of a global shutter there is no such time.
_LINE_S: dict[str, dict[int, float]] = {
    "imx219": dict.fromkeys((2464, 1232, 1080, 480), 3448 / 182.4e6),
    "imx296": {},
    "imx477": {
        3040: 24000 / 840e6,
        **dict.fromkeys((1520, 1080), 12740 / 840e6),
        990: 6664 / 840e6,
    },
    "imx708": {2592: 15648 / 595.2e6, 1296: 7824 / 585.6e6, 864: 5216 / 566.4e6},  # not its HDR
}


class PicameraGrabber:
    """A Raspberry Pi camera by picamera2, which comes with the Pi's own operating system.

    Args:
        width_px, height_px: of the images.
        fps: wanted of them.
        mode: of the sensor that is wanted; libcamera takes the one that is most like it. Left to
            it, it is the one that is most like the images.

    Raises:
        SourceError: picamera2 is not there, or no camera is.
    """

    def __init__(
        self, width_px: int, height_px: int, fps: float, mode: SensorMode | None = None
    ) -> None:
        self._camera = _open_picamera(width_px, height_px, fps, mode)
        self._to_centre_s = 0.5 * _readout_s(self._camera)
        self._period_s, self._metadata = 1.0 / fps, dict[str, Any]()

    def grab(self) -> tuple[float, NDArray[np.uint8]] | None:
        """The next image."""
        request = self._camera.capture_request(wait=SILENT_S)
        try:
            image = request.make_array("main")
            metadata = request.get_metadata()
        finally:
            request.release()
        self._metadata = metadata
        # SensorTimestamp: start of the read-out, ns since boot, when the first row's exposure ends.
        to_centre_s = self._to_centre_s - 0.5 * metadata["ExposureTime"] / 1e6
        return metadata["SensorTimestamp"] / 1e9 + to_centre_s, np.asarray(image, np.uint8)

    @property
    def sensor_mode(self) -> SensorMode:
        """Of the newest image; what is seen of the sensor is known from the first one on."""
        sensor = _sensor(self._camera)
        return SensorMode(
            sensor=self._camera.camera_properties.get("Model"),
            read_px=sensor.get("output_size"),
            bits=sensor.get("bit_depth"),
            seen_px=self._metadata.get("ScalerCrop"),
        )

    def light_controls(self) -> "PicameraLightControls":
        """Its exposure and gain.

        Raises:
            SourceError: libcamera knows of none for this camera.
        """
        return PicameraLightControls(self._camera, self._period_s, lambda: self._metadata)

    def close(self) -> None:
        """Give the camera back, also one whose cable is off: what waits for images is cancelled."""
        with suppress(AttributeError):  # older versions cannot
            self._camera.cancel_all_and_flush()
        self._camera.close()


class PicameraLightControls:
    """Exposure and gain by libcamera; each image's metadata tell what it was exposed with.

    Raises:
        SourceError: libcamera knows of none for this camera.
    """

    def __init__(
        self, camera: Any, period_s: float, metadata: Callable[[], dict[str, Any]]
    ) -> None:
        self._camera, self._metadata = camera, metadata
        known = camera.camera_controls  # name: (least, most, default)
        if not {"AeEnable", "ExposureTime", "AnalogueGain"} <= known.keys():
            raise SourceError("it has no control for that")
        shortest_us, longest_us, _ = known["ExposureTime"]
        least_gain, most_gain, _ = known["AnalogueGain"]
        self.span = LightRange(
            shortest_s=max(shortest_us, 1) * 1e-6,
            longest_s=min(longest_us * 1e-6 or period_s, period_s),
            step_s=1e-6,
            least_gain=max(float(least_gain), 1.0),
            most_gain=max(float(most_gain), 1.0),
        )

    def now(self) -> Light:
        """Of the newest image."""
        metadata = self._metadata()
        return Light(metadata["ExposureTime"] * 1e-6, float(metadata["AnalogueGain"]))

    def set(self, light: Light) -> None:
        """From one of the next images on; it does not wait for it."""
        exposure_us = round(light.exposure_s * 1e6)
        self._camera.set_controls(
            {"AeEnable": False, "ExposureTime": exposure_us, "AnalogueGain": light.gain}
        )

    def release(self) -> None:
        """Its own automatic again."""
        self._camera.set_controls({"AeEnable": True, "ExposureTime": 0, "AnalogueGain": 0.0})


def _readout_s(camera: Any) -> float:
    """From the first row to the last; 0 for a sensor that is not known: calibrate its offset."""
    name = str(camera.camera_properties.get("Model", ""))
    rows = (_sensor(camera).get("output_size") or (0, 0))[1]
    # Camera Module 3 tells its lens and filter behind its sensor: imx708_wide_noir.
    return float(rows * _LINE_S.get(name.partition("_")[0], {}).get(rows, 0.0))


def _sensor(camera: Any) -> dict[str, Any]:
    """How it is read, as libcamera has chosen; empty of versions that do not say."""
    return camera.camera_configuration().get("sensor") or {}


def _open_picamera(width_px: int, height_px: int, fps: float, mode: SensorMode | None) -> Any:
    try:
        # Comes with the Pi's system, not from the package index: unknown to type checkers.
        picamera2 = importlib.import_module("picamera2")
    except ImportError as error:
        raise SourceError(
            "picamera2 is not installed: `sudo apt install python3-picamera2`, and make the "
            "virtual environment with --system-site-packages"
        ) from error
    except Exception as error:  # of what it is built on: numpy of another version, as a rule
        raise SourceError(
            f"picamera2 does not load ({error}): where that is numpy's version, upgrade simplejpeg "
            "in the virtual environment"
        ) from error
    camera = None
    try:
        camera = picamera2.Picamera2()
        # picamera2 names formats back to front: "RGB888" is BGR in memory, as OpenCV has it.
        main = {"size": (width_px, height_px), "format": "RGB888"}
        asked: dict[str, Any] = {"controls": {"FrameRate": fps}}
        if mode is not None and mode.read_px is not None:
            asked["sensor"] = {"output_size": mode.read_px, "bit_depth": mode.bits}
        camera.configure(camera.create_video_configuration(main, **asked))
        camera.start()
    except Exception as error:  # libcamera's have no common base
        if camera is not None:
            with suppress(Exception):
                camera.close()  # else the next one finds it taken
        raise SourceError(f"no Raspberry Pi camera: {error}; `rpicam-hello` shows why") from error
    return camera
