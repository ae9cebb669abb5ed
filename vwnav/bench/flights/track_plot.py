"""The image of a flight's track: truth, estimate, where it broke, where it landed, modes."""

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from vwnav.bench.figures import pyplot
from vwnav.bench.flights.track import FlightTrace
from vwnav.types import Array

_SHADES = {
    "OFFBOARD": "#dbe9f6", "TAKEOFF": "#e5f5e0", "HOLD": "#fff3c4", "LAND": "#fde0dd",
    "DESCEND": "#f4a6a0", "RETURN": "#e7d4e8", "POSITION": "#d9d9d9",
}  # fmt: skip
_OTHER_SHADE = "#f0f0f0"
_TITLE_CHARS = 150


def save_track(
    track: FlightTrace, begun_s: float, broke_s: float | None, title: str, path: Path
) -> None:
    """Draw it seen from above, and height and error over time with the modes shaded.

    Args:
        track: of the flight; its places are about where the aircraft stood.
        begun_s: when the mission began, on the track's clock.
        broke_s: when something broke, since then; None: nothing did.
        title: above the image.
        path: of the PNG.

    Raises:
        VwnavError: matplotlib is missing.
    """
    plt = pyplot()
    figure, axes = plt.subplot_mosaic(
        [["above", "height"], ["above", "error"]], figsize=(13, 6.5), width_ratios=(1.0, 1.2)
    )
    _draw_from_above(axes["above"], track, None if broke_s is None else broke_s + begun_s)
    _draw_height(axes["height"], track, begun_s)
    _draw_error(axes["error"], track, begun_s)
    changes = [(each.t_s - begun_s, each.text) for each in track.modes()]
    end_s = track.truth[-1].t_s - begun_s
    for axis in (axes["height"], axes["error"]):
        shade_modes(axis, changes, end_s)
        if broke_s is not None:
            axis.axvline(broke_s, color="tab:red", lw=1)
        axis.set(xlim=(0.0, end_s))
    axes["height"].legend(fontsize=7, ncols=4)
    figure.suptitle(textwrap.fill(title, _TITLE_CHARS), fontsize=10)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_from_above(axis: Any, track: FlightTrace, broke_s: float | None) -> None:
    true = np.array([each.position_ned_m for each in track.truth])
    axis.plot(true[:, 1], true[:, 0], "k", lw=1.2, label="truth")
    sent = _sent_places(track)
    if len(sent):
        axis.plot(sent[:, 2], sent[:, 1], ".", color="tab:blue", ms=2, label="estimate sent")
    if broke_s is not None:
        north, east, _ = track.truth_at(broke_s).position_ned_m
        axis.plot(east, north, "X", color="tab:red", ms=11, label="it breaks")
    last = track.truth[-1]
    label = "down" if last.on_ground else "still flying"
    axis.plot(last.position_ned_m[1], last.position_ned_m[0], "^", color="k", ms=9, label=label)
    axis.plot(0.0, 0.0, "s", color="tab:green", ms=7, label="origin")
    axis.set(xlabel="east, m", ylabel="north, m")
    axis.set_aspect("equal", adjustable="datalim")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)


def _draw_height(axis: Any, track: FlightTrace, begun_s: float) -> None:
    times = np.array([each.t_s for each in track.truth]) - begun_s
    axis.plot(times, [-each.position_ned_m[2] for each in track.truth], "k", label="truth")
    sent = _sent_places(track)
    if len(sent):
        axis.plot(sent[:, 0] - begun_s, -sent[:, 3], ".", color="tab:blue", ms=2, label="estimate")
    axis.set(ylabel="height, m")


def _draw_error(axis: Any, track: FlightTrace, begun_s: float) -> None:
    axis.set(xlabel="time, s", ylabel="off by, m")
    sent = _sent_places(track)
    if not len(sent):
        return
    estimates = track.heard.estimates
    true = np.array([track.truth_at(each.stamp_s).position_ned_m for each in estimates])
    off_m = np.hypot(*(sent[:, 1:3] - true[:, :2]).T)
    sigma_m = [np.sqrt(nn + ee) for nn, _, ee in (each.covariance_ne_m2 for each in estimates)]
    axis.plot(sent[:, 0] - begun_s, off_m, ".", ms=2, label="estimate sent, horizontally")
    axis.plot(sent[:, 0] - begun_s, sigma_m, ".", ms=1, color="0.5", label="its sigma")
    axis.legend(fontsize=8)


def shade_modes(axis: Any, changes: list[tuple[float, str]], end_s: float) -> None:
    """Shade the flown modes behind a plot over time; `changes` are (time in s, its name)."""
    labelled: set[str] = set()
    for i, (since_s, name) in enumerate(changes):
        until_s = changes[i + 1][0] if i + 1 < len(changes) else end_s
        label = None if name in labelled else name.title()
        labelled.add(name)
        axis.axvspan(since_s, until_s, color=_SHADES.get(name, _OTHER_SHADE), lw=0, label=label)


def _sent_places(track: FlightTrace) -> Array:
    """(n, 4) arrival, north, east, down of every estimate sent."""
    rows = [(each.t_s, *each.position_ned_m) for each in track.heard.estimates]
    return np.array(rows, np.float64).reshape(-1, 4)
