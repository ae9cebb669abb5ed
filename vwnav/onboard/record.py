"""What remains of a flight, and what is seen of it meanwhile: files, live line, table."""

import logging
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from vwnav import __version__
from vwnav.clock import Clock
from vwnav.config import Config
from vwnav.flight import Flight
from vwnav.maps.pack import MapPack
from vwnav.onboard.options import FlyOptions
from vwnav.pipeline import Pipeline
from vwnav.recording.disk.budget import DiskBudget
from vwnav.recording.flight_recorder import FlightRecorder, was_tried
from vwnav.recording.input_log import About
from vwnav.recording.recorder import Recorder, plain
from vwnav.recording.run_folder import TrajectoryWriter, write_json
from vwnav.recording.track_plot import TrackPlot
from vwnav.screen import LiveLine, print_table, say
from vwnav.seams import StepResult
from vwnav.sim.score import Score, summarise
from vwnav.sim.truth import TruthReader
from vwnav.types import Estimate, Frame, MapFix, Rejected
from vwnav.vehicle import VehicleState

_log = logging.getLogger(__name__)


class FlightRecord:
    """A `vwnav.seams.Watcher` that keeps and shows everything.

    Args:
        folder: of the run; made where it is missing.
        at_once: what cannot be recorded is not flown. Else the flight goes on without.

    Attributes:
        input_log: what the filter is told, from before its start: `Ekf.record(input_log.input)`.
    """

    def __init__(
        self,
        folder: Path,
        about: About,
        pack: MapPack,
        config: Config,
        truth: TruthReader | None,
        clock: Clock,
        budget: DiskBudget | None = None,
        at_once: bool = True,
    ) -> None:
        self._folder = folder
        self._clock = clock
        self._truth = truth
        self._started_s = clock()
        self._trajectory: TrajectoryWriter | None = None
        settings = config.model_dump(mode="json")
        recorder = Recorder(folder / "flight.mcap", settings, budget=budget, at_once=at_once)
        self._recorder = FlightRecorder(recorder, about)
        self.input_log = self._recorder.input_log
        self._image = TrackPlot(pack, about.local_frame)
        self._score = Score(about.local_frame) if truth is not None else None
        self._line = LiveLine()
        self._line.__enter__()
        self._lock = threading.Lock()
        self._rejected: Counter[str] = Counter()
        self._frames = 0
        self._last: MapFix | Rejected | None = None
        self._flight: Flight | None = None
        self._pipeline: Pipeline | None = None

    def follow(self, flight: Flight, pipeline: Pipeline) -> None:
        """The flight to be recorded."""
        self._flight, self._pipeline = flight, pipeline

    def event(self, text: str) -> None:
        """Something worth a line."""
        now_s = self._clock()
        self._recorder.event(now_s, text)
        say(f"{now_s - self._started_s:7.1f} s  {text}")

    def saw_frame(self, frame: Frame, step: StepResult) -> None:
        """An image went through the pipeline."""
        setpoint = self._flight.setpoint if self._flight else None
        self._recorder.image(step, setpoint)  # first: close behind its estimate
        with self._lock:
            self._frames += 1
        self._recorder.frame(frame)
        self._image.add(step)
        self._saw_outcome(step.outcome)
        if self._trajectory is None:
            path = self._folder / "trajectory.csv"
            local_frame = self.input_log.about.local_frame
            self._trajectory = TrajectoryWriter(path, local_frame, frame.t_s, at_once=False)
        yaw_rad = setpoint.yaw_rad if setpoint else None
        self._trajectory.write(step, yaw_rad)  # last: a full disk takes nothing else along

    def _saw_outcome(self, outcome: MapFix | Rejected) -> None:
        if not was_tried(outcome):
            return
        self._last = outcome
        if isinstance(outcome, Rejected):
            self._rejected[outcome.reason.name.lower()] += 1
        elif self._score is not None and self._truth is not None:
            truth = self._truth.at(outcome.t_s)
            if truth is not None:
                self._score.add_fix(outcome, truth)

    def saw_tick(self, t_s: float, estimate: Estimate | None, vehicle: VehicleState) -> None:
        """The control loop ticked."""
        setpoint = self._flight.setpoint if self._flight else None
        if not self._recorder.tick(t_s, estimate, vehicle, setpoint) or estimate is None:
            return
        truth = self._truth.at(estimate.t_s) if self._truth else None
        if truth is not None and self._score is not None and vehicle.armed:
            self._score.add_estimate(estimate, truth)
            self._image.add_truth(self._score.truth_ned_m[-1])
        self._line.show(t_s, self._status(t_s, estimate, vehicle))

    def _status(self, t_s: float, estimate: Estimate, vehicle: VehicleState) -> str:
        north_m, east_m, down_m = estimate.position_ned_m
        phase = self._flight.phase.value if self._flight else ""
        age = "none"
        if estimate.t_last_fix_s is not None:
            age = f"{t_s - estimate.t_last_fix_s:.1f} s ago"
        inliers = self._last.stats.inliers if self._last else 0
        battery = "?" if vehicle.battery_ratio is None else f"{100 * vehicle.battery_ratio:.0f} %"
        error = ""
        if self._score is not None and self._score.last_error_m is not None:
            error = f"  error {self._score.last_error_m:.2f} m"
        return (
            f"{t_s - self._started_s:7.1f} s  {phase:17} N {north_m:7.1f} E {east_m:7.1f} "
            f"up {-down_m:5.1f} m  sigma {estimate.sigma_horizontal_m:4.1f} m  fix {age} "
            f"({inliers} inliers)  {vehicle.mode.value}  battery {battery}{error}"
        )

    def close(self, options: FlyOptions, pipeline: Pipeline, map_name: str) -> None:
        """Finish the files and print the table; what cannot be written is said, the rest is."""
        self._line.__exit__(None, None, None)
        endings: tuple[tuple[str, Callable[[], None]], ...] = (
            ("trajectory.csv", self._close_trajectory),
            ("flight.mcap", self._recorder.close),
            ("run.json", lambda: self._write_summary(options, pipeline, map_name)),
            ("track.png", lambda: self._image.save(self._folder / "track.png")),
        )
        for name, finish in endings:
            try:
                finish()
            except Exception as error:
                _log.exception("%s could not be finished", name)
                say(f"{name} could not be finished: {error}")
        print_table("flight", self._rows(pipeline))

    def _close_trajectory(self) -> None:
        if self._trajectory is not None:
            self._trajectory.close()

    def _write_summary(self, options: FlyOptions, pipeline: Pipeline, map_name: str) -> None:
        write_json(self._folder / "run.json", self._summary(options, pipeline, map_name))

    def _summary(self, options: FlyOptions, pipeline: Pipeline, map_name: str) -> dict[str, object]:
        end = self._flight.end if self._flight else None
        summary: dict[str, object] = {
            "command": "fly",
            "version": __version__,
            "simulated": options.sim,
            "map": map_name,
            **self.input_log.about.as_json(),
            "completed": end is not None and end.reason is None,
            "reason": end.reason if end else "the flight loop broke off",
            "frames": self._frames,
            "attempts": pipeline.attempts,
            "fixes": pipeline.accepted,
            "rejected": dict(self._rejected),
            "duration_s": round(self._clock() - self._started_s, 1),
        }
        if self._score is not None:
            summary["score"] = {
                "true_path_m": round(self._score.path_m(), 1),
                "estimate_error_m": plain(summarise(self._score.estimate_errors_m)),
                "fix_error_m": plain(summarise(self._score.fix_errors_m)),
                "error_at_landing_m": self._score.last_error_m,
                "max_distance_from_home_m": round(self._score.max_distance_from_home_m(), 1),
            }
        return summary

    def _rows(self, pipeline: Pipeline) -> list[tuple[str, str]]:
        rate = 100.0 * pipeline.accepted / pipeline.attempts if pipeline.attempts else 0.0
        end = self._flight.end if self._flight else None
        done = "whole route flown" if end and end.reason is None else "not completed"
        rows = [
            ("result", done),
            ("fixes of attempts", f"{pipeline.accepted} of {pipeline.attempts} ({rate:.1f} %)"),
        ]
        rows += [(f"rejected: {reason}", str(n)) for reason, n in self._rejected.most_common(4)]
        if self._score is not None:
            rows.append(("true path", f"{self._score.path_m():.0f} m"))
            for name, errors in (
                ("estimate error", self._score.estimate_errors_m),
                ("fix error", self._score.fix_errors_m),
            ):
                found = summarise(errors)
                if found:
                    text = f"{found.mean_m:.2f} / {found.p95_m:.2f} / {found.max_m:.2f} m"
                    rows.append((f"{name} mean / 95 % / max", text))
            if self._score.last_error_m is not None:
                rows.append(("error at landing", f"{self._score.last_error_m:.2f} m"))
        rows.append(("results in", str(self._folder)))
        return rows
