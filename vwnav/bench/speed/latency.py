"""From exposure to estimate, in real time: the flight's pipeline beside a camera and a link."""

import math
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from vwnav.assemble import assemble
from vwnav.bench.speed.ground import TrialGround
from vwnav.bench.speed.results import Latency
from vwnav.bench.speed.settings import CAMERA_HZ, Setting
from vwnav.clock import Clock, WallClock
from vwnav.config import Config
from vwnav.estimation.beginning.starts import Start
from vwnav.pipeline import Pipeline
from vwnav.runtime import LINK_HZ
from vwnav.types import Attitude, Frame, Gray, Range

_NORTH_WXYZ = np.array([1.0, 0.0, 0.0, 0.0])
_POLL_S = 0.005


@dataclass(slots=True)
class _LinkLoop:
    """The link's loop: attitude and height in, estimates out, 50 times a second."""

    pipeline: Pipeline
    clock: Clock
    agl_m: float
    over: threading.Event
    latencies_s: list[float] = field(default_factory=list)
    gap_s: float = 0.0

    def run(self) -> None:
        """Until it is over."""
        fixed_s, before_s = None, self.clock()
        while not self.over.is_set():
            now_s = self.clock()
            self.gap_s = max(self.gap_s, now_s - before_s)
            self.pipeline.feed(Attitude(now_s, _NORTH_WXYZ))
            self.pipeline.feed(Range(now_s, self.agl_m))
            estimate = self.pipeline.estimate(now_s)
            if estimate is not None and estimate.t_last_fix_s not in (None, fixed_s):
                fixed_s = estimate.t_last_fix_s
                assert fixed_s is not None
                self.latencies_s.append(self.clock() - fixed_s)
            before_s = now_s
            self.clock.wait_until(now_s + 1.0 / LINK_HZ)


def measure_latency(
    setting: Setting, ground: TrialGround, target_hz: float, seconds: float
) -> Latency:
    """Fly a small circle in real time; the images were drawn before."""
    extractor = setting.load()
    pack = ground.pack(extractor)
    agl_m = ground.agl_m(pack.levels[0].m_per_px, setting.size_wh)
    images = ground.circle(agl_m, CAMERA_HZ)
    config = Config(**setting.as_config(target_hz))  # type: ignore[arg-type]
    clock, over = WallClock(), threading.Event()
    with ThreadPoolExecutor(1, "map matching") as pool:
        assembled = assemble(
            extractor, None, pack, ground.camera, ground.local_frame, config, pool, _say_nothing
        )
        assembled.ekf.initialise(_in_the_air(clock(), agl_m))
        link = _LinkLoop(assembled.pipeline, clock, agl_m, over)
        thread = threading.Thread(target=link.run, name="link", daemon=True)
        start_s, cpu_s = time.monotonic(), time.process_time()
        thread.start()
        try:
            _look(assembled.pipeline, images, clock, seconds)
        finally:
            over.set()
            thread.join()
        spent_s = time.monotonic() - start_s
        cores = (time.process_time() - cpu_s) / spent_s
    times_ms = 1e3 * np.array(link.latencies_s)
    return Latency(
        seconds=spent_s,
        rate_hz=assembled.pipeline.attempts / spent_s,
        fixes=len(times_ms),
        p50_ms=float(np.median(times_ms)) if len(times_ms) else None,
        p99_ms=float(np.quantile(times_ms, 0.99, method="higher")) if len(times_ms) else None,
        link_gap_ms=1e3 * link.gap_s,
        cores=cores,
    )


def _in_the_air(t_s: float, agl_m: float) -> Start:
    """Over home, at a height that is known a little."""
    at_ned_m = np.array([0.0, 0.0, -agl_m])
    return Start(
        t_s=t_s,
        position_ned_m=at_ned_m,
        agl_m=agl_m,
        sigma_agl_m=0.05 * agl_m,
        sigma_velocity_m_s=2.0,
    )


def _look(pipeline: Pipeline, images: list[Gray], clock: Clock, seconds: float) -> None:
    """The camera's loop: each image at its time; what comes while one is in work is missed."""
    start_s, number = clock(), 0
    while number / CAMERA_HZ < seconds:
        t_s = start_s + number / CAMERA_HZ
        clock.wait_until(t_s)
        while not pipeline.covers(t_s) and clock() < t_s + 0.1:
            clock.wait_until(clock() + _POLL_S)
        pipeline.step(Frame(t_s, images[number % len(images)], number))
        number = max(number + 1, math.ceil((clock() - start_s) * CAMERA_HZ))


def _say_nothing(_: str) -> None:
    """Nobody asks what the pipeline says here."""
