"""The recorder of a flight on a disk that does not answer."""

import threading
from pathlib import Path
from tempfile import TemporaryDirectory

from vwnav.recording.recorder import Recorder


class StalledRecorder(Recorder):
    """Takes everything and writes nothing, until it is closed."""

    def __init__(self) -> None:
        self._released = threading.Event()
        self._folder = TemporaryDirectory(prefix="vwnav-stalled-")
        super().__init__(Path(self._folder.name) / "flight.mcap", {})
        self._disk.put(self._stall)

    def close(self) -> None:
        """The disk answers again."""
        self._released.set()
        super().close()
        self._folder.cleanup()

    def _stall(self) -> None:
        self._released.wait()
