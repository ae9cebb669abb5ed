"""Whether something that should move on stands still."""


class Stall:
    """Looks at a count, at the looker's own pace: who sleeps does not look.

    Args:
        most_looks: that it may stay the same.
    """

    def __init__(self, most_looks: int) -> None:
        self._most_looks = most_looks
        self._count, self._looks = 0, 0

    def look(self, count: int) -> bool:
        """Whether it has stood still for too long."""
        self._looks = self._looks + 1 if count == self._count else 0
        self._count = count
        return self._looks > self._most_looks
