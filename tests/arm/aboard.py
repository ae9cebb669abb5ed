"""What runs inside the emulated tree: one part of the program, its result as a line of JSON.

FOLDER/python tests/arm/aboard.py imports | features IMAGE OUT MODEL... | flight FOLDER MODEL |
                                  recorder FOLDER | watchdog URL
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


def features(image: str, out: str, *models: str) -> dict[str, Any]:
    """The image's features by each released model, into OUT-MODEL.npz."""
    import numpy as np

    from vwnav.vision.features.learned import LearnedFeatures

    gray, seconds = np.load(image), {}
    for model in models:
        extractor = LearnedFeatures(Path(model))
        start_s = time.process_time()
        found = extractor.extract(gray, 1000)
        seconds[model] = round(time.process_time() - start_s, 2)
        np.savez(f"{out}-{model}.npz", uv=found.uv, descriptors=found.descriptors)
    return {"extraction_s": seconds}


def flight(folder: str, model: str) -> dict[str, Any]:
    """A flight's images through the pipeline, from where it is known to be."""
    import cv2
    import numpy as np

    from vwnav.assemble import assemble, choose_features
    from vwnav.cameras.video_file import VideoFile
    from vwnav.config import Config, with_features
    from vwnav.estimation.beginning.starts import Start
    from vwnav.geometry.calibration import load_camera
    from vwnav.geometry.geodesy import LocalFrame
    from vwnav.maps.pack import MapPack
    from vwnav.recording.telemetry_files import load_telemetry
    from vwnav.seams import InlineExecutor
    from vwnav.types import MapFix, Rejected

    cv2.setNumThreads(1)
    place, start = Path(folder), json.loads((Path(folder) / "start.json").read_text())
    rows: list[tuple[float, float, str, int]] = []

    def status(outcome: MapFix | Rejected) -> str:
        return "fix" if isinstance(outcome, MapFix) else outcome.reason.name

    config = with_features(Config(), "learned", Path(model))
    with MapPack.open(place / "map.mbtiles") as pack:
        assembled = assemble(
            *choose_features(config.features, print), pack, load_camera(place / "camera.toml"),
            LocalFrame(*start["origin"]), config, InlineExecutor(), print,
        )  # fmt: skip
        known = start["known"] | {"position_ned_m": np.array(start["known"]["position_ned_m"])}
        assembled.ekf.initialise(Start(t_s=0.0, **known))
        told = load_telemetry(place / "telemetry.csv").measurements(0.0)
        video = VideoFile(place / "flight.mkv")
        while (frame := video.next_frame()) is not None:
            # One row of telemetry after the image: its attitude is known.
            while told and (told[0].t_s <= frame.t_s or not assembled.pipeline.covers(frame.t_s)):
                assembled.pipeline.feed(told.pop(0))
            step = assembled.pipeline.step(frame)
            assert step.estimate is not None
            north_m, east_m, _ = step.estimate.position_ned_m
            found = step.outcome
            rows.append((float(north_m), float(east_m), status(found), found.stats.inliers))
        video.close()
    return {"rows": rows, "cpu_s": round(time.process_time(), 1)}


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
    images = sum(each.topic == "/camera" for each in read)
    return {"events": texts == [str(i) for i in range(40)], "pictures": images,
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
    part.__name__: part for part in (imports, features, flight, recorder, watchdog)
}

if __name__ == "__main__":
    print(json.dumps(PARTS[sys.argv[1]](*sys.argv[2:])))
