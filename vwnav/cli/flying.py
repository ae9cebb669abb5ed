"""What `vwnav fly` does, once its options are read."""

import signal
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from vwnav.assemble import about_run, assemble, choose_features
from vwnav.cameras.sources import open_source
from vwnav.cli.flight_record import FlightRecord
from vwnav.cli.fly import FlyOptions
from vwnav.cli.map import parse_lat_lon
from vwnav.cli.screen import say, show_checks
from vwnav.cli.simulation import (
    DEFAULT_ROUTE,
    DEFAULT_SITE,
    draw_site,
    map_pack_of,
    start_embedded_vehicle,
)
from vwnav.clock import AwaitedExecutor, Clock, WallClock
from vwnav.config import Config, load_config, save_config
from vwnav.errors import ConfigError, LinkError, PreflightError, VwnavError
from vwnav.estimation.ekf import Start
from vwnav.flight import Flight
from vwnav.geometry.calibration import load_camera
from vwnav.geometry.camera import Camera
from vwnav.geometry.geodesy import LocalFrame
from vwnav.guidance.missions import LocalWaypoint, load_route
from vwnav.maps.coverage import check_route
from vwnav.maps.pack import MapPack
from vwnav.mavlink.links import parse_link
from vwnav.mavlink.mavsdk_autopilot import MavsdkAutopilot
from vwnav.mission.mission import Crew, Mission
from vwnav.pace import PacedClock
from vwnav.recording.run_folder import make_run_folder
from vwnav.runtime import FlightRuntime
from vwnav.safety.camera_watch import CameraWatch
from vwnav.safety.check import Check
from vwnav.safety.estimate_guard import EstimateGuard
from vwnav.safety.readiness import Equipment, check_flight
from vwnav.sim.camera_source import SimulatedCamera
from vwnav.sim.renderer import CameraRenderer, default_camera
from vwnav.sim.sites import is_site, parse_site
from vwnav.sim.truth import TruthReader
from vwnav.types import Array, FrameSource, Navigation
from vwnav.vehicle import Autopilot, VehicleState
from vwnav.watchdog.launch import WatchdogProcess, start_watchdog

DEFAULT_HEIGHT_M = 50.0  # of waypoints that say none
FIRST_STATE_S = 5.0
WORTH_SAYING_S = 10.0  # of simulated time that stood still
MATCHING_LATE_S = 0.2  # a fix that takes longer is late: a simulated time waits for it


@dataclass(frozen=True, slots=True, eq=False)
class FlightPlan:
    """All that is known before the link is opened.

    Attributes:
        local_frame: NED origin of the run: home, on the ground, where that is known; else a
            frame about the middle of the map, and nothing but a frame.
        route_ned_m: (n, 3) waypoints.
        home_known: False when the take-off may be anywhere on the map.
        about_home: the waypoints are counted from home.
    """

    config: Config
    pack: MapPack
    camera: Camera
    local_frame: LocalFrame
    route_ned_m: Array
    home_known: bool
    about_home: bool

    @property
    def mission(self) -> Mission:
        """What the flight is asked to do."""
        return Mission(
            self.route_ned_m,
            about_home=self.about_home and not self.home_known,
            home_ne_m=np.zeros(2) if self.home_known else None,
            refuse=self.refuse,
        )

    def refuse(self, route_ned_m: Array) -> str:
        """Why a route (n, 3) must not be flown: the map does not cover it; "" when it does."""
        covered = check_route(self.pack, self._lat_lon_deg(route_ned_m))
        return "" if covered.ok else covered.summary()

    @property
    def route_lat_lon_deg(self) -> Array:
        """(n + 2, 2): from home over the waypoints and back, as far as it is known now."""
        home = np.zeros((1, 3))
        stops = [home, self.route_ned_m, home] if self.home_known else [self.route_ned_m]
        return self._lat_lon_deg(np.vstack(stops))

    def _lat_lon_deg(self, places_ned_m: Array) -> Array:
        lat_deg, lon_deg, _ = self.local_frame.to_geodetic(places_ned_m)
        return np.stack([lat_deg, lon_deg], axis=-1)


def fly_route(options: FlyOptions) -> None:
    """Fly, and write the run folder.

    Raises:
        VwnavError: anything that kept the route from being flown to its end.
        PreflightError: not safe to fly: the map does not cover the route.
    """
    cv2.setNumThreads(1)
    options = _with_simulated_defaults(options)
    with ExitStack() as stack:
        plan = plan_flight(options, stack)
        folder = make_run_folder(options.output, "fly")
        save_config(plan.config, folder / "config.toml")
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
        source = open_camera(options, renderer, truth, clock, stack)
        autopilot = MavsdkAutopilot(
            watchdog.navigator_url, clock=clock, link_url=link,
            ground_station_ids=plan.config.flight.ground_station_ids,
        )  # fmt: skip
        stack.callback(autopilot.close)
        _fly(options, plan, folder, watchdog, autopilot, source, truth, clock, stack)


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


def plan_flight(options: FlyOptions, stack: ExitStack) -> FlightPlan:
    """All that is known before the link is opened.

    Raises:
        VwnavError: a file that cannot be used.
        PreflightError: the map does not cover the route.
    """
    config = load_config(options.config_path)
    assert options.route is not None
    route = load_route(options.route, "global" if options.route_frame == "global" else "local")
    camera = load_camera(options.camera) if options.camera else default_camera()
    pack = stack.enter_context(MapPack.open(_map_path(options)))
    home = parse_lat_lon(options.home) if options.home else route.home
    if home is None and options.sim:
        site = parse_site(options.video or DEFAULT_SITE)
        home = (site.home_lat_deg, site.home_lon_deg)
    home_lat, home_lon = home or _middle(pack)
    local_frame = LocalFrame(home_lat, home_lon, pack.elevation_m(home_lat, home_lon) or 0.0)
    route_ned_m = route.to_ned(local_frame, DEFAULT_HEIGHT_M)
    about_home = isinstance(route.waypoints[0], LocalWaypoint)
    plan = FlightPlan(config, pack, camera, local_frame, route_ned_m, home is not None, about_home)
    if plan.home_known or not about_home:
        covered = check_route(pack, plan.route_lat_lon_deg)
        if not covered.ok:
            raise PreflightError(covered.summary())
    return plan


def _map_path(options: FlyOptions) -> Path:
    text = str(options.map_source)
    if not is_site(text):
        return Path(text)
    primary, fallback = choose_features(options.features, options.model, say)
    return map_pack_of(text, [primary, *([fallback] if fallback else [])])


def _middle(pack: MapPack) -> tuple[float, float]:
    south, west, north, east = pack.bounds
    return (south + north) / 2.0, (west + east) / 2.0


def open_truth(
    url: str | None, link: str, observer_url: str, clock: Clock, stack: ExitStack
) -> TruthReader | None:
    """Ground truth of a simulator; through the watchdog where it comes on the autopilot's link."""
    if url is None:
        return None
    if is_same_link(url, link):
        url = observer_url
    truth = TruthReader(url, clock=clock)
    stack.callback(truth.close)
    return truth


def is_same_link(truth_url: str, link: str) -> bool:
    """Whether the truth comes on the port of the autopilot's own link, which has one owner."""
    scheme, _, rest = truth_url.partition(":")
    try:
        truth = parse_link(f"{scheme}://{rest.removeprefix('//')}")
    except LinkError:
        return False  # the reader of the truth says what is wrong with it
    return truth.is_same_port(parse_link(link))


def draw_camera(options: FlyOptions, plan: FlightPlan, stack: ExitStack) -> CameraRenderer | None:
    """What a simulated camera is drawn with; None for a real one."""
    video = str(options.video)
    if not is_site(video):
        return None
    height_m = -float(plan.route_ned_m[0, 2])
    return draw_site(video, plan.camera, plan.route_lat_lon_deg, height_m, options.seed, stack)


def open_camera(
    options: FlyOptions,
    renderer: CameraRenderer | None,
    truth: TruthReader | None,
    clock: Clock,
    stack: ExitStack,
    flown_m: float = 0.0,
) -> FrameSource:
    """The camera, or one that is drawn from a simulator's truth.

    `flown_m` is how high the vehicle flies already: its ground, which is drawn, lies so far below.
    """
    source: FrameSource
    if renderer is None:
        source = open_source(str(options.video))
    else:
        assert truth is not None
        site = parse_site(str(options.video))
        home = (site.home_lat_deg, site.home_lon_deg)
        source = SimulatedCamera(renderer, truth, home, clock, flown_m)
    stack.callback(source.close)
    return source


def _fly(
    options: FlyOptions,
    plan: FlightPlan,
    folder: Path,
    watchdog: WatchdogProcess,
    autopilot: Autopilot,
    source: FrameSource,
    truth: TruthReader | None,
    clock: Clock,
    stack: ExitStack,
) -> None:
    pool = stack.enter_context(ThreadPoolExecutor(1, "map matching"))
    executor = AwaitedExecutor(pool, clock, clock.join("map matching"), MATCHING_LATE_S)
    assembled = assemble(
        plan.pack, plan.camera, options.features, options.model, plan.local_frame, plan.config,
        executor, say,
    )  # fmt: skip
    frame = plan.local_frame
    autopilot.set_origin(frame.lat_deg, frame.lon_deg, frame.alt_amsl_m)  # before any estimate
    about = about_run(assembled, options.features, "nadir")
    record = FlightRecord(folder, about, plan.pack, plan.config, truth, clock)
    assembled.ekf.record(record.tape.input)
    vehicle = first_state(autopilot, clock)
    # Of one that flies nothing is known: the first fix begins.
    if not (vehicle.armed and vehicle.in_air):
        assembled.ekf.initialise(_start(options, plan, vehicle))
    camera = CameraWatch(plan.camera.width_px, plan.camera.height_px)
    crew = mission_crew(autopilot, camera, plan, record, options.arms)
    flight = Flight(
        autopilot, plan.mission, watchdog.keepalive, crew, plan.config.flight, plan.config.limits,
        plan.config.safety,
    )  # fmt: skip
    record.follow(flight, assembled.pipeline)
    runtime = FlightRuntime(
        assembled.pipeline, flight, autopilot, EstimateGuard(plan.config.estimate),
        watchdog.keepalive, camera, record,
    )  # fmt: skip
    with _stopped_by_signals():
        try:
            if not options.arms:
                _listen_for_enter(flight)
            end = runtime.run(source, clock)
        finally:
            record.close(options, assembled)
    if end.reason is not None:
        error = PreflightError if end.unsafe else VwnavError
        raise error(f"{end.reason} (record in {folder})")


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


def _start(options: FlyOptions, plan: FlightPlan, vehicle: VehicleState) -> Start:
    """On the ground, at home where that is known."""
    return Start(
        t_s=vehicle.t_s,
        position_ned_m=np.zeros(3) if plan.home_known else None,
        sigma_m=options.home_sigma_m,
    )


def mission_crew(
    autopilot: Autopilot, camera: CameraWatch, plan: FlightPlan, record: FlightRecord, arms: bool
) -> Crew:
    """Who the mission speaks with: the record, the screen, and the readiness list."""

    def checks(vehicle: VehicleState, navigation: Navigation, t_s: float) -> tuple[Check, ...]:
        equipment = Equipment(
            autopilot.findings, autopilot.budget_refusal, camera.picture_s, camera.trouble
        )
        return check_flight(vehicle, navigation, equipment, plan.config.safety, t_s)

    return Crew(record.event, checks, show_checks, arms)


def _listen_for_enter(flight: Flight) -> None:
    """A person at a terminal lets it arm; a service has nobody there."""
    if not sys.stdin.isatty():
        return

    def listen() -> None:
        while sys.stdin.readline():
            flight.go()

    threading.Thread(target=listen, name="keyboard", daemon=True).start()


@contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """A service that is stopped, or a terminal that is closed, lands as Ctrl-C does."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = {each: signal.signal(each, interrupt) for each in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
