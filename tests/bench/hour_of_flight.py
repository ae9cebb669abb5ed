"""Fly for an hour in lockstep, recording, and print the process' memory once a minute.

    python hour_of_flight.py RECORDING [SECONDS]

One line of JSON a minute: simulated seconds, resident megabytes, what of the heap is in use and
what is free, fixes until then, by how much the height is wrong and its sigma. At the end it waits
to be killed: the recording is never closed.
"""

import ctypes
import gc
import json
import signal
import sys
from pathlib import Path

import numpy as np

from vwnav.bench.flights.fly import fly
from vwnav.bench.flights.lockstep_place import lockstep_place
from vwnav.bench.flights.scenario import Scenario
from vwnav.bench.flights.setup import Setup
from vwnav.bench.flights.track import Heard
from vwnav.bench.flights.world import World
from vwnav.onboard.heap import fill_array_cache, give_back_free_memory

MINUTE_S = 60.0
LAP_NED_M = ((60.0, -60.0, -50.0), (130.0, 0.0, -50.0), (50.0, 70.0, -50.0), (0.0, 0.0, -50.0))
LAPS = 120  # more than an hour of them
SEEN_BESIDE_M = 150.0  # of the route, leaning by up to 20 degrees


def resident_mb() -> float:
    """Of this process (proc(5), statm: pages of 4 KiB)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


class Mallinfo2(ctypes.Structure):
    """What glibc counts of its heap, in bytes (mallinfo(3)): mapped blocks apart from the rest."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in (
            "arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks",
            "fordblks", "keepcost",
        )
    )  # fmt: skip


def heap_mb() -> dict[str, float]:
    """In use, and free but kept: growth of the first is a leak, of the second fragments."""
    mallinfo2 = ctypes.CDLL(None).mallinfo2
    mallinfo2.restype = Mallinfo2
    found = mallinfo2()
    used, free = found.uordblks + found.hblkhd, found.fordblks
    return {"used_mb": round(used / 1e6, 2), "free_mb": round(free / 1e6, 2)}


class Minutes:
    """Tells the memory, and drops what the harness notes for a judge that never comes."""

    def __init__(self, last_s: float) -> None:
        self._due_s = 0.0
        self._last_s = last_s

    def see(self, world: World) -> None:
        """Called after every step."""
        if self._due_s == 0.0:
            draw_all(world)
            self._due_s = MINUTE_S
        if world.t_s < self._due_s:
            return
        self._due_s += MINUTE_S
        world.track.truth.clear()
        world.track.homes.clear()
        world.track.heard = Heard()
        world.navigator.record.steps.clear()
        gc.collect()
        give_back_free_memory()  # once a minute, as `vwnav fly` does
        estimate = world.navigator.pipeline.estimate(world.t_s)
        assert estimate is not None
        told = {
            "t_s": round(world.t_s),
            "resident_mb": round(resident_mb(), 2),
            **heap_mb(),
            "tiles": world.camera.renderer.tiles_in_memory,
            "fixes": world.navigator.pipeline.accepted,
            "down_error_m": round(float(estimate.position_ned_m[2]) - world.core.vehicle.body.d, 2),
            "sigma_down_m": round(float(estimate.covariance[2, 2]) ** 0.5, 2),
            "phase": world.navigator.flight.phase.value,
        }
        print(json.dumps(told), flush=True)
        if world.t_s >= self._last_s:
            signal.pause()


def draw_all(world: World) -> None:
    """What the simulated camera may see: it else draws and keeps it as the wind leads it there.

    From the route's height, and coarser, for a camera that leans far.
    """
    lap_ned_m = np.array([(0.0, 0.0, -50.0), *LAP_NED_M])
    for factor in (1.0, 2.0):
        route_ned_m = lap_ned_m * [1.0, 1.0, factor]
        world.camera.renderer.prepare(route_ned_m, half_width_m=SEEN_BESIDE_M)


def main() -> None:
    """See the module."""
    fill_array_cache()  # as `vwnav fly` does
    recording = Path(sys.argv[1])
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 3600.0
    setup = Setup(route_ned_m=LAP_NED_M * LAPS, battery_drain_s=20_000.0)
    scenario = Scenario(name="an hour", setup=setup, breaks=(), limit_s=seconds + 1.0)
    fly(scenario, lockstep_place(), recording, Minutes(seconds).see)


if __name__ == "__main__":
    main()
