"""What runs inside the emulated tree: one part of the program, its result as a line of JSON.

FOLDER/python tests/arm/aboard.py imports | features PICTURE OUT MODEL... | recorder FOLDER |
                                  watchdog URL
"""

import importlib
import json
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

DEPENDENCIES = (
    "numpy", "cv2", "onnxruntime", "mavsdk", "pymavlink.mavutil", "serial", "typer", "rich",
    "pydantic_settings", "PIL.Image", "tomli_w", "foxglove",
)  # fmt: skip


def imports() -> dict[str, Any]:
    """Everything that flies, imported."""
    for name in DEPENDENCIES:
        importlib.import_module(name)
    import vwnav.onboard.program  # noqa: F401

    return {"machine": platform.machine(), "imported": len(DEPENDENCIES)}


def features(picture: str, out: str, *models: str) -> dict[str, Any]:
    """The picture's features by each released model, into OUT-MODEL.npz."""
    import numpy as np

    from vwnav.vision.features.learned import LearnedFeatures

    gray, seconds = np.load(picture), {}
    for model in models:
        extractor = LearnedFeatures(Path(model))
        start_s = time.process_time()
        found = extractor.extract(gray, 1000)
        seconds[model] = round(time.process_time() - start_s, 2)
        np.savez(f"{out}-{model}.npz", uv=found.uv, descriptors=found.descriptors)
    return {"extraction_s": seconds}


def recorder(folder: str) -> dict[str, Any]:
    """A recording, written and read back."""
    import numpy as np

    from vwnav.recording.reader import is_cut_off, read_recording
    from vwnav.recording.recorder import Recorder
    from vwnav.types import Frame

    path = Path(folder) / "flight.mcap"
    writer = Recorder(path, {"settings": 1})
    for i in range(40):
        writer.frame(Frame(i / 10, np.full((60, 80), i, np.uint8), i))
        writer.event(i / 10, str(i))
        time.sleep(0.02)
    writer.close()
    read = list(read_recording(path))
    texts = [each.content["text"] for each in read if each.topic == "/event"]
    pictures = sum(each.topic == "/camera" for each in read)
    return {"events": texts == [str(i) for i in range(40)], "pictures": pictures,
            "whole": not is_cut_off(path)}  # fmt: skip


def watchdog(url: str) -> dict[str, Any]:
    """The watchdog's own process on a link: beaten, it answers; then it is let go."""
    from vwnav.watchdog.launch import start_watchdog

    with start_watchdog(url) as process:
        until_s = time.monotonic() + 60.0
        while process.keepalive.report is None and time.monotonic() < until_s:
            process.keepalive.beat(False, "getting ready")
            time.sleep(0.05)
        report = process.keepalive.report
    return {"state": None if report is None else report.state.name}


PARTS: dict[str, Callable[..., dict[str, Any]]] = {
    part.__name__: part for part in (imports, features, recorder, watchdog)
}

if __name__ == "__main__":
    print(json.dumps(PARTS[sys.argv[1]](*sys.argv[2:])))
