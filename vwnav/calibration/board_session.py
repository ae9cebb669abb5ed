"""Watches the board being shown: views of one camera, in one size and one mode of its sensor."""

import time
from collections.abc import Iterator

from vwnav.calibration.board import BoardFinder
from vwnav.calibration.coverage import Coverage
from vwnav.cameras.live import RealTimeSource
from vwnav.cameras.modes import mode_of
from vwnav.errors import CalibrationError, SourceError
from vwnav.geometry.camera import to_gray
from vwnav.geometry.sensor_mode import SensorMode
from vwnav.screen import LiveLine, say
from vwnav.seams import FrameSource
from vwnav.types import Frame

_AGAIN_S = 1.0  # a camera that has failed is asked again


class BoardSession:
    """What was shown.

    Args:
        images: a live camera is watched until its views are enough, or Ctrl-C; one that is
            unplugged, or comes back in another size or mode, is waited for.

    Attributes:
        coverage: its views.
        size_wh: of the images in pixels.
        mode: of the camera's sensor; None where the source does not say.
        seen: images that were looked at.
        cut_short: whether a person ended the last watch of a live camera, which could go on.
    """

    def __init__(self, images: FrameSource) -> None:
        self._images, self._live = images, isinstance(images, RealTimeSource)
        self._finder, self._said = BoardFinder(), ""
        self.size_wh, self.seen = (0, 0), 0
        self.coverage = Coverage(self.size_wh)
        self.mode: SensorMode | None = None
        self.cut_short = False

    def watch(self) -> None:
        """Until the source ends, the views of a live one are enough, or Ctrl-C; it may go on then.

        Raises:
            VwnavError: of the source before its first image, and of one that is not live later,
                too; its images are of several sizes.
        """
        self.cut_short = False
        with LiveLine() as line:
            try:
                for frame in self._frames():
                    missing = self._look(frame, line)
                    if self._live and not missing:
                        break
            except KeyboardInterrupt:
                self.cut_short = self._live
                say("enough: taking what there is")
        if not self.seen:
            raise SourceError("no picture came")

    def _frames(self) -> Iterator[Frame]:
        """Those that may be compared with the first one."""
        while True:
            try:
                frame = self._images.next_frame()
            except SourceError as error:
                if not (self._live and self.seen):
                    raise
                self._wait(str(error))
                time.sleep(_AGAIN_S)
                continue
            if frame is None:
                return
            self.seen += 1
            if trouble := self._trouble_with(frame):
                if not self._live:
                    raise CalibrationError(f"picture {self.seen} {trouble}")
                self._wait(f"what the camera gives now {trouble}")
                continue
            self._said = ""
            yield frame

    def _trouble_with(self, frame: Frame) -> str:
        size_wh, mode = (frame.image.shape[1], frame.image.shape[0]), mode_of(self._images)
        if self.seen == 1:
            self.size_wh, self.coverage = size_wh, Coverage(size_wh)
        if size_wh != self.size_wh:
            return (
                f"is {size_wh[0]} x {size_wh[1]} px, what came before it {self.size_wh[0]} x "
                f"{self.size_wh[1]}: a calibration is for one size"
            )
        if self.mode is not None and self.mode.trouble_with(mode):
            return f"is of another mode ({mode}), not {self.mode}: a calibration is for one"
        self.mode = self.mode or mode
        return ""

    def _wait(self, why: str) -> None:
        if why != self._said:
            self._said = why
            views = len(self.coverage.views)
            say(f"{why}; {views} views are kept: waiting for it, Ctrl-C takes what there is")

    def _look(self, frame: Frame, line: LiveLine) -> list[str]:
        """What is missing still."""
        view = self._finder.find(to_gray(frame.image))
        if view is not None:
            self.coverage.add(view)
        missing = self.coverage.missing()
        wanted = f"show {missing[0]}" if missing else "enough"
        line.show(
            frame.t_s,
            f"{'board seen' if view is not None else 'no board  '}  "
            f"{len(self.coverage.views)} views  {100.0 * self.coverage.covered:.0f} % of the "
            f"picture  {wanted}",
        )
        return missing
