"""Images with the calibrated time offset: the centre row's time, on the autopilot's clock."""

from collections.abc import Callable
from dataclasses import replace

from vwnav.cameras.light.keeper import HoldsExposure, LightKeeper
from vwnav.cameras.modes import mode_of
from vwnav.geometry.sensor_mode import SensorMode
from vwnav.seams import FrameSource
from vwnav.types import Frame


class RetimedSource:
    """A `FrameSource` whose images are stamped later by `offset_s`."""

    def __init__(self, source: FrameSource, offset_s: float) -> None:
        self._source, self._offset_s = source, offset_s

    def next_frame(self) -> Frame | None:
        """The next image; None at the end."""
        frame = self._source.next_frame()
        return None if frame is None else replace(frame, t_s=frame.t_s + self._offset_s)

    @property
    def sensor_mode(self) -> SensorMode | None:
        """Of the source, where it tells one."""
        return mode_of(self._source)

    def hold_exposure(
        self, most_s: Callable[[], float], say: Callable[[str], None]
    ) -> LightKeeper | None:
        """Of the source, where it is a live one."""
        source = self._source
        return source.hold_exposure(most_s, say) if isinstance(source, HoldsExposure) else None

    def close(self) -> None:
        """Close the source."""
        self._source.close()
