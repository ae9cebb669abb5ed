"""Print the table of faults as docs/flying.md has it: `python -m vwnav.bench.flights.table`."""

from vwnav.bench.flights.table import manual

if __name__ == "__main__":
    print(manual())
