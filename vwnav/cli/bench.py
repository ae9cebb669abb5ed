"""`vwnav bench`: how good the parts are, measured."""

import typer

from vwnav.cli.bench_estimator import estimator

app = typer.Typer(no_args_is_help=True, help="Measure the parts of the navigator.")
app.command("estimator")(estimator)


@app.callback()
def _bench() -> None:
    pass
