"""How many mutants of vwnav/safety its tests kill: of a seeded sample, or of all.

    python tests/mutants.py [--count 300 | --count all] [--seed 1] [--jobs 1]

Mutants are made and run by mutmut, as pyproject.toml says ([tool.mutmut]). A mutant that no test
reaches has survived; one that never ends is killed. `mutmut show NAME` shows what one changed.
"""

import argparse
import fnmatch
import math
import random
import subprocess
import sys
from collections import Counter
from pathlib import Path

from mutmut.__main__ import create_mutants
from mutmut.configuration import config
from mutmut.mutation.data import SourceFileMutationData
from mutmut.stats import status_by_exit_code
from mutmut.utils.file_utils import copy_also_copy_files, copy_src_dir

_Z_95 = 1.96
_KILLED = {"killed", "timeout"}
_WANTED = 0.9


def wilson(killed: int, tested: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    share, z2 = killed / tested, _Z_95**2
    middle = share + z2 / (2 * tested)
    half = _Z_95 * math.sqrt(share * (1 - share) / tested + z2 / (4 * tested**2))
    return (middle - half) / (1 + z2 / tested), (middle + half) / (1 + z2 / tested)


def mutated_files() -> list[Path]:
    """Those that are mutated, in order."""
    patterns = config().only_mutate
    found = sorted(p for pattern in patterns for p in Path().glob(pattern) if p.suffix == ".py")
    return [p for p in found if not any(fnmatch.fnmatch(str(p), d) for d in config().do_not_mutate)]


def statuses() -> dict[str, str]:
    """What became of each mutant there is, by its name, from mutmut's files."""
    found: dict[str, str] = {}
    for path in mutated_files():
        data = SourceFileMutationData(path=path)
        data.load()
        found |= {name: status_by_exit_code[code] for name, code in data.exit_code_by_key.items()}
    return found


def make(jobs: int) -> list[str]:
    """Make the mutants as `mutmut run` does, which takes them over; returns their names."""
    Path("mutants").mkdir(exist_ok=True)
    copy_src_dir()
    copy_also_copy_files()
    create_mutants(jobs)
    return list(statuses())


def report(found: dict[str, str], of: int) -> float:
    """Print what survived, and the share that was killed; returns it."""
    for name, status in found.items():
        if status not in _KILLED:
            print(f"{status}: {name}")
    killed, tested = sum(status in _KILLED for status in found.values()), len(found)
    low, high = wilson(killed, tested)
    print(", ".join(f"{status} {count}" for status, count in Counter(found.values()).items()))
    print(f"{killed} of {tested} mutants killed ({of} there are): {killed / tested:.1%}", end="")
    print("" if tested == of else f", 95 % interval {low:.1%} to {high:.1%}")
    return killed / tested


def main() -> int:
    """Exit code 1 when fewer than 90 % are killed, 2 when they could not be run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", default="300", help="of the sample, or all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    every = make(options.jobs)
    names = every
    if options.count != "all":
        count = min(int(options.count), len(every))
        names = sorted(random.Random(options.seed).sample(every, count))
    mutmut = str(Path(sys.executable).with_name("mutmut"))
    done = subprocess.run([mutmut, "run", "--max-children", str(options.jobs), *names], check=False)
    if done.returncode:
        return 2
    found = statuses()
    killed = report({name: found[name] for name in names}, len(every))
    return 0 if killed >= _WANTED else 1


if __name__ == "__main__":
    sys.exit(main())
