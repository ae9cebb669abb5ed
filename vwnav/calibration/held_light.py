"""A live camera's exposure, held as a flight holds it, and what comes of that in words."""

import math

from vwnav.cameras.light.keeper import OWN, HoldsExposure, LightKeeper
from vwnav.geometry.camera import Camera
from vwnav.geometry.exposure import MOST_BLUR_PX, blur_px_s
from vwnav.seams import FrameSource

SPEED_M_S, HEIGHT_M = 8.0, 50.0


class HeldLight:
    """Holds what is live; without a calibration nobody knows what blurs, and nothing limits it."""

    def __init__(
        self, source: FrameSource, calibration: Camera | None, height_m: float = HEIGHT_M
    ) -> None:
        self._motion = f"at {SPEED_M_S:g} m/s and {height_m:g} m"
        self._px_s = 0.0
        if calibration is not None:
            self._px_s = blur_px_s(float(calibration.K[0, 0]), SPEED_M_S, height_m)
        most_s = MOST_BLUR_PX / self._px_s if self._px_s else math.inf
        self._keeper: LightKeeper | None = None
        if isinstance(source, HoldsExposure):
            self._keeper = source.hold_exposure(lambda: most_s, lambda _: None)

    def in_words(self) -> str:
        """What the newest image was exposed with, and its blur; empty of what is not live."""
        if self._keeper is None:
            return ""
        if self._keeper.trouble:
            return OWN.format(self._keeper.trouble)
        if (light := self._keeper.light) is None:
            return "not known yet"
        told = f"{1e3 * light.exposure_s:.1f} ms, gain {light.gain:.1f}"
        if not self._px_s:
            return f"{told}; --camera tells its blur"
        return f"{told}: {self._px_s * light.exposure_s:.1f} px of blur {self._motion}"
