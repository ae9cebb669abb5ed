"""Mission and runtime put on board: the same for the navigator and for the one that succeeds it."""

import time
from collections import deque
from dataclasses import dataclass

from vwnav.clock import Clock
from vwnav.flight import Flight
from vwnav.mission.mission import Crew, DeadMansHandle
from vwnav.onboard.flight_plan import FlightPlan
from vwnav.onboard.record import FlightRecord
from vwnav.pipeline import Pipeline
from vwnav.runtime import FlightRuntime
from vwnav.safety.camera_watch import CameraWatch
from vwnav.safety.check import Check
from vwnav.safety.estimate_guard import EstimateGuard
from vwnav.safety.readiness import Equipment, check_flight
from vwnav.screen import ReadinessTable
from vwnav.seams import GuardedWatcher
from vwnav.vehicle import Autopilot, Navigation, VehicleState

FIRST_STATE_S = 5.0


@dataclass(frozen=True, slots=True)
class Aboard:
    """The mission, and the threads that fly it."""

    flight: Flight
    runtime: FlightRuntime


def put_aboard(
    plan: FlightPlan,
    pipeline: Pipeline,
    autopilot: Autopilot,
    keep_alive: DeadMansHandle,
    camera: CameraWatch,
    record: FlightRecord,
    notices: deque[str],
    arms: bool,
    first_counter: int = 0,
) -> Aboard:
    """Build both.

    Args:
        plan: what is flown.
        pipeline: from images to the estimate.
        autopilot: the link's driver.
        keep_alive: the sign of life to the watchdog.
        camera: looks at each image.
        record: hears and keeps everything.
        notices: where the pipeline puts what it has to say.
        arms: whether it arms by itself.
        first_counter: of resets, where it goes on for another navigator.
    """
    config = plan.config
    watcher = GuardedWatcher(record)
    crew = _crew(autopilot, camera, plan, watcher, arms)
    flight = Flight(
        autopilot, plan.mission, keep_alive, crew, config.flight, config.limits, config.safety
    )
    record.follow(flight, pipeline)
    guard = EstimateGuard(config.estimate, first_counter)
    runtime = FlightRuntime(
        pipeline, flight, autopilot, guard, keep_alive, camera, watcher, notices
    )
    return Aboard(flight, runtime)


def first_state(autopilot: Autopilot, clock: Clock) -> VehicleState:
    """The vehicle once it has told where it is: on the ground, or flying already."""
    until_s = time.monotonic() + FIRST_STATE_S
    while time.monotonic() < until_s:
        autopilot.step(clock())
        state = autopilot.state()
        if state.connected and state.attitude is not None:
            break
        time.sleep(0.02)
    return autopilot.state()


def _crew(
    autopilot: Autopilot, camera: CameraWatch, plan: FlightPlan, watcher: GuardedWatcher, arms: bool
) -> Crew:
    """Who the mission speaks with: the record, the screen, and the readiness list."""

    def checks(vehicle: VehicleState, navigation: Navigation, t_s: float) -> tuple[Check, ...]:
        equipment = Equipment(autopilot.findings, autopilot.link_refusal, camera.sight)
        return check_flight(vehicle, navigation, equipment, plan.config.safety, t_s)

    return Crew(watcher.event, checks, ReadinessTable().show, arms)
