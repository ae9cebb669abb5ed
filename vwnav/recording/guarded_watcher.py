"""A watcher that can break and cost nothing else."""

import logging
from collections.abc import Callable

from vwnav.seams import StepResult, Watcher
from vwnav.types import Estimate, Frame
from vwnav.vehicle import VehicleState

_log = logging.getLogger(__name__)


class GuardedWatcher:
    """Hands on to a watcher what happens; what that one raises ends nothing, and is said once.

    All that a flight tells goes through one of these: a full disk or a closed terminal raises
    wherever something is said, be it between two commands of the mission.
    """

    def __init__(self, watcher: Watcher) -> None:
        self._watcher = watcher
        self._failed = False

    def event(self, text: str) -> None:
        """Something worth a line."""
        try:
            self._watcher.event(text)
        except Exception:
            _log.exception("could not record: %s", text)

    def saw_frame(self, frame: Frame, step: StepResult) -> None:
        """An image went through the pipeline."""
        self._see(lambda: self._watcher.saw_frame(frame, step))

    def saw_tick(self, t_s: float, estimate: Estimate | None, vehicle: VehicleState) -> None:
        """The mission ticked."""
        self._see(lambda: self._watcher.saw_tick(t_s, estimate, vehicle))

    def _see(self, see: Callable[[], None]) -> None:
        try:
            see()
        except Exception as error:
            if not self._failed:
                self._failed = True
                _log.exception("the record failed")
                self.event(f"recording fails, the flight goes on: {error!r}")
