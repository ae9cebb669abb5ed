"""The report as one JSON object, and as tables for a person."""

from collections.abc import Iterator
from dataclasses import asdict

from rich.box import SIMPLE_HEAD
from rich.table import Table

from vwnav.bench.cells import number, percent, rounded
from vwnav.bench.features import flight_scenes, pair_scenes, scoring, thesis, timing
from vwnav.bench.features.macs import SIZE_WH
from vwnav.bench.features.run import Report
from vwnav.bench.features.scoring import FeatureScore
from vwnav.bench.features.timing import Times


def as_json(report: Report) -> dict[str, object]:
    """Plain values; `docs/benchmarks.md` says what each means."""
    w, h = SIZE_WH
    return {
        "protocol": {
            "pair_keypoints": pair_scenes.KEYPOINTS,
            "flight_keypoints": flight_scenes.KEYPOINTS,
            "right_px": scoring.RIGHT_PX,
            "fit_px": scoring.FIT_PX,
            "near": scoring.NEAR,
            "far": scoring.FAR,
            "timing_keypoints": timing.KEYPOINTS,
            "thesis_keypoints": thesis.KEYPOINTS,
        },
        "networks": {
            each.name: {"parameters": each.cost.parameters, f"macs_{w}x{h}": each.cost.macs}
            for each in report.sets
            if each.cost is not None
        },
        "groups": {
            name: {
                "unit": report.units.get(name),
                "methods": {method: rounded(asdict(score)) for method, score in scores.items()},
            }
            for name, scores in report.groups.items()
        },
        "timing": {
            size: {name: rounded(asdict(times)) for name, times in of_size.items()}
            for size, of_size in report.timing.items()
        },
        "thesis": {name: rounded(asdict(row)) for name, row in report.thesis.items()},
        "skipped": report.skipped,
    }


def tables(report: Report) -> Iterator[Table]:
    """One for each group, one for cost and time, one for the thesis."""
    for name, scores in report.groups.items():
        yield _group_table(name, report.units.get(name, ""), scores)
    yield _cost_table(report)
    yield _thesis_table(report)


def _group_table(name: str, unit: str, scores: dict[str, FeatureScore]) -> Table:
    scenes = next(iter(scores.values())).scenes
    columns = ["points", "matches", "inliers", "right %", "error px", "rep %", "+chance"]
    columns += ["AUC@1", "AUC@3", "AUC@5"]
    columns += [f"{what} {unit}".strip() for what in ("<3", "<8", "off")]
    table = _table(f"{name}: {scenes} scenes", ["features", *columns])
    for method, each in scores.items():
        auc = [None] * 3 if each.auc is None else list(each.auc.values())
        table.add_row(
            method,
            f"{each.keypoints:.0f}",
            f"{each.matches:.0f}",
            f"{each.inliers:.1f}",
            percent(each.precision),
            number(each.reprojection_px),
            percent(each.repeatability),
            percent(each.repeated_above_chance),
            *(percent(area) for area in auc),
            percent(each.located_near),
            percent(each.located_far),
            number(each.place_error),
        )
    return table


def _cost_table(report: Report) -> Table:
    columns = ["features", "parameters", "MMAC"]
    for size in report.timing:
        columns += [f"{size} ms", "/ SIFT", "/ XFeat", "match ms"]
    table = _table("Cost: one thread, processor time, medians", columns)
    for each in report.sets:
        cost = each.cost
        row = [each.name]
        row += ["-", "-"] if cost is None else [f"{cost.parameters:,}", f"{cost.macs / 1e6:,.0f}"]
        for of_size in report.timing.values():
            row += _time_cells(of_size[each.name])
        table.add_row(*row)
    return table


def _time_cells(times: Times) -> list[str]:
    return [
        f"{times.extract_cpu_ms:.1f}",
        number(times.extract_cpu_to_sift),
        number(times.extract_cpu_to_xfeat),
        f"{times.match_cpu_ms:.1f}",
    ]


def _thesis_table(report: Report) -> Table:
    columns = ["features", "points per image", "ms", "matched", "match %", "ms with matching"]
    table = _table(f"Thesis tables 6.1 and 6.2: {thesis.KEYPOINTS} keypoints", columns)
    for name, row in report.thesis.items():
        table.add_row(
            name,
            f"{row.points_per_image:.0f}",
            f"{row.extract_ms:.1f}",
            f"{row.matched_per_image:.1f}",
            f"{100.0 * row.match_ratio:.2f}",
            f"{row.match_ms:.1f}",
        )
    return table


def _table(title: str, columns: list[str]) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for index, column in enumerate(columns):
        table.add_column(column, justify="left" if index == 0 else "right", no_wrap=True)
    return table
