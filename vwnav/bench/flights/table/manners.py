"""What is otherwise by design where the autopilot is an ArduCopter."""

from dataclasses import replace

from vwnav.bench.flights.scenario import Scenario
from vwnav.sim.config import Manners

# Without setpoints it flies on for 3 s, and once its EKF failsafe has acted (8 s) it comes down
# level, as the wind has it, until it is held again.
COPTER_LANDS_WITHIN_M = dict.fromkeys(
    ("link cut for 3 s", "link cut for 5 s", "link cut for 10 s"), 45.0
)
# Those that are flown in its manners too by `make test-long`.
FLOWN_IN_COPTER_MANNERS = {
    "attitude missing for 5 s",
    "battery critical",
    "link cut for 1 s on the route",
    "link cut for 10 s on the route",
    "link cut for 10 s while descending",
    "link cut for 5 s on the route",
    "IMU turns on its side in flight",
    "navigator killed",
    "navigator stopped for 20 s",
    "nothing breaks",
    "pictures gone for good at 50 m",
    "pilot takes over while on the route",
    "round trip of 0.3 s on the route",
}


def in_manners(row: Scenario, manners: Manners) -> Scenario:
    """The row as this autopilot flies it, with the bounds that are its own.

    One that names its autopilot (its manners, a parameter) is flown with that one always.
    """
    if row.setup.manners != "px4" or row.setup.parameters:
        return row
    setup = replace(row.setup, manners=manners)
    if manners != "copter" or row.lands_within_m is None:
        return replace(row, setup=setup)
    own = (bound_m for part, bound_m in COPTER_LANDS_WITHIN_M.items() if part in row.name)
    return replace(row, setup=setup, lands_within_m=next(own, row.lands_within_m))
