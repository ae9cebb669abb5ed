"""What is freed is given back."""

import subprocess
import sys

PROGRAM = """
import numpy as np
from pathlib import Path
from vwnav.onboard.heap import give_back_free_memory

def resident_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

rng = np.random.default_rng(1)
give_back_free_memory()
before_mb, kept = resident_mb(), []
for _ in range(200):
    pictures = [np.ones(rng.integers(1_100_000, 9_000_000), np.uint8) for _ in range(4)]
    kept.append(np.ones(20_000, np.uint8))
del pictures
held_mb = resident_mb() - before_mb
assert give_back_free_memory()
print(held_mb, resident_mb() - before_mb - 200 * 0.02)
"""


def test_images_of_all_sizes_leave_nothing_behind():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True
    )
    held_mb, left_mb = map(float, done.stdout.split())
    assert left_mb < 3.0 < held_mb
