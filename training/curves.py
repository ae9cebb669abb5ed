"""Draw the curves of training runs from their log.csv.

python training/curves.py runs/nano runs/default [-o runs/curves.png]
"""

import argparse
import csv
import io
import sys
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # to run it as a script

from training.complaint import one_line
from training.whole import write_whole

SHOWN = {
    "matching": "Loss of matching",
    "agreement": "Loss of peaks' agreement",
    "matched": "Keypoints rightly matched, share",
    "inliers": "Kept-aside pairs: inliers of 500",
}
SUFFIXES = (".png", ".svg", ".pdf")
SMOOTH = 10  # lines of the log


@dataclass(frozen=True, slots=True)
class Curve:
    """One figure over the minutes of a run."""

    minutes: list[float]
    values: list[float]


def read_curve(log: Path, name: str) -> Curve:
    """One column of a log, where it is filled in.

    Raises:
        SystemExit: it is no log of a run; one line says so.
    """
    try:
        with log.open(newline="") as file:
            rows = [row for row in csv.DictReader(file) if row.get(name)]
        return Curve([float(r["elapsed_s"]) / 60.0 for r in rows], [float(r[name]) for r in rows])
    except (ValueError, KeyError, csv.Error) as error:
        raise SystemExit(f"{log} is no log of a run, or damaged ({error})") from error


def smoothed(curve: Curve) -> Curve:
    """Mean of each `SMOOTH` lines; a curve that is as short stays as it is."""
    if len(curve.values) < 2 * SMOOTH:
        return curve
    parts = [slice(i, i + SMOOTH) for i in range(0, len(curve.values) - SMOOTH + 1, SMOOTH)]
    return Curve(
        [fmean(curve.minutes[part]) for part in parts],
        [fmean(curve.values[part]) for part in parts],
    )


def draw(runs: list[Path], output: Path) -> None:
    """Draw every shown figure of every run.

    Raises:
        SystemExit: a run has no log, or nothing can be drawn to `output`; one line says so.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    if output.suffix.lower() not in SUFFIXES:
        raise SystemExit(f"{output}: the curves are drawn as {' or '.join(SUFFIXES)}")
    figure, axes = pyplot.subplots(2, 2, figsize=(11.0, 7.0), layout="constrained")
    for axis, (name, title) in zip(axes.flat, SHOWN.items(), strict=True):
        for run in runs:
            if not (run / "log.csv").is_file():
                raise SystemExit(f"no log.csv in {run}: give the folder of a run")
            curve = smoothed(read_curve(run / "log.csv", name))
            axis.plot(curve.minutes, curve.values, label=run.name)
        axis.set_title(title, loc="left")
        axis.set_xlabel("minutes")
        axis.spines[["top", "right"]].set_visible(False)
    axes[0, 0].legend(frameon=False)
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=110, format=output.suffix[1:].lower())
    pyplot.close(figure)
    output.parent.mkdir(parents=True, exist_ok=True)
    write_whole(output, drawn.getvalue())


@one_line()
def main(arguments: list[str] | None = None) -> None:
    """Read the command line and draw.

    Raises:
        SystemExit: it cannot be done; one line says why.
    """
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs="+", type=Path, help="folders of runs")
    parser.add_argument("-o", "--out", type=Path, default=Path("runs/curves.png"))
    given = parser.parse_args(arguments)
    draw(given.runs, given.out)
    print(f"wrote {given.out}")


if __name__ == "__main__":
    main()
