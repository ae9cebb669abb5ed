"""A flight test judged and drawn."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vwnav.bench.flights.thesis.plots import save_plots
from vwnav.bench.flights.thesis.samples import SAMPLE_S, Reference, Sample, columns, write_csv
from vwnav.bench.flights.thesis.tests import HOLD_S, FlightTest
from vwnav.mission.mission import Phase
from vwnav.types import Array

POSITION_M, YAW_DEG = 0.2, 2.0  # the thesis, 6.2: with GPS
_HOME_M = 3.0
_WAYPOINT_M = 2.0
_STEADY_S = 3.0  # after the hold begins
_FAILSAFE = Phase.FAILSAFE.value
_NAMES: dict[Reference, str] = {"true": "the truth", "fused": "the autopilot's own position"}
_SAYS: dict[Reference, str] = {"true": "", "fused": ", as the autopilot believes"}
_DOWN_M: dict[Reference, float] = {"true": 0.5, "fused": 3.0}  # its barometer drifts in a flight
SCORED: dict[Reference, str] = {
    "true": "the simulator's truth",
    "fused": "the autopilot's own position, which is made of vwnav's estimates: this is "
    "consistency, not truth",
}


@dataclass(frozen=True, slots=True)
class Step:
    """Something that had to happen; `detail` says what was seen."""

    name: str
    passed: bool
    detail: str


@dataclass(frozen=True, slots=True)
class Statistic:
    """Sizes of an error; `thesis` is what it had with GPS, None where it tells nothing."""

    name: str
    unit: str
    rms: float
    p95: float
    largest: float
    thesis: float | None


def steps(test: FlightTest, samples: Sequence[Sample], by: Reference = "true") -> list[Step]:
    """What the test asks for, in its order; places `by` whose word."""
    found = [_modes(test, samples), _home(samples, by)]
    if test.name == "hover":
        held_s = _lasts_s(held(samples))
        found.append(Step(f"held for {HOLD_S:.0f} s", held_s >= HOLD_S, f"{held_s:.1f} s"))
    if test.name == "waypoints":
        found.append(_waypoints(test, samples, by))
    if test.name != "failsafe":
        flown = {each.phase for each in samples}
        calm = not flown & {_FAILSAFE, Phase.RELEASED.value}
        found.append(Step("no failsafe", calm, "none" if calm else "it was flown"))
    return found


def statistics(
    test: FlightTest, samples: Sequence[Sample], by: Reference = "true"
) -> list[Statistic]:
    """Errors while it was ours: in Offboard, for the hover while it held; those that are known.

    What is no truth is not held against the thesis' figures.
    """
    ours = held(samples) if test.name == "hover" else [s for s in samples if s.mode == "OFFBOARD"]
    if not ours:
        return []
    there = columns(ours, *_place(by)[:2])
    estimated = columns(ours, "estimated_north_m", "estimated_east_m")
    yaw, commanded, believed = columns(
        ours, f"{by}_yaw_deg", "commanded_yaw_deg", "estimated_yaw_deg"
    ).T
    metres, degrees = (POSITION_M, YAW_DEG) if by == "true" else (None, None)
    errors = [
        (f"estimate off {_NAMES[by]}", "m", np.hypot(*(estimated - there).T), metres),
        (f"heading off the commanded{_SAYS[by]}", "deg", _turn_deg(yaw - commanded), degrees),
        (f"estimated heading off {_NAMES[by]}", "deg", _turn_deg(believed - yaw), None),
    ]
    if test.name == "hover":
        errors.insert(1, (f"held off the place{_SAYS[by]}", "m", np.hypot(*there.T), metres))
    return [_statistic(*each) for each in errors if np.any(np.isfinite(each[2]))]


def held(samples: Sequence[Sample]) -> list[Sample]:
    """While it waited above home, from when it was steady there."""
    waiting = [each for each in samples if each.phase == Phase.FIRST_FIX.value]
    return [each for each in waiting if each.t_s >= waiting[0].t_s + _STEADY_S]


def _lasts_s(samples: Sequence[Sample]) -> float:
    """By their times: in real time, on a busy machine, they come later than they are due."""
    return samples[-1].t_s - samples[0].t_s + SAMPLE_S if samples else 0.0


def _modes(test: FlightTest, samples: Sequence[Sample]) -> Step:
    """The wanted ones are part of those that were flown, in this order."""
    flown = [samples[0].mode]
    for each in samples:
        if each.mode != flown[-1]:
            flown.append(each.mode)
    rest = iter(flown)
    missing = next((mode for mode in test.modes if mode not in rest), None)
    seen = ", ".join(mode.lower() for mode in flown)
    wanted = ", ".join(mode.lower() for mode in test.modes)
    detail = seen if missing is None else f"{seen}; {missing.lower()} is missing"
    return Step(f"modes {wanted}", missing is None, detail)


def _home(samples: Sequence[Sample], by: Reference) -> Step:
    north_m, east_m, up_m = columns(samples[-1:], *_place(by))[0].tolist()
    off_m = float(np.hypot(north_m, east_m))
    down = up_m < _DOWN_M[by]
    detail = f"{off_m:.2f} m off" if down else f"{up_m:.0f} m high at the end"
    name = f"landed within {_HOME_M:g} m of the start{_SAYS[by]}"
    return Step(name, down and off_m <= _HOME_M, detail)


def _waypoints(test: FlightTest, samples: Sequence[Sample], by: Reference) -> Step:
    track = columns(samples, *_place(by))
    known = track[np.all(np.isfinite(track), axis=1)]
    route = np.array(test.scenario.setup.route_ned_m) * (1.0, 1.0, -1.0)
    near_m = [float(np.min(np.linalg.norm(known - each, axis=1), initial=np.inf)) for each in route]
    passed = max(near_m) <= _WAYPOINT_M
    detail = ", ".join(f"{each:.2f} m" for each in near_m)
    return Step(f"every waypoint within {_WAYPOINT_M:g} m{_SAYS[by]}", passed, detail)


def _place(by: Reference) -> tuple[str, str, str]:
    return f"{by}_north_m", f"{by}_east_m", f"{by}_up_m"


def _statistic(name: str, unit: str, errors: Array, thesis: float | None) -> Statistic:
    known = np.abs(errors[np.isfinite(errors)])
    rms, p95 = float(np.sqrt(np.mean(known**2))), float(np.percentile(known, 95))
    return Statistic(name, unit, rms, p95, float(known.max()), thesis)


def _turn_deg(difference_deg: Array) -> Array:
    return np.asarray((difference_deg + 180.0) % 360.0 - 180.0)


@dataclass(frozen=True, slots=True)
class TestReport:
    """What became of a test.

    Attributes:
        statistics: none where it never got so far.
        files: that were written to its folder.
        timeline: what the program said, a line each.
        scored_against: what, in words.
    """

    name: str
    steps: tuple[Step, ...]
    statistics: tuple[Statistic, ...]
    files: tuple[str, ...]
    timeline: tuple[str, ...]
    scored_against: str

    @property
    def passed(self) -> bool:
        """Every step did."""
        return all(step.passed for step in self.steps)


def report_on(
    test: FlightTest,
    samples: Sequence[Sample],
    said: Sequence[str],
    folder: Path,
    by: Reference = "true",
) -> TestReport:
    """Judge what was noted, write the plots and the table.

    Raises:
        VwnavError: matplotlib is missing.
    """
    table = f"{test.name}.csv"
    write_csv(samples, folder / table)
    files = (table, *save_plots(test, samples, folder, by))
    judged, numbers = tuple(steps(test, samples, by)), tuple(statistics(test, samples, by))
    return TestReport(test.name, judged, numbers, files, tuple(said), SCORED[by])
