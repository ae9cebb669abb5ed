"""The report in one figure (needs matplotlib, the eval extra)."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from vwnav.bench.features.run import ALL, Report
from vwnav.bench.features.scoring import FeatureScore
from vwnav.bench.figures import pyplot, save

_COLOURS = (
    "#1b6ca8", "#63a4d8", "#0f8b6d", "#7cc8b0", "#b0752a", "#e0b476", "#8a8a8a", "#c23b3b",
    "#7b3fa0", "#c79be0", "#222222", "#d6c22b",
)  # fmt: skip


def write_plot(path: Path, report: Report) -> None:
    """Inliers, places found, AUC by group, and inliers against time.

    Raises:
        VwnavError: matplotlib is not installed.
    """
    figure, axes = pyplot().subplots(2, 2, figsize=(14.0, 8.5), layout="constrained")
    _bars(axes[0, 0], report, "Inliers", lambda s: s.inliers)
    _bars(axes[0, 1], report, "Located within 3 m or px, %", lambda s: 100.0 * s.located_near)
    _bars(
        axes[1, 0],
        report,
        "AUC of corner error at 3 px, %",
        lambda s: None if s.auc is None else 100.0 * s.auc["3_px"],
    )
    _cost(axes[1, 1], report)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)
    save(figure, path)


def _bars(
    axis: Any, report: Report, title: str, value: Callable[[FeatureScore], float | None]
) -> None:
    """Bars of every feature set, side by side for each group that has the value."""
    names = [each.name for each in report.sets]
    groups = [
        group
        for group, scores in report.groups.items()
        if group != ALL and all(value(score) is not None for score in scores.values())
    ]
    width = 0.84 / len(names)
    for index, name in enumerate(names):
        heights = [value(report.groups[group][name]) for group in groups]
        places = [k + (index - (len(names) - 1) / 2.0) * width for k in range(len(groups))]
        axis.bar(places, heights, width, label=name, color=_COLOURS[index % len(_COLOURS)])
    axis.set_xticks(
        range(len(groups)), [group.replace("_", "\n", 1) for group in groups], size="small"
    )
    axis.set_title(title, loc="left")
    axis.spines[["top", "right"]].set_visible(False)


def _cost(axis: Any, report: Report) -> None:
    """Inliers over all scenes against the time of the larger image."""
    size = list(report.timing)[-1]
    for index, each in enumerate(report.sets):
        x, y = report.timing[size][each.name].extract_cpu_ms, report.groups[ALL][each.name].inliers
        axis.scatter(x, y, s=70, color=_COLOURS[index % len(_COLOURS)], zorder=3)
        above = 6 if index % 2 else -14  # two precisions of one size lie side by side
        axis.annotate(each.name, (x, y), xytext=(5, above), textcoords="offset points")
    axis.set_xscale("log")
    axis.set_xlabel(f"extraction of {size}, ms of one core")
    axis.set_title("Inliers over all scenes", loc="left")
    axis.grid(alpha=0.3)
    axis.margins(x=0.2)
    axis.spines[["top", "right"]].set_visible(False)
