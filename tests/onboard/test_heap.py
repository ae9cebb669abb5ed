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


ARRAYS = """
import numpy as np
from pathlib import Path
from vwnav.onboard.heap import fill_array_cache

def resident_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

def use_arrays_of_all_small_sizes():
    for size in range(1, 1024):
        arrays = [np.empty(size, np.uint8) for _ in range(20)]
        del arrays

fill_array_cache()
before_mb = resident_mb()
use_arrays_of_all_small_sizes()
print(resident_mb() - before_mb)
"""


def test_small_arrays_of_all_sizes_take_nothing_more_in_flight():
    """Left out, it is 3.7 MB."""
    done = subprocess.run(
        [sys.executable, "-c", ARRAYS], capture_output=True, text=True, check=True
    )
    assert float(done.stdout) < 0.3
