"""Samples of the autopilot's IMU, from whichever message carries them, on our clock."""

import logging
import math
from typing import Any

import numpy as np

from vwnav.drivers.boot_clock import BootClock
from vwnav.drivers.port import Fields
from vwnav.geometry.rotations import rotation_from_quat
from vwnav.types import Array, Attitude, ImuSample

_log = logging.getLogger(__name__)
_STRANGE_S = 1.0  # further from now a stamp is not of the clock that attitudes are stamped with
_SILENT_S = 1.0  # of HIGHRES_IMU, then RAW_IMU counts
_MILLI_G_M_S2 = 9.80665e-3
_MILLI = 1e-3
_AT_REST_M_S2 = np.array([0.0, 0.0, -9.80665])
_MOST_M_S2 = 160.0  # 16 g: one absurd sample shall not count for minutes
# On these averages no aircraft accelerates so much for so long.
_AVERAGES_S, _FOREIGN_M_S2 = np.array([0.5, 10.0]), np.array([7.0, 3.0])


class ImuSamples:
    """Makes samples of what HIGHRES_IMU says, or ArduPilot's RAW_IMU where that one does not come.

    Attitude and IMU share the autopilot's clock since boot, so they fit together to the
    millisecond however late they arrive. An IMU that does not feel gravity where the attitude has
    it is mounted otherwise than the autopilot was told, or broken: none of it is handed on.
    """

    def __init__(self) -> None:
        self._newest_s = -math.inf
        self._newest_us = 0
        self._highres_s = -math.inf
        self._felt_ned: Array = np.tile(_AT_REST_M_S2, (2, 1))  # a row for each average
        self._foreign = False

    def highres(
        self, fields: Fields, clock: BootClock, received_s: float, attitude: Attitude | None
    ) -> ImuSample | None:
        """Of a HIGHRES_IMU: m/s^2 and rad/s; of several sensors, the first one.

        Args:
            fields: of the message.
            clock: joins the autopilot's clock to ours.
            received_s: when it came.
            attitude: the newest one; without any a sample cannot be judged.
        """
        names = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro")
        values = [fields[name] for name in names]
        if fields.get("id", 0) != 0 or any(value is None for value in values):
            return None
        self._highres_s = received_s
        sample = self._sample(fields["time_usec"], np.array(values), clock, received_s)
        return self._trusted(sample, attitude)

    def raw(
        self, fields: Fields, clock: BootClock, received_s: float, attitude: Attitude | None
    ) -> ImuSample | None:
        """Of a RAW_IMU as ArduPilot fills it: thousandths of g and of rad/s."""
        if fields.get("id", 0) != 0 or received_s - self._highres_s < _SILENT_S:
            return None
        force = np.array([fields[name] for name in ("xacc", "yacc", "zacc")], dtype=np.float64)
        rates = np.array([fields[name] for name in ("xgyro", "ygyro", "zgyro")], dtype=np.float64)
        values = np.concatenate([force * _MILLI_G_M_S2, rates * _MILLI])
        sample = self._sample(fields["time_usec"], values, clock, received_s)
        return self._trusted(sample, attitude)

    def _sample(
        self, t_us: int, values: Any, clock: BootClock, received_s: float
    ) -> ImuSample | None:
        t_s = clock.to_monotonic(t_us / 1e6)
        if t_s is None or abs(t_s - received_s) > _STRANGE_S or not np.isfinite(values).all():
            return None
        clock.handle_stamp(t_us / 1e6, received_s)
        started_anew = t_us < self._newest_us - _STRANGE_S * 1e6
        if not started_anew and (t_us <= self._newest_us or t_s <= self._newest_s):
            return None  # a duplicate, or overtaken by a newer one on its way
        span_s = (t_us - self._newest_us) / 1e6
        self._newest_s, self._newest_us = t_s, t_us
        known = 0.0 < span_s < _STRANGE_S
        return ImuSample(t_s, values[:3], values[3:], span_s if known else None)

    def _trusted(self, sample: ImuSample | None, attitude: Attitude | None) -> ImuSample | None:
        """The sample, unless gravity is felt elsewhere than where the attitude has it."""
        if sample is None or attitude is None:
            return None
        R_ned_body = rotation_from_quat(attitude.quat_wxyz)
        shares = -np.expm1(-min(sample.span_s or 0.0, _STRANGE_S) / _AVERAGES_S)
        force_ned = R_ned_body @ np.clip(sample.specific_force_m_s2, -_MOST_M_S2, _MOST_M_S2)
        self._felt_ned = self._felt_ned + shares[:, None] * (force_ned - self._felt_ned)
        off_m_s2 = np.linalg.norm(self._felt_ned - _AT_REST_M_S2, axis=1)
        if self._foreign != bool(np.any(off_m_s2 > _FOREIGN_M_S2)):
            self._foreign = not self._foreign
            what = "not used" if self._foreign else "used again"
            _log.warning(
                "the autopilot's IMU is %s: gravity %.1f m/s^2 from where its attitude has it; "
                "check its orientation and calibration",
                what,
                off_m_s2[0],
            )
        return None if self._foreign else sample
