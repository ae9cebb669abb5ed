"""A height that is open by a good part of itself, and ways that are scaled by it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.types import Attitude, Estimate, Height, OdometryMotion

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def at_rest(climb_m_s: float, agl_m: float, sigma_m: float) -> list[Estimate]:
    """Each second's estimate where images stand still and the barometer climbs; they begin at 3."""
    ekf, keyframe, believed = Ekf(EkfConfig()), (0.0, agl_m), []
    ekf.handle(Attitude(0.0, LEVEL))
    ekf.initialise(
        Start(
            t_s=0.0, position_ned_m=np.array([0.0, 0.0, -agl_m]), agl_m=agl_m, sigma_agl_m=sigma_m,
            sigma_velocity_m_s=2.0,
        )
    )  # fmt: skip
    for n in range(1, 61):
        t_s = round(0.1 * n, 6)
        ekf.handle(Attitude(t_s, LEVEL))
        ekf.handle(Height(t_s, agl_m + climb_m_s * min(t_s, 3.0)))
        now = ekf.estimate(t_s)
        assert now is not None
        if n == 30:
            keyframe = t_s, now.agl_m
        if n > 30:
            ekf.handle(
                OdometryMotion(
                    keyframe[0], t_s, np.zeros(3), 0.01**2 * np.eye(3), 0.0, 0.003, keyframe[1], 99
                )
            )
        if n % 10 == 0:
            believed.append(now)
    return believed


@given(climb_m_s=st.floats(-0.4, 0.4), agl_m=st.floats(4.0, 8.0), sigma_share=st.floats(0.25, 0.6))
def test_images_that_stand_still_tell_no_height(climb_m_s, agl_m, sigma_share):
    """They end the climb that was believed. A height of 1 m was believed to be 6 m by them."""
    before, after = at_rest(climb_m_s, agl_m, sigma_share * agl_m)[2::3]
    assert after.velocity_ned_m_s[2] == pytest.approx(0.0, abs=0.1)
    assert abs(after.agl_m - before.agl_m) < 0.3 * sigma_share * agl_m
    assert after.sigma_agl_m == pytest.approx(before.sigma_agl_m, rel=0.1)
