"""MAVLink commands with their acknowledgement, and why one was refused, in words.

Nothing here waits. A procedure is a generator that does a little and yields; whoever steps the link
resumes it, and what it returns is None when the autopilot agreed, else the reason why not.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

from vwnav.mavlink.modes import Command
from vwnav.mavlink.ports.port import Fields, Send
from vwnav.vehicle import NO_ANSWER, Request

Procedure = Generator[None, None, str | None]

# MAV_RESULT: https://mavlink.io/en/messages/common.html#MAV_RESULT
_ACCEPTED, _IN_PROGRESS = 0, 5
_RESULTS = {
    1: "not now",
    2: "denied",
    3: "not supported",
    4: "failed",
    6: "cancelled",
}
_TRIES = 3
_PROGRESS_S = 2.0
_FORGOTTEN_S = 3.0  # an answer that comes later is taken for one to something else


@dataclass(slots=True)
class _Transmission:
    """One COMMAND_LONG on the air; several are of the same command."""

    number: int
    sent_s: float
    answer: "_Answer"


@dataclass(slots=True)
class _Answer:
    result: int | None = None
    at_s: float = 0.0


def _never() -> bool:
    return False


def _no_reason() -> str | None:
    return None


class CommandSender:
    """Sends commands and knows which answer belongs to which.

    Args:
        system_id: of the autopilot.
        clock: monotonic clock, in seconds.
        patience_s: how long an answer may take on this link before it is asked for again.
    """

    def __init__(
        self,
        send: Send,
        system_id: Callable[[], int],
        clock: Callable[[], float],
        patience_s: Callable[[], float],
    ) -> None:
        self._send = send
        self._system_id = system_id
        self._clock = clock
        self._patience_s = patience_s
        self._unanswered: list[_Transmission] = []

    def handle_ack(self, fields: Fields, received_s: float) -> None:
        """Take a COMMAND_ACK in: it answers the oldest transmission of that command."""
        self._unanswered = [t for t in self._unanswered if received_s - t.sent_s < _FORGOTTEN_S]
        number, result = fields["command"], fields["result"]
        transmission = next((t for t in self._unanswered if t.number == number), None)
        if transmission is None:
            return
        if result != _IN_PROGRESS:
            self._unanswered.remove(transmission)
        transmission.answer.result, transmission.answer.at_s = result, received_s

    def tell(self, command: Command) -> None:
        """Send once and forget: what comes of it shows in the telemetry."""
        self._send("COMMAND_LONG", self._fields(command, 0))

    def command(
        self,
        command: Command,
        seen: Callable[[], bool] = _never,
        overtaken: Callable[[], str | None] = _no_reason,
    ) -> Procedure:
        """Send, and send again where no answer comes, three times at most.

        Args:
            command: what is asked for.
            seen: whether telemetry shows that it was done: as good as an answer.
            overtaken: why it must not be sent again (the pilot has acted since), None while it may.
        """
        answer = _Answer()
        for attempt in range(_TRIES):
            sent_s = self._clock()
            self._unanswered.append(_Transmission(command.number, sent_s, answer))
            self._send("COMMAND_LONG", self._fields(command, attempt))
            while answer.result is None and self._clock() - sent_s < self._patience_s():
                yield
                if seen():
                    return None
                reason = overtaken()
                if reason is not None:
                    return reason
            if answer.result is not None:
                break
        while answer.result == _IN_PROGRESS and self._clock() - answer.at_s < _PROGRESS_S:
            yield
        return _in_words(answer.result)

    def _fields(self, command: Command, attempt: int) -> dict[str, Any]:
        params = [*command.params, *[0.0] * (7 - len(command.params))]
        numbered = {f"param{i}": value for i, value in enumerate(params, start=1)}
        return {
            "target_system": self._system_id(),
            "target_component": 1,
            "command": command.number,
            "confirmation": attempt,
        } | numbered


def _in_words(result: int | None) -> str | None:
    if result in (_ACCEPTED, _IN_PROGRESS):
        return None
    if result is None:
        return f"{NO_ANSWER} to {_TRIES} tries"
    return _RESULTS.get(result, f"refused with code {result}")


class CurrentRequest:
    """What was asked for last: a procedure under way, or none."""

    def __init__(self) -> None:
        self._under_way: tuple[Request, Procedure] | None = None

    def begin(self, procedure: Procedure) -> Request:
        """In place of the one before; the first message leaves at once."""
        self.end("replaced by a newer command")
        request = Request()
        self._under_way = (request, procedure)
        self.resume()
        return request

    def end(self, refused: str) -> None:
        """Leave it, for that reason."""
        if self._under_way is None:
            return
        (request, procedure), self._under_way = self._under_way, None
        procedure.close()
        request.refused, request.done = refused, True

    def resume(self) -> None:
        """Carry it on; whatever it raises ends it."""
        if self._under_way is None:
            return
        request, procedure = self._under_way
        try:
            next(procedure)
        except StopIteration as end:
            self._under_way = None
            request.refused, request.done = end.value, True
        except BaseException:
            self.end("it failed on our side")
            raise
