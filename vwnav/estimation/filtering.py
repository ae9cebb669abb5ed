"""The filter as the pipeline sees it."""

from typing import Protocol

from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.inertial.attitudes import AttitudeHistory
from vwnav.estimation.inputs import Measurement
from vwnav.estimation.states import FilterState, Innovation
from vwnav.types import Estimate


class Filtering(Protocol):
    """What the pipeline needs of `vwnav.estimation.ekf.Ekf`."""

    @property
    def state(self) -> FilterState | None:
        """The state after the newest event; None before a start."""
        ...

    @property
    def attitudes(self) -> AttitudeHistory:
        """The autopilot's, as they are believed."""
        ...

    @property
    def counts_heading(self) -> bool:
        """Whether a video's own turning is all that tells the heading."""
        ...

    def initialise(self, start: Start) -> None:
        """Begin, or begin anew."""
        ...

    def handle(self, seen: Measurement) -> Innovation:
        """Take a measurement of any kind."""
        ...

    def estimate(self, t_s: float) -> Estimate | None:
        """The estimate at a time; None while there is nothing to predict from."""
        ...

    def covers(self, t_s: float) -> bool:
        """Whether telemetry has reached an exposure."""
        ...
