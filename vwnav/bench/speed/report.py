"""The report as one JSON object, as tables for a person, and as a settings file."""

import os
from collections.abc import Iterator
from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import Any

import tomli_w
from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table

from vwnav.bench.cells import rounded
from vwnav.bench.speed import accuracy
from vwnav.bench.speed.choice import described, words
from vwnav.bench.speed.projection import BOARDS
from vwnav.bench.speed.results import SpeedReport, TimedSetting
from vwnav.errors import ConfigError
from vwnav.files.whole import write_whole

_HEAD = "# Chosen by `vwnav bench speed`"  # begins what is written; only that is written over

# Chapter 7 of the thesis: its whole navigation on a Raspberry Pi 4, images a second.
THESIS_HZ = {"sift": "17", "orb": "17", "XFeat": "below 1"}


def as_json(report: SpeedReport) -> dict[str, Any]:
    """Plain values; `docs/benchmarks.md` says what each means."""
    chosen = report.chosen
    return {
        "machine": report.machine,
        "cores": report.cores,
        "target_hz": report.wanted.target_hz,
        "repeats": report.wanted.repeats,
        "settings": [_row_json(row) for row in report.rows],
        "accuracy_source": accuracy.source(),
        "chosen": None
        if chosen is None
        else {
            **_row_json(chosen.timed),
            "latency": rounded(asdict(chosen.latency)),
            "config": chosen.timed.setting.as_config(report.wanted.target_hz),
            "words": list(words(chosen, report.rows, report.wanted.target_hz, report.cores)),
        },
        "projection": [rounded(asdict(each)) for each in report.projected],
        "thesis_hz": THESIS_HZ,
        "before": [asdict(check) for check in report.before],
        "after": [asdict(check) for check in report.after],
        "skipped": report.skipped,
    }


def _row_json(row: TimedSetting) -> dict[str, Any]:
    return {
        "features": row.setting.label,
        "size": row.setting.size,
        "keypoints": row.setting.keypoints,
        "threads": row.setting.features.threads,
        "time": rounded(asdict(row.time)),
        "accuracy": None if row.accuracy is None else asdict(row.accuracy),
    }


def tables(report: SpeedReport) -> Iterator[Group]:
    """Settings, the thesis beside, the projection; each fits into 80 columns."""
    yield _settings_table(report)
    yield _thesis_table(report)
    if report.projected:
        yield _projection_table(report)


def _settings_table(report: SpeedReport) -> Group:
    title = (
        f"One picture located on the map, ms ({report.wanted.repeats} pictures a row; "
        f"{report.machine}, {report.cores} cores).\n"
        "kp: keypoints, thr: threads; within 3 m and inliers are of a real flight."
    )
    names = ["features", "size", "kp", "thr", "p50", "p99", "Hz", "extr", "match", "ver"]
    table = _table([*names, "3 m", "inl"])
    before = ""
    for row in report.rows:
        time, known = row.time, row.accuracy
        label = row.setting.label
        table.add_row(
            label if label != before else "",
            row.setting.size,
            str(row.setting.keypoints),
            str(row.setting.features.threads),
            *(f"{value:.0f}" for value in (time.p50_ms, time.p99_ms)),
            f"{time.rate_hz:.1f}",
            *(f"{value:.0f}" for value in (time.extract_ms, time.match_ms, time.verify_ms)),
            "-" if known is None else f"{100.0 * known.within_3_m:.0f} %",
            "-" if known is None else f"{known.inliers:.0f}",
        )
        before = label
    return Group(title, table)


def _thesis_table(report: SpeedReport) -> Group:
    title = "Pictures a second (640x480, 1000 keypoints): the thesis on its Pi 4, and here"
    table = _table(["features", "thesis", "here"])
    here: dict[str, float] = {}
    for row in report.rows:
        if (row.setting.size, row.setting.keypoints) == ("640x480", 1000):
            label = row.setting.label
            here[label] = max(here.get(label, 0.0), row.time.rate_hz)
    for label in dict.fromkeys([*THESIS_HZ, *here]):
        rate = f"{here[label]:.1f}" if label in here else "-"
        table.add_row(label, THESIS_HZ.get(label, "-"), rate)
    return Group(title, table)


def _projection_table(report: SpeedReport) -> Group:
    rates = "; ".join(
        f"{board.name} {board.float_gflop_s:g} and {board.int8_gflop_s:g}" for board in BOARDS
    )
    title = (
        "Projection, nothing measured: the network alone, by published GFLOP/s\n"
        f"(float and int8: {rates})"
    )
    columns = [cell for board in BOARDS for cell in (f"{board.name} ms", "Hz")]
    table = _table(["model", "precision", "size", "GMAC", *columns])
    for each in report.projected:
        cells = (cell for ms in each.ms.values() for cell in (f"{ms:.0f}", f"{1e3 / ms:.1f}"))
        precision = "int8" if each.is_int8 else "float"
        table.add_row(each.model, precision, each.size, f"{each.gmac:.2f}", *cells)
    return Group(title, table)


def _table(columns: list[str]) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=0)
    for index, column in enumerate(columns):
        table.add_column(column, justify="left" if index == 0 else "right", no_wrap=True)
    return table


def refusal(report: SpeedReport) -> str:
    """Why nothing was chosen, and what may be done."""
    advice = "ask for less with --target-hz, or stop what else runs"
    wanted = f"{report.wanted.target_hz:g} Hz"
    if report.tried:
        rates = ", ".join(f"{each.latency.rate_hz:.1f}" for each in report.tried)
        return (
            f"nothing holds {wanted} here: settings that do alone reached {rates} Hz beside camera "
            f"and link; {advice}"
        )
    fastest = min(report.rows, key=lambda row: row.time.p99_ms)
    return (
        f"nothing holds {wanted} here: the fastest, {described(fastest.setting)}, takes "
        f"{fastest.time.p50_ms:.0f} ms, the slowest {fastest.time.p99_ms:.0f} ms; {advice}"
    )


def check_place(path: Path) -> None:
    """See that a file may be written there, before anything is measured, and writes over nothing.

    What an earlier run of the command wrote gives way.

    Raises:
        ConfigError: it cannot.
    """
    if path.is_dir() or not path.parent.is_dir():
        raise ConfigError(f"cannot write {path}: give a file in a folder that exists")
    if not os.access(path.parent, os.W_OK):
        raise ConfigError(f"cannot write {path}: its folder may not be written")
    if path.exists() and not _is_ours(path):
        raise ConfigError(f"{path} is there already, and of no `bench speed`; give another file")


def _is_ours(path: Path) -> bool:
    """Whether an earlier run wrote it; an empty file holds nothing."""
    try:
        with path.open("rb") as file:
            return file.read(len(_HEAD)).decode(errors="replace") in ("", _HEAD)
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from error


def write_settings(path: Path, report: SpeedReport) -> None:
    """The chosen setting as a file that `fly --config` takes; whole or not at all.

    Raises:
        ConfigError: it cannot be written.
    """
    chosen = report.chosen
    assert chosen is not None
    said = words(chosen, report.rows, report.wanted.target_hz, report.cores)
    head = f"{_HEAD} on {date.today()} for {report.machine}.\n"
    comment = head + "".join(f"# {line}\n" for line in said)
    settings = tomli_w.dumps(chosen.timed.setting.as_config(report.wanted.target_hz))
    try:
        write_whole(path, f"{comment}\n{settings}")
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from error
