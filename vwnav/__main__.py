"""The command `vwnav`, also `python -m vwnav`: mounts the sub-commands.

Errors become one line and an exit code.
"""

import errno
import os
import sys

# Read when numpy loads. A product of matrices as small as the filter's is done before other threads
# have begun; waiting for the next one they took two thirds more of the processor.
os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")

import typer

from vwnav import __version__
from vwnav.cli import doctor, flighttest, fly, localize, replay
from vwnav.cli import map as map_commands
from vwnav.cli.bench.estimator import estimator
from vwnav.cli.bench.features import drift, features
from vwnav.cli.bench.flights import flights
from vwnav.cli.bench.localizer import localizer
from vwnav.cli.bench.mount import mount
from vwnav.cli.bench.shutter import shutter
from vwnav.cli.bench.significance import significance
from vwnav.cli.bench.speed import speed
from vwnav.cli.bench.waypoints import waypoints
from vwnav.cli.camera import calibrate, look
from vwnav.errors import FlightError, PreflightError, VwnavError
from vwnav.machine.signals import raised_signals

EXIT_FAILED = 1
EXIT_NOT_SAFE = 3
EXIT_FLIGHT_ENDED = 4  # of a service alone: deploy/vwnav.service starts none of these anew
EXIT_INTERRUPTED = 130
_LINE_BEGINS, _LINE_ENDS = 1200, 300
_LONGEST_LINE = _LINE_BEGINS + _LINE_ENDS
_STANDARD = range(3)  # descriptors of the standard streams
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)

app = typer.Typer(
    name="vwnav",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Fly a drone without GPS: match its down-looking camera to a map loaded before.",
    epilog="Start with: vwnav fly --sim",
)
app.command("fly", rich_help_panel="On the drone")(fly.fly)
app.command("doctor", rich_help_panel="On the drone")(doctor.doctor)
app.add_typer(map_commands.app, name="map", rich_help_panel="Before the flight")
app.command("camera", rich_help_panel="On the drone")(look.camera)
app.add_typer(calibrate.app, name="calibrate", rich_help_panel="Before the flight")
app.command("replay", rich_help_panel="After the flight")(replay.replay)
app.command("localize", rich_help_panel="After the flight")(localize.localize)
app.add_typer(flighttest.app, name="flighttest", rich_help_panel="Before the flight")
benches = typer.Typer(no_args_is_help=True, help="Measure the parts of the navigator.")
for measure in (
    estimator,
    flights,
    localizer,
    mount,
    shutter,
    significance,
    speed,
    waypoints,
    features,
    drift,
):
    benches.command()(measure)
app.add_typer(benches, name="bench", rich_help_panel="At the workstation")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"vwnav {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    context: typer.Context,
    _version: bool = typer.Option(
        False, "--version", is_eager=True, callback=_print_version, help="Print the version."
    ),
) -> None:
    if context.invoked_subcommand != "fly":  # an aircraft is landed first: it heeds them itself
        context.with_resource(raised_signals())


def main() -> None:
    """Run the command; known errors become one line on stderr and an exit code.

    Raises:
        OSError: it names no file, and is not that there is no room: nothing a person can mend.
    """
    _replace_closed_streams()
    try:
        _run()
    except VwnavError as wrong:
        print(f"vwnav: {_one_line(wrong)}", file=sys.stderr)
        sys.exit(_exit_code(wrong))
    except KeyboardInterrupt:
        print("vwnav: interrupted", file=sys.stderr)
        sys.exit(EXIT_INTERRUPTED)
    except OSError as error:
        _complain(error)
        sys.exit(EXIT_FAILED)


def _replace_closed_streams() -> None:
    """Where a stream was closed (`>&-`) the next file would get its number, and what libraries say.

    Python's own is None then: what is written to it raises, and an error goes to the results.
    """
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= _STANDARD[-1]:
        pass
    os.close(descriptor)
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))  # noqa: SIM115


def _one_line(wrong: VwnavError) -> str:
    """What it says, whatever it has taken of a file: no control characters, not megabytes."""
    text = " ".join(str(wrong).split())
    text = "".join(each if each.isprintable() else "\N{REPLACEMENT CHARACTER}" for each in text)
    return text if len(text) <= _LONGEST_LINE else f"{text[:_LINE_BEGINS]} ... {text[-_LINE_ENDS:]}"


def _exit_code(wrong: VwnavError) -> int:
    match wrong:
        case PreflightError():
            return EXIT_NOT_SAFE
        case FlightError():
            from vwnav.onboard.service import ServiceManager  # a flight has it already

            return EXIT_FLIGHT_ENDED if ServiceManager().listens else EXIT_FAILED
        case _:
            return EXIT_FAILED


def _run() -> None:
    try:
        app()
    except SystemExit as ended:
        if ended.code == EXIT_INTERRUPTED:  # what typer makes of Ctrl-C, without a word
            raise KeyboardInterrupt from ended
        raise
    finally:
        _flush()  # while it can be said that standard output does not take it


def _flush() -> None:
    print(end="", flush=True)


def _complain(error: OSError) -> None:
    """Say what could not be written; of a pipe that was closed nobody wants to hear."""
    if error.filename is None and error.errno not in (errno.EPIPE, *_NO_ROOM):
        raise error
    if error.errno != errno.EPIPE:
        what = error.filename or ("standard output" if _is_stuck() else "a file")
        print(f"vwnav: {what}: {error.strerror}", file=sys.stderr)
    # What it could not take must not be tried again on the way out.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _is_stuck() -> bool:
    """Whether standard output holds what it could not take."""
    try:
        _flush()
    except OSError:
        return True
    return False


if __name__ == "__main__":
    main()
