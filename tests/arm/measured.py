"""Runs a command, and writes the most memory that it took, in MB, into a file.

    measured.py PEAK COMMAND...

A process of its own, because what is started counts what its parent had as its own.
"""

import resource
import subprocess
import sys
from pathlib import Path

if __name__ == "__main__":
    code = subprocess.run(sys.argv[2:]).returncode
    peak_kb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    Path(sys.argv[1]).write_text(str(peak_kb / 1e3))
    sys.exit(code)
