"""The disk is full or does not answer; the computer's date is set."""

from vwnav.bench.flights.faults import computer
from vwnav.bench.flights.scenario import flies_on

DISK_AND_CLOCK = [
    flies_on("disk full", computer.DiskFull()),
    flies_on("disk stalled", computer.DiskStalled()),
    flies_on("computer's date jumps by an hour", computer.WallClockJumps(3600.0), 10.0),
    flies_on("computer's date jumps back by a day", computer.WallClockJumps(-86400.0), 10.0),
]
