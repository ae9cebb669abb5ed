"""Breaks the processes of `vwnav fly` from inside, each fault when a file of its own appears.

Their interpreters load this at their start through the `sitecustomize` that `patch_folder` writes:
the product itself knows nothing of it. Camera and model break for every navigator of a flight, all
else in the first one alone.
"""

import pickle
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from vwnav.bench.flights.faults.camera import CameraTrouble, ImagesLate, Trouble
from vwnav.bench.flights.faults.computer import LoopHangs, MatchingRaises, ModelRaises, StepRaises
from vwnav.bench.flights.stage import Fault, Loop
from vwnav.types import Frame

_FAULTS = "faults.pickle"
_IN_EACH_NAVIGATOR = (
    'import sys\nif "fly" in sys.orig_argv:\n'
    "    from vwnav.bench.flights.live.inside import break_inside\n"
    "    break_inside({folder!r})\n"
)
Stands = Callable[[], bool]  # whether it is broken by now


def patch_folder(folder: Path, faults: Mapping[int, Fault]) -> Path:
    """A folder for PYTHONPATH; a fault breaks as long as its `trigger_of` is there."""
    folder.mkdir(parents=True, exist_ok=True)
    if faults:
        (folder / _FAULTS).write_bytes(pickle.dumps(dict(faults)))
        (folder / "sitecustomize.py").write_text(_IN_EACH_NAVIGATOR.format(folder=str(folder)))
    return folder


def trigger_of(folder: Path, number: int) -> Path:
    """The file that breaks a fault."""
    return folder / f"break-{number}"


def break_inside(folder: str) -> None:
    """Patch this process."""
    is_first = "--standby" not in sys.orig_argv
    faults: dict[int, Fault] = pickle.loads((Path(folder) / _FAULTS).read_bytes())
    for number, fault in faults.items():
        stands = trigger_of(Path(folder), number).exists
        match fault:
            case CameraTrouble(make):
                _alter_images(make(), stands)
            case ImagesLate(seconds, stamped):
                _alter_images(_late(seconds, stamped), stands)
            case ModelRaises():
                _break_model(stands)
            case StepRaises(loop) if is_first:
                _break_step(loop, stands, _raise)
            case LoopHangs(loop) if is_first:
                _break_step(loop, stands, threading.Event().wait)
            case MatchingRaises() if is_first:
                _break_matching(stands)


def _alter_images(trouble: Trouble, stands: Stands) -> None:
    from vwnav.sim.camera_source import SimulatedCamera

    whole = SimulatedCamera.next_frame

    def next_frame(self: SimulatedCamera) -> Frame | None:
        while (frame := whole(self)) is not None:
            broken = trouble(frame) if stands() else frame
            if broken is not None:
                return broken
        return None

    SimulatedCamera.next_frame = next_frame  # type: ignore[method-assign]


def _late(seconds: float, stamped: bool) -> Trouble:
    waiting: deque[Frame] = deque()

    def delay(frame: Frame) -> Frame | None:
        waiting.append(frame)
        if frame.t_s < waiting[0].t_s + seconds:
            return None
        late = waiting.popleft()
        return late if stamped else replace(late, t_s=late.t_s + seconds)

    return delay


def _break_model(stands: Stands) -> None:
    from vwnav.vision.features.learned import LearnedFeatures

    whole = LearnedFeatures.extract

    def extract(self: LearnedFeatures, *args: Any, **kwargs: Any) -> Any:
        if stands():
            raise RuntimeError("bad allocation in the inference session")
        return whole(self, *args, **kwargs)

    LearnedFeatures.extract = extract  # type: ignore[method-assign]


def _break_step(loop: Loop, stands: Stands, breaks: Callable[[], object]) -> None:
    owner, name = _step_of(loop)
    whole = getattr(owner, name)

    def step(*args: Any, **kwargs: Any) -> Any:
        if stands():
            breaks()
        return whole(*args, **kwargs)

    setattr(owner, name, step)


def _step_of(loop: Loop) -> tuple[type, str]:
    """What one of the loops calls at each turn, as `bench.flights.navigator` has it."""
    from vwnav.flight import Flight
    from vwnav.mavlink.autopilot import LinkedAutopilot
    from vwnav.pipeline import Pipeline

    steps: dict[Loop, tuple[type, str]] = {
        "link": (LinkedAutopilot, "step"),
        "mission": (Flight, "tick"),
        "picture": (Pipeline, "step"),
    }
    return steps[loop]


def _break_matching(stands: Stands) -> None:
    from vwnav.vision.localizer import Localizer

    whole = Localizer.localize

    def localize(*args: Any, **kwargs: Any) -> Any:
        if stands():
            _raise()
        return whole(*args, **kwargs)

    Localizer.localize = localize  # type: ignore[method-assign]


def _raise() -> None:
    raise RuntimeError("broken on purpose")
