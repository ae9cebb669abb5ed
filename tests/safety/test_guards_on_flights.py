"""Both guards on estimates that a navigator sent into real PX4 software, and that lost it."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from vwnav.safety.estimate_guard import EstimateGuard
from vwnav.types import Estimate
from vwnav.watchdog.relay_guard import RelayedPosition, RelayGuard

mcap = pytest.importorskip("mcap.reader")

# The first estimate that lost the aircraft, in seconds from the first one of the recording.
LOST_S = {"px4_link_cut_5s": 43.2, "px4_stopped_20s": 62.7}


def messages(folder: Path):
    """(armed, estimate) in order; five a second were recorded of the fifty that were sent."""
    armed = False
    with (folder / "flight.mcap").open("rb") as file:
        topics = ["/estimate", "/vehicle"]
        for _, channel, message in mcap.make_reader(file).iter_messages(topics=topics):
            fields = json.loads(message.data)
            if channel.topic == "/vehicle":
                armed = fields["armed"]
                continue
            values = {k: np.array(v) if isinstance(v, list) else v for k, v in fields.items()}
            yield armed, Estimate(**{k: v for k, v in values.items() if k in Estimate.__slots__})


def truth_ne_m(folder: Path, t_s: float) -> np.ndarray:
    with (folder / "truth.csv").open() as file:
        rows = [[float(r[k]) for k in ("t_s", "north_m", "east_m")] for r in csv.DictReader(file)]
    table = np.array(rows).T
    return np.array([np.interp(t_s, table[0], table[i]) for i in (1, 2)])


def as_sent(estimate: Estimate) -> RelayedPosition:
    north_m, east_m, down_m = (float(v) for v in estimate.position_ned_m)
    sigma_m, counter = estimate.sigma_horizontal_m, estimate.reset_counter
    return RelayedPosition(estimate.t_s, (north_m, east_m, down_m), sigma_m, counter)


@pytest.mark.parametrize("name", LOST_S)
def test_all_good_estimates_are_sent_and_none_of_those_that_lost_the_aircraft(data_folder, name):
    folder = data_folder / "mavlink" / "vwnav_flights" / name
    if not folder.is_dir():
        pytest.skip(f"no recorded flight at {folder}")
    flight = list(messages(folder))
    start_s = flight[0][1].t_s
    for each in ("navigator", "watchdog"):
        guard, relay, sent = EstimateGuard(), RelayGuard(), []
        for armed, estimate in flight:
            if each == "navigator":
                passes = guard.admit(estimate, estimate.t_s, armed) is not None
            else:
                passes = relay.admit_position(as_sent(estimate), estimate.t_s, armed)
            sent += [estimate] if passes else []
        assert sent == [e for _, e in flight if e.t_s - start_s < LOST_S[name] - 0.1]
        last = sent[-1]
        assert np.hypot(*(last.position_ned_m[:2] - truth_ne_m(folder, last.t_s))) < 1.0
