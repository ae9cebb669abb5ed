"""`vwnav fly` in real time against a simulated autopilot: started, watched, cleared away."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20.ardupilotmega import MAV_COMP_ID_AUTOPILOT1

from vwnav.bench.flights.faults.aircraft import order_packet
from vwnav.bench.flights.live.relay import MavlinkPilot, Relay
from vwnav.bench.flights.live.whereabouts import (
    ByItself,
    ByTruth,
    Eyes,
    Whereabouts,
    place_ned_m,
)
from vwnav.bench.flights.track import FlightTrace, LogLine, Truth
from vwnav.errors import VwnavError
from vwnav.geometry.geodesy import LocalFrame
from vwnav.mavlink.modes import AutopilotKind, flight_mode
from vwnav.mission.mission import Phase
from vwnav.recording.run_folder import unused
from vwnav.sim.config import Manners
from vwnav.types import Array
from vwnav.vehicle import FlightMode, Order

_LOOK_S = 0.05
_MAP_S = 900.0  # to draw the map of a new place, on a machine that others load
_PILOT_S = 10.0  # he is waited for
_GROUND_M = 0.7
_LANDS_S = 240.0  # it is waited for at most
_LINE = re.compile(r"^\s*[\d.]+ s  (?P<text>\S.*)$")
_PHASES = {phase.value for phase in Phase}
_ARMED = 128
_NAMES = {
    FlightMode.OFFBOARD: FlightMode.OFFBOARD,
    FlightMode.TAKEOFF: FlightMode.TAKEOFF,
    FlightMode.LAND: FlightMode.LAND,
    FlightMode.RETURN: FlightMode.RETURN,
    FlightMode.DESCEND: FlightMode.DESCEND,
    FlightMode.MANUAL: FlightMode.MANUAL,
}


@dataclass(frozen=True, slots=True)
class Links:
    """How a simulated autopilot is reached.

    Attributes:
        connection: URL of its link.
        truth: of its ground truth; None where it is flown with `eyes`.
        pilot: of its pilot's link, None without one.
    """

    connection: str
    truth: str | None
    pilot: str | None
    eyes: Eyes | None = None


class Simulator:
    """An autopilot in simulation: its link through a relay of ours, where it is, its pilot.

    Attributes:
        mode, armed, manners: as its heartbeat says.
        system_id: of the first autopilot that is heard, which is the one; 0 before.
        heard: the newest message of each kind that passed over the link, see `relay.HEARD`.

    Raises:
        VwnavError: it cannot be reached, or tells no truth.
    """

    def __init__(self, links: Links) -> None:
        self.mode, self.armed = FlightMode.HOLD, False
        self.manners: Manners = "px4"
        self.system_id = 0
        self._stood_z_m = 0.0
        self.heard: dict[str, Any] = {}
        with contextlib.ExitStack() as stack:
            self.relay = Relay(links.connection, self._hear)
            stack.callback(self.relay.close)
            self.pilot = None
            if links.pilot is not None:
                hand_on = self.relay.autopilot_link.a.write
                self.pilot = MavlinkPilot(links.pilot, hand_on, lambda: self.system_id)
                stack.callback(self.pilot.close)
            self.where: Whereabouts
            if links.truth is not None:
                self.where = ByTruth(links.truth, stack)
            else:
                assert links.eyes is not None
                self.where = ByItself(links.eyes, self.heard, self.own_place_ned_m)
            self._stack = stack.pop_all()

    def close(self) -> None:
        """Give everything back."""
        self._stack.close()

    def wait_for_pilot(self, url: str | None) -> None:
        """Until his link hears the autopilot; at once where he has none.

        Raises:
            VwnavError: it does not.
        """
        until_s = time.monotonic() + _PILOT_S
        while self.pilot is not None and not self.pilot.hears:
            if time.monotonic() > until_s:
                raise VwnavError(
                    f"no autopilot is heard on the pilot's link {url} for {_PILOT_S:.0f} s: give "
                    "the port that it sends to (udpin://0.0.0.0:14550), or that it listens on"
                )
            time.sleep(_LOOK_S)

    def look(self, home: LocalFrame) -> Truth:
        """What it does now, NED about a place on the ground, as far as it is told."""
        place_ned_m, velocity_ned_m_s = self.where.look(home)
        return Truth(
            time.monotonic(), place_ned_m, velocity_ned_m_s, self.mode, self.armed,
            -float(place_ned_m[2]) < _GROUND_M,
        )  # fmt: skip

    def own_place_ned_m(self, home: LocalFrame) -> Array:
        """(3,) where the autopilot believes to be, its height from where it stood; NaN untold.

        PX4 counts heights from an origin of its own, which may lie far below.
        """
        place = place_ned_m(self.heard.get("LOCAL_POSITION_NED"), self.heard, home)
        return place - (0.0, 0.0, self._stood_z_m)

    @property
    def navigators_id(self) -> tuple[int, int] | None:
        """System and component of the program, None before it has sent an estimate."""
        sent = self.heard.get("VISION_POSITION_ESTIMATE")
        return None if sent is None else (sent.get_srcSystem(), sent.get_srcComponent())

    def order(self, order: Order) -> None:
        """A ground station asks the program for something, on the link to it."""
        if self.navigators_id is not None:
            self.relay.autopilot_link.a.write(order_packet(order, *self.navigators_id))

    def bring_down(self, timeout_s: float) -> None:
        """Wait until it is disarmed; a pilot lands it.

        Raises:
            VwnavError: it still flies.
        """
        if self.armed and self.pilot is not None:
            self.pilot.ask(FlightMode.LAND)
        until_s = time.monotonic() + timeout_s
        while self.armed:
            if time.monotonic() > until_s:
                raise VwnavError(f"the vehicle is still armed after {timeout_s:.0f} s: land it")
            time.sleep(_LOOK_S)

    def _hear(self, message: Any) -> None:
        if self._is_anothers(message):
            return
        self.heard[message.get_type()] = message
        if message.get_type() == "LOCAL_POSITION_NED" and not self.armed:
            self._stood_z_m = float(message.z)
        if message.get_type() != "HEARTBEAT":
            return
        self.armed = bool(message.base_mode & _ARMED)
        with contextlib.suppress(ValueError):
            kind = AutopilotKind(message.autopilot)
            self.system_id = message.get_srcSystem()
            mode = flight_mode(kind, message.custom_mode)
            self.manners = "copter" if kind is AutopilotKind.ARDUPILOT else "px4"
            self.mode = _NAMES.get(mode, FlightMode.HOLD)

    def _is_anothers(self, message: Any) -> bool:
        """Of a second autopilot on the link, to which `vwnav fly` does not listen either."""
        is_autopilots = message.get_srcComponent() == MAV_COMP_ID_AUTOPILOT1
        return is_autopilots and self.system_id not in (0, message.get_srcSystem())


@contextlib.contextmanager
def simulator_at(links: Links) -> Iterator[Simulator]:
    """Reach it; at the end everything is given back.

    Raises:
        VwnavError: it cannot be reached, tells no truth, or has no pilot where one is asked for.
    """
    simulator = Simulator(links)
    try:
        simulator.wait_for_pilot(links.pilot)
        yield simulator
    finally:
        simulator.close()


class LiveFlight:
    """One flight of `vwnav fly`, under way.

    Attributes:
        track: truth, modes, phases and what the program said, as for flights in lockstep; its
            times are of `time.monotonic`, its places about where the aircraft stood.
        begun_s: when it was started, on that clock.
        home: with its origin where the aircraft stood.
        see: is called whenever something may have happened.
    """

    def __init__(
        self,
        simulator: Simulator,
        process: "subprocess.Popen[bytes]",
        folder: Path,
        tell: Callable[[str], None],
    ) -> None:
        self._tell = tell
        self.simulator = simulator
        self.process = process
        self.folder = folder
        self.track = FlightTrace()
        self.begun_s = time.monotonic()
        self.home = simulator.where.frame_here()
        self.see: Callable[[], None] = lambda: None
        self._log = (folder / "log").open(errors="replace")
        self._rest = ""

    @property
    def t_s(self) -> float:
        """Since it was started."""
        return time.monotonic() - self.begun_s

    def note(self, text: str) -> None:
        """A line of ours among the program's."""
        self.track.events.append(LogLine(self.t_s, text))

    def watch(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Note what happens until `done`; False after `timeout_s`."""
        until_s = time.monotonic() + timeout_s
        while True:
            self._look()
            self.see()
            if done():
                return True
            if time.monotonic() > until_s:
                return False
            time.sleep(_LOOK_S)

    def is_in(self, phase: Phase) -> bool:
        """Where the mission stands, as far as it has said so."""
        return bool(self.track.phases) and self.track.phases[-1].text == phase.value

    def is_down(self) -> bool:
        """It has flown, and its motors stand."""
        return not self.simulator.armed and any(each.armed for each in self.track.truth)

    def has_ended(self) -> bool:
        """The program has."""
        return self.process.poll() is not None

    def last_words(self) -> str:
        """The newest line of the program, also one that says why it ended."""
        said = (self.folder / "log").read_text(errors="replace").strip()
        return said.rpartition("\n")[2].strip() or "nothing"

    def place_ned_m(self) -> Array:
        """Where it truly is."""
        return self.simulator.look(self.home).position_ned_m

    def close(self) -> None:
        """Read no more."""
        self._log.close()

    def _look(self) -> None:
        self.track.truth.append(self.simulator.look(self.home))
        self._rest += self._log.read()
        *lines, self._rest = self._rest.split("\n")
        for line in lines:
            found = _LINE.match(line)
            if found is None:
                continue
            text = found["text"].strip()
            self._tell(text)
            phase = text.split("  ")[0]  # of a status line, which alone tells the first one
            if phase in _PHASES and not (self.track.phases and self.track.phases[-1].text == phase):
                self.track.phases.append(LogLine(self.t_s, phase))
            self.track.events.append(LogLine(self.t_s, text))


@contextlib.contextmanager
def live_flight(
    simulator: Simulator,
    folder: Path,
    route: str,
    patch: Path | None = None,
    settings: str = "",
    tell: Callable[[str], None] = lambda _: None,
) -> Iterator[LiveFlight]:
    """Start `vwnav fly` where the aircraft stands, until it gets ready; at the end it is gone.

    Args:
        simulator: that flies.
        folder: of everything that is written.
        route: ID,X,Y,Z lines about home.
        patch: folder from which its interpreters load what breaks inside of them, see `inside`.
        settings: TOML.
        tell: receives what the program says, a line each: who arms it has to know.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "route.txt").write_text(route)
    (folder / "settings.toml").write_text(settings)
    run = ["--config", str(folder / "settings.toml"), "-o", str(unused(folder / "run"))]
    command = [
        sys.executable, "-m", "vwnav", "fly", *simulator.where.fly_words(),
        "--route", str(folder / "route.txt"), "--connection", simulator.relay.url, *run,
    ]  # fmt: skip
    paths = [*([] if patch is None else [str(patch)]), *sys.path]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(each for each in paths if each)}
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, env=env)
    flight = LiveFlight(simulator, process, folder, tell)
    try:
        flight.watch(lambda: bool(flight.track.phases) or flight.has_ended(), _MAP_S)
        yield flight
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGCONT)
            if simulator.armed and simulator.where.reference == "fused":
                process.terminate()  # it lands first: whose camera is none of ours may be real
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(_LANDS_S)
            process.kill()  # also one that hangs: its watchdog lands then
        process.wait()
        flight.close()
