"""Images and tables of the filter's benchmark; matplotlib is loaded when one is drawn."""

import csv
from pathlib import Path

import numpy as np

from vwnav.bench.estimator.flown import Run
from vwnav.bench.estimator.run import heading
from vwnav.bench.estimator.scores import chi_square_bounds, position_nees
from vwnav.bench.figures import pyplot, save
from vwnav.types import Array, OdometryMotion

_SETTLING_S = 15.0  # errors before that do not set the scale
_YAW_COLUMNS = (
    "t_s", "commanded_yaw_deg", "true_yaw_deg", "measured_yaw_deg", "compass_yaw_deg",
    "estimated_yaw_deg", "estimated_yaw_lambda_deg",
)  # fmt: skip


def save_nees_plot(runs: list[Run], path: Path) -> None:
    """Mean normalised error squared over time with its 95 % bounds, and the errors' sizes."""
    plt = pyplot()
    rows = runs[0].rows
    nees = np.mean([position_nees(run.rows) for run in runs], axis=0)
    low, high = chi_square_bounds(2, len(runs))
    figure, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(9, 6))
    top.plot(rows.t_s, nees, lw=0.8)
    top.axhspan(low, high, color="0.85")
    top.set(ylabel="NEES, north and east", ylim=(0.0, 6.0))
    squares = np.mean([np.sum(run.rows.error_ne_m**2, axis=1) for run in runs], axis=0)
    sigmas = np.mean([run.rows.P[:, 0, 0] + run.rows.P[:, 1, 1] for run in runs], axis=0)
    bottom.plot(rows.t_s, np.sqrt(squares), label="RMS error", lw=0.8)
    bottom.plot(rows.t_s, np.sqrt(sigmas), label="the filter's sigma", lw=0.8)
    bottom.set(xlabel="s", ylabel="m", ylim=(0.0, None))
    bottom.legend()
    save(figure, path)


def save_error_plot(run: Run, path: Path) -> None:
    """Errors of one flight over time with the filter's sigma about them."""
    plt = pyplot()
    rows = run.rows
    panels = (
        ("north, m", rows.error_ne_m[:, 0], np.sqrt(rows.P[:, 0, 0])),
        ("east, m", rows.error_ne_m[:, 1], np.sqrt(rows.P[:, 1, 1])),
        ("heading, deg", np.degrees(rows.error_yaw_rad), np.degrees(rows.sigma_yaw_rad)),
        ("height above ground, m", rows.error_agl_m, rows.sigma_agl_m),
    )
    figure, axes = plt.subplots(len(panels), 1, sharex=True, figsize=(9, 10))
    for axis, (name, error, sigma) in zip(axes, panels, strict=True):
        axis.fill_between(rows.t_s, -sigma, sigma, color="0.85", label="1 sigma")
        axis.plot(rows.t_s, error, lw=0.8, label="error")
        span = 1.2 * max(float(np.max(np.abs(error[rows.t_s > _SETTLING_S]), initial=0.1)), 0.1)
        axis.set(ylabel=name, ylim=(-span, span))
    axes[0].legend()
    axes[-1].set(xlabel="s")
    save(figure, path)


def save_yaw_table(run: Run, with_lambda: Run, path: Path) -> None:
    """The figure's numbers; angles in degrees, unwrapped so that turns read as turns."""
    columns = _yaw_columns(run, with_lambda)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(_YAW_COLUMNS)
        writer.writerows([f"{value:.3f}" for value in row] for row in columns)


def save_yaw_plot(run: Run, with_lambda: Run, path: Path) -> None:
    """Figure 6.20 of the thesis: commanded, measured and estimated heading, and their errors."""
    plt = pyplot()
    t_s, commanded, true, measured, _, estimated, lambda_ = _yaw_columns(run, with_lambda).T
    figure, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(9, 6))
    top.plot(t_s, commanded, "k--", lw=0.8, label="commanded")
    top.plot(t_s, measured, lw=0.8, label="measured (pictures)")
    top.plot(t_s, estimated, lw=1.0, label="estimated")
    top.set(ylabel="heading, deg")
    top.legend()
    bottom.plot(t_s, measured - true, lw=0.8, label="measured")
    bottom.plot(t_s, estimated - true, lw=1.0, label="estimated")
    bottom.plot(t_s, lambda_ - true, lw=0.8, label="estimated, lambda 0.5 (eq. 3.30)")
    bottom.set(xlabel="s", ylabel="error, deg")
    bottom.legend()
    save(figure, path)


def _yaw_columns(run: Run, with_lambda: Run) -> Array:
    """(n, 7) of `_YAW_COLUMNS`."""
    truth, rows = run.stream.truth, run.rows
    at = np.array([truth.index(t) for t in rows.t_s])
    true = truth.yaw_rad[at]

    def near(yaw_rad: Array) -> Array:
        return np.asarray(true + np.mod(yaw_rad - true + np.pi, 2.0 * np.pi) - np.pi)

    columns = [
        near(truth.commanded_yaw_rad[at]),
        true,
        near(_turned_by_images(run)),
        near(run.stream.measured_yaw_rad[at]),
        near(np.array([heading(e) for e in run.estimates])),
        near(np.array([heading(e) for e in with_lambda.estimates])),
    ]
    return np.column_stack([rows.t_s, *(np.degrees(c) for c in columns)])


def _turned_by_images(run: Run) -> Array:
    """(n,) heading as the homographies alone count it, from the true one at the first image."""
    truth = run.stream.truth
    times: list[float] = []
    yaws: list[float] = []
    key_s, key_yaw = -1.0, 0.0
    for event, _ in run.answers:
        motion = event.seen
        if not isinstance(motion, OdometryMotion):
            continue
        if motion.t0_s != key_s:
            known = bool(times) and times[-1] == motion.t0_s
            key_yaw = yaws[-1] if known else float(truth.yaw_rad[truth.index(motion.t0_s)])
            key_s = motion.t0_s
        times.append(motion.t1_s)
        yaws.append(key_yaw + motion.yaw_increment_rad)
    return np.interp(run.rows.t_s, times, np.unwrap(yaws))
