"""The folder a run leaves: `trajectory.csv` and `run.json`, beside what others put there."""

import csv
import json
import math
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, TextIO

from vwnav.errors import VwnavError
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import euler_from_rotation, rotation_from_quat
from vwnav.seams import StepResult
from vwnav.types import MapFix, Rejected, RejectReason

COLUMNS = [
    "t_s",
    "lat_deg",
    "lon_deg",
    "north_m",
    "east_m",
    "down_m",
    "vn_m_s",
    "ve_m_s",
    "vd_m_s",
    "roll_deg",
    "pitch_deg",
    "yaw_deg",
    "sigma_n_m",
    "sigma_e_m",
    "sigma_d_m",
    "fix_status",
    "inliers",
    "features",
    "fix_lat_deg",
    "fix_lon_deg",
    "measured_yaw_deg",
    "commanded_yaw_deg",
]


def make_run_folder(wanted: Path | None, kind: str) -> Path:
    """Create `wanted`, or `runs/<kind>-<time>`.

    Raises:
        VwnavError: the folder cannot be made or holds another run.
    """
    folder = wanted or Path("runs") / f"{kind}-{datetime.now():%Y%m%d-%H%M%S}"
    if any((folder / name).exists() for name in ("trajectory.csv", "flight.mcap")):
        raise VwnavError(f"{folder} already holds a run; give another folder with -o")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise VwnavError(f"cannot make the run folder {folder}: {error.strerror}") from error
    return folder


@dataclass
class TrajectoryWriter:
    """Writes one row of `trajectory.csv` per picture, as it happens.

    Until `close` the file is called `trajectory.csv.part`: a killed run keeps its rows, and nobody
    takes them for a whole run.

    Args:
        path: of the CSV.
        local_frame: NED origin of the run.
        t0_s: time of the first picture; `t_s` in the file counts from it.
    """

    path: Path
    local_frame: LocalFrame
    t0_s: float
    _partial: Path = field(init=False)
    _file: TextIO = field(init=False)
    _rows: Any = field(init=False)

    def __post_init__(self) -> None:
        self._partial = self.path.with_suffix(".csv.part")
        self._file = self._partial.open("w", newline="", buffering=1)
        self._rows = csv.DictWriter(self._file, COLUMNS, restval="")
        self._rows.writeheader()

    def write(self, step: StepResult, commanded_yaw_rad: float | None = None) -> None:
        """Append the row of one picture."""
        row: dict[str, object] = {"t_s": f"{step.t_s - self.t0_s:.4f}"}
        if step.estimate is not None:
            row |= self._estimate_cells(step)
        row |= _outcome_cells(step.outcome)
        if commanded_yaw_rad is not None:
            row["commanded_yaw_deg"] = f"{math.degrees(commanded_yaw_rad):.2f}"
        self._rows.writerow(row)

    def _estimate_cells(self, step: StepResult) -> dict[str, str]:
        estimate = step.estimate
        assert estimate is not None
        lat_deg, lon_deg, _ = self.local_frame.to_geodetic(estimate.position_ned_m)
        north_m, east_m, down_m = estimate.position_ned_m
        vn_m_s, ve_m_s, vd_m_s = estimate.velocity_ned_m_s
        angles = euler_from_rotation(rotation_from_quat(estimate.quat_wxyz))
        roll_deg, pitch_deg, yaw_deg = (math.degrees(a) for a in angles)
        sigmas = [math.sqrt(max(estimate.covariance[i, i], 0.0)) for i in range(3)]
        cells = {"lat_deg": f"{float(lat_deg):.8f}", "lon_deg": f"{float(lon_deg):.8f}"}
        metric = (north_m, east_m, down_m, vn_m_s, ve_m_s, vd_m_s, roll_deg, pitch_deg, yaw_deg)
        cells |= {n: f"{v:.3f}" for n, v in zip(COLUMNS[3:15], (*metric, *sigmas), strict=True)}
        return cells

    def close(self) -> None:
        """Finish the file."""
        self._file.close()
        self._partial.replace(self.path)


def _outcome_cells(outcome: MapFix | Rejected) -> dict[str, object]:
    if isinstance(outcome, Rejected):
        tried = outcome.reason is not RejectReason.NOT_TRIED
        cells: dict[str, object] = {"fix_status": outcome.reason.name.lower() if tried else ""}
        return cells | (
            {"inliers": outcome.stats.inliers, "features": outcome.features} if tried else {}
        )
    yaw_rad = outcome.yaw_rad
    return {
        "fix_status": "fix",
        "inliers": outcome.stats.inliers,
        "features": outcome.features,
        "fix_lat_deg": f"{outcome.lat_deg:.8f}",
        "fix_lon_deg": f"{outcome.lon_deg:.8f}",
        "measured_yaw_deg": "" if yaw_rad is None else f"{math.degrees(yaw_rad):.2f}",
    }


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write whole or not at all."""
    partial = path.with_suffix(path.suffix + ".part")
    partial.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n")
    partial.replace(path)
