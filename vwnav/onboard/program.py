"""`vwnav fly` once its options are read: everything opened, flown, and closed again."""

import socket
import sys
import threading
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace

import cv2
import numpy as np

from vwnav.assemble import about_run, assemble
from vwnav.clock import AwaitedExecutor, Clock, WallClock
from vwnav.config import save_config
from vwnav.errors import ConfigError, FlightError, PreflightError, VwnavError
from vwnav.estimation.beginning.starts import Start
from vwnav.flight import Flight
from vwnav.machine.never_waits import stderr_that_never_waits
from vwnav.machine.priority import go_first
from vwnav.machine.signals import heeding_signals
from vwnav.mavlink.mavsdk_autopilot import HEARD_WITHIN_S, MavsdkAutopilot
from vwnav.mission.config import FlightConfig
from vwnav.mission.mission import FlightEnd, Phase
from vwnav.onboard.aboard import Aboard, first_state, put_aboard
from vwnav.onboard.equipment import (
    draw_camera,
    hold_exposure,
    open_camera,
    open_truth,
    watch_camera,
)
from vwnav.onboard.flight_plan import FlightPlan
from vwnav.onboard.heap import keep_heap_small
from vwnav.onboard.options import FlyOptions
from vwnav.onboard.plan import plan_flight
from vwnav.onboard.record import FlightRecord
from vwnav.onboard.rejoining import wait_for_the_aircraft
from vwnav.onboard.service import FlightFolder, ServiceHandle, ServiceManager
from vwnav.onboard.simulation import DEFAULT_ROUTE, DEFAULT_SITE
from vwnav.pace import PacedClock
from vwnav.recording.disk.budget import DiskBudget
from vwnav.recording.disk.thread import sync_file
from vwnav.recording.run_folder import check_run_folder, make_run_folder, unused
from vwnav.screen import say
from vwnav.seams import FrameSource
from vwnav.sim.config import Manners, VehicleConfig
from vwnav.sim.named_sites import is_site, parse_site
from vwnav.sim.site import Site
from vwnav.sim.truth import TruthReader
from vwnav.sim.vehicle import start_vehicle
from vwnav.vehicle import Autopilot, VehicleState
from vwnav.watchdog.launch import WatchdogProcess, start_watchdog

FIRST_STATE_S = 5.0
WORTH_SAYING_S = 10.0  # of simulated time that stood still
MATCHING_LATE_S = 0.2  # a fix that takes longer is late: a simulated time waits for it


def fly_route(options: FlyOptions) -> None:
    """Fly, and write the run folder.

    Raises:
        VwnavError: anything that kept it from beginning.
        PreflightError: not safe to fly: the map does not cover the route.
        FlightError: the route was not flown to its end.
    """
    go_first()
    cv2.setNumThreads(1)
    keep_heap_small()
    manager = ServiceManager()
    options = _with_simulated_defaults(_left_to_a_person(options, manager))
    with ExitStack() as stack:
        stack.enter_context(stderr_that_never_waits())
        if options.sim:  # whose site is drawn first
            check_run_folder(options.output)
        plan = plan_flight(options, stack)
        if plan.returns:
            say(plan.returns)
        if not options.sim and wait_for_the_aircraft(str(options.connection), manager):
            options = _of_a_flight_that_broke_off(options)
            stack.push(_ends_for_good)
        folder = make_run_folder(options.output, "fly")
        held = FlightFolder(folder, _is_tried_again(options))
        stack.push(held.leave)
        save_config(plan.config, folder / "config.toml")
        sync_file(folder / "config.toml")
        budget = DiskBudget(folder, plan.config.recording, removes=options.output is None)
        for removed in budget.make_room():
            say(f"removed {removed}: flights may take {plan.config.recording.most_gb:g} GB")
        renderer = draw_camera(options, plan, stack)
        link, truth_url = options.connection, options.truth
        clock = _clock(options, stack)
        if options.sim:
            site = parse_site(options.video or DEFAULT_SITE)
            link, truth_url = start_embedded_vehicle(
                site, options.manners, options.wind_m_s, options.seed, clock, stack
            )
        assert link is not None
        # An embedded simulation ends with its navigator: there is nothing left to succeed in.
        successor = [] if options.sim else options.successor(folder)
        watchdog = stack.enter_context(
            start_watchdog(link, folder / "watchdog.log", successor, clock, say)
        )
        truth = open_truth(truth_url, link, watchdog.observer_url, clock, stack)
        source = open_camera(options, plan, renderer, truth, clock, stack)
        if not options.sim:
            say(f"waiting for the autopilot on {link}, for {HEARD_WITHIN_S:.0f} s at most")
        autopilot = connect(watchdog, link, clock, plan.config.flight)
        stack.callback(autopilot.close)
        _fly(options, plan, held, budget, watchdog, autopilot, source, truth, clock, stack)


def connect(
    watchdog: WatchdogProcess, link_url: str, clock: Clock, config: FlightConfig
) -> MavsdkAutopilot:
    """The autopilot behind the watchdog, which follows the same one from the first beat on.

    Raises:
        LinkError: no PX4 or ArduPilot is on the link.
    """
    autopilot = MavsdkAutopilot(
        watchdog.navigator_url, clock=clock, link_url=link_url,
        ground_station_ids=config.ground_station_ids, system_id=config.autopilot_id,
    )  # fmt: skip
    watchdog.keepalive.system_id = autopilot.system_id()
    return autopilot


def _clock(options: FlyOptions, stack: ExitStack) -> Clock:
    """A simulation's time waits for who is late, unless it is to be the wall's."""
    if not options.sim or options.realtime:
        return WallClock()
    clock = PacedClock.create()
    stack.callback(clock.remove)
    stack.callback(lambda: _say_whom_time_waited_for(clock))
    return clock


def _say_whom_time_waited_for(clock: PacedClock) -> None:
    held = sorted(clock.held_s().items(), key=lambda each: -each[1])
    held_s = sum(each_s for _, each_s in held)
    if held_s > WORTH_SAYING_S:
        whom = ", ".join(f"{name} {each_s:.0f} s" for name, each_s in held if each_s >= 1.0)
        say(f"this machine was too busy: simulated time waited {held_s:.0f} s for it ({whom})")


def _with_simulated_defaults(options: FlyOptions) -> FlyOptions:
    """`--sim` fills in what was not said; a real flight wants a calibrated camera."""
    if options.sim:
        return replace(
            options,
            map_source=options.map_source or options.video or DEFAULT_SITE,
            route=options.route or DEFAULT_ROUTE,
            video=options.video or DEFAULT_SITE,
        )
    if is_site(str(options.video)) and options.truth is None:
        raise ConfigError("--video sim:SITE is drawn from ground truth: give its URL with --truth")
    if not is_site(str(options.video)) and options.camera is None:
        raise ConfigError("fly needs --camera: a flight wants a calibrated camera")
    return options


def _left_to_a_person(options: FlyOptions, manager: ServiceManager) -> FlyOptions:
    """A service is started by the board, or anew: nobody has looked whether who stands near."""
    if not (options.arm and manager.listens):
        return options
    say("--arm is not heeded: a service never arms by itself, a person does")
    return replace(options, arm=False)


def _ends_for_good(_kind: object, error: BaseException | None, _traceback: object) -> None:
    """For a stack: started anew it would not know of the flight that broke off, nor the place."""
    if isinstance(error, VwnavError):
        raise FlightError(str(error)) from error


def _is_tried_again(options: FlyOptions) -> bool:
    """By the service manager, if it does not begin (`deploy/vwnav.service`)."""
    return ServiceManager().listens and options.output is None and not options.rejoined


def _of_a_flight_that_broke_off(options: FlyOptions) -> FlyOptions:
    """The same command again: its folder holds that flight."""
    output = None if options.output is None else unused(options.output)
    return replace(options, rejoined=True, output=output)


def _fly(
    options: FlyOptions,
    plan: FlightPlan,
    held: FlightFolder,
    budget: DiskBudget,
    watchdog: WatchdogProcess,
    autopilot: Autopilot,
    source: FrameSource,
    truth: TruthReader | None,
    clock: Clock,
    stack: ExitStack,
) -> None:
    pool = stack.enter_context(ThreadPoolExecutor(1, "map matching"))
    executor = AwaitedExecutor(pool, clock, clock.join("map matching"), MATCHING_LATE_S)
    notices = deque[str]()
    watchdog.say = notices.append  # to the ground stations, too
    assembled = assemble(
        *plan.features, plan.pack, plan.camera, plan.local_frame,
        plan.config, executor, notices.append,
    )  # fmt: skip
    stack.callback(assembled.pipeline.give_up)
    frame = plan.local_frame
    autopilot.set_origin(frame.lat_deg, frame.lon_deg, frame.alt_amsl_m)  # before any estimate
    about = about_run(assembled, plan.config.features.name, "nadir")
    record = FlightRecord(held.folder, about, plan.pack, plan.config, truth, clock, budget)
    assembled.ekf.record(record.input_log.input)
    vehicle = first_state(autopilot, clock)
    # Of one that flies nothing is known: the first fix begins.
    if not (vehicle.armed and vehicle.in_air):
        assembled.ekf.initialise(_start(options, plan, vehicle))
    handle = ServiceHandle(watchdog.keepalive, ServiceManager())
    watch = watch_camera(source, plan.camera)
    aboard = put_aboard(
        plan, assembled.pipeline, autopilot, handle, watch, record, notices, options.arms
    )
    hold_exposure(source, plan, lambda: aboard.runtime.navigation, notices.append)
    with heeding_signals(aboard.runtime.interrupt):
        try:
            if not options.arms:
                _listen_for_enter(aboard.flight)
            end = _end_of(aboard, source, clock)
            held.began = not end.unsafe
        finally:
            handle.end()
            record.close(options, assembled.pipeline, plan.pack.name)
    is_removed = end.unsafe and held.is_tried_again
    _raise_reason(end, "" if is_removed else f" (record in {held.folder})")


def _end_of(aboard: Aboard, source: FrameSource, clock: Clock) -> FlightEnd:
    """What broke it in flight ended it, and is in the log; on the ground it is an error."""
    try:
        return aboard.runtime.run(source, clock)
    except Exception as error:
        if aboard.flight.phase is Phase.GET_READY and not aboard.flight.engaged:
            raise
        return FlightEnd(str(error) if isinstance(error, VwnavError) else repr(error))


def _raise_reason(end: FlightEnd, where: str) -> None:
    """One that never began may come good; one that ended is for a person to look at."""
    if end.reason is not None:
        error = PreflightError if end.unsafe else FlightError
        raise error(end.reason + where)


def _start(options: FlyOptions, plan: FlightPlan, vehicle: VehicleState) -> Start:
    """On the ground, at home where that is known; not where a flight that broke off came down."""
    stands_at_home = plan.home_known and not options.rejoined
    return Start(
        t_s=vehicle.t_s,
        position_ned_m=np.zeros(3) if stands_at_home else None,
        sigma_m=options.home_sigma_m,
        by_person=True,
    )


def _listen_for_enter(flight: Flight) -> None:
    """A person at a terminal lets it arm; a service has nobody there."""
    if not sys.stdin.isatty():
        return

    def listen() -> None:
        while sys.stdin.readline():
            flight.go()

    threading.Thread(target=listen, name="keyboard", daemon=True).start()


def start_embedded_vehicle(
    site: Site, manners: Manners, wind_m_s: float, seed: int, clock: Clock, stack: ExitStack
) -> tuple[str, str]:
    """Start the simulated vehicle at the site's home.

    Returns:
        URLs of its link, for the watchdog, and of its ground truth.
    """
    link, truth = free_ports(2)
    config = VehicleConfig(
        manners=manners,
        home_lat_deg=site.home_lat_deg,
        home_lon_deg=site.home_lon_deg,
        companion_url=f"udpout:127.0.0.1:{link}",
        truth_url=f"udpin:127.0.0.1:{truth}",
        ground_url="",
        wind_m_s=wind_m_s,
        seed=seed,
        clock_file=str(clock.file or ""),
    )
    stack.enter_context(start_vehicle(config))
    return f"udpin://127.0.0.1:{link}", f"udpout:127.0.0.1:{truth}"


def free_ports(count: int) -> list[int]:
    """UDP ports of this machine that nobody has."""
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    try:
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [int(each.getsockname()[1]) for each in sockets]
    finally:
        for each in sockets:
            each.close()
