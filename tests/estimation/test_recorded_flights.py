"""Three flights on real PX4 that were lost: the mended filter, told the same, stays honest."""

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.config import EkfConfig
from vwnav.estimation.ekf import Ekf
from vwnav.estimation.events import NedFix
from vwnav.estimation.inputs import Asked
from vwnav.recording.input_log import ImageSeen, read_input_log
from vwnav.types import Array, Estimate

MOST_SIGMAS = 5.0
MOST_ERROR_M = 3.0  # horizontally, where fixes are to be had
LATELY_S = 1.0


@dataclass(frozen=True)
class Truth:
    """Position NED (n, 3) of the simulator over time, down from where it stood."""

    t_s: Array
    position_ned_m: Array

    def at(self, t_s: float) -> Array:
        return np.array([np.interp(t_s, self.t_s, axis) for axis in self.position_ned_m.T])

    def near(self, fix: NedFix) -> bool:
        """In the logs some fixes are wrong themselves: no filter is right by one of those."""
        return bool(np.hypot(*(fix.position_ne_m - self.at(fix.t_s)[:2])) < MOST_ERROR_M)

    def covers(self, t_s: float) -> bool:
        return bool(self.t_s[0] <= t_s <= self.t_s[-1])


def truth_of(folder: Path) -> Truth:
    with (folder / "truth.csv").open(newline="") as file:
        names = ("t_s", "north_m", "east_m", "alt_amsl_m")
        rows = np.array([[float(row[name]) for name in names] for row in csv.DictReader(file)])
    down_m = rows[0, 3] - rows[:, 3]
    return Truth(rows[:, 0], np.column_stack([rows[:, 1:3], down_m]))


def replayed(input_log: Path, ekf: Ekf, truth: Truth) -> Iterator[tuple[Estimate, float]]:
    """Each fourth estimate asked for in flight, and the exposure of the newest right fix."""
    fix_s, asked = -math.inf, 0
    for seen in read_input_log(input_log):
        asked += isinstance(seen, Asked)
        if isinstance(seen, ImageSeen) or (isinstance(seen, Asked) and asked % 4):
            continue
        if isinstance(seen, Start | Asked):
            estimate = ekf.take(seen)
            if estimate is not None:
                yield estimate, fix_s
            continue
        ekf.handle(seen)
        if isinstance(seen, NedFix) and truth.near(seen):
            fix_s = max(fix_s, seen.t_s)


@pytest.mark.parametrize("name", ["px4_attitude_missing", "px4_link_cut_5s", "px4_stopped_20s"])
def test_a_lost_flight_replayed_stays_within_its_sigmas_and_near_its_fixes(name, data_folder):
    folder = data_folder / "mavlink" / "vwnav_flights" / name
    if not folder.is_dir():
        pytest.skip(f"no recorded flight at {folder}")
    truth, ekf, judged = truth_of(folder), Ekf(EkfConfig()), 0
    for estimate, fix_s in replayed(folder / "flight.mcap", ekf, truth):
        if not truth.covers(estimate.t_s):
            continue
        error_m = estimate.position_ned_m - truth.at(estimate.t_s)
        P, when = estimate.covariance, f"{estimate.t_s - truth.t_s[0]:.1f} s"
        level = math.sqrt(error_m[:2] @ np.linalg.solve(P[:2, :2], error_m[:2]))
        assert level < MOST_SIGMAS, when
        assert abs(error_m[2]) < MOST_SIGMAS * math.sqrt(P[2, 2]), when
        if 0.0 <= estimate.t_s - fix_s <= LATELY_S:
            assert np.hypot(*error_m[:2]) < MOST_ERROR_M, when
        judged += 1
    assert judged > 2000
