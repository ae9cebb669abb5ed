"""Samples of the autopilot's IMU, from whichever message carries them, on our clock."""

import math
from typing import Any

import numpy as np

from vwnav.mavlink.ports.port import Fields
from vwnav.sender_clock import SenderClock
from vwnav.types import ImuSample

# Further from now a stamp is not of the clock that attitudes are stamped with, or of no use.
OLDEST_S, CLOCK_ERROR_S = 10.0, 0.5
_GAP_S = 1.0  # between two samples that tell nothing of each other
_SILENT_S = 1.0  # of HIGHRES_IMU, then RAW_IMU counts
_MILLI_G_M_S2 = 9.80665e-3
_MILLI = 1e-3


class ImuSamples:
    """Makes samples of what HIGHRES_IMU says, or ArduPilot's RAW_IMU where that one does not come.

    Attitude and IMU share the autopilot's clock since boot, so they fit together to the
    millisecond however late they arrive.
    """

    def __init__(self) -> None:
        self._newest_s = -math.inf
        self._newest_us = 0
        self._highres_s = -math.inf

    def highres(self, fields: Fields, clock: SenderClock, received_s: float) -> ImuSample | None:
        """Of a HIGHRES_IMU: m/s^2 and rad/s; of several sensors, the first one.

        Args:
            fields: of the message.
            clock: joins the autopilot's clock to ours.
            received_s: when it came.
        """
        names = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro")
        values = [fields[name] for name in names]
        if fields.get("id", 0) != 0 or any(value is None for value in values):
            return None
        self._highres_s = received_s
        return self._sample(fields["time_usec"], np.array(values), clock, received_s)

    def raw(self, fields: Fields, clock: SenderClock, received_s: float) -> ImuSample | None:
        """Of a RAW_IMU as ArduPilot fills it: thousandths of g and of rad/s."""
        if fields.get("id", 0) != 0 or received_s - self._highres_s < _SILENT_S:
            return None
        force = np.array([fields[name] for name in ("xacc", "yacc", "zacc")], dtype=np.float64)
        rates = np.array([fields[name] for name in ("xgyro", "ygyro", "zgyro")], dtype=np.float64)
        values = np.concatenate([force * _MILLI_G_M_S2, rates * _MILLI])
        return self._sample(fields["time_usec"], values, clock, received_s)

    def _sample(
        self, t_us: int, values: Any, clock: SenderClock, received_s: float
    ) -> ImuSample | None:
        boot_s = clock.near(t_us / 1e6)
        t_s = clock.to_monotonic(boot_s)
        if t_s is None or not received_s - OLDEST_S < t_s < received_s + CLOCK_ERROR_S:
            return None
        if not np.isfinite(values).all():
            return None
        clock.handle_stamp(boot_s, received_s)
        started_anew = t_us < self._newest_us - _GAP_S * 1e6
        if not started_anew and (t_us <= self._newest_us or t_s <= self._newest_s):
            return None  # a duplicate, or overtaken by a newer one on its way
        span_s = (t_us - self._newest_us) / 1e6
        self._newest_s, self._newest_us = t_s, t_us
        known = 0.0 < span_s < _GAP_S
        return ImuSample(t_s, values[:3], values[3:], span_s if known else None)
