"""What any replay is told and leaves: its options, its counts, `run.json` and the table."""

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from vwnav import __version__
from vwnav.maps.pack import MapPack
from vwnav.recording.input_log import About
from vwnav.recording.run_folder import TrajectoryWriter, write_json
from vwnav.recording.track_plot import TrackPlot
from vwnav.screen import print_table
from vwnav.seams import StepResult
from vwnav.types import MapFix, Rejected, RejectReason


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """The command line of `vwnav replay`."""

    source: str
    map_path: Path
    camera: Path | None
    hfov_deg: float | None
    telemetry: Path | None
    features: str | None
    model: Path | None
    config_path: Path | None
    output: Path | None

    @property
    def from_input_log(self) -> bool:
        """Whether the filter's recorded inputs are wanted: a recording, nothing about images."""
        asked = (self.camera, self.hfov_deg, self.telemetry, self.model, self.config_path)
        return (
            Path(self.source).suffix == ".mcap"
            and self.features in (None, "learned")
            and all(option is None for option in asked)
        )


@dataclass
class Tally:
    """Counts over a replay."""

    frames: int = 0
    attempts: int = 0
    fixes: int = 0
    first_fix_t_s: float | None = None
    rejected: Counter[str] = field(default_factory=Counter)
    busy_s: float = 0.0

    def add(self, step: StepResult, t0_s: float) -> None:
        """Count one image."""
        self.frames += 1
        match step.outcome:
            case MapFix() as fix:
                self.attempts += 1
                self.fixes += 1
                if self.first_fix_t_s is None:
                    self.first_fix_t_s = fix.t_s - t0_s
            case Rejected(reason=RejectReason.NOT_TRIED):
                pass
            case Rejected(reason=reason):
                self.attempts += reason is not RejectReason.TOO_LOW  # as the pipeline counts
                self.rejected[reason.name.lower()] += 1

    @property
    def frames_per_s(self) -> float:
        """Images through the pipeline per second of its own time (decoding not counted)."""
        return self.frames / self.busy_s if self.busy_s > 0.0 else 0.0


@contextmanager
def no_halves(folder: Path, *others: str) -> Iterator[None]:
    """Where a trajectory does not come to its end, its rows and the `others` of its run go.

    Whatever ends it, Ctrl-C too: the same command can be given again. Of a flight they would stay:
    they cannot be had again.
    """
    try:
        yield
    except BaseException:
        if not (folder / "trajectory.csv").exists():
            for name in ("trajectory.csv.part", *others):
                (folder / name).unlink(missing_ok=True)
        raise


class ReplayRecord:
    """Writes the run folder of a replay, image by image.

    Attributes:
        tally: the counts so far.
    """

    def __init__(self, folder: Path, about: About, pack: MapPack, t0_s: float) -> None:
        self.tally = Tally()
        self._folder = folder
        self._about = about
        self._t0_s = t0_s
        self._trajectory = TrajectoryWriter(folder / "trajectory.csv", about.local_frame, t0_s)
        self._image = TrackPlot(pack, about.local_frame)

    def add(self, step: StepResult, commanded_yaw_rad: float | None) -> None:
        """Write and count one image."""
        self.tally.add(step, self._t0_s)
        self._trajectory.write(step, commanded_yaw_rad)
        self._image.add(step)

    def close(self) -> None:
        """Finish the trajectory and draw the track."""
        self._trajectory.close()
        self._image.save(self._folder / "track.png")

    def summarise(self, options: ReplayOptions, found: Mapping[str, object]) -> None:
        """Write `run.json`, with what else was `found`, and print the table."""
        tally = self.tally
        write_json(
            self._folder / "run.json",
            {
                "command": "replay",
                "version": __version__,
                "source": Path(options.source).name,
                "map": options.map_path.name,
                **self._about.as_json(),
                "frames": tally.frames,
                "attempts": tally.attempts,
                "fixes": tally.fixes,
                "rejected": dict(tally.rejected),
                "first_fix_t_s": tally.first_fix_t_s,
                "frames_per_s": round(tally.frames_per_s, 1),
                **found,
            },
        )
        rate = 100.0 * tally.fixes / tally.attempts if tally.attempts else 0.0
        first_fix = "none" if tally.first_fix_t_s is None else f"{tally.first_fix_t_s:.2f} s"
        print_table(
            "replay",
            [
                ("frames", str(tally.frames)),
                ("fixes of attempts", f"{tally.fixes} of {tally.attempts} ({rate:.1f} %)"),
                ("first fix at", first_fix),
                ("speed", f"{tally.frames_per_s:.1f} frames/s on one core"),
                ("results in", str(self._folder)),
            ],
        )
