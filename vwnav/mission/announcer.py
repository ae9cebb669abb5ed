"""What safety decides, in words, once for each change."""

from vwnav.safety.hierarchy import Action, Decision, Rank

_DOING = {
    Action.SLOW: "slower",
    Action.HOLD: "holding",
    Action.CLIMB: "climbing to where the map shows more",
}
# Phases of their own, which say it.
_TOLD_ELSEWHERE = frozenset({Action.RETURN, Action.LAND, Action.YIELD, Action.RELEASE})


class Announcer:
    """Remembers what was decided last."""

    def __init__(self) -> None:
        self._decided = (Action.NAVIGATE, Rank.NAVIGATION)

    def words(self, decision: Decision) -> str:
        """Of a decision that is another than the last one; "" where nothing is to be said."""
        before, self._decided = self._decided, (decision.action, decision.rank)
        if self._decided == before or decision.action in _TOLD_ELSEWHERE:
            return ""
        if decision.action is not Action.NAVIGATE:
            return f"{decision.reason}: {_DOING[decision.action]}"
        return "" if before[0] in _TOLD_ELSEWHERE else "all well again: going on"
