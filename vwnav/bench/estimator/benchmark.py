"""The benchmark of the filter: all scenarios, their verdicts, recordings and plots."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vwnav.bench.estimator.flown import Metric, Run
from vwnav.bench.estimator.plots import save_nees_plot, save_yaw_plot, save_yaw_table
from vwnav.bench.estimator.record import load_stream, save_stream
from vwnav.bench.estimator.run import play
from vwnav.bench.estimator.scenarios import FilterScenario, fly_scenario

LAMBDA = 0.5

Say = Callable[[str], None]


def bench(
    scenario: FilterScenario, runs: int, seed: int, folder: Path | None, say: Say
) -> list[Metric]:
    """Fly one scenario and judge it; recordings and plots go to the folder.

    Raises:
        VwnavError: plots or recordings are wanted and their packages are missing.
    """
    flown = fly_scenario(scenario, runs, seed, say)
    metrics = scenario.judge(flown)
    if folder is not None:
        same = _replays_alike(flown[0], scenario, folder / f"{scenario.name}.mcap")
        metrics.append(Metric("replays bit for bit from MCAP", float(same), "", 1.0, None))
        if scenario.name.startswith(("nominal", "outage")):
            save_nees_plot(flown, folder / f"{scenario.name}.png")
    if scenario.name == "turns":
        metrics += _with_lambda(flown[0], scenario, runs, seed, folder)
    return metrics


def _replays_alike(run: Run, scenario: FilterScenario, path: Path) -> bool:
    path.unlink(missing_ok=True)
    save_stream(run.stream, path)
    again = play(load_stream(path, run.stream.truth), scenario.config)
    return all(
        a.t_s == b.t_s
        and np.array_equal(a.position_ned_m, b.position_ned_m)
        and np.array_equal(a.velocity_ned_m_s, b.velocity_ned_m_s)
        and np.array_equal(a.quat_wxyz, b.quat_wxyz)
        and np.array_equal(a.covariance, b.covariance)
        for a, b in zip(run.estimates, again.estimates, strict=True)
    )


def _with_lambda(
    plain: Run, scenario: FilterScenario, runs: int, seed: int, folder: Path | None
) -> list[Metric]:
    """The effect of the thesis' correction on the same flights, of which `plain` is the first."""
    config = replace(scenario.config, visual_weight=LAMBDA)
    pulled = fly_scenario(replace(scenario, config=config), runs, seed)
    if folder is not None:
        save_yaw_table(plain, pulled[0], folder / "yaw.csv")
        save_yaw_plot(plain, pulled[0], folder / "yaw.png")
    return [
        replace(metric, name=f"lambda {LAMBDA}: {metric.name}", low=None, high=None)
        for metric in scenario.judge(pulled)
    ]


def as_json(metrics: list[Metric]) -> dict[str, Any]:
    """By name: value, unit, what is asked and whether it is reached."""
    return {
        m.name: {"value": m.value, "unit": m.unit, "low": m.low, "high": m.high, "good": m.good}
        for m in metrics
    }
