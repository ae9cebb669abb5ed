"""The navigator's process in lockstep: its loops as workers of a simulated processor."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vwnav.bench.flights.noted_link import LockstepWatcher
from vwnav.bench.flights.stage import Loop
from vwnav.config import Config
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.ekf import Ekf
from vwnav.flight import Flight
from vwnav.geometry.geodesy import LocalFrame
from vwnav.mavlink.autopilot import LinkedAutopilot
from vwnav.mavlink.ports.pymavlink_port import PymavlinkPort
from vwnav.mission.mission import Crew, Mission, Phase
from vwnav.onboard.succession import last_place, start_after
from vwnav.pipeline import Pipeline
from vwnav.recording.flight_recorder import FlightRecorder
from vwnav.recording.input_log import About
from vwnav.recording.recorder import Recorder
from vwnav.runtime import LINK_HZ, TICK_HZ, FlightRuntime
from vwnav.safety.camera_watch import CameraWatch
from vwnav.safety.check import Check
from vwnav.safety.estimate_guard import EstimateGuard
from vwnav.safety.readiness import Equipment, check_flight
from vwnav.seams import GuardedWatcher
from vwnav.sim.lockstep_camera import LockstepCamera
from vwnav.sim.memory_link import MemoryEnd
from vwnav.sim.processor import Costs, LateExecutor, Processor, SimulatedClock, Worker
from vwnav.types import Estimate, Frame
from vwnav.vehicle import Navigation, VehicleState
from vwnav.watchdog.keepalive import KeepAlive
from vwnav.watchdog.successor import Resume

_CAMERA_AGAIN_S = 1.0
_FIXES_BEFORE = 2  # of a mission that begins in the air
_LINK_S = 0.8  # from the watchdog's word until the link is up, where the autopilot is heard


@dataclass(slots=True)
class Equipped:
    """What the navigator is built from besides its links.

    Attributes:
        watch: over the camera's images.
        executor: of the pipeline's matching.
        record: takes every line said.
        notices: where the pipeline puts what it has to say.
        about: the run, in writing.
    """

    mission: Mission
    local_frame: LocalFrame
    config: Config
    watch: CameraWatch
    pipeline: Pipeline
    ekf: Ekf
    executor: LateExecutor
    record: LockstepWatcher
    notices: deque[str]
    about: About


class Navigator:
    """Driver, pipeline, flight and runtime, stepped; its loops begin with `start`.

    Args:
        link: to the watchdog; `channel` carries the beats.
        first_counter: of resets, where it goes on for another one.
    """

    def __init__(
        self,
        equipped: Equipped,
        link: MemoryEnd,
        channel: MemoryEnd,
        camera: LockstepCamera,
        clock: SimulatedClock,
        processor: Processor,
        costs: Costs,
        first_counter: int = 0,
    ) -> None:
        config = equipped.config
        self._clock = clock
        self._processor = processor
        self._costs = costs
        self._camera = camera
        self.record, self.executor = equipped.record, equipped.executor
        self.port = PymavlinkPort(link, clock)
        self.autopilot = LinkedAutopilot(
            self.port, clock, ground_station_ids=config.flight.ground_station_ids
        )
        self.keep_alive = KeepAlive(channel, clock)
        self.pipeline, self.ekf = equipped.pipeline, equipped.ekf
        self._about, self._watch = equipped.about, equipped.watch
        watcher = GuardedWatcher(self.record)
        crew = Crew(watcher.event, self._checks)
        self.flight = Flight(
            self.autopilot, equipped.mission, self.keep_alive, crew, config.flight, config.limits,
            config.safety,
        )  # fmt: skip
        self._guard = EstimateGuard(config.estimate, first_counter)
        self.runtime = FlightRuntime(
            self.pipeline, self.flight, self.autopilot, self._guard, self.keep_alive, self._watch,
            watcher, equipped.notices,
        )  # fmt: skip
        self._config = config
        frame = equipped.local_frame
        self.autopilot.set_origin(frame.lat_deg, frame.lon_deg, frame.alt_amsl_m)
        self._workers: dict[str, Worker] = {}
        self._frame: Frame | None = None
        self._frame_done_s: float | None = None
        self._frame_begun_s = 0.0
        self._camera_again_s = 0.0
        self._asleep_until_s = -np.inf
        self._hung: set[Loop] = set()
        self.ended = False

    def keep_at(self, path: Path) -> None:
        """Record this flight in a file, from its start.

        Raises:
            VwnavError: the file cannot be made.
        """
        self.keep(Recorder(path, self._config.model_dump(mode="json")))

    def keep(self, writer: Recorder) -> None:
        """Record this flight as `vwnav fly` does, images left out."""
        recorder = FlightRecorder(writer, self._about)
        self.ekf.record(recorder.input_log.input)
        self.record.setpoint = lambda: self.flight.setpoint
        self.record.recorder = recorder

    def keep_no_more(self) -> None:
        """Close the recording, if there is one."""
        recorder, self.record.recorder = self.record.recorder, None
        if recorder is not None:
            recorder.close()

    @property
    def disk_full(self) -> bool:
        """Nothing can be recorded."""
        return self.record.disk_full

    @disk_full.setter
    def disk_full(self, full: bool) -> None:
        self.record.disk_full = full

    def step_of(self, loop: Loop) -> tuple[object, str]:
        """The owner and the name of what one of its loops calls at each turn."""
        match loop:
            case "link":
                return self.autopilot, "step"
            case "mission":
                return self.flight, "tick"
            case "picture":
                return self.pipeline, "step"

    def listen(self, t_s: float) -> None:
        """Before its loops run: the link comes up, and nothing that is heard is believed."""
        self.port.poll()
        self.autopilot.step(t_s)
        self.autopilot.take_measurements()

    def hear(self, t_s: float) -> None:
        """The same, and what is heard is kept for the filter."""
        self.port.poll()
        self.autopilot.step(t_s)
        for measurement in self.autopilot.take_measurements():
            self.pipeline.feed(measurement)

    @property
    def hears_vehicle(self) -> bool:
        """Its heartbeat and its attitude: the process waits for them before anything begins."""
        vehicle = self.autopilot.state()
        return vehicle.connected and vehicle.attitude is not None

    def pretend(self, estimate: Estimate, armed: bool) -> None:
        """Send an estimate that no filter has made, as it would have been sent until now."""
        sent = self._guard.admit(estimate, self._clock.now_s, armed)
        if sent is not None:
            self.autopilot.send_estimate(sent)

    def start(self, start: Start | None) -> None:
        """Begin, with what is known of the place; of an aircraft in flight that may be nothing."""
        if start is not None:
            self.pipeline.begin(start)
        costs, processor, t_s = self._costs, self._processor, self._clock.now_s
        self._workers = {
            "link": Worker(processor, lambda: costs.link, 1.0 / LINK_HZ, t_s),
            "mission": Worker(processor, lambda: costs.control, 1.0 / TICK_HZ, t_s),
        }

    def fly_blindfold(self, t_s: float) -> None:
        """As `step`, but the mission does not begin yet."""
        self.port.poll()
        if self._workers["link"].due(t_s):
            self.runtime.step_link(t_s)
        self._see(t_s)

    @property
    def knows_where(self) -> bool:
        """Images have told a motion and places."""
        return (
            self.pipeline.accepted >= _FIXES_BEFORE and self.runtime.navigation.seen_s is not None
        )

    def take_up(self, phase: Phase) -> None:
        """The mission begins here, as if it had flown to where it is."""
        estimate = self.pipeline.estimate(self._clock.now_s)
        assert estimate is not None
        self.flight.take_up(phase, estimate)

    def step(self, t_s: float) -> None:
        """Let time pass: whatever work has ended by now is done."""
        if self.ended or t_s < self._asleep_until_s:
            return
        self.port.poll()
        if "link" not in self._hung and self._workers["link"].due(t_s):
            self.runtime.step_link(t_s)
        if "mission" not in self._hung and self._workers["mission"].due(t_s):
            self.runtime.step_control(t_s)
        if self.runtime.link_broke:
            self.end()
        else:
            self._see(t_s)

    def hang(self, loop: Loop) -> None:
        """One of its loops never comes round again; the others go on."""
        self._hung.add(loop)

    def stop_until(self, t_s: float) -> None:
        """Stopped as by SIGSTOP: nothing of it runs, what arrives waits."""
        self._asleep_until_s = t_s
        for worker in self._workers.values():
            worker.sleep_until(t_s)
        self.executor.sleep_until(t_s)
        if self._frame_done_s is not None:
            self._frame_done_s = max(self._frame_done_s, t_s)

    @property
    def over(self) -> bool:
        """It has nothing more to do: the mission has ended, or the process."""
        steers = self.runtime.failure is None and "mission" not in self._hung
        return self.ended or not steers or self.flight.end is not None

    def end(self) -> None:
        """The process ends, in whatever way."""
        self.ended = True

    def _see(self, t_s: float) -> None:
        """The vision loop: an image, its telemetry, the work on it."""
        if self._frame_done_s is not None:
            if t_s >= self._frame_done_s:
                assert self._frame is not None
                self.runtime.step_vision(self._frame, self._frame_begun_s)
                self._frame = self._frame_done_s = None
            return
        if self._frame is None and "picture" not in self._hung:
            self._frame = self._take(t_s)
        if self._frame is not None and not self.runtime.awaits_telemetry(self._frame, t_s):
            self._frame_begun_s = t_s
            self._frame_done_s = self._processor.end_of(t_s, self._costs.image)

    def _take(self, t_s: float) -> Frame | None:
        if t_s < self._camera_again_s or not self._camera.arrived(t_s):
            return None
        try:
            return self._camera.take(t_s)
        except Exception as error:
            self._camera_again_s = t_s + _CAMERA_AGAIN_S
            self.record.event(f"the camera fails: {error}")
            return None

    def _checks(
        self, vehicle: VehicleState, navigation: Navigation, t_s: float
    ) -> tuple[Check, ...]:
        equipment = Equipment(
            self.autopilot.findings, self.autopilot.link_refusal, self._watch.sight
        )
        return check_flight(vehicle, navigation, equipment, self._config.safety, t_s)


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
        self.stands_by = True

    def handle_beat(self) -> None:
        """It lives."""

    def step(self, resume: Resume | None, t_s: float) -> None:
        """Keep it ready; with `resume` it is needed, from now on."""
        if resume is None:
            return
        if self.navigator is None:
            self._woken_s, self._resume = t_s, resume
            counter = 0 if resume.position is None else resume.position.reset_counter
            self.navigator = self._make(counter)
        self.go_on(t_s)

    def go_on(self, t_s: float) -> None:
        """What it does by itself, whether a watchdog is there or not."""
        navigator = self.navigator
        if navigator is None:
            return
        assert self._woken_s is not None
        if self._flies:
            navigator.step(t_s)
        elif t_s - self._woken_s < _LINK_S or not navigator.hears_vehicle:
            navigator.hear(t_s)
        else:
            self._begin(navigator, t_s)

    def close(self) -> None:
        """It ends with the watchdog."""
        if self.navigator is not None:
            self.navigator.end()

    def _begin(self, navigator: Navigator, t_s: float) -> None:
        self._flies = True
        assert self._resume is not None
        place, position = last_place(self._resume, self._local_frame), self._resume.position
        if place is None or position is None:
            navigator.start(None)
        else:
            velocity_ne_m_s, learned = np.array(self._resume.velocity_ne_m_s), self._resume.learned
            navigator.start(start_after(place, velocity_ne_m_s, position.t_s, t_s, learned))
        navigator.flight.ride(t_s, "the navigator ended: this one only sends estimates")
