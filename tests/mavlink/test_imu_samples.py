"""The IMU of an autopilot, before the filter sees it."""

import numpy as np
import pytest

from vwnav.mavlink.telemetry.imu_samples import ImuSamples
from vwnav.sender_clock import SenderClock

PERIOD_US = 20_000


def heard(samples: ImuSamples, clock: SenderClock, count: int, start: int = 0, late_s: float = 0.0):
    """What is handed on of `count` samples at rest, taken one by one, all so late."""
    taken = []
    for i in range(start, start + count):
        t_us = 1_000_000 + PERIOD_US * i
        clock.handle_stamp(t_us / 1e6, 50.0 + late_s + t_us / 1e6)
        fields = {"xacc": 0.0, "yacc": 0.0, "zacc": -9.8}
        rates = dict.fromkeys(("xgyro", "ygyro", "zgyro"), 0.0)
        values = fields | rates | {"time_usec": t_us}
        taken.append(samples.highres(values, clock, 50.0 + late_s + t_us / 1e6))
    return [sample for sample in taken if sample is not None]


def test_samples_are_on_our_clock_with_the_sensors_own_span():
    taken = heard(ImuSamples(), SenderClock(), 5)
    assert [sample.t_s for sample in taken] == pytest.approx([51.0 + 0.02 * i for i in range(5)])
    assert [sample.span_s for sample in taken] == [None, *[pytest.approx(0.02)] * 4]


def test_what_a_line_that_hung_hands_over_late_is_heard_as_attitudes_are():
    samples, clock = ImuSamples(), SenderClock()
    heard(samples, clock, 100)
    late = heard(samples, clock, 50, start=100, late_s=1.9)
    assert [sample.t_s for sample in late] == pytest.approx([53.0 + 0.02 * i for i in range(50)])


def test_an_autopilot_that_starts_anew_is_heard_anew():
    samples, clock = ImuSamples(), SenderClock()
    heard(samples, clock, 200, start=1000)
    clock = SenderClock()
    again = heard(samples, clock, 10)
    assert np.all(np.diff([sample.t_s for sample in again]) > 0.0)
    assert len(again) == 10
