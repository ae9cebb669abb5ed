"""What a pilot took over, and the way on from there once he gives it back in so many words."""

from collections.abc import Callable
from typing import NamedTuple

from vwnav.mission.mission import Next, Phase
from vwnav.vehicle import Autopilot, Navigation, Request, VehicleState

_TRAVELS = frozenset({Phase.ROUTE, Phase.RETURN})


class _Interrupted(NamedTuple):
    """A phase that can be gone on with, and what had gone wrong by then."""

    phase: Phase
    trouble: str | None


class Takeover:
    """The newest one: each forgets what the one before had interrupted.

    Attributes:
        given_back: the pilot's side has asked us to go on.
    """

    def __init__(self, autopilot: Autopilot, say: Callable[[str], None]) -> None:
        self._autopilot = autopilot
        self._say = say
        self._interrupted: _Interrupted | None = None
        self._offboard: Request | None = None
        self.given_back = False

    @property
    def trouble(self) -> str | None:
        """What had gone wrong before it."""
        return None if self._interrupted is None else self._interrupted.trouble

    def begin(self, phase: Phase, trouble: str | None) -> None:
        """Somebody else has the aircraft, in that phase."""
        if phase is Phase.RESUME:
            return  # whose Offboard was refused: what was interrupted is as it was
        self._interrupted = _Interrupted(phase, trouble) if phase in _TRAVELS else None

    def ask_back(
        self, vehicle: VehicleState, navigation: Navigation, lands_for: str | None
    ) -> bool:
        """Ask for Offboard, where there is something to go on with, and to fly it on.

        A pilot is left with what we would only land, for the reason `lands_for`.
        """
        self.given_back = False
        if self._interrupted is None or not vehicle.in_air:
            self._say("there is no route to go on with: the aircraft stays the pilot's")
        elif navigation.estimate is None:
            self._say("there is no estimate to fly on: the aircraft stays the pilot's")
        elif lands_for is not None:
            self._say(f"{lands_for}: the aircraft stays the pilot's")
        else:
            self._offboard = self._autopilot.start_offboard()
            return True
        return False

    def answer(self) -> Next | None:
        """What follows from the autopilot's answer; None before it."""
        request, interrupted = self._offboard, self._interrupted
        assert request is not None
        assert interrupted is not None
        if not request.done:
            return None
        if request.refused is None:
            return Next(interrupted.phase)
        return Next(Phase.RELEASED, f"the autopilot refused Offboard: {request.refused}")
