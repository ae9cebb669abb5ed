"""The simulated camera: an image shows where the vehicle was when it was exposed."""

import time
from itertools import pairwise

import numpy as np
import pytest

from vwnav.clock import WallClock
from vwnav.geometry.geodesy import LocalFrame
from vwnav.pace import PacedClock
from vwnav.sim.camera_source import SimulatedCamera
from vwnav.sim.truth_state import TruthState

HOME = (60.4, 22.5)
SPEED_M_S = 10.0


class LateTruth:
    """Of a vehicle that flies north; told so long after it was so."""

    def __init__(self, late_s):
        self.late_s, self.began_s = late_s, time.monotonic()
        self.frame = LocalFrame(*HOME, 0.0)

    def north_m(self, t_s):
        return SPEED_M_S * (t_s - self.began_s)

    def wait(self, timeout_s):
        return self.latest()

    def latest(self):
        return self.at(time.monotonic())

    def at(self, t_s):
        t_s = min(t_s, time.monotonic() - self.late_s)
        place = self.frame.to_geodetic(np.array([self.north_m(t_s), 0.0, -50.0]))
        zero = (0.0, 0.0, 0.0)
        return TruthState(t_s, *map(float, place), (1.0, 0.0, 0.0, 0.0), zero, zero)


class Renderer:
    """Draws where it stands."""

    def render(self, position_ned_m, R_ned_body, t_s, velocity_ned_m_s, rates_rad_s):
        return np.full((2, 2), position_ned_m[0])


@pytest.mark.parametrize(("late_s", "old_s"), [(0.0, 0.0), (0.06, 0.0), (0.5, 0.4)])
def test_an_image_waits_for_truth_of_its_exposure_and_later_is_exposed_when_that_was(late_s, old_s):
    truth = LateTruth(late_s)
    camera = SimulatedCamera(Renderer(), truth, HOME, WallClock(), flown_m=50.0)
    frames = []
    for _ in range(4):
        frames.append((camera.next_frame(), time.monotonic()))
    camera.close()
    for frame, now_s in frames:
        assert frame.image[0, 0] == pytest.approx(truth.north_m(frame.t_s), abs=0.05)
        assert now_s - frame.t_s > old_s
    assert all(b.t_s > a.t_s for (a, _), (b, _) in pairwise(frames))


class SilentTruth(LateTruth):
    """Of a simulator that has ended."""

    def __init__(self, clock):
        super().__init__(0.0)
        self.ended_s = clock()

    def at(self, t_s):
        return super().at(min(t_s, self.ended_s))


def test_simulated_time_goes_on_when_the_simulator_has_ended():
    clock = PacedClock.create()
    camera = SimulatedCamera(Renderer(), SilentTruth(clock), HOME, clock, flown_m=50.0)
    try:
        began_s = clock()
        clock.wait_until(began_s + 1.5)  # whom nothing is told any more is not waited for
        gone_s, gone_wall_s = clock(), time.monotonic()
        clock.wait_until(gone_s + 3.0)
        assert time.monotonic() - gone_wall_s < 10.0
    finally:
        camera.close()
        clock.remove()
