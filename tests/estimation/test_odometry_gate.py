"""Ways that contradict the IMU are not believed, until they and a fix agree again."""

import numpy as np
import pytest

from vwnav.estimation.config import EkfConfig
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.odometry import apply_misled
from vwnav.estimation.odometry_gate import OdometryGate
from vwnav.estimation.states import FilterState, States, first_variance
from vwnav.estimation.timeline import Misled


def tell(
    gate: OdometryGate, begin_s: float, seconds: float, agrees: bool, brakes_m_s2: float = 3.0
) -> float:
    """Ten ways a second; returns when the next one is due."""
    P = 0.3**2 * np.eye(States.SIZE)
    for i in range(round(10 * seconds)):
        x = np.zeros(States.SIZE)
        x[States.VELOCITY.start] = 8.0 - 0.1 * i * brakes_m_s2
        t_s = begin_s + 0.1 * i
        state = FilterState(t_s, x, P, True, True, tracked_s=t_s, pictured_s=t_s)
        gate.learn(agrees, state)
    return begin_s + seconds


def test_ways_that_are_refused_are_lost_and_come_back_with_a_fix_only():
    gate = OdometryGate(AttitudeHistory(1.0), EkfConfig())
    t_s = tell(gate, 0.0, 5.0, True)
    t_s = tell(gate, t_s, 1.3, False)
    assert gate.lost
    t_s = tell(gate, t_s, 6.0, True)
    assert gate.lost
    gate.fixed = True
    t_s = tell(gate, t_s, 0.1, True)
    assert not gate.lost


def test_lost_again_they_have_to_agree_for_longer():
    gate = OdometryGate(AttitudeHistory(1.0), EkfConfig())
    t_s = tell(gate, 0.0, 1.5, False)
    gate.fixed = True
    t_s = tell(gate, t_s, 3.0, True)
    assert not gate.lost
    t_s = tell(gate, t_s, 1.5, False)
    gate.fixed = True
    t_s = tell(gate, t_s, 10.0, True)
    assert gate.lost
    tell(gate, t_s, 12.0, True)
    assert not gate.lost


def test_in_steady_flight_ways_of_another_moment_agree_and_that_proves_nothing():
    gate = OdometryGate(AttitudeHistory(1.0), EkfConfig())
    t_s = tell(gate, 0.0, 1.5, False, brakes_m_s2=0.0)
    gate.fixed = True
    t_s = tell(gate, t_s, 30.0, True, brakes_m_s2=0.0)
    assert gate.lost
    tell(gate, t_s, 4.0, True)
    assert not gate.lost


def test_after_a_gap_of_pictures_it_may_be_the_filter_that_is_wrong():
    gate = OdometryGate(AttitudeHistory(1.0), EkfConfig())
    tell(gate, tell(gate, 0.0, 0.8, False) + 1.0, 1.0, False)
    assert not gate.lost


def test_what_wrong_ways_have_taught_is_as_at_first_and_the_velocity_as_wrong_as_they_were():
    config, rng = EkfConfig(), np.random.default_rng(1)
    root = rng.normal(size=(States.SIZE, States.SIZE))
    before = FilterState(8.0, rng.normal(size=States.SIZE), root @ root.T, True, True, 8.0, 8.0)
    after = apply_misled(before, Misled(8.0, 2.0), config)
    for taught in (States.TILT, States.WIND_FORCE, States.ACCELEROMETER_BIAS_LEVEL):
        assert np.all(after.x[taught] == 0.0)
        known = np.diag(after.P)[taught]
        assert known == pytest.approx(first_variance(config)[taught])
    added = np.diag(after.P - before.P)
    assert added[States.VELOCITY_NE] == pytest.approx([4.0, 4.0])
    assert added[States.POSITION_NE] == pytest.approx([36.0, 36.0])  # half of 2 m/s for 6 s
    assert np.linalg.eigvalsh(after.P).min() > -1e-9
