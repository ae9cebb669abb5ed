"""Ground that rises and falls: ways tell its slope, so that height and speed stay true."""

import numpy as np
import pytest
from honesty import worst_sigmas

from tests.quick import first_quick
from vwnav.bench.estimator.flown import Run
from vwnav.bench.estimator.run import play
from vwnav.bench.estimator.streams import sense
from vwnav.bench.estimator.world import FilterWorld, fly
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.states import States
from vwnav.types import Attitude, OdometryMotion

OUTAGES_S = ((50.0, 65.0), (90.0, 105.0))
LEVEL = EkfConfig(slope=1e-4, slope_seen=1e3)  # what a filter without these states believes


def flown(seed: int, relief_m: float, config: EkfConfig) -> Run:
    """Two minutes over relief, with an IMU, and twice 15 s without a fix."""
    world = FilterWorld(seconds=120.0, imu_hz=50.0, relief_m=relief_m, outages_s=OUTAGES_S)
    rng = np.random.default_rng(seed)
    return play(sense(world, fly(world, [rng])[0], rng), config)


@pytest.mark.parametrize("seed", first_quick([1, 2, 3]))
def test_relief_of_some_ten_per_cent_leaves_place_and_height_within_their_sigmas(seed):
    run = flown(seed, 8.0, EkfConfig())
    assert worst_sigmas(run) < 4.5
    assert np.max(np.abs(run.rows.error_agl_m) / run.rows.sigma_agl_m) < 5.0


@pytest.mark.long
def test_a_filter_that_takes_the_ground_for_level_is_wrong_there():
    assert max(worst_sigmas(flown(seed, 8.0, LEVEL)) for seed in (1, 2, 3)) > 5.0


@pytest.mark.long
def test_level_ground_costs_little():
    slopes, level = (flown(1, 0.0, config) for config in (EkfConfig(), LEVEL))
    mean_m = [float(np.hypot(*run.rows.error_ne_m.T).mean()) for run in (slopes, level)]
    assert mean_m[0] < mean_m[1] + 0.15


def test_an_image_is_told_of_the_slope_that_the_terrain_table_knows():
    ekf = Ekf(EkfConfig(), lambda north_m, east_m: 0.1 * north_m - 0.2 * east_m)
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.array([3.0, 4.0, -50.0])))
    ekf.handle(Attitude(0.0, np.array([1.0, 0.0, 0.0, 0.0])))
    assert ekf.estimate(0.0).slope_ne == pytest.approx((0.1, -0.2))


def test_a_slope_that_every_image_shows_by_the_same_keyframe_is_no_tilt():
    """The keyframe was dated wrongly while it leaned: one error, seen thirty times."""
    ekf, level = Ekf(EkfConfig()), np.array([1.0, 0.0, 0.0, 0.0])
    ekf.handle(Attitude(0.0, level))
    ekf.initialise(Start(t_s=0.0, position_ned_m=np.array([0.0, 0.0, -50.0]), agl_m=50.0))
    for n in range(1, 151):
        t_s = round(0.02 * n, 6)
        ekf.handle(Attitude(t_s, level))
        if n % 5 == 0:
            still = OdometryMotion(
                0.1, t_s, np.zeros(3), 0.05**2 * np.eye(3), 0.0, 0.003, 50.0, 99,
                slope_ne=np.array([-0.1, 0.15]), slope_covariance=0.06**2 * np.eye(2),
            )  # fmt: skip
            ekf.handle(still)
    assert np.degrees(np.abs(ekf.state.x[States.TILT])).max() < 0.5
