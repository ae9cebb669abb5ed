"""Rows of the table flown one after the other, or several at a time, and what became of each."""

import logging
import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from vwnav.bench.flights.fly import fly
from vwnav.bench.flights.judge import judge
from vwnav.bench.flights.place import Place
from vwnav.bench.flights.scenario import Scenario
from vwnav.bench.flights.table import TABLE, family_of
from vwnav.bench.flights.table.manners import in_manners
from vwnav.bench.flights.track import FlightTrace
from vwnav.sim.config import Manners

_log = logging.getLogger(__name__)

MakePlace = Callable[[], Place]


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
        picture: of its track, None where none was drawn.
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


def fly_rows(
    rows: Sequence[Scenario],
    make_place: MakePlace,
    folder: Path,
    jobs: int,
    manners: Manners = "px4",
) -> Iterator[RowResult]:
    """Fly rows of the table, `jobs` at a time; results come as they are done.

    Args:
        rows: of `TABLE`, which every process has.
        make_place: a function of a module, as it is called in every process.
        folder: of the pictures of those that fail.
        jobs: processes; 1 flies in this one.
        manners: the autopilot's.
    """
    names = [row.name for row in rows]
    if jobs == 1:
        for name in names:
            yield fly_row(name, make_place, folder, manners)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        waiting = [pool.submit(fly_row, name, make_place, folder, manners) for name in names]
        try:
            for each in as_completed(waiting):
                yield each.result()
        finally:
            pool.shutdown(cancel_futures=True)


def fly_row(name: str, make_place: MakePlace, folder: Path, manners: Manners = "px4") -> RowResult:
    """Fly one row of the table, and draw its track if it fails.

    A flight that raises has failed, and is no reason to lose all the others.
    """
    row = in_manners(next(each for each in TABLE if each.name == name), manners)
    place = make_place()
    try:
        return _flown(row, place, folder)
    except Exception as error:
        _log.exception("%s broke off", name)
        return RowResult(
            name=row.name, family=family_of(row), expected=row.expected, where=row.where,
            when=row.when, wrong=(f"the flight broke off: {error!r}",), broke_s=None,
            landed_off_m=None, fastest_m_s=0.0, worst_sigmas=None, flown_s=0.0, cost_s=0.0,
            timeline=(), picture=None,
        )  # fmt: skip


def _flown(row: Scenario, place: Place, folder: Path) -> RowResult:
    began_s = time.process_time()
    flown = fly(row, place)
    verdict = judge(flown)
    track, begun_s, picture = flown.track, flown.begun_s, None
    if verdict.wrong:
        picture = draw_failure(row.name, track, begun_s, flown.broke_s, verdict.wrong, folder)
    happened = timeline_of(track, begun_s)
    return RowResult(
        name=row.name, family=family_of(row), expected=row.expected, where=row.where, when=row.when,
        wrong=verdict.wrong, broke_s=flown.broke_s, landed_off_m=verdict.landed_off_m,
        fastest_m_s=verdict.fastest_m_s, worst_sigmas=verdict.worst_sigmas, flown_s=flown.flown_s,
        cost_s=time.process_time() - began_s, timeline=tuple(happened), picture=picture,
    )  # fmt: skip


def draw_failure(
    name: str, track: FlightTrace, begun_s: float, broke_s: float | None, wrong: Sequence[str],
    folder: Path,
) -> str:  # fmt: skip
    """Name of the picture of its track in the folder."""
    from vwnav.bench.flights.picture import save_track

    file = "".join(c if c.isalnum() else "_" for c in name) + ".png"
    save_track(track, begun_s, broke_s, f"{name}: {'; '.join(wrong)}", folder / file)
    return file


def timeline_of(track: FlightTrace, begun_s: float) -> list[str]:
    """What was said, which modes were flown and where the mission stood, by time."""
    lines = [(each.t_s, each.text) for each in track.events]
    lines += [(each.t_s - begun_s, f"mode {each.text}") for each in track.modes()]
    lines += [(each.t_s, f"phase: {each.text}") for each in track.phases]
    return [f"{t_s:.2f} s {line}" for t_s, line in sorted(lines)]
