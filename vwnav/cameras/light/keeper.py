"""Holds a live camera's exposure, in a thread of its own: a command may hang, images come on."""

import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from vwnav.cameras.light.control import Light, LightControl, LightRange
from vwnav.errors import SourceError

_log = logging.getLogger(__name__)
_EVERY_S = 0.1  # an image is looked at
_SAMPLED_EVERY_PX = 8
_GIVES_UP_AFTER = 5  # commands in a row that failed: a cable that is pulled fails some, too
_STOP_TIMEOUT_S = 1.0
OWN = "the camera keeps its own exposure, fast flight may blur pictures: {}"


class LightControls(Protocol):
    """One opened camera's exposure and gain. Any call may raise what its driver raises."""

    span: LightRange

    def now(self) -> Light:
        """What the newest image was exposed with."""
        ...

    def set(self, light: Light) -> None:
        """Expose the images to come with this; the camera's own automatic is off from then on."""
        ...

    def release(self) -> None:
        """Leave it as it was found."""
        ...


@runtime_checkable
class Lit(Protocol):
    """A grabber of a camera whose exposure can be set."""

    def light_controls(self) -> LightControls:
        """Those of the camera.

        Raises:
            SourceError: it has none.
        """
        ...


@runtime_checkable
class HoldsExposure(Protocol):
    """A source of live images."""

    def hold_exposure(
        self, most_s: Callable[[], float], say: Callable[[str], None]
    ) -> "LightKeeper | None":
        """Begin to, see `LightKeeper`; None where nothing is live."""
        ...


class LightKeeper:
    """Exposes a camera's images as long as their motion allows, and amplifies what lacks.

    A camera that cannot be told, or refuses it, is left to itself, and that is said once.

    Attributes:
        light: what the newest image was exposed with; None while that is not known.
        trouble: why the camera is left to itself; empty while it is not.
    """

    def __init__(self, most_s: Callable[[], float], say: Callable[[str], None]) -> None:
        """Take over.

        Args:
            most_s: the longest exposure that does not blur, now.
            say: takes a line that is worth one.
        """
        self._most_s, self._say = most_s, say
        self._newest: tuple[object, NDArray[np.uint8]] | None = None
        self._grabber: object = None
        self._controls: LightControls | None = None
        self._control: LightControl | None = None
        self._failures, self._said = 0, False
        self.light: Light | None = None
        self.trouble = ""
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="light", daemon=True)
        self._thread.start()

    def saw(self, grabber: object, image: NDArray[np.uint8]) -> None:
        """An image came; called from the grabbing thread, and never waits."""
        self._newest = grabber, image

    def close(self) -> None:
        """Leave the camera as it was found."""
        self._closed.set()
        self._thread.join(_STOP_TIMEOUT_S)

    def _run(self) -> None:
        while not self._closed.wait(_EVERY_S):
            newest, self._newest = self._newest, None
            if newest is not None:
                self._look(*newest)
        self._release()

    def _look(self, grabber: object, image: NDArray[np.uint8]) -> None:
        try:
            if grabber is not self._grabber:
                self._meet(grabber)
            self._hold(float(image[::_SAMPLED_EVERY_PX, ::_SAMPLED_EVERY_PX].mean()))
            self._failures = 0
        except SourceError as error:
            self._give_up(grabber, str(error))
        except Exception as error:  # whatever a driver raises
            _log.debug("the camera's exposure could not be set: %s", error)
            self._failures += 1
            if self._controls is not None:  # what was told may not have arrived: it is told anew
                self._control = LightControl(self._controls.span)
            if self._failures >= _GIVES_UP_AFTER:
                self._give_up(grabber, f"it refuses another ({error})")

    def _meet(self, grabber: object) -> None:
        """A camera that was opened, for the first time or anew."""
        self._release()
        if not isinstance(grabber, Lit):
            raise SourceError("it has no control for that")
        self._controls = grabber.light_controls()
        self._control = LightControl(self._controls.span)
        self._grabber, self.trouble = grabber, ""

    def _hold(self, level: float) -> None:
        if self._controls is None or self._control is None:
            return
        self.light = self._controls.now()
        then = self._control.next(time.monotonic(), level, self.light, self._most_s())
        if then is not None:
            self._controls.set(then)

    def _give_up(self, grabber: object, why: str) -> None:
        self._release()
        self._grabber, self.trouble, self._failures = grabber, why, 0
        if not self._said:
            self._said = True
            self._say(OWN.format(why))

    def _release(self) -> None:
        controls, self._controls, self.light = self._controls, None, None
        if controls is not None:
            with suppress(Exception):
                controls.release()
