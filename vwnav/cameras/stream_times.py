"""When the images of a stream were sent: one that is read late was not exposed late."""

from vwnav.sender_clock import SenderClock

_AT_ITS_PACE = 0.8  # of the time between two stamps: images that lay ready come faster
_READY_MOST_S = 3.0  # whatever comes faster for longer has no stamps that can be believed


class StreamTimes:
    """Dates images by the stamps that they carry, on a clock of the stream's own.

    What was read before anybody asked (FFmpeg reads for half a second and more, to know the stream)
    comes at once: when that arrives tells nothing, and the clock begins with the first image that
    had to be waited for.
    """

    def __init__(self) -> None:
        self._sender: SenderClock | None = None
        self._before: tuple[float, float] | None = None  # stamp and arrival of the last image
        self._since_s = 0.0  # arrival of the first one

    def sent_s(self, stamp_s: float, arrival_s: float) -> float | None:
        """On our clock; the arrival where the stamp, or its not being one (NaN), tells nothing.

        None of an image that lay ready, or may have: nobody knows how old it is.
        """
        before, self._before = self._before, (stamp_s, arrival_s)
        if before is None:
            self._since_s = arrival_s
            return None
        if not stamp_s > before[0]:  # it counts anew or not at all
            self._sender = None
            return arrival_s
        if self._sender is None:
            lay_ready = arrival_s - before[1] < _AT_ITS_PACE * (stamp_s - before[0])
            if lay_ready:
                return None if arrival_s - self._since_s < _READY_MOST_S else arrival_s
            self._sender = SenderClock()
        sent_s = self._sender.date(stamp_s, arrival_s)
        return arrival_s if sent_s is None else sent_s
