"""Rows of the table flown one after the other, or several at a time, and what became of each."""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from vwnav.bench.flights.scenario import FlightVerdict, Flown, Scenario
from vwnav.bench.flights.track import FlightTrace
from vwnav.machine.signals import raise_signals


@dataclass(frozen=True, slots=True, kw_only=True)
class RowResult:
    """What became of a row; plain values, so that it travels between processes.

    Attributes:
        wrong: what was; nothing when it passed.
        broke_s: when it broke, since the mission began; None: it never did.
        landed_off_m: from where it was meant to come down; None: it did not, or nothing says where.
        worst_sigmas: of an estimate that was sent; None in real time, where nobody counts.
        flown_s, cost_s: simulated seconds; seconds of a processor.
        timeline: what happened when, a line each.
        image: of its track, None where none was drawn.
    """

    name: str
    family: str
    expected: str
    where: str
    when: str
    wrong: tuple[str, ...]
    broke_s: float | None
    landed_off_m: float | None
    fastest_m_s: float
    worst_sigmas: float | None
    flown_s: float
    cost_s: float
    timeline: tuple[str, ...]
    picture: str | None

    @property
    def passed(self) -> bool:
        """Nothing was wrong."""
        return not self.wrong


FlyRow = Callable[[str], RowResult]


def fly_rows(names: Sequence[str], fly_row: FlyRow, jobs: int) -> Iterator[RowResult]:
    """Fly rows of the table, `jobs` at a time; results come as they are done.

    Args:
        names: of the rows.
        fly_row: a function of a module, as it is called in every process.
        jobs: processes; 1 flies in this one.
    """
    if jobs == 1:
        yield from map(fly_row, names)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context, raise_signals) as pool:
        waiting = [pool.submit(fly_row, name) for name in names]
        try:
            for each in as_completed(waiting):
                yield each.result()
        finally:
            pool.shutdown(cancel_futures=True)


def result_of(
    flown: Flown, verdict: FlightVerdict, family: str, cost_s: float, folder: Path
) -> RowResult:
    """Of a row that was flown; its track is drawn in the folder if it fails."""
    row, track, begun_s, picture = flown.scenario, flown.track, flown.begun_s, None
    if verdict.wrong:
        picture = draw_failure(row.name, track, begun_s, flown.broke_s, verdict.wrong, folder)
    return RowResult(
        name=row.name, family=family, expected=row.expected, where=row.where, when=row.when,
        wrong=verdict.wrong, broke_s=flown.broke_s, landed_off_m=verdict.landed_off_m,
        fastest_m_s=verdict.fastest_m_s, worst_sigmas=verdict.worst_sigmas, flown_s=flown.flown_s,
        cost_s=cost_s, timeline=tuple(timeline_of(track, begun_s)), picture=picture,
    )  # fmt: skip


def broken_off(row: Scenario, family: str, error: Exception) -> RowResult:
    """Of a row whose flight raised."""
    return RowResult(
        name=row.name, family=family, expected=row.expected, where=row.where,
        when=row.when, wrong=(f"the flight broke off: {error!r}",), broke_s=None,
        landed_off_m=None, fastest_m_s=0.0, worst_sigmas=None, flown_s=0.0, cost_s=0.0,
        timeline=(), picture=None,
    )  # fmt: skip


def draw_failure(
    name: str, track: FlightTrace, begun_s: float, broke_s: float | None, wrong: Sequence[str],
    folder: Path,
) -> str:  # fmt: skip
    """Name of the image of its track in the folder."""
    from vwnav.bench.flights.track_plot import save_track

    file = "".join(c if c.isalnum() else "_" for c in name) + ".png"
    save_track(track, begun_s, broke_s, f"{name}: {'; '.join(wrong)}", folder / file)
    return file


def timeline_of(track: FlightTrace, begun_s: float) -> list[str]:
    """What was said, which modes were flown and where the mission stood, by time."""
    lines = [(each.t_s, each.text) for each in track.events]
    lines += [(each.t_s - begun_s, f"mode {each.text}") for each in track.modes()]
    lines += [(each.t_s, f"phase: {each.text}") for each in track.phases]
    return [f"{t_s:.2f} s {line}" for t_s, line in sorted(lines)]
