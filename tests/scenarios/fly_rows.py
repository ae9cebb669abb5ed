"""Fly rows of the table by hand.

python tests/scenarios/fly_rows.py [--manners copter] [part of a name ...]
"""

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from scenario_place import default_place
from scenario_table import TABLE, in_manners

from vwnav.bench.flights.judge import judge
from vwnav.bench.flights.scenario import fly


def main(arguments: list[str]) -> int:
    """Fly every row that has one of the parts in its name; the number of bad ones."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--manners", choices=("px4", "copter"), default="px4")
    parser.add_argument("parts", nargs="*", metavar="part of a name")
    options = parser.parse_args(arguments)
    place, parts, bad = default_place(), options.parts, 0
    for row in TABLE:
        if parts and not any(part in row.name for part in parts):
            continue
        scenario = in_manners(row, options.manners)
        began_s = time.process_time()
        flown = fly(scenario, place)
        verdict = judge(flown)
        cost_s, flown_s = time.process_time() - began_s, flown.world.t_s
        bad += bool(verdict.wrong)
        off = "" if verdict.landed_off_m is None else f", down {verdict.landed_off_m:.1f} m off"
        word = "FAIL" if verdict.wrong else "ok  "
        print(
            f"{word} {scenario.name}: {flown_s:.0f} s in {cost_s:.0f} s, "
            f"{verdict.fastest_m_s:.1f} m/s, {verdict.worst_sigmas:.1f} sigmas{off}",
            flush=True,
        )
        for wrong in verdict.wrong:
            print(f"       {wrong}", flush=True)
        if verdict.wrong or len(parts) == 1:
            lines = [(e.t_s, f"- {e.text}") for e in flown.track.events]
            lines += [(e.t_s - flown.world.begun_s, f"mode {e.text}") for e in flown.track.modes()]
            lines += [(e.t_s, f"phase {e.text}") for e in flown.track.phases]
            for t_s, line in sorted(lines):
                print(f"       {t_s:7.2f} {line}", flush=True)
    return bad


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
