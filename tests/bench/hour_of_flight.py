"""Fly for an hour in lockstep, recording, and print the process' memory once a minute.

    python hour_of_flight.py RECORDING [SECONDS]

One line of JSON a minute: simulated seconds, resident megabytes, fixes until then. At the end it
waits to be killed: the recording is never closed.
"""

import gc
import json
import signal
import sys
from pathlib import Path

from vwnav.bench.flights.lockstep_place import lockstep_place
from vwnav.bench.flights.scenario import Scenario, fly
from vwnav.bench.flights.setup import Setup
from vwnav.bench.flights.track import Heard
from vwnav.bench.flights.world import World

MINUTE_S = 60.0
LAP_NED_M = ((60.0, -60.0, -50.0), (130.0, 0.0, -50.0), (50.0, 70.0, -50.0), (0.0, 0.0, -50.0))
LAPS = 120  # more than an hour of them


def resident_mb() -> float:
    """Of this process (proc(5), statm: pages of 4 KiB)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


class Minutes:
    """Tells the memory, and drops what the harness notes for a judge that never comes."""

    def __init__(self, last_s: float) -> None:
        self._due_s = MINUTE_S
        self._last_s = last_s

    def see(self, world: World) -> None:
        """Called after every step."""
        if world.t_s < self._due_s:
            return
        self._due_s += MINUTE_S
        world.track.truth.clear()
        world.track.homes.clear()
        world.track.heard = Heard()
        world.navigator.record.steps.clear()
        gc.collect()
        told = {
            "t_s": round(world.t_s),
            "resident_mb": round(resident_mb(), 2),
            "fixes": world.navigator.pipeline.accepted,
            "phase": world.navigator.flight.phase.value,
        }
        print(json.dumps(told), flush=True)
        if world.t_s >= self._last_s:
            signal.pause()


def main() -> None:
    """See the module."""
    recording = Path(sys.argv[1])
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 3600.0
    setup = Setup(route_ned_m=LAP_NED_M * LAPS, battery_drain_s=20_000.0)
    scenario = Scenario(name="an hour", setup=setup, breaks=(), limit_s=seconds + 1.0)
    fly(scenario, lockstep_place(), recording, Minutes(seconds).see)


if __name__ == "__main__":
    main()
