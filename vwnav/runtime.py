"""Real time around `Pipeline.step`: three loops that must not wait for each other.

Pictures go through the pipeline as they come; the estimate goes to the autopilot at a steady 50 Hz
(a gap of 200 ms stops its fusion); the mission ticks at 20 Hz and may wait for acknowledgements.
"""

import logging
import threading
import time
from collections.abc import Callable, Iterator
from typing import Protocol

from vwnav.flight import Flight, FlightEnd
from vwnav.pipeline import Pipeline, Sensors, StepResult
from vwnav.safety.estimate_guard import is_flyable
from vwnav.types import Autopilot, Estimate, Frame, FrameSource, ImuSample, VehicleState

log = logging.getLogger(__name__)

ESTIMATE_HZ = 50.0
TICK_HZ = 20.0
MAX_BAD_FRAMES = 30  # pictures in a row that break the pipeline before vision is given up


def _between_pictures(vehicle: VehicleState, imu: tuple[ImuSample, ...]) -> Sensors:
    return Sensors(
        attitude=vehicle.attitude,
        height_m=vehicle.height_m,
        height_t_s=vehicle.height_t_s,
        imu=imu,
    )


class Watcher(Protocol):
    """Sees what happens, for the record and the screen. Called from the loops: must be quick."""

    def saw_frame(self, frame: Frame, step: StepResult) -> None:
        """A picture went through the pipeline."""
        ...

    def saw_tick(self, t_s: float, estimate: Estimate | None, vehicle: VehicleState) -> None:
        """The mission ticked."""
        ...


class FlightRuntime:
    """Runs a flight to its end.

    Args:
        clock: the monotonic clock that stamps pictures and telemetry.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        flight: Flight,
        autopilot: Autopilot,
        source: FrameSource,
        watcher: Watcher,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._pipeline = pipeline
        self._flight = flight
        self._autopilot = autopilot
        self._source = source
        self._watcher = watcher
        self._clock = clock
        self._stop = threading.Event()
        self._failure: BaseException | None = None

    def run(self) -> FlightEnd:
        """Fly; returns when the mission has ended. An interrupt lands first.

        Raises:
            Exception: whatever broke the control loop; the watchdog has the aircraft then.
        """
        loops = [
            threading.Thread(target=self._guard, args=(loop,), name=loop.__name__, daemon=True)
            for loop in (self._stream_estimates, self._control, self._see)
        ]
        for thread in loops:
            thread.start()
        try:
            self._wait()
        except KeyboardInterrupt:
            self._flight.abort("interrupted by the operator: landing")
            self._wait()
        finally:
            self._stop.set()
            for thread in loops:
                thread.join(timeout=2.0)
        if self._failure is not None:
            raise self._failure
        assert self._flight.end is not None
        return self._flight.end

    def _wait(self) -> None:
        while self._flight.end is None and self._failure is None:
            time.sleep(0.1)

    def _guard(self, loop: Callable[[], None]) -> None:
        try:
            loop()
        except BaseException as error:
            log.exception("%s stopped", loop.__name__)
            self._failure = error

    def _stream_estimates(self) -> None:
        trusted = True
        for t_s in self._beats(ESTIMATE_HZ):
            sensors = _between_pictures(self._autopilot.state(), self._autopilot.take_imu())
            self._pipeline.sense(t_s, sensors)
            estimate = self._pipeline.estimate(t_s)
            if estimate is None:
                continue
            if trusted != (trusted := is_flyable(estimate)):
                log.warning("the estimate is %s", "sent again" if trusted else "not sent: lost")
            if trusted:
                self._autopilot.send_estimate(estimate)

    def _control(self) -> None:
        for t_s in self._beats(TICK_HZ):
            estimate = self._pipeline.estimate(t_s)
            self._flight.tick(t_s, estimate)
            self._watcher.saw_tick(t_s, estimate, self._autopilot.state())

    def _see(self) -> None:
        """Pictures through the pipeline; one that breaks it is skipped, the flight goes on."""
        bad = 0
        while not self._stop.is_set() and bad < MAX_BAD_FRAMES:
            frame = self._source.next_frame()
            if frame is None:
                log.warning("the camera has stopped: flying on without pictures")
                return
            try:
                step = self._pipeline.step(frame, self._sensors(frame.t_s))
            except Exception:
                bad += 1
                log.exception("picture %d could not be used", frame.index)
                continue
            bad = 0
            self._watcher.saw_frame(frame, step)
        if bad:
            log.error("%d pictures in a row could not be used: vision is off", bad)

    def _sensors(self, t_s: float) -> Sensors:
        vehicle = self._autopilot.state()
        return Sensors(
            attitude=self._autopilot.attitude_at(t_s),
            height_m=vehicle.height_m,
            height_t_s=vehicle.height_t_s,
            rangefinder_m=vehicle.rangefinder_m,
            on_ground=not vehicle.armed,
        )

    def _beats(self, rate_hz: float) -> Iterator[float]:
        """Times of a steady beat; after a stall it goes on from now instead of catching up."""
        next_s = self._clock()
        while not self._stop.is_set():
            yield self._clock()
            next_s = max(next_s + 1.0 / rate_hz, self._clock())
            time.sleep(max(0.0, next_s - self._clock()))
