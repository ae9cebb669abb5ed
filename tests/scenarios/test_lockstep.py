"""A flight in lockstep is the same each time, however busy the machine is."""

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from vwnav.bench.flights.fly import fly
from vwnav.bench.flights.lockstep_place import lockstep_place
from vwnav.bench.flights.log import flight_log
from vwnav.bench.flights.scenario import Scenario
from vwnav.bench.flights.table.telemetry import MISSING
from vwnav.bench.flights.world import World
from vwnav.recording.recorded_flight_log import recorded_flight_log
from vwnav.rules.rule import check
from vwnav.rules.table import RULES

SHORT = replace(MISSING[2], limit_s=12.0)


def bytes_and_estimates(scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> tuple[str, str]:
    """Digests of all that the vehicle heard and said, and of every estimate of the filter."""
    link, filter_ = hashlib.sha256(), hashlib.sha256()
    begin = World.begin

    def listen(world: World) -> None:
        for end in (world.autopilot_link.a, world.autopilot_link.b):
            end.write = noted(end.write)  # type: ignore[method-assign]
        begin(world)

    def noted(write):  # type: ignore[no-untyped-def]
        def put(data: bytes) -> None:
            link.update(data)
            write(data)

        return put

    monkeypatch.setattr(World, "begin", listen)
    flown = fly(scenario, lockstep_place())
    monkeypatch.setattr(World, "begin", begin)
    for step in flown.steps:
        if step.estimate is not None:
            filter_.update(step.estimate.position_ned_m.tobytes())
            filter_.update(step.estimate.covariance.tobytes())
    return link.hexdigest(), filter_.hexdigest()


def test_the_same_scenario_gives_the_same_bytes_and_estimates(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first = bytes_and_estimates(SHORT, monkeypatch)
    assert first == bytes_and_estimates(SHORT, monkeypatch)


def test_another_seed_gives_others(monkeypatch: pytest.MonkeyPatch) -> None:
    first = bytes_and_estimates(replace(SHORT, limit_s=1.0), monkeypatch)
    other = replace(SHORT, limit_s=1.0, setup=replace(SHORT.setup, seed=2))
    assert first != bytes_and_estimates(other, monkeypatch)


def test_what_a_flight_records_is_held_against_the_rules_too(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    path = tmp_path / "flight.mcap"
    flown = fly(replace(SHORT, limit_s=2.0), lockstep_place(), path)
    log, recorded = flight_log(flown), recorded_flight_log(path)
    assert not [verdict for verdict in check(RULES, recorded) if verdict.breach is not None]
    assert len(recorded.setpoints) == pytest.approx(10, abs=1)
    assert [fix.t_s for fix in recorded.fixes] == [fix.t_s for fix in log.fixes]
