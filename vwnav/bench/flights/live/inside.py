"""Breaks a navigator's process from inside, when a file appears.

The interpreter of `vwnav fly` loads this at its start through the `sitecustomize` that
`patch_folder` writes: the product itself knows nothing of it.
"""

from pathlib import Path
from typing import Any

_IN_THE_NAVIGATOR = (
    'import sys\nif "fly" in sys.orig_argv and "--standby" not in sys.orig_argv:\n'
    "    from vwnav.bench.flights.live.inside import break_inside\n"
    "    break_inside({what!r}, {trigger!r})\n"
)


def patch_folder(folder: Path, what: str, trigger: Path) -> Path:
    """A folder for PYTHONPATH; `what` breaks as soon as the file `trigger` is there."""
    folder.mkdir(parents=True, exist_ok=True)
    text = _IN_THE_NAVIGATOR.format(what=what, trigger=str(trigger))
    (folder / "sitecustomize.py").write_text(text)
    return folder


def break_inside(what: str, trigger: str) -> None:
    """Patch this process; `what` is "model", or a function of `faults.camera`."""
    if what == "model":
        _break_model(Path(trigger))
    elif what:
        _break_camera(what, Path(trigger))


def _break_camera(what: str, trigger: Path) -> None:
    import vwnav.bench.flights.faults.camera as troubles
    from vwnav.sim.camera_source import SimulatedCamera
    from vwnav.types import Frame

    trouble = getattr(troubles, what)()
    whole = SimulatedCamera.next_frame

    def next_frame(self: SimulatedCamera) -> Frame | None:
        while (frame := whole(self)) is not None:
            broken: Frame | None = trouble(frame) if trigger.exists() else frame
            if broken is not None:
                return broken
        return None

    SimulatedCamera.next_frame = next_frame  # type: ignore[method-assign]


def _break_model(trigger: Path) -> None:
    from vwnav.vision.features.learned import LearnedFeatures

    whole = LearnedFeatures.extract

    def extract(self: LearnedFeatures, *args: Any, **kwargs: Any) -> Any:
        if trigger.exists():
            raise RuntimeError("bad allocation in the inference session")
        return whole(self, *args, **kwargs)

    LearnedFeatures.extract = extract  # type: ignore[method-assign]
