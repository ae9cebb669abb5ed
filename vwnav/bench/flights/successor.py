"""The second navigator in lockstep: woken by the watchdog, it gives estimates and nothing else."""

from collections.abc import Callable

import numpy as np

from vwnav.bench.flights.navigator import Navigator
from vwnav.geometry.geodesy import LocalFrame
from vwnav.succession import start_after
from vwnav.types import Array
from vwnav.watchdog.loop import Resume

_LINK_S = 0.8  # from the watchdog's word until the link is up and the vehicle's state is known


class LockstepSuccessor:
    """A `watchdog.loop.Successor` in this thread.

    Args:
        make: the navigator, told the reset counter to go on from.
        local_frame: the run's origin.
    """

    def __init__(self, make: Callable[[int], Navigator], local_frame: LocalFrame) -> None:
        self._make = make
        self._local_frame = local_frame
        self._woken_s: float | None = None
        self._resume: Resume | None = None
        self._flies = False
        self.navigator: Navigator | None = None

    def step(self, resume: Resume | None, t_s: float) -> None:
        """Keep it ready; with `resume` it is needed, from now on."""
        if resume is None:
            return
        if self.navigator is None:
            self._woken_s, self._resume = t_s, resume
            counter = 0 if resume.position is None else resume.position.reset_counter
            self.navigator = self._make(counter)
        navigator = self.navigator
        assert self._woken_s is not None
        if self._flies:
            navigator.step(t_s)
        elif t_s - self._woken_s < _LINK_S:
            navigator.hear(t_s)
        else:
            self._begin(navigator, t_s)

    def close(self) -> None:
        """It ends with the watchdog."""
        if self.navigator is not None:
            self.navigator.end()

    def _begin(self, navigator: Navigator, t_s: float) -> None:
        self._flies = True
        place = self._last_place()
        if place is None:
            navigator.start(None)
        else:
            assert self._resume is not None
            assert self._resume.position is not None
            navigator.start(start_after(place, self._resume.position.t_s, t_s))
        navigator.flight.ride(t_s, "the navigator ended: this one only sends estimates")

    def _last_place(self) -> Array | None:
        """(3,) of the last good estimate, about the run's origin."""
        resume = self._resume
        if resume is None or resume.position is None or resume.origin is None:
            return None
        origin = resume.origin
        frame = LocalFrame(origin.lat_deg, origin.lon_deg, origin.alt_amsl_m)
        lat, lon, _ = frame.to_geodetic(np.array(resume.position.position_ned_m))
        ned_m = self._local_frame.to_ned(float(lat), float(lon), self._local_frame.alt_amsl_m)
        ned_m[2] = resume.position.position_ned_m[2]
        return np.asarray(ned_m)
