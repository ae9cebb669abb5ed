"""Which features look next: the learned ones, or SIFT while they fail."""

from collections.abc import Callable

from vwnav.seams import FeatureChoiceConfig, Localizing


class FeatureChoice:
    """Which localizer comes next: the primary, or the fallback while the primary fails."""

    def __init__(
        self,
        primary: Localizing,
        fallback: Localizing | None,
        config: FeatureChoiceConfig,
        say: Callable[[str], None],
    ) -> None:
        self._primary = primary
        self._fallback = fallback
        self._config = config
        self._say = say
        self._failures = 0
        self._on_fallback = False
        self._fallback_attempts = 0
        self._broken: set[str] = set()  # reasons that were said

    def next(self) -> Localizing:
        """The localizer to try now."""
        if not self._on_fallback or self._fallback is None:
            return self._primary
        self._fallback_attempts += 1
        if self._fallback_attempts % self._config.primary_retry_every == 0:
            return self._primary
        return self._fallback

    def broke(self, used: Localizing, error: Exception) -> None:
        """A localizer raised: a model that fails at run time. The fallback stands in at once."""
        reason = f"{type(error).__name__}: {error}"
        stands_in = used is self._primary and self._fallback is not None
        if reason not in self._broken:
            self._broken.add(reason)
            self._say(f"map matching failed ({reason})" + (": SIFT stands in" if stands_in else ""))
        if stands_in and not self._on_fallback:
            self._on_fallback, self._fallback_attempts = True, 0

    def report(self, used: Localizing, succeeded: bool) -> None:
        """Learn from an attempt: enough failures switch to the fallback, one success back."""
        if used is not self._primary or self._fallback is None:
            return
        self._failures = 0 if succeeded else self._failures + 1
        if succeeded and self._on_fallback:
            self._on_fallback = False
            self._say("learned features work again")
        elif not self._on_fallback and self._failures >= self._config.fallback_after:
            self._on_fallback, self._fallback_attempts = True, 0
            self._say(f"no fix from learned features in {self._failures} attempts: SIFT stands in")
