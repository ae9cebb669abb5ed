"""What is asked of whole flights with rendered images, and verdicts."""

import math
from dataclasses import dataclass

import numpy as np

from vwnav.bench.estimator.flown import Metric, NavigatedFlight, RenderedScenario, Run
from vwnav.bench.estimator.rendered_errors import fix_errors, odometry_errors, parts, way_errors
from vwnav.bench.estimator.scenarios import judge_nominal
from vwnav.bench.estimator.scores import SETTLED_S, position_nees, rms
from vwnav.bench.estimator.world import FilterWorld
from vwnav.estimation.events import NedFix
from vwnav.geometry.rotations import wrap_pi

FIRST_FIXES = 20  # of the climb and the hover after it; then odometry flies alone
IMU_HZ = 50.0  # as asked of the autopilot
WRONG_FIX_M = 20.0
_LEAST_WAY_M = 1.0


def judge_rendered(flown: list[NavigatedFlight]) -> list[Metric]:
    """Accuracy and honesty, and whether the fast benchmark's errors are those of images."""
    attempts = sum(len(flight.outcomes) for flight in flown)
    taken = sum(flight.fixes for flight in flown)
    runs = [flight.run for flight in flown]
    errors_m = np.array(
        [
            event.error_m
            for run in runs
            for event, answer in run.answers
            if isinstance(event.seen, NedFix) and answer.accepted
        ]
    )
    return [
        *judge_nominal(runs),
        *_unseen(runs),
        Metric("fixes accepted, of attempts", 100.0 * taken / max(attempts, 1), "%"),
        Metric("fix error, RMS, tilt left aside", rms(errors_m), "m"),
        Metric("fix error, 95 %", float(np.quantile(errors_m, 0.95)), "m"),
        Metric("accepted fixes over 20 m wrong", float(np.sum(errors_m > WRONG_FIX_M)), "",
               None, 0.0),
        *_fix_model(runs),
        *_odometry_model(runs),
    ]  # fmt: skip


def _unseen(runs: list[Run]) -> list[Metric]:
    """Whether the filter knows its heading and height, which nothing else asks."""
    rows = [run.rows for run in runs]
    yaw = np.concatenate(
        [((r.error_yaw_rad / r.sigma_yaw_rad) ** 2)[r.t_s > SETTLED_S] for r in rows]
    )
    agl = np.concatenate([((r.error_agl_m / r.sigma_agl_m) ** 2)[r.t_s > SETTLED_S] for r in rows])
    return [
        Metric("NEES of heading (1) mean", float(np.mean(yaw))),
        Metric("NEES of AGL (1) mean", float(np.mean(agl))),
    ]


def _assumed(field: str) -> str:
    return f"{field} ({getattr(FilterWorld(), field):g} assumed)"


def _fix_model(runs: list[Run]) -> list[Metric]:
    """Beside each error the one that the fast benchmark assumes."""
    flights = [errors for errors in map(fix_errors, runs) if len(errors.yaw_rad) > 1]
    place = parts([flight.ne_m for flight in flights])
    yaw = parts([np.degrees(flight.yaw_rad) for flight in flights])
    agl = parts([flight.agl_ratio for flight in flights])
    return [
        Metric(_assumed("fix_sigma_m"), place.white, "m"),
        Metric(_assumed("map_error_m"), place.slow, "m"),
        Metric(_assumed("fix_yaw_deg"), yaw.white, "deg"),
        Metric(_assumed("map_turn_deg"), yaw.slow, "deg"),
        Metric(_assumed("fix_agl_ratio"), agl.white),
        Metric(_assumed("map_scale"), agl.slow),
    ]


def _odometry_model(runs: list[Run]) -> list[Metric]:
    flights = [way_errors(run) for run in runs]
    found = odometry_errors(flights)
    nees = np.concatenate([flight.nees for flight in flights])
    return [
        Metric(_assumed("odometry_sigma"), found.image),
        Metric("odometry_sigma, keyframe's end", found.kept),
        Metric("odometry_sigma, vertical", found.image_down),
        Metric("odometry_sigma, vertical, its end", found.kept_down),
        Metric(_assumed("odometry_yaw_rad"), found.yaw_image_rad, "rad"),
        Metric("odometry_yaw_rad, keyframe's end", found.yaw_kept_rad, "rad"),
        Metric(_assumed("tilt_in_odometry"), found.tilt),
        Metric("scale error of the way (0 assumed)", 100.0 * found.scale, "%"),
        Metric("NEES of the way by itself (3)", float(np.mean(nees))),
    ]


@dataclass(frozen=True, slots=True)
class _DriftSinceFix:
    """Of one flight since its last fix; `end` and `worst` errors in percent of the way."""

    way_m: float
    end: float
    worst: float
    turned_deg: float
    agl: float
    nees: float


def _drift(run: Run) -> _DriftSinceFix | None:
    """None where no fix was taken, or nothing was flown after the last."""
    rows, last_s = run.rows, run.estimates[-1].t_last_fix_s
    after = np.flatnonzero(rows.t_s >= (np.inf if last_s is None else last_s))
    if not len(after) or rows.way_m[-1] - rows.way_m[after[0]] < _LEAST_WAY_M:
        return None
    way_m = float(rows.way_m[-1] - rows.way_m[after[0]])
    error = 100.0 * np.hypot(*rows.error_ne_m.T)[after] / way_m
    return _DriftSinceFix(
        way_m=way_m,
        end=float(error[-1]),
        worst=float(np.max(error)),
        turned_deg=math.degrees(wrap_pi(rows.error_yaw_rad[-1] - rows.error_yaw_rad[after[0]])),
        agl=100.0 * float(rows.error_agl_m[-1] / rows.agl_m[-1]),
        nees=float(position_nees(rows)[-1]),
    )


def judge_odometry(flown: list[NavigatedFlight]) -> list[Metric]:
    """Drift since the last fix in percent of the way, and whether the filter knows of it."""
    found = [_drift(flight.run) for flight in flown]
    drifts = [drift for drift in found if drift is not None]
    each = [metric for k, drift in enumerate(found, 1) for metric in _drift_metrics(k, drift)]
    if not drifts:
        return each
    ends, nees = np.array([d.end for d in drifts]), np.array([d.nees for d in drifts])
    return [
        Metric("error at the end, RMS", rms(ends), "% of way", None, 1.0),
        Metric("the worst flight's end", float(np.max(ends)), "% of way", None, 1.0),
        Metric("the worst anywhere", max(d.worst for d in drifts), "% of way"),
        Metric("heading drift, RMS", rms(np.array([d.turned_deg for d in drifts])), "deg"),
        Metric("AGL error at the end, RMS", rms(np.array([d.agl for d in drifts])), "%"),
        Metric("NEES at the end, mean (2)", float(np.mean(nees)), "", None, 3.0),
        Metric("covered by the 3-sigma ellipse", 100.0 * float(np.mean(nees < 9.0)), "%"),
        *each,
    ]


def _drift_metrics(number: int, drift: _DriftSinceFix | None) -> list[Metric]:
    """Of one flight."""
    if drift is None:
        return [Metric(f"flight {number}: drift after a fix measured", 0.0, "", 1.0)]
    name = f"flight {number}, {drift.way_m:.0f} m"
    return [
        Metric(f"{name}: error at its end", drift.end, "% of way", None, 1.0),
        Metric(f"{name}: at its worst", drift.worst, "% of way"),
        Metric(f"{name}: heading drifted by", drift.turned_deg, "deg"),
        Metric(f"{name}: AGL error at its end", drift.agl, "%"),
        Metric(f"{name}: NEES at its end (2)", drift.nees),
    ]


RENDERED = (
    RenderedScenario("rendered", judge_rendered),
    RenderedScenario("rendered-imu", judge_rendered, imu_hz=IMU_HZ),
    RenderedScenario("rendered-odometry", judge_odometry, FIRST_FIXES),
    RenderedScenario("rendered-odometry-imu", judge_odometry, FIRST_FIXES, IMU_HZ),
)
