"""`vwnav flighttest`: flights with something broken in them, each with a verdict."""

import json
import logging
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from vwnav.cli.manners import manners_of
from vwnav.errors import ConfigError, VwnavError
from vwnav.files.whole import write_whole
from vwnav.screen import print_rows, say, verdict_cell

if TYPE_CHECKING:
    from vwnav.bench.flights.live.session import Links
    from vwnav.bench.flights.live.whereabouts import Eyes
    from vwnav.bench.flights.rows import RowResult
    from vwnav.bench.flights.scenario import Scenario
    from vwnav.bench.flights.thesis.report import TestReport
    from vwnav.bench.flights.thesis.tests import FlightTest
    from vwnav.sim.config import Manners

_log = logging.getLogger(__name__)
_NAMES_SHOWN = 3
_CONNECTION = "An autopilot in simulation, flown in real time; else all in simulated time."
_PILOT = "With --connection: a second link, on which this command plays the pilot."
_TRUTH = "With --connection: where the simulator tells its ground truth."
_UNTRUE = "With --connection and no --truth, as `vwnav fly` has it:"
_ONE_OBJECT = "One JSON object on stdout."
_FOLDER = "Folder of the result: three plots and a table (CSV)."
_DRAWN = "Not the table: so many flights with the faults of two to four of its rows."
_MANNERS = (
    "The simulated vehicle's: px4, px4-1.16 or copter; with --connection the autopilot's own count."
)

app = typer.Typer(no_args_is_help=True, help="Fly tests, and say whether they passed.")


@app.command()
def faults(
    listed: bool = typer.Option(False, "--list", help="Say what there is, and fly nothing."),
    only: list[str] = typer.Option([], help="Only rows with this in their name; may be repeated."),
    jobs: int = typer.Option(1, min=1, help="How many are flown at a time."),
    drawn: int = typer.Option(0, min=0, help=_DRAWN),
    first: int = typer.Option(0, min=0, help="With --drawn: the number of the first one."),
    manners: str = typer.Option("px4", help=_MANNERS),
    connection: str | None = typer.Option(None, help=_CONNECTION),
    pilot: str | None = typer.Option(None, help=_PILOT),
    truth: str | None = typer.Option(None, help=_TRUTH),
    as_json: bool = typer.Option(False, "--json", help="One JSON object a line on stdout."),
    output: Path | None = typer.Option(
        None, "-o", "--output", help="Folder of the result: faults.json, a picture of each failure."
    ),
) -> None:
    """Fly the whole program in simulated time with one thing broken, fault by fault.

    Each has an expected outcome; what comes out otherwise fails, and its track is drawn.

    Examples:
    vwnav flighttest faults --list
    vwnav flighttest faults --jobs 2 -o faults
    vwnav flighttest faults --only "link cut" --only black
    vwnav flighttest faults --manners copter --only "navigator killed"
    vwnav flighttest faults --drawn 50 --jobs 2 -o drawn
    vwnav flighttest faults --connection udpin://0.0.0.0:14540 --truth udpout:127.0.0.1:14560
    """
    from vwnav.bench.flights.table import drawn_rows, rows_named

    if drawn and (only or connection is not None):
        raise ConfigError("--drawn goes with neither --only nor --connection")
    if first and not drawn:
        raise ConfigError("--first is the first flight of --drawn N: say how many")
    rows = drawn_rows(drawn, first) if drawn else rows_named(only)
    if connection is not None:
        from vwnav.bench.flights.live.campaign import live_rows

        rows = live_rows(rows, pilot is not None)
    if not rows:
        raise ConfigError(f"no fault is named {' or '.join(only)}: see --list")
    if listed:
        _show_list(rows, as_json)
        return
    from vwnav.recording.run_folder import make_run_folder

    links, ways = _links(connection, truth, pilot), manners_of(manners)
    folder = make_run_folder(output, "faults")
    flown = _in_lockstep(rows, jobs, folder, ways) if links is None else _live(rows, links, folder)
    results = _collect(rows, flown, as_json, folder)
    failed = [each.name for each in results if not each.passed]
    if failed:
        named = ", ".join(failed[:_NAMES_SHOWN]) + (" ..." if len(failed) > _NAMES_SHOWN else "")
        raise VwnavError(f"{len(failed)} of {len(results)} faults failed: {named}")


def _thesis_test(name: str, what: str, example: str) -> None:
    """One of the thesis' flight tests as a command: `what` it flies, the words of an `example`."""

    def test(
        manners: str = typer.Option("px4", help=_MANNERS),
        connection: str | None = typer.Option(None, help=_CONNECTION),
        pilot: str | None = typer.Option(None, help=_PILOT),
        truth: str | None = typer.Option(None, help=_TRUTH),
        map_source: str | None = typer.Option(None, "--map", help=f"{_UNTRUE} the map pack."),
        camera: Path | None = typer.Option(None, help=f"{_UNTRUE} the camera's calibration."),
        video: str | None = typer.Option(None, help=f"{_UNTRUE} the simulator's own camera."),
        home: str | None = typer.Option(None, help=f"{_UNTRUE} LAT,LON of the take-off."),
        as_json: bool = typer.Option(False, "--json", help=_ONE_OBJECT),
        output: Path | None = typer.Option(None, "-o", "--output", help=_FOLDER),
    ) -> None:
        if truth is not None and (map_source or camera or video or home):
            raise ConfigError("--map, --camera, --video and --home go without --truth")
        eyes = _eyes(map_source, camera, video, home)
        links = _links(connection, truth, pilot, eyes)
        _run_test(name, manners_of(manners), links, as_json, output)

    app.command(name, help=f"{what}\n\nExample: vwnav flighttest {name} {example}")(test)


_thesis_test(
    "hover",
    "Arm, climb, hold for 30 s, land: the thesis' hover test, figures 6.3 to 6.5.",
    "-o hover",
)
_thesis_test(
    "waypoints",
    "Fly a route and come home: the thesis' waypoint test, figures 6.6 to 6.8.",
    "-o waypoints",
)
_thesis_test(
    "failsafe",
    "Fly a route; a pilot takes over and hands back, then his radio fails: figures 6.9 to 6.11.",
    "--manners copter -o failsafe",
)


def _eyes(
    map_source: str | None, camera: Path | None, video: str | None, home: str | None
) -> "Eyes | None":
    """None where nothing is given.

    Raises:
        ConfigError: something is missing.
    """
    from vwnav.bench.flights.live.whereabouts import Eyes
    from vwnav.geometry.geodesy import parse_lat_lon

    given = {"--map": map_source, "--camera": camera, "--video": video, "--home": home}
    missing = [name for name, value in given.items() if value is None]
    if len(missing) == len(given):
        return None
    if map_source is None or camera is None or video is None or home is None:
        raise ConfigError(f"without --truth a test needs {', '.join(missing)}, too")
    parse_lat_lon(home)
    return Eyes(map_source, camera, video, home)


def _links(
    connection: str | None, truth: str | None, pilot: str | None, eyes: "Eyes | None" = None
) -> "Links | None":
    """None without a connection.

    Raises:
        ConfigError: there is one, and neither a truth that a camera can be drawn from nor `eyes`;
            there is none, and something that goes with it.
    """
    from vwnav.bench.flights.live.session import Links

    if connection is None:
        if truth is not None or pilot is not None or eyes is not None:
            raise ConfigError(
                "--truth, --pilot, --map, --camera, --video and --home go with --connection: "
                "without it everything is simulated"
            )
        return None
    if truth is None and eyes is None:
        raise ConfigError(
            "--connection needs --truth: the camera is drawn from it (hover, waypoints and "
            "failsafe also take --map, --camera, --video and --home, and score against the "
            "autopilot's own position)"
        )
    return Links(connection, truth, pilot, eyes)


def _run_test(
    name: str, manners: "Manners", links: "Links | None", as_json: bool, output: Path | None
) -> None:
    from vwnav.bench.flights.thesis.tests import TESTS, in_manners
    from vwnav.recording.run_folder import make_run_folder

    if links is None:
        folder = make_run_folder(output, name)
        report = _fly_test(in_manners(TESTS[name], manners), folder)
    else:
        from vwnav.bench.flights.live.session import simulator_at
        from vwnav.bench.flights.thesis.live import fly_live_test
        from vwnav.bench.flights.thesis.report import report_on

        with simulator_at(links) as simulator:
            folder = make_run_folder(output, name)
            samples, said = fly_live_test(TESTS[name], simulator, folder, say)
            flown = in_manners(TESTS[name], simulator.manners)
            report = report_on(flown, samples, said, folder, simulator.where.reference)
    if as_json:
        print(json.dumps(asdict(report)))
    else:
        _show_test(report)
    say(f"flighttest: wrote {', '.join(report.files)} to {folder}")
    if failed := [step.name for step in report.steps if not step.passed]:
        raise VwnavError(f"the {name} test failed: {'; '.join(failed)}")
    say(f"the {name} test passed, scored against {report.scored_against}")


def _fly_test(test: "FlightTest", folder: Path) -> "TestReport":
    """Fly it in lockstep, write its plots and its table."""
    from vwnav.bench.figures import pyplot
    from vwnav.bench.flights.fly import fly
    from vwnav.bench.flights.lockstep_place import lockstep_place
    from vwnav.bench.flights.thesis.report import report_on
    from vwnav.bench.flights.thesis.sampler import Sampler

    pyplot()  # what it lacks is said now, not when it has been flown
    sampler = Sampler()
    flown = fly(test.scenario, lockstep_place(), see=sampler)
    said = [f"{each.t_s:.1f} s {each.text}" for each in flown.track.events]
    return report_on(test, sampler.samples, said, folder)


def _show_test(report: "TestReport") -> None:
    steps = [(verdict_cell(step.passed), step.name, step.detail) for step in report.steps]
    title = f"{report.name}, scored against {report.scored_against}"
    print_rows(title, ("", "step", "seen"), steps)
    sizes = []
    for each in report.statistics:
        values = [f"{value:.2f} {each.unit}" for value in (each.rms, each.p95, each.largest)]
        thesis = "" if each.thesis is None else f"{each.thesis:g} {each.unit}"
        sizes.append((each.name, *values, thesis))
    print_rows("", ("error", "RMS", "95 %", "largest", "the thesis, with GPS"), sizes)


def _show_list(rows: "Iterable[Scenario]", as_json: bool) -> None:
    from vwnav.bench.flights.table import family_of

    cells = [(family_of(row), row.name, row.where, row.when, row.expected) for row in rows]
    header = ("family", "name", "where", "when", "expected")
    if as_json:
        for each in cells:
            print(json.dumps(dict(zip(header, each, strict=True))))
    else:
        print_rows("faults", header, cells)


def _in_lockstep(
    rows: "list[Scenario]", jobs: int, folder: Path, manners: "Manners"
) -> "Iterator[RowResult]":
    from vwnav.bench.flights.lockstep_place import lockstep_place
    from vwnav.bench.flights.rows import fly_rows

    lockstep_place()  # its map is drawn once, here
    names = [row.name for row in rows]
    return fly_rows(names, partial(fly_row, folder=folder, manners=manners), jobs)


def fly_row(name: str, folder: Path, manners: "Manners") -> "RowResult":
    """Fly one row of the table, and draw its track if it fails.

    A flight that raises has failed, and is no reason to lose all the others.
    """
    # Imported here, in whichever process flies it: `--help` loads none of it.
    from vwnav.bench.flights.fly import fly
    from vwnav.bench.flights.judge import judge
    from vwnav.bench.flights.lockstep_place import lockstep_place
    from vwnav.bench.flights.rows import broken_off, result_of
    from vwnav.bench.flights.table import family_of, row_of
    from vwnav.bench.flights.table.manners import in_manners

    row = in_manners(row_of(name), manners)
    place, family, began_s = lockstep_place(), family_of(row), time.process_time()
    try:
        flown = fly(row, place)
        return result_of(flown, judge(flown), family, time.process_time() - began_s, folder)
    except Exception as error:
        _log.exception("%s broke off", name)
        return broken_off(row, family, error)


def _live(rows: "list[Scenario]", links: "Links", folder: Path) -> "Iterator[RowResult]":
    from vwnav.bench.flights.live.campaign import fly_live_row
    from vwnav.bench.flights.live.session import simulator_at
    from vwnav.bench.flights.table import family_of
    from vwnav.onboard.simulation import map_pack_of
    from vwnav.vision.features.load import load_features

    with simulator_at(links) as simulator:
        # Here, not in the first flight, which would spend its time to reach the route on it.
        map_pack_of(simulator.where.site, [load_features("learned"), load_features("sift")])
        for number, row in enumerate(rows, 1):
            yield fly_live_row(row, family_of(row), simulator, folder / f"{number:02d}")


def _collect(
    rows: "list[Scenario]", flown: "Iterable[RowResult]", as_json: bool, folder: Path
) -> "list[RowResult]":
    """Results in the table's order; each is told as soon as it is there."""
    results: list[RowResult] = []
    for result in flown:
        results.append(result)
        if as_json:
            print(json.dumps(asdict(result)), flush=True)
        else:
            _tell(result, len(results), len(rows))
    order = [row.name for row in rows]
    results.sort(key=lambda each: order.index(each.name))
    write_whole(folder / "faults.json", "".join(f"{json.dumps(asdict(r))}\n" for r in results))
    if not as_json:
        _show_verdicts(results)
    say(f"flighttest: wrote faults.json and a picture of each failure to {folder}")
    return results


def _tell(result: "RowResult", done: int, count: int) -> None:
    say(f"{done}/{count} {'pass' if result.passed else 'FAIL'} {result.name}")
    if not result.passed:
        for line in (*result.wrong, *(f"  {each}" for each in result.timeline)):
            say(f"    {line}")


def _show_verdicts(results: "list[RowResult]") -> None:
    cells = [
        (
            verdict_cell(each.passed),
            each.family,
            each.name,
            each.expected if each.passed else "; ".join(each.wrong),
            "" if each.landed_off_m is None else f"{each.landed_off_m:.1f}",
            "" if each.worst_sigmas is None else f"{each.worst_sigmas:.1f}",
            f"{each.flown_s:.0f}",
        )
        for each in results
    ]
    header = ("", "family", "fault", "outcome", "down, m off", "worst sigmas", "flown, s")
    passed = sum(each.passed for each in results)
    print_rows(f"{passed} of {len(results)} faults passed", header, cells)
    cost_s = sum(each.cost_s for each in results)
    print(f"{cost_s / 60.0:.0f} minutes of a processor", file=sys.stderr)
