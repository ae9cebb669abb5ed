"""What a run leaves behind: time spent, log.csv, TensorBoard, lines on the screen, checkpoints."""

import csv
import io
import time
from pathlib import Path
from typing import Any

import torch
from torch.utils.tensorboard import SummaryWriter

from training.config import TrainConfig
from training.validate import MatchScore
from training.whole import write_whole

LOSSES = (
    "total",
    "matching",
    "agreement",
    "reprojection",
    "score",
    "repeats",
    "repeated",
    "matched",
    "unlike",
)
SCORES = ("inliers", "precision", "located", "error_px", "above_chance")


class StopWatch:
    """Adds up the iterations' own time; a process that was stopped for a while does not age."""

    def __init__(self, elapsed_s: float) -> None:
        """Go on from `elapsed_s`."""
        self.elapsed_s = elapsed_s
        self.usual_s: float | None = None  # running mean of an iteration
        self.waiting_s = 0.0  # running mean of what an iteration waits for its samples
        self._tick = time.monotonic()

    def loaded(self) -> None:
        """Note that the samples have come that this iteration waited for."""
        self.waiting_s += 0.02 * (time.monotonic() - self._tick - self.waiting_s)

    def lap(self) -> None:
        """Count the time since the last call, but no more than five usual iterations."""
        now = time.monotonic()
        took_s, self._tick = now - self._tick, now
        if self.usual_s is None:
            self.usual_s = min(took_s, 0.5)  # the first waits for the loader to start
        took_s = min(took_s, 5 * self.usual_s)
        self.usual_s += 0.02 * (took_s - self.usual_s)
        self.elapsed_s += took_s

    def skip(self) -> None:
        """Leave out the time since the last call."""
        self._tick = time.monotonic()


class Journal:
    """Writes figures to log.csv, TensorBoard and the screen."""

    def __init__(self, folder: Path, step: int) -> None:
        """Append to the folder's log; TensorBoard forgets what came after `step`."""
        is_new = not (folder / "log.csv").exists()
        self._file = (folder / "log.csv").open("a", newline="")
        self._csv = csv.writer(self._file)
        if is_new:
            self._csv.writerow(["step", "elapsed_s", "learning_rate", *LOSSES, *SCORES])
        self._board = SummaryWriter(str(folder), purge_step=step)
        self._recent: dict[str, float] = {}

    def add(self, figures: dict[str, torch.Tensor]) -> None:
        """Take the figures of one step into the running means."""
        for name, value in figures.items():
            now = value.item()
            self._recent[name] = 0.95 * self._recent.get(name, now) + 0.05 * now

    def tell(self, step: int, progress: float, learning_rate: float, watch: StopWatch) -> None:
        """Log the running means."""
        left_min = (1 - progress) / max(progress, 1e-6) * watch.elapsed_s / 60
        told = "  ".join(f"{name} {value:.3f}" for name, value in self._recent.items())
        rate = 1 / (watch.usual_s or 1.0)
        head = f"step {step}  {100 * progress:.1f} %"
        waiting = 100 * watch.waiting_s * rate
        pace = f"{rate:.1f} it/s, {waiting:.0f} % of it loading"
        print(f"{head}  {told}  {pace}  ETA {left_min:.0f} min", flush=True)
        values = [f"{self._recent[name]:.4f}" for name in LOSSES]
        self._csv.writerow([step, f"{watch.elapsed_s:.1f}", f"{learning_rate:.2e}", *values])
        self._file.flush()
        for name, value in self._recent.items():
            self._board.add_scalar(name, value, step)

    def validated(self, step: int, watch: StopWatch, score: MatchScore, sift: MatchScore) -> None:
        """Log a validation."""
        at = f"step {step}, {watch.elapsed_s / 60:.1f} min"
        print(f"  validation at {at}: {score}   (upright SIFT: {sift})", flush=True)
        figures = {name: getattr(score, name) for name in SCORES}
        empty = [""] * (1 + len(LOSSES))
        told = [f"{value:.4f}" for value in figures.values()]
        self._csv.writerow([step, f"{watch.elapsed_s:.1f}", *empty, *told])
        for name, value in figures.items():
            self._board.add_scalar(f"validation/{name}", value, step)

    def close(self) -> None:
        """Finish the files."""
        self._file.close()
        self._board.close()


class Every:
    """True once per so many minutes of a stop watch."""

    def __init__(self, minutes: float, watch: StopWatch) -> None:
        """First true after `minutes` from now."""
        self._period_s, self._watch = 60 * minutes, watch
        self._next_s = watch.elapsed_s + self._period_s

    def due(self) -> bool:
        """Ask, and start the next period if it is."""
        if self._watch.elapsed_s < self._next_s:
            return False
        self._next_s = self._watch.elapsed_s + self._period_s
        return True


def save_checkpoint(path: Path, **state: Any) -> Path:
    """Write a checkpoint whole or not at all."""
    buffer = io.BytesIO()
    torch.save(state, buffer)
    write_whole(path, buffer.getvalue())
    return path


def progress_of(step: int, elapsed_s: float, config: TrainConfig) -> float:
    """How far a run is, 0 to 1, by steps or by time, whichever is further."""
    by_steps = step / config.max_steps if config.max_steps else 0.0
    by_time = elapsed_s / (60 * config.minutes) if config.minutes else 0.0
    return min(max(by_steps, by_time), 1.0)
