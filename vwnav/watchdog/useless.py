"""When a navigator's process is to be ended: it lives, and is of no use to the aircraft."""

from dataclasses import dataclass

from vwnav.watchdog.dead_man import Silence


@dataclass(frozen=True, slots=True, kw_only=True)
class UselessConfig:
    """For how long it may be of no use, in flight.

    Attributes:
        silent_s: neither a beat nor an estimate to hand on. It gets the aircraft back no more
            then, and 5 s later the successor tells the place: before ArduCopter gives its own up,
            8 s after the last estimate (measured).
        leaves_within_s: after its word that it ends: it has the camera, and its files are synced
            once a second.
    """

    silent_s: float = 3.0
    leaves_within_s: float = 1.0


class UselessNavigator:
    """Counts for how long it has been of no use, while we listened."""

    def __init__(self, config: UselessConfig) -> None:
        self._config = config
        self._silence = Silence()
        self._ends_s: float | None = None
        self._gone = False

    def listen(self, t_s: float) -> None:
        """Time passes."""
        self._silence.listen(t_s)

    def heard(self) -> None:
        """It has beaten, or told a place that was handed on."""
        self._silence.end()

    def says_it_ends(self, t_s: float) -> None:
        """Nothing comes from it any more."""
        self._ends_s = t_s

    def has_ended(self) -> None:
        """There is nobody to be ended."""
        self._gone = True

    def reason_to_end(self, t_s: float) -> str:
        """Why it is to be ended now, "" when it is not; after the word that it ends, once."""
        if self._gone:
            return ""
        if self._ends_s is not None:
            self._gone = t_s - self._ends_s >= self._config.leaves_within_s
            return "has not come to its end" if self._gone else ""
        if self._silence.waking_s < self._config.silent_s:
            return ""
        self._silence.end()
        return f"has neither beaten nor told a place for {self._config.silent_s:.0f} s"
