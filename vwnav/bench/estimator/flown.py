"""A flight that the filter has been through, and the numbers that are made of it."""

from collections.abc import Callable
from dataclasses import dataclass

from vwnav.bench.estimator.streams import MeasurementEvent, MeasurementStream
from vwnav.estimation.events import NedFix
from vwnav.estimation.states import FilterState, Innovation
from vwnav.types import Array, Estimate, MapFix, OdometryMotion, Rejected


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Estimates at a steady rate against the truth, one row each.

    Attributes:
        t_s: (n,). error_ne_m (n, 2), error_v_m_s (n, 3), error_yaw_rad (n,), error_agl_m (n,):
            estimate minus truth.
        P: (n, 6, 6) of position and velocity. sigma_yaw_rad, sigma_agl_m: (n,).
        agl_m: (n,) true. way_m: (n,) flown so far, horizontally.
    """

    t_s: Array
    error_ne_m: Array
    error_v_m_s: Array
    error_yaw_rad: Array
    error_agl_m: Array
    P: Array
    sigma_yaw_rad: Array
    sigma_agl_m: Array
    agl_m: Array
    way_m: Array


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A flight through the filter.

    Attributes:
        answers: each event but attitudes and IMU samples, which are many and never compared, with
            what the filter said of it. cost_s: (n,) processor time of each.
        busy_s: processor time of all, estimates included.
    """

    stream: MeasurementStream
    rows: Rows
    estimates: list[Estimate]
    answers: list[tuple[MeasurementEvent, Innovation]]
    last: FilterState
    cost_s: Array
    busy_s: float


def images(run: Run) -> int:
    """How many images odometry has seen."""
    return sum(isinstance(event.seen, OdometryMotion) for event, _ in run.answers)


def accepted_wrong(run: Run, wrong_m: float) -> int:
    """How many accepted fixes were further off than that."""
    return sum(
        isinstance(event.seen, NedFix) and answer.accepted and event.error_m > wrong_m
        for event, answer in run.answers
    )


@dataclass(frozen=True, slots=True)
class Metric:
    """A number beside what is asked of it; `low` and `high` None ask nothing."""

    name: str
    value: float
    unit: str = ""
    low: float | None = None
    high: float | None = None

    @property
    def good(self) -> bool | None:
        """Whether it is within; None where nothing is asked."""
        if self.low is None and self.high is None:
            return None
        above = self.low is None or self.value >= self.low
        return above and (self.high is None or self.value <= self.high)


@dataclass(frozen=True, slots=True, eq=False)
class NavigatedFlight:
    """A flight that was navigated. `outcomes`: of each attempt to match an image to the map."""

    run: Run
    outcomes: list[MapFix | Rejected]

    @property
    def fixes(self) -> int:
        """How many attempts the filter took."""
        return sum(isinstance(outcome, MapFix) for outcome in self.outcomes)


@dataclass(frozen=True, slots=True)
class RenderedScenario:
    """How flights are flown and judged.

    Attributes:
        most_fixes: the map is asked until it has given so many; 0 is no limit.
        imu_hz: of the samples that the autopilot streams; 0 is none.
    """

    name: str
    judge: Callable[[list[NavigatedFlight]], list[Metric]]
    most_fixes: int = 0
    imu_hz: float = 0.0
