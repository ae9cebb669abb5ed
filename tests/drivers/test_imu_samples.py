"""The IMU of an autopilot, before the filter sees it."""

import logging

import numpy as np
import pytest

from vwnav.drivers.boot_clock import BootClock
from vwnav.drivers.imu_samples import ImuSamples
from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler
from vwnav.types import Attitude

PERIOD_US = 20_000


def heard(samples: ImuSamples, clock: BootClock, count: int, force, start: int = 0, roll_rad=0.0):
    """What is handed on of `count` samples that feel `force`, taken one by one."""
    attitude = Attitude(0.0, quat_from_rotation(rotation_from_euler(roll_rad, 0.0, 0.0)))
    taken = []
    for i in range(start, start + count):
        t_us = 1_000_000 + PERIOD_US * i
        clock.handle_stamp(t_us / 1e6, 50.0 + t_us / 1e6)
        fields = dict(zip(("xacc", "yacc", "zacc"), force, strict=True))
        rates = dict.fromkeys(("xgyro", "ygyro", "zgyro"), 0.0)
        values = fields | rates | {"time_usec": t_us}
        taken.append(samples.highres(values, clock, 50.0 + t_us / 1e6, attitude))
    return [sample for sample in taken if sample is not None]


def test_samples_are_on_our_clock_with_the_sensors_own_span():
    taken = heard(ImuSamples(), BootClock(), 5, (0.0, 0.0, -9.8))
    assert [sample.t_s for sample in taken] == pytest.approx([51.0 + 0.02 * i for i in range(5)])
    assert [sample.span_s for sample in taken] == [None, *[pytest.approx(0.02)] * 4]


@pytest.mark.parametrize("force", [(0.0, 0.0, 9.8), (9.8, 0.0, 0.0), (0.0, 0.0, -30.0)])
def test_an_imu_that_feels_gravity_elsewhere_is_not_used_and_it_is_said(force, caplog):
    samples, clock = ImuSamples(), BootClock()
    with caplog.at_level(logging.WARNING):
        heard(samples, clock, 500, force)
        assert heard(samples, clock, 50, force, start=500) == []
    assert len(caplog.records) == 1
    assert "IMU is not used" in caplog.text


def test_leaning_and_braking_are_no_reason_to_refuse_it():
    samples, clock = ImuSamples(), BootClock()
    leaning = rotation_from_euler(0.3, 0.0, 0.0).T @ [0.0, 0.0, -9.8]
    assert len(heard(samples, clock, 500, leaning, roll_rad=0.3)) == 500
    assert len(heard(samples, clock, 100, (6.0, 0.0, -9.8), start=500)) == 100


def test_an_imu_that_comes_right_is_used_again():
    samples, clock = ImuSamples(), BootClock()
    heard(samples, clock, 500, (0.0, 0.0, 9.8))
    assert heard(samples, clock, 2000, (0.0, 0.0, -9.8), start=500)


def test_an_autopilot_that_starts_anew_is_heard_anew():
    samples, clock = ImuSamples(), BootClock()
    heard(samples, clock, 200, (0.0, 0.0, -9.8), start=1000)
    clock = BootClock()
    again = heard(samples, clock, 10, (0.0, 0.0, -9.8))
    assert np.all(np.diff([sample.t_s for sample in again]) > 0.0)
    assert len(again) == 10
