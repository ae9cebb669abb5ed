"""The pipeline's seams: its settings, what a step brings, asks of which parts, and shows."""

import logging
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Annotated, Any, Protocol

from vwnav.settings.ranges import Count, Settings, Within
from vwnav.types import Array, Attitude, Estimate, Frame, MapFix, OdometryMotion, Prior, Rejected
from vwnav.vehicle import VehicleState

_log = logging.getLogger(__name__)
_BEGINS_SLOWLY = 3.0  # times as long a search for the very place is waited for
ATTITUDE_WAIT_S = 0.4  # an image waits so long after its exposure for its attitude to come


@dataclass(frozen=True, slots=True)
class FeatureChoiceConfig(Settings):
    """When SIFT stands in for the learned features."""

    fallback_after: Count = 8  # rejections in a row before the fallback is tried
    # While on the fallback, each n-th attempt tries the primary again
    primary_retry_every: Count = 4


@dataclass(frozen=True, slots=True)
class PipelineConfig(FeatureChoiceConfig):
    """How often the map is asked, and for how long."""

    # An image is matched to the map this often
    fix_interval_s: Annotated[float, Within(0.0, 60.0)] = 0.2
    # The same while the position is unknown: a search is slow
    search_interval_s: Annotated[float, Within(0.0, 60.0)] = 1.0
    # A wider prior is cut to this
    max_prior_sigma_m: Annotated[float, Within(0.0, 1e5, above=True)] = 150.0
    # Attempts in a row without a fix; then, and every so many, look twice as far
    doubt_after: Count = 25
    # A look that takes longer finds nothing, the next one may; where it begins, three times this
    give_up_after_s: Annotated[float, Within(0.0, 3600.0, above=True)] = 20.0
    # After so many the map is asked no more: odometry alone; 0 is no limit
    most_fixes: Annotated[int, Within(0, 1_000_000)] = 0


@dataclass(frozen=True, slots=True, eq=False)
class StepResult:
    """What one image brought. `outcome` may belong to an earlier image (see its `t_s`)."""

    t_s: float
    motion: OdometryMotion | Rejected
    outcome: MapFix | Rejected
    estimate: Estimate | None


class FrameSource(Protocol):
    """Images, in order of time. `next_frame` waits for the next one; None is the end."""

    def next_frame(self) -> Frame | None:
        """The next image; None at the end."""
        ...

    def close(self) -> None:
        """Free the source."""
        ...


class InlineExecutor(Executor):
    """Runs a call at once in the calling thread: replay is deterministic with it."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call `fn` now; its result, or what it raised, waits in the returned future."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Localizing(Protocol):
    """What the pipeline needs of `vwnav.vision.localizer.Localizer`."""

    def localize(self, frame: Frame, prior: Prior, seed: int) -> MapFix | Rejected:
        """Where an image was taken."""
        ...

    def give_up(self) -> None:
        """Let the call that is running in another thread end soon."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """An image being matched; it `begins` where nothing believed `then` says its place.

    It is looked for `widely` where what is believed of it may be wrong by much.
    """

    t_s: float
    localizer: Localizing
    future: Future[MapFix | Rejected]
    begins: bool
    then: Estimate | None
    widely: bool

    def is_overdue(self, t_s: float, most_s: float) -> bool:
        """Whether it has taken longer than `most_s`, or three times that where it `begins`."""
        return t_s - self.t_s > most_s * (_BEGINS_SLOWLY if self.begins else 1.0)


class FeatureChoice:
    """Which localizer comes next: the primary, or the fallback while the primary fails."""

    def __init__(
        self,
        primary: Localizing,
        fallback: Localizing | None,
        config: FeatureChoiceConfig,
        say: Callable[[str], None],
    ) -> None:
        self._primary, self._fallback = primary, fallback
        self._config, self._say = config, say
        self._failures, self._on_fallback, self._fallback_attempts = 0, False, 0
        self._broken: set[str] = set()  # reasons that were said
        self._stood_in = False  # which was said

    def next(self) -> Localizing:
        """The localizer to try now."""
        if not self._on_fallback or self._fallback is None:
            return self._primary
        self._fallback_attempts += 1
        again = self._fallback_attempts % self._config.primary_retry_every == 0
        return self._primary if again else self._fallback

    def broke(self, used: Localizing, error: Exception) -> None:
        """A localizer raised: a model that fails at run time. The fallback stands in at once."""
        reason = f"{type(error).__name__}: {error}"
        stands_in = used is self._primary and self._fallback is not None
        if reason not in self._broken:
            self._broken.add(reason)
            self._say(f"map matching failed ({reason})" + (": SIFT stands in" if stands_in else ""))
        self._stood_in = self._stood_in or stands_in
        if stands_in and not self._on_fallback:
            self._on_fallback, self._fallback_attempts = True, 0

    def report(self, used: Localizing, succeeded: bool) -> None:
        """Learn from an attempt: enough failures switch to the fallback, one success back.

        It is said when the fallback finds what the primary did not: low above the ground, in every
        climb, neither finds anything. What was made for another camera than is flown with tells
        nothing.
        """
        if used is not self._primary:
            if succeeded and used is self._fallback and not self._stood_in:
                self._stood_in = True
                self._say("learned features find nothing here: SIFT stands in")
            return
        self._failures = 0 if succeeded else self._failures + 1
        if succeeded and self._on_fallback:
            self._on_fallback = False
            if self._stood_in:
                self._say("learned features work again")
            self._stood_in = False
        elif not self._on_fallback and self._failures >= self._config.fallback_after:
            self._on_fallback, self._fallback_attempts = True, 0


class Tracking(Protocol):
    """What the pipeline needs of `vwnav.vision.odometry.odometry.Odometry`."""

    readout_s: tuple[float, float]  # what rows are thought to take, and one sigma

    def counted_attitude(self, t_s: float) -> Attitude:
        """Of a video alone: level, with the heading counted from its images."""
        ...

    def step(
        self, frame: Frame, R_ned_body: Array | None, agl_m: float
    ) -> OdometryMotion | Rejected:
        """Motion since the keyframe."""
        ...

    def mistook(self) -> None:
        """What was followed was not the ground: from the newest image on."""
        ...


class Watcher(Protocol):
    """Sees what happens, for the record and the screen. Called from the loops: must be quick."""

    def saw_frame(self, frame: Frame, step: StepResult) -> None:
        """An image went through the pipeline."""
        ...

    def saw_tick(self, t_s: float, estimate: Estimate | None, vehicle: VehicleState) -> None:
        """The mission ticked."""
        ...

    def event(self, text: str) -> None:
        """Something worth a line."""
        ...


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
