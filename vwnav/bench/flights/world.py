"""Vehicle, link, watchdog, navigator and camera in one thread, stepped together by one clock."""

import math
import random
import shutil
import time
from collections import deque
from collections.abc import Iterable
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from vwnav.assemble import about_run, assemble, with_map
from vwnav.bench.flights.navigator import Equipped, LockstepSuccessor, Navigator
from vwnav.bench.flights.noted_link import LockstepWatcher, NotedLink
from vwnav.bench.flights.setup import PARAMETERS, AirStart, Setup
from vwnav.bench.flights.stage import LINK_LATENCY_S, BreakableFeatures
from vwnav.bench.flights.track import FlightTrace, Heard, LogLine, Truth
from vwnav.estimation.beginning.starts import Start
from vwnav.geometry.camera import Camera
from vwnav.geometry.geodesy import LocalFrame
from vwnav.maps.pack import MapPack
from vwnav.mission.mission import Phase
from vwnav.rules.flight_log import NAVIGATOR_ENDED, At
from vwnav.safety.camera_watch import CameraWatch
from vwnav.sim.config import PilotPlan, VehicleConfig
from vwnav.sim.core import Peer, Role, VehicleCore
from vwnav.sim.lens import RenderConfig
from vwnav.sim.lockstep_camera import LockstepCamera
from vwnav.sim.memory_link import MemoryLink
from vwnav.sim.multirotor.setpoint import Setpoint
from vwnav.sim.multirotor.simulated import STEP_S
from vwnav.sim.named_sites import tiles_folder
from vwnav.sim.processor import Costs, LateExecutor, Processor, SimulatedClock
from vwnav.sim.renderer import CameraRenderer
from vwnav.sim.site import Site
from vwnav.sim.tiles import DrawnGround
from vwnav.types import Array, Estimate, FeatureExtractor, Frame, Prior
from vwnav.watchdog.loop import Known, Watchdog, WatchdogConfig, WatchdogLinks

_NOTED_EVERY = 5  # steps: 50 Hz
_LINK_UP_S = 4.0  # on the ground, before a flight that begins in the air
_SETTLED_S = 0.5  # of telemetry before its filter begins
_LOOKS_S = 3.0  # for the first images to be matched, where they can be
_AIR_SIGMA_M, _AIR_SIGMA_M_S = 0.5, 0.5
_SPARE_S = 0.3  # until a waiting watchdog has the link: measured on a busy machine
_CAMERA_LATENCY_S = 0.04


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """What many flights may share.

    Attributes:
        pack: path of the map.
        primary, fallback: extractors, as `vwnav.assemble.choose_features` gives them.
    """

    site: Site
    pack: Path
    camera: Camera
    primary: FeatureExtractor
    fallback: FeatureExtractor | None


class World:
    """A flight in lockstep. Deterministic: no clock but its own, no thread, no global randomness.

    Attributes:
        clock: its time; the navigator's and the watchdog's monotonic clock.
        begun_s: when the mission began, on that clock.
        place: with the map that is flown on.
        wall_clock: the computer's date, as it was before a fault set it.
        track: what is noted for the judge, about the run's origin.
    """

    def __init__(self, setup: Setup, place: Place) -> None:
        self.setup = setup
        self._folder: TemporaryDirectory[str] | None = None
        if setup.copies_map:
            self._folder = TemporaryDirectory(prefix="vwnav-flight-")
            place = replace(place, pack=Path(shutil.copy(place.pack, self._folder.name)))
        self.place = place = replace(place, camera=setup.told_camera(place.camera))
        self.wall_clock = time.time
        self.clock, self.track = SimulatedClock(), FlightTrace()
        rng = random.Random(setup.seed)
        self._stands_ned_m = np.array([*setup.stands_ne_m, 0.0])
        self.autopilot_link = MemoryLink(self.clock, rng, LINK_LATENCY_S)
        self._navigator_link = MemoryLink(self.clock, rng)
        self._observer_link = MemoryLink(self.clock, rng)
        self._observer_link.cut(True)  # nobody listens
        self._beats = MemoryLink(self.clock, rng)
        self.core = self._vehicle(place)
        self.processor, self.costs = Processor(), Costs()
        self.camera = self._camera(place)
        self.features = BreakableFeatures(place.primary)
        self.local_frame = LocalFrame(place.site.home_lat_deg, place.site.home_lon_deg, 0.0)
        self.navigator = self._navigator(place, 0)
        self.successor = LockstepSuccessor(lambda n: self._navigator(place, n), self.local_frame)
        self.watchdog: Watchdog | None = self._watchdog()
        self._steps, self._spare_due_s, self._end_seen = 0, math.inf, False
        self._known: Known | None = None
        self.begun_s = 0.0

    def _vehicle(self, place: Place) -> VehicleCore:
        setup, site = self.setup, place.site
        frame = LocalFrame(site.home_lat_deg, site.home_lon_deg, 0.0)
        lat_deg, lon_deg, _ = frame.to_geodetic(self._stands_ned_m)
        config = VehicleConfig(
            manners=setup.manners, home_lat_deg=float(lat_deg), home_lon_deg=float(lon_deg),
            home_alt_amsl_m=0.0, seed=setup.seed, wind_m_s=setup.wind_m_s,
            wind_from_deg=setup.wind_from_deg, gust_m_s=setup.gust_m_s,
            range_most_m=setup.range_most_m, relief=setup.relief,
            heading_bias_deg=setup.compass_off_deg,
            parameters=(*PARAMETERS[setup.manners], *setup.parameters),
            pilot=PilotPlan(rc_on=setup.rc_on), battery_drain_s=setup.battery_drain_s,
        )  # fmt: skip
        north, link = lambda: self._tells.autopilot.north, self.autopilot_link.a
        peer = Peer(NotedLink(link, self.clock, self.track, north), Role.COMPANION)
        return VehicleCore(config, [peer], lambda: setup.vehicle_s(self.clock()))

    def _watchdog(self, known: Known | None = None) -> Watchdog:
        ways = self.autopilot_link.b, self._navigator_link.a, self._observer_link.a, self._beats.a
        parts = WatchdogLinks(*ways), WatchdogConfig(), self.successor, self.navigator
        return Watchdog(*parts, known and known.pass_on(self.clock.now_s))

    def _camera(self, place: Place) -> LockstepCamera:
        timing_s = 1.0 / self.setup.image_hz, _CAMERA_LATENCY_S, self.setup.late_s
        return LockstepCamera(draw(self.setup, place), self._stands_ned_m, *timing_s)

    def _navigator(self, place: Place, first_counter: int) -> Navigator:
        return Navigator(
            self._equipped(place), self._navigator_link.b, self._beats.b, self.camera, self.clock,
            self.processor, self.costs, first_counter,
        )  # fmt: skip

    def _equipped(self, place: Place) -> Equipped:
        setup, camera, notices = self.setup, place.camera, deque[str]()
        pack, record = MapPack.open(place.pack), LockstepWatcher(self.note, self.clock)
        config = with_map(setup.config, pack)
        executor = LateExecutor(self.clock, self.processor, self._cost_of_matching)
        assembled = assemble(self.features, place.fallback, pack, camera, self.local_frame, config,
                             executor, notices.append)  # fmt: skip
        watch = CameraWatch(camera.width_px, camera.height_px)
        about = about_run(assembled, self.features.name, "nadir")
        return Equipped(setup.mission, self.local_frame, config, watch, assembled.pipeline,
                        assembled.ekf, executor, record, notices, about)  # fmt: skip

    def _cost_of_matching(self, frame: Frame, prior: Prior, seed: int) -> float:
        return self.costs.search if prior.lat_deg is None else self.costs.match

    @property
    def _tells(self) -> Navigator:
        """Who gives the estimates: each in the north that it believes the autopilot has."""
        return (self.navigator.ended and self.successor.navigator) or self.navigator

    @property
    def site_seed(self) -> int:
        """Of the site that the map is of."""
        return self.place.site.seed

    def show(self, ground: DrawnGround, tiles: Path | None = None) -> None:
        """The camera sees this from now on; its tiles are kept in that folder, for other runs."""
        self.camera.renderer = _draw(ground, tiles, self.setup, self.place.camera)

    @property
    def own_map(self) -> Path:
        """A map's file that may be damaged.

        Raises:
            ValueError: the flight shares its map with others.
        """
        if self._folder is None:
            raise ValueError("set copies_map: this flight shares its map with others")
        return self.place.pack

    @property
    def t_s(self) -> float:
        """Since the mission began."""
        return self.clock.now_s - self.begun_s

    def lose_watchdog(self, silent_s: float = 0.0) -> None:
        """Its process is gone, for so long unnoticed; the spare one has what it knew."""
        if self.watchdog is not None:  # else the spare one was killed as it came up
            self._known, self.watchdog = deepcopy(self.watchdog.known), None
        self._spare_due_s = self.clock.now_s + silent_s + _SPARE_S
        self.note("the watchdog is gone")

    def note(self, text: str) -> None:
        """A line for the judge and the reader."""
        self.track.events.append(LogLine(self.t_s, text))

    def begin(self) -> None:
        """Bring everything up to where the mission begins."""
        setup, navigator = self.setup, self.navigator
        for _ in self._steps_of(_SETTLED_S if setup.start is None else _LINK_UP_S):
            navigator.listen(self.clock.now_s)
        if setup.start is None:
            told_ne_m = setup.told_home_ne_m
            known = None if told_ne_m is None else np.array([*told_ne_m, 0.0])
            navigator.start(Start(t_s=self.clock.now_s, position_ned_m=known, by_person=True))
        elif setup.start.phase is None:
            self._lift(setup.start)
            navigator.start(None)
        else:
            self._fly_there(setup.start, setup.start.phase)
        self.begun_s = self.clock.now_s
        self.track.truth.clear()
        self.track.heard = Heard()

    def _fly_there(self, start: AirStart, phase: Phase) -> None:
        """Estimates flow and images are matched, as after a flight to that place."""
        place, velocity = np.array(start.place_ned_m), np.array(start.velocity_ned_m_s)
        began = place - velocity * _SETTLED_S
        for step in self._steps_of(_SETTLED_S):
            self.navigator.listen(self.clock.now_s)
            self._pretend(step, began, np.zeros(3), False)
        self._lift(start)
        body = self.core.vehicle.body
        for step in self._steps_of(_SETTLED_S):
            self.navigator.hear(self.clock.now_s)
            here = np.array([body.n, body.e, body.d])
            self._pretend(step, here, np.array([body.vn, body.ve, body.vd]), True)
        self.navigator.start(self._known_in_the_air())
        for _ in self._steps_of(_LOOKS_S):
            self._steer(start)
            self.navigator.fly_blindfold(self.clock.now_s)
            if self.navigator.knows_where:
                break
        self.navigator.take_up(phase)

    def _steer(self, start: AirStart) -> None:
        """In Offboard, before the mission steers."""
        vn, ve, vd = start.velocity_ned_m_s
        yaw_rad = self.core.vehicle.estimator.attitude.yaw_rad
        self.core.vehicle.set_target(Setpoint(vn_m_s=vn, ve_m_s=ve, vd_m_s=vd, yaw_rad=yaw_rad))

    def _lift(self, start: AirStart) -> None:
        """The vehicle flies steadily, a little before its place."""
        vehicle = self.core.vehicle
        began = np.array(start.place_ned_m) - np.array(start.velocity_ned_m_s) * _SETTLED_S
        vehicle.begin_in_flight(
            (float(began[0]), float(began[1]), float(began[2])),
            start.velocity_ned_m_s,
            float(np.radians(vehicle.config.heading_deg)),
            start.mode,
        )

    def _pretend(self, step: int, place_ned_m: Array, velocity_ned_m_s: Array, armed: bool) -> None:
        """Estimates at 50 Hz of a place that it has flown to: the guards know it by them.

        Of a disarmed aircraft they may jump: so they begin before it is lifted.
        """
        if step % _NOTED_EVERY:
            return
        now_s = self.clock.now_s
        estimate = Estimate(
            t_s=now_s,
            position_ned_m=self._stands_ned_m + place_ned_m,
            velocity_ned_m_s=velocity_ned_m_s,
            covariance=np.diag([0.25, 0.25, 0.05, 0.05, 0.05, 0.05]),
            quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]),
            sigma_yaw_rad=0.1,
            agl_m=-float(place_ned_m[2]),
            sigma_agl_m=0.5,
            t_last_fix_s=now_s,
            reset_counter=0,
        )
        self.navigator.pretend(estimate, armed)

    def _known_in_the_air(self) -> Start:
        """What the filter would know: the truth, with an error that its sigma covers."""
        body = self.core.vehicle.body
        rng = np.random.default_rng([self.setup.seed, 7])
        error_m = np.array([*rng.normal(0.0, 0.5 * _AIR_SIGMA_M, 2), 0.0])
        return Start(
            t_s=self.clock.now_s,
            position_ned_m=self._stands_ned_m + np.array([body.n, body.e, body.d]) + error_m,
            sigma_m=_AIR_SIGMA_M,
            agl_m=-body.d,
            sigma_agl_m=0.5,
            sigma_velocity_m_s=max(_AIR_SIGMA_M_S, float(np.hypot(body.vn, body.ve))),
        )

    def _steps_of(self, seconds: float) -> Iterable[int]:
        """Time passes for vehicle, watchdog and camera, step by step."""
        for step in range(round(seconds / STEP_S)):
            self._advance()
            yield step

    def step(self) -> None:
        """Advance by `STEP_S`."""
        self._advance()
        self.navigator.step(self.clock.now_s)
        if self.navigator.ended and not self._end_seen and self.watchdog is not None:
            self._end_seen = True
            self.note(NAVIGATOR_ENDED)
            self.watchdog.handle_navigator_end(self.clock.now_s)
        self.track.enters(self.navigator.flight.phase.value, self.t_s)
        if self._steps % _NOTED_EVERY == 0:
            self._note_truth()

    def _advance(self) -> None:
        self._steps += 1
        self.clock.now_s = t_s = self._steps * STEP_S
        self.core.step_to_now(2)
        if t_s >= self._spare_due_s:
            self._spare_due_s, self.watchdog = math.inf, self._watchdog(self._known)
            for port in (self.autopilot_link.b, self._navigator_link.a, self._beats.a):
                port.drop()  # nobody had it open
        if self.watchdog is not None:
            self.watchdog.step(t_s)
        else:
            self.successor.go_on(t_s)
        self.camera.step(t_s, self.core.vehicle.body)

    def _note_truth(self) -> None:
        vehicle, track, t_s = self.core.vehicle, self.track, self.clock.now_s
        body = vehicle.body
        track.truth.append(
            Truth(
                t_s,
                self._stands_ned_m + np.array([body.n, body.e, body.d]),
                np.array([body.vn, body.ve, body.vd]),
                vehicle.flight_mode,
                vehicle.commander.armed,
                body.on_ground,
                vehicle.battery.remaining,
            )
        )
        home = self.navigator.flight.home_ne_m
        if home is not None:
            track.homes.append(At(t_s, (float(home[0]), float(home[1]))))


def draw(setup: Setup, place: Place) -> CameraRenderer:
    """What the camera sees of the place."""
    return _draw(place.site, tiles_folder(place.site), setup, place.camera)


def _draw(ground: DrawnGround, tiles: Path | None, setup: Setup, told: Camera) -> CameraRenderer:
    camera, rng = setup.true_camera(told), np.random.default_rng(setup.seed)
    config = RenderConfig(
        color=False, background=False, relief=setup.relief, map_warp=setup.map_warp
    )
    return CameraRenderer(ground, camera, config, rng, tiles)
