"""How far a replayed trajectory has drifted from a track that somebody else made.

With `pipeline.most_fixes = 1` in the settings of the replay, place, height and heading are those of
one fix, and odometry goes on alone from there.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vwnav.errors import SourceError
from vwnav.files.tables import named_rows
from vwnav.geometry.geodesy import LocalFrame
from vwnav.types import Array

_LEAST_PLACES = 3
_LEAST_WAY_M = 1.0


@dataclass(frozen=True, slots=True)
class Drift:
    """Of a trajectory against a track, from their first common moment on.

    Attributes:
        way_m: length of the track.
        end_ratio, worst_ratio: distance from the track at its end and at the worst, of `way_m`.
        scale, turn_rad: by which the trajectory would have to be multiplied and turned, clockwise
            positive, about its start to fit best.
    """

    way_m: float
    end_ratio: float
    worst_ratio: float
    scale: float
    turn_rad: float


def drift(flown_ne_m: Array, track_ne_m: Array) -> Drift:
    """Compare places (n, 2), north and east, of the same moments."""
    flown = flown_ne_m @ np.array([1.0, 1.0j])
    track = track_ne_m @ np.array([1.0, 1.0j])
    way_m = float(np.sum(np.abs(np.diff(track))))
    apart_m = np.abs(flown - track)
    from_start = flown - flown[0]
    fit = np.vdot(from_start, track - track[0]) / np.vdot(from_start, from_start)
    return Drift(
        way_m,
        float(apart_m[-1]) / way_m,
        float(np.max(apart_m)) / way_m,
        float(np.abs(fit)),
        math.atan2(fit.imag, fit.real),
    )


def compare(trajectory: Path, track: Path) -> Drift:
    """Read both and compare them at the track's moments.

    Raises:
        SourceError: a file cannot be read or is no such table, they share too few moments, or
            nothing moves.
    """
    t0_s, lat_lon0 = _read(trajectory)
    t1_s, lat_lon1 = _read(track)
    shared = (t1_s >= t0_s[0]) & (t1_s <= t0_s[-1])
    if np.count_nonzero(shared) < _LEAST_PLACES:
        raise SourceError(f"{trajectory} and {track} share too few moments")
    frame = LocalFrame(float(lat_lon1[0, 0]), float(lat_lon1[0, 1]), 0.0)
    flown, seen = (
        np.array([frame.to_ned(lat, lon, 0.0)[:2] for lat, lon in table])
        for table in (lat_lon0, lat_lon1[shared])
    )
    if min(np.ptp(flown, axis=0).max(), np.ptp(seen, axis=0).max()) < _LEAST_WAY_M:
        raise SourceError(f"{trajectory} or {track} hardly moves: there is no way to drift on")
    at = [np.interp(t1_s[shared], t0_s, flown[:, i]) for i in (0, 1)]
    return drift(np.column_stack(at), seen)


def _read(path: Path) -> tuple[Array, Array]:
    """Times (n,) and lat, lon (n, 2) of the rows that have them."""
    try:
        with path.open(newline="") as file:
            rows = [row for _, row in named_rows(file, path, SourceError)[1]]
    except (OSError, UnicodeDecodeError) as error:
        raise SourceError(f"cannot read {path}: {error}") from error
    try:
        table = [
            [float(_either(row, name)) for name in ("t", "lat", "lon")]
            for row in rows
            if _either(row, "lat") != ""
        ]
    except (KeyError, ValueError) as error:
        raise SourceError(f"{path} has no columns of time, latitude and longitude") from error
    if not table:
        raise SourceError(f"{path} holds no places")
    values = np.array(table)
    return values[:, 0], values[:, 1:]


def _either(row: dict[str, str], name: str) -> str:
    long = {"t": "t_s", "lat": "lat_deg", "lon": "lon_deg"}[name]
    return row[long] if long in row else row[name]
