"""Figures 6.3 to 6.11 of the thesis, flown by vwnav: altitude, position, heading, modes shaded."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vwnav.bench.figures import pyplot
from vwnav.bench.flights.thesis.samples import Reference, Sample, columns
from vwnav.bench.flights.thesis.tests import FlightTest
from vwnav.bench.flights.track_plot import shade_modes

_TRUE, _ESTIMATED, _FUSED = "k", "tab:blue", "tab:orange"


def save_plots(
    test: FlightTest, samples: Sequence[Sample], folder: Path, by: Reference = "true"
) -> list[str]:
    """Draw three; their names in the folder. Where it landed is `by` whose word.

    Raises:
        VwnavError: matplotlib is missing.
    """
    draws = (_altitude, _position, _heading)
    names = [f"{test.name}_{kind}.png" for kind in ("altitude", "position", "yaw")]
    plt = pyplot()
    for draw, name, figure_number in zip(draws, names, test.figures, strict=True):
        figure, axis = plt.subplots(figsize=(9, 5))
        draw(axis, samples, by)
        manners = test.scenario.setup.manners
        axis.set_title(f"{test.name} ({manners}), as figure {figure_number} of the thesis, no GPS")
        axis.legend(fontsize=8)
        axis.grid(alpha=0.3)
        figure.tight_layout()
        figure.savefig(folder / name, dpi=120)
        plt.close(figure)
    return names


def _altitude(axis: Any, samples: Sequence[Sample], _: Reference) -> None:
    t_s, true, estimated, fused, pressure = columns(
        samples, "t_s", "true_up_m", "estimated_up_m", "fused_up_m", "barometer_up_m"
    ).T
    axis.plot(t_s, pressure, color="0.6", lw=0.8, label="barometer")
    axis.plot(t_s, fused, color=_FUSED, lw=1.0, label="autopilot's fusion")
    axis.plot(t_s, estimated, color=_ESTIMATED, lw=1.0, label="vwnav's estimate")
    axis.plot(t_s, true, color=_TRUE, lw=1.0, label="truth")
    axis.set(xlabel="time, s", ylabel="height above the start, m")
    _shade(axis, samples)


def _position(axis: Any, samples: Sequence[Sample], by: Reference) -> None:
    high_m = columns(samples, f"{by}_up_m")[:, 0]
    flying = [each for each, up_m in zip(samples, high_m, strict=True) if up_m > 1.0]
    for kind, color, label in (
        ("fused", _FUSED, "autopilot's fusion"),
        ("estimated", _ESTIMATED, "vwnav's estimate"),
        ("true", _TRUE, "truth"),
    ):
        north, east = columns(flying, f"{kind}_north_m", f"{kind}_east_m").T
        axis.plot(east, north, color=color, lw=1.0, label=label)
    axis.plot(0.0, 0.0, "s", color="tab:green", label="start")
    landed = columns(samples[-1:], f"{by}_east_m", f"{by}_north_m")[0]
    axis.plot(*landed, "k^", label="landed")
    axis.set(xlabel="east, m", ylabel="north, m")
    axis.set_aspect("equal", adjustable="datalim")


def _heading(axis: Any, samples: Sequence[Sample], _: Reference) -> None:
    t_s = columns(samples, "t_s")[:, 0]
    for kind, style, label in (
        ("commanded", {"color": "tab:red", "ls": "--"}, "commanded"),
        ("estimated", {"color": _ESTIMATED}, "vwnav's estimate"),
        ("true", {"color": _TRUE}, "truth"),
    ):
        yaw_deg = columns(samples, f"{kind}_yaw_deg")[:, 0]
        axis.plot(t_s, _unwrapped(yaw_deg), lw=1.0, label=label, **style)
    axis.set(xlabel="time, s", ylabel="heading, degrees")
    _shade(axis, samples)


def _unwrapped(yaw_deg: "np.ndarray[Any, Any]") -> "np.ndarray[Any, Any]":
    """Turns read as turns: a break of the line where it passes south."""
    broken = yaw_deg.copy()
    broken[1:][np.abs(np.diff(yaw_deg)) > 180.0] = np.nan
    return broken


def _shade(axis: Any, samples: Sequence[Sample]) -> None:
    changes = [(samples[0].t_s, samples[0].mode)]
    for each in samples:
        if each.mode != changes[-1][1]:
            changes.append((each.t_s, each.mode))
    shade_modes(axis, changes, samples[-1].t_s)
    axis.set(xlim=(samples[0].t_s, samples[-1].t_s))
