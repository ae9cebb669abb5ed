"""The flight as three steps that must not wait for each other, and the threads that call them.

Images go through the pipeline as they come; telemetry goes into it and the estimate goes out at a
steady 50 Hz (a gap of 200 ms stops the autopilot's fusion); the mission ticks at 20 Hz. In life
each step has a thread; a simulation in lockstep calls them one after the other.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace

from vwnav.clock import Clock
from vwnav.errors import LinkError, VwnavError
from vwnav.flight import Flight
from vwnav.mission.mission import ASKS, GONE_S, DeadMansHandle, FlightEnd, Phase
from vwnav.pipeline import Pipeline
from vwnav.safety.camera_watch import MOST_AHEAD_S, CameraWatch
from vwnav.safety.estimate_guard import EstimateGuard
from vwnav.safety.stall import Stall
from vwnav.seams import ATTITUDE_WAIT_S, FrameSource, GuardedWatcher, StepResult
from vwnav.types import Frame, MapFix, OdometryMotion, Rejected, RejectReason
from vwnav.vehicle import Autopilot, Navigation, VehicleState

log = logging.getLogger(__name__)

LINK_HZ = 50.0
TICK_HZ = 20.0
_LINK_FAILS_S = 1.0
_HANGS_S = 2.0  # of one loop's turns while another one does not come round
_LEAVES_S = 2.0  # for a loop to end its turn
_LEAVES_AT_ONCE_S = 0.2  # the same where somebody waits to take over
SILENT_S = 1.1  # of telemetry: a gap of a second is bridged, by the filter and by autopilots
_ATTITUDE_POLL_S = 0.01
_CAMERA_AGAIN_S = 0.2
# What simulated time waits for (`vwnav.clock`), beside the beats of the loops:
TELEMETRY_LATE_S = 0.1  # from the measurement of an attitude to the filter
IMAGE_LATE_S = 0.07  # from an image's arrival to the end of its step


class FlightRuntime:
    """A flight's steps; `run` calls them in threads until the flight has ended.

    Whatever breaks, the aircraft is not left: a watcher that fails (a full disk) is left out, an
    image or a camera that fails is a missing image, a link step that fails is tried again, and
    when the mission itself breaks, it falls silent, so that the watchdog lands the aircraft, while
    estimates go on until the motors stop. Where the link's steps fail on and on, or hang, no
    estimate goes out: the program ends at once, the watchdog lands the aircraft, and its successor
    gives estimates. A mission that hangs is one that broke.

    Attributes:
        failure: what broke the mission or the link.
        link_broke: nothing reaches the autopilot any more: the process is to end at once.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        flight: Flight,
        autopilot: Autopilot,
        guard: EstimateGuard,
        keep_alive: DeadMansHandle,
        camera: CameraWatch,
        watcher: GuardedWatcher,
        notices: deque[str],
    ) -> None:
        self._pipeline = pipeline
        self._flight = flight
        self._autopilot = autopilot
        self._guard = guard
        self._keep_alive = keep_alive
        self._camera = camera
        self._watcher, self._notices = watcher, notices
        self._lock = threading.Lock()
        self._navigation = Navigation(None)
        self._seen_s: float | None = None
        self._contradicted = self._follows = False
        self._heard_s: float | None = None
        self._link_fails_since_s: float | None = None
        self.link_broke, self._turns, self._ticks = False, 0, 0
        self._link_stall = Stall(round(_HANGS_S * TICK_HZ))
        self._mission_stall = Stall(round(_HANGS_S * LINK_HZ))
        self._said: set[str] = set()
        self._stop, self._is_interrupted = threading.Event(), False
        self.failure: Exception | None = None

    @property
    def navigation(self) -> Navigation:
        """What there is to fly on."""
        with self._lock:
            return self._navigation

    # ---- the steps

    def step_link(self, t_s: float) -> None:
        """Telemetry into the pipeline, the guarded estimate out to the autopilot.

        A step that fails is left out; once none has worked for a second, the link is broken.
        """
        self._turns += 1
        self._notice_hung_mission()
        try:
            self._exchange(t_s)
        except Exception as error:
            log.exception("a step of the link failed")
            self._say_once("link", f"a step of the link failed, it goes on: {error!r}")
            if self._link_fails_since_s is None:
                self._link_fails_since_s = t_s
            if t_s - self._link_fails_since_s > _LINK_FAILS_S:
                self._break_link(error)
        else:
            self._link_fails_since_s = None

    def _exchange(self, t_s: float) -> None:
        self._autopilot.step(t_s)
        for measurement in self._autopilot.take_measurements():
            self._pipeline.feed(measurement)
            self._turns += 1  # who catches up does not hang
        self._obey_ground_stations()
        believed = self._pipeline.estimate(t_s)
        vehicle = self._autopilot.state()
        self._heard_s = None if vehicle.attitude is None else vehicle.attitude.t_s
        self._lose_what_is_not_heard(vehicle, t_s)
        sent = self._guard.admit(believed, t_s, vehicle.armed, self._seen_s)
        lost = self._guard.reason if believed is not None and sent is None else ""
        learned = self._pipeline.learned()
        with self._lock:
            before = self._navigation
            seen = self._seen_s, self._contradicted, learned, self._follows
            self._navigation = Navigation(sent, lost, *seen, self._pipeline.attempts)
        if sent is not None:
            self._autopilot.send_estimate(sent)
        if believed is not None and bool(lost) != bool(before.lost):
            said = f"the estimate is not sent any more: {lost}" if lost else "estimates again"
            self._notices.append(said)
        self._tell_what_was_noticed()

    def _tell_what_was_noticed(self) -> None:
        """By filter and loops, to the record, the screen and the ground stations."""
        while self._notices:
            text = self._notices.popleft()
            self._watcher.event(text)
            self._autopilot.send_text(text)

    def _obey_ground_stations(self) -> None:
        orders, refused = self._autopilot.take_orders()
        for order in orders:
            self._watcher.event(f"{ASKS} {order.value}")
            self._flight.obey(order)
        for text in refused:
            self._watcher.event(text)

    def _lose_what_is_not_heard(self, vehicle: VehicleState, t_s: float) -> None:
        """What the guard cannot see: a silent autopilot, a watchdog that hands nothing on.

        An estimate that has run on its own through a gap comes back as a new one, or not at all.
        """
        report = self._keep_alive.report
        if vehicle.armed and vehicle.silence_s > SILENT_S:
            self._guard.miss("the autopilot is not heard", t_s)
        hands_on = report is None or report.relays_estimates or not vehicle.armed
        self._guard.follow_relay(hands_on, t_s)

    def _break_link(self, error: Exception) -> None:
        """Nobody is told a place from here on: whoever takes over shall begin now."""
        self.failure, self.link_broke = error, True
        self._watcher.event(f"the link broke: vwnav ends, and the watchdog lands it ({error!r})")
        self._keep_alive.leave()

    def step_control(self, t_s: float) -> None:
        """One tick of the mission, none after one that failed; what there is to fly on is fresh."""
        if self.failure is not None:
            return
        self._ticks += 1
        if self._link_stall.look(self._turns):
            self._break_link(LinkError("the loop of the link hangs"))
            return
        navigation = self.navigation
        try:
            self._flight.tick(t_s, navigation)
        except Exception as error:
            log.exception("the mission broke")
            self.failure = error
            self._notices.append(f"the mission broke: the watchdog lands the aircraft ({error!r})")
            return
        vehicle = self._autopilot.state()
        self._watcher.saw_tick(t_s, navigation.estimate, vehicle)

    def _notice_hung_mission(self) -> None:
        """One that waits for good is a broken one: told, and left when the motors have stopped."""
        hangs = self._ticks > 0 and self._mission_stall.look(self._ticks)
        if hangs and self.failure is None:
            self.failure = VwnavError("the loop of the mission hangs")
            self._notices.append("the mission hangs: the watchdog lands the aircraft")

    def step_vision(self, frame: Frame, t_s: float) -> None:
        """One image through the pipeline; one that breaks it is an image that told nothing."""
        trouble = self._camera.look(frame, t_s)
        if trouble:
            frame = replace(frame, t_s=t_s)  # its own may be the trouble
        try:
            step = self._without(frame, trouble) if trouble else self._pipeline.step(frame)
        except Exception as error:
            first = "broken picture" not in self._said  # thirty tracebacks a second tell no more
            log.warning("picture %d could not be used: %r", frame.index, error, exc_info=first)
            self._say_once("broken picture", f"a picture could not be used: {error!r}")
            self._follows = False
            return
        way = step.motion
        if isinstance(way, Rejected) and way.reason is RejectReason.NO_FRAME:
            self._say_once(way.detail, f"pictures are not used: {way.detail}")
        with self._lock:
            # What the filter refuses of motions: `Verdict.DISTRUSTED`.
            self._contradicted = isinstance(way, Rejected) and way.reason is RejectReason.PRIOR
            self._follows = isinstance(way, OdometryMotion) or isinstance(step.outcome, MapFix)
            if self._follows:
                self._seen_s = frame.t_s
        self._watcher.saw_frame(frame, step)

    def awaits_telemetry(self, frame: Frame, t_s: float) -> bool:
        """Whether telemetry may still come that reaches to an image's exposure."""
        late_s = t_s - frame.t_s
        may_come = -MOST_AHEAD_S <= late_s < ATTITUDE_WAIT_S  # nobody waits for a false time
        return may_come and not self._pipeline.covers(frame.t_s)

    # ---- life

    def run(self, source: FrameSource, clock: Clock) -> FlightEnd:
        """Fly; returns when the mission has ended (see `interrupt`).

        Args:
            source: of the images.
            clock: the one that stamps images and telemetry.

        Raises:
            Exception: what broke the mission, after the aircraft has been brought down.
        """
        loops = [
            threading.Thread(target=loop, name=name, daemon=True)
            for name, loop in (
                ("link", lambda: self._link_loop(clock)),
                ("mission", lambda: self._mission_loop(clock)),
                ("vision", lambda: self._vision_loop(source, clock)),
            )
        ]
        for thread in loops:
            thread.start()
        try:
            self._wait()
        finally:
            self._stop.set()
            for thread in loops:
                thread.join(_LEAVES_AT_ONCE_S if self.link_broke else _LEAVES_S)
        if self.failure is not None:
            raise self.failure
        assert self._flight.end is not None
        return self._flight.end

    def interrupt(self) -> None:
        """Land; one who does not steer goes on. For a signal's handler: it notes it, no more."""
        self._is_interrupted = True

    def _wait(self) -> None:
        """Until the flight has ended."""
        while not (self.link_broke or self._is_down_after_failure() or self._flight.end):
            time.sleep(0.1)
            if self._is_interrupted:
                self._is_interrupted = False
                self._heed_interrupt()

    def _heed_interrupt(self) -> None:
        if self._flight.phase is Phase.RELEASED:
            self._watcher.event(
                "interrupted, but somebody else flies the aircraft on these estimates: they go on "
                "until it is disarmed"
            )
        else:
            self._flight.abort("interrupted by the operator: landing")

    def _is_down_after_failure(self) -> bool:
        if self.failure is None:
            return False
        vehicle = self._autopilot.state()
        return not vehicle.armed or vehicle.silence_s > GONE_S

    def _link_loop(self, clock: Clock) -> None:
        telemetry, heard_s = clock.join("telemetry"), self._heard_s
        for t_s in self._beats(clock, "link", LINK_HZ):
            self._pipeline.link_rests.clear()
            self.step_link(t_s)
            self._pipeline.link_rests.set()
            if self.link_broke:
                break
            if self._heard_s is not None and self._heard_s != heard_s:
                heard_s = self._heard_s
                telemetry.until(heard_s + TELEMETRY_LATE_S)
        telemetry.leave()

    def _mission_loop(self, clock: Clock) -> None:
        for t_s in self._beats(clock, "mission", TICK_HZ):
            self.step_control(t_s)
            if self.failure is not None:
                return

    def _vision_loop(self, source: FrameSource, clock: Clock) -> None:
        """Images as they come; a camera that fails is asked again and again."""
        vision = clock.join("vision")
        while not self._stop.is_set():
            try:
                frame = source.next_frame()
            except Exception as error:
                self._say_once("camera", f"the camera fails, flying on without pictures: {error}")
                self._stop.wait(_CAMERA_AGAIN_S)
                continue
            if frame is None:
                if not self._stop.is_set():
                    self._notices.append("the camera has stopped: flying on without pictures")
                return
            while self.awaits_telemetry(frame, clock()) and not self._stop.is_set():
                clock.wait_until(clock() + _ATTITUDE_POLL_S)
            vision.until(clock() + IMAGE_LATE_S)
            self.step_vision(frame, clock())
            vision.leave()

    def _beats(self, clock: Clock, name: str, rate_hz: float) -> Iterator[float]:
        """Times of a steady beat; after a stall it goes on from now instead of catching up."""
        period_s = 1.0 / rate_hz
        participant, next_s = clock.join(name), clock()
        try:
            while not self._stop.is_set():
                yield clock()
                next_s = max(next_s + period_s, clock())
                participant.until(next_s + period_s)
                clock.wait_until(next_s)
        finally:
            participant.leave()

    # ---- what must never end a flight

    def _without(self, frame: Frame, trouble: str) -> StepResult:
        """The step of an image that is not used."""
        nothing = Rejected(frame.t_s, RejectReason.NO_FRAME, trouble)
        return StepResult(frame.t_s, nothing, nothing, self._pipeline.estimate(frame.t_s))

    def _say_once(self, about: str, text: str) -> None:
        if about not in self._said:
            self._said.add(about)
            self._notices.append(text)
