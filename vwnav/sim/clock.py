"""Time as a simulation has it; whoever flies sets it."""


class SimulatedClock:
    """A clock that stands until it is set; call it for the time (s), like `time.monotonic`."""

    def __init__(self, now_s: float = 0.0) -> None:
        self.now_s = now_s

    def __call__(self) -> float:
        """The time now."""
        return self.now_s
