"""Whether a tilt error of the autopilot's turns with the body or stays in NED, the gyro tells."""

import numpy as np
import pytest

from vwnav.estimation.beginning.starts import Start, first_state
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.context import Context
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.inertial.imu import ImuHistory
from vwnav.estimation.process import predict
from vwnav.estimation.states import States
from vwnav.geometry.rotations import quat_from_vector, quat_multiply
from vwnav.types import Attitude, ImuSample

STEP_S, SPAN_S, RATE_RAD_S = 0.02, 3.0, np.radians(30.0)
TILT_RAD = np.radians(2.0)


@pytest.mark.parametrize("stays", [True, False])
def test_after_a_turn_by_90_degrees_the_tilt_is_where_the_gyro_has_it(stays):
    attitudes = AttitudeHistory(10.0)
    imu = ImuHistory(attitudes, 10.0)
    for n in range(round(SPAN_S / STEP_S) + 1):
        t_s = round(STEP_S * n, 6)
        turned = quat_from_vector(np.array([0.0, 0.0, RATE_RAD_S * t_s]))
        tilt = quat_from_vector(np.array([TILT_RAD, 0.0, 0.0]))
        told = quat_multiply(tilt, turned) if stays else quat_multiply(turned, tilt)
        attitudes.add(Attitude(t_s, told))
        imu.add(ImuSample(t_s, np.array([0.0, 0.0, -9.81]), np.array([0.0, 0.0, RATE_RAD_S])))
    config = EkfConfig()
    start = first_state(Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -50.0])), config)
    start.x[States.TILT] = TILT_RAD, 0.0
    start.P[States.TILT, States.TILT] = np.radians(0.1) ** 2 * np.eye(2)
    start.P[States.GYRO_BIAS, States.GYRO_BIAS] = np.radians(0.05) ** 2 * np.eye(3)
    known = start._replace(heading_known=True)
    state = predict(known, SPAN_S, Context(config, attitudes, imu))
    expected = (0.0, -TILT_RAD) if stays else (TILT_RAD, 0.0)
    assert state.x[States.TILT] == pytest.approx(expected, abs=np.radians(0.3))


@pytest.mark.parametrize("steps", [10, 20, 50, 100])
def test_a_turn_in_a_silence_opens_the_tilt_in_however_many_steps_it_is_told(steps):
    """The more often attitudes were told, the surer it was: 1.0 degrees at 10 Hz, 0.5 at 100."""
    attitudes, turn_rad = AttitudeHistory(10.0), np.radians(90.0)
    imu = ImuHistory(attitudes, 10.0)
    for n in range(steps + 1):
        yaw = np.array([0.0, 0.0, turn_rad * n / steps])
        attitudes.add(Attitude(n / steps, quat_from_vector(yaw)))
        if n == 0:
            imu.add(ImuSample(0.0, np.array([0.0, 0.0, -9.81]), np.zeros(3)))
    config = EkfConfig()
    start = first_state(Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -50.0])), config)
    start.P[States.TILT, States.TILT] = np.radians(0.3) ** 2 * np.eye(2)
    state, context = start._replace(heading_known=True), Context(config, attitudes, imu)
    for n in range(steps):
        state = predict(state, (n + 1) / steps, context)
    sigma_deg = np.degrees(np.sqrt(np.diag(state.P[States.TILT, States.TILT])))
    assert sigma_deg == pytest.approx(2.6, abs=0.4)
