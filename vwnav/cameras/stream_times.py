"""When the images of a stream were sent: one that is read late was not exposed late."""

import math

from vwnav.sender_clock import SenderClock


class StreamTimes:
    """Dates images by the stamps that they carry, on a clock of the stream's own."""

    def __init__(self) -> None:
        self._sender, self._stamp_s = SenderClock(), -math.inf

    def sent_s(self, stamp_s: float, arrival_s: float) -> float:
        """On our clock; the arrival where the stamp, or its not being one (NaN), tells nothing."""
        counts_on = stamp_s > self._stamp_s
        self._stamp_s = stamp_s
        if not counts_on:  # anew, or not at all
            self._sender = SenderClock()
            return arrival_s
        sent_s = self._sender.date(stamp_s, arrival_s)
        return arrival_s if sent_s is None else sent_s
