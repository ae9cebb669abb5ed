"""A Raspberry Pi camera in the place of picamera2, for commands that run in this folder.

It shows the pictures of the folder that FAKE_PI names, again and again, by its `plan.json`:
modes: [width, height, bits, crop], of which libcamera takes the one most like what is asked.
chosen: number of the mode that it takes where none is asked.
pulled: an image and how often it is then looked for in vain; the cable is off from there.
"""

import json
import os
import time
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import cv2

FOLDER = Path(os.environ["FAKE_PI"])
PLAN = json.loads((FOLDER / "plan.json").read_text())
IMAGES = [cv2.imread(str(path)) for path in sorted(FOLDER.glob("*.png"))]
NUMBER, MISSED = count(), count(1)
PERIOD_S = 0.1


class Picamera2:
    camera_controls: dict = {}  # noqa: RUF012
    camera_properties = {"Model": "imx219"}  # noqa: RUF012

    def __init__(self) -> None:
        self.pulled = PLAN.get("pulled", [10**9, 0])
        if PLAN.get("off") and next(MISSED) <= self.pulled[1]:
            raise RuntimeError("Camera __init__ sequence did not complete.")
        PLAN["off"] = False

    def create_video_configuration(self, _main, **asked):
        return asked

    def configure(self, asked) -> None:
        modes = PLAN["modes"]
        wanted = asked.get("sensor", {}).get("output_size")
        self.mode = modes[PLAN["chosen"]]
        if wanted is not None:
            self.mode = min(modes, key=lambda mode: abs(mode[0] - wanted[0]))

    def camera_configuration(self):
        return {"sensor": {"output_size": tuple(self.mode[:2]), "bit_depth": self.mode[2]}}

    def start(self) -> None: ...
    def close(self) -> None: ...

    def capture_request(self, wait: float):
        time.sleep(PERIOD_S)
        number = next(NUMBER)
        if number == self.pulled[0]:
            PLAN["off"] = True
            raise TimeoutError(f"no image for {wait} s")
        metadata = {
            "SensorTimestamp": time.monotonic_ns(), "ExposureTime": 4000,
            "ScalerCrop": tuple(self.mode[3]),
        }  # fmt: skip
        image = IMAGES[number % len(IMAGES)]
        return SimpleNamespace(
            make_array=lambda _: image, get_metadata=lambda: metadata, release=lambda: None
        )
