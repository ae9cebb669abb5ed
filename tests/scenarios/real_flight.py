"""The real command against a simulated vehicle in real time, with something broken on purpose.

`vwnav fly` runs as a user starts it: watchdog process, MAVSDK, UDP, threads, files. Faults that a
signal cannot make are patched in by a module that the interpreter loads at its start.
"""

import contextlib
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from network_camera import NetworkCamera

from vwnav.bench.flights.live.processes import watchdogs_of
from vwnav.bench.flights.live.relay import Relay
from vwnav.geometry.calibration import save_camera
from vwnav.geometry.geodesy import LocalFrame
from vwnav.onboard.program import free_ports
from vwnav.sim.renderer import default_camera
from vwnav.sim.truth import TruthReader
from vwnav.sim.vehicle import VehicleConfig, start_vehicle

_CALIBRATION = "camera.toml"
ROOT = Path(__file__).resolve().parents[2]
HOME = LocalFrame(60.4, 22.5, 40.0)
ROUTE_TEXT = "1,45,0,32\n2,45,-40,32\n"
DOWN_M = 0.5
Whose = Literal["first", "others", "all"]
_WHOSE: dict[Whose, str] = {
    "first": 'import sys\nif "fly" in sys.orig_argv and "--standby" not in sys.orig_argv:\n',
    "others": 'import sys\nif "--standby" in sys.orig_argv:\n',
    "all": 'import sys\nif "fly" in sys.orig_argv:\n',
}


@dataclass
class RealFlight:
    """A flight under way.

    Attributes:
        command: that started the navigator.
        process: of the navigator.
        folder: of its run.
        log: of what it says.
        truth: where the vehicle truly is.
        camera: that it sees by, where that is in a network.
    """

    command: list[str]
    process: subprocess.Popen[bytes]
    folder: Path
    log: Path
    truth: TruthReader
    camera: NetworkCamera | None
    _track: list[tuple[float, np.ndarray, float]] = field(default_factory=list)

    def said(self, text: str) -> bool:
        return text in self.log.read_text(errors="replace")

    def place_ned_m(self) -> np.ndarray:
        state = self.truth.latest()
        assert state is not None
        return HOME.to_ned(state.lat_deg, state.lon_deg, state.alt_amsl_m)

    def wait(self, what: Callable[[], bool], seconds: float) -> float:
        """How long it took; its speed is watched meanwhile."""
        began_s = time.monotonic()
        while not what():
            waited_s = time.monotonic() - began_s
            assert waited_s < seconds, self.log.read_text(errors="replace")[-3000:]
            self.look()
            time.sleep(0.05)
        return time.monotonic() - began_s

    def look(self) -> None:
        state = self.truth.latest()
        if state is not None:
            speed = float(np.hypot(*state.velocity_ned_m_s[:2]))
            self._track.append((time.monotonic(), self.place_ned_m(), speed))

    def wait_until_on_route(self) -> None:
        self.wait(lambda: self.said("on route"), 120.0)
        self.wait(lambda: self._speed_m_s() > 4.0, 30.0)

    def wait_until_down(self, seconds: float) -> float:
        return self.wait(lambda: -self.place_ned_m()[2] < DOWN_M, seconds)

    def fastest_m_s(self) -> float:
        return max(speed for _, _, speed in self._track)

    @contextlib.contextmanager
    def started_again(self, after_its_end: bool = False) -> Iterator["RealFlight"]:
        """The same command, by a service or a person, while the aircraft is where it is.

        What follows a flight that has ended is told its folder; else it finds one beside.
        """
        folder, path = self.folder.with_name("run-2"), self.log.with_name("log-2")
        command = [*self.command, "-o", str(folder)] if after_its_end else self.command
        with path.open("wb") as log:
            process = subprocess.Popen(command, stdout=log, stderr=log, cwd=ROOT)
        try:
            yield RealFlight(self.command, process, folder, path, self.truth, self.camera)
        finally:
            process.kill()
            process.wait()

    def signal(self, number: signal.Signals) -> None:
        os.kill(self.process.pid, number)

    def watchdog_pid(self) -> int:
        """Of the one that has the link: the spare one waits with `--spare`."""
        found = [pid for pid, waits in self.watchdogs().items() if not waits]
        assert found, "there is no watchdog"
        return found[0]

    def watchdogs(self) -> dict[int, bool]:
        """Process ids of all, and whether each waits as a spare one."""
        return watchdogs_of(self.process.pid)

    def successor_pids(self) -> list[int]:
        """Of the navigators that serve after the first, or wait to: the oldest first."""
        found = []
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                words = (folder / "cmdline").read_bytes().split(b"\0")
                if b"--standby" in words and str(self.folder / "successor").encode() in words:
                    found.append(int(folder.name))
        return sorted(found)

    def _speed_m_s(self) -> float:
        state = self.truth.latest()
        return 0.0 if state is None else float(np.hypot(*state.velocity_ned_m_s[:2]))


def broken(code: str, folder: Path, whose: Whose = "first") -> dict[str, str]:
    """Environment in which the navigator, those that follow it, or all are patched by `code`."""
    folder.mkdir(parents=True, exist_ok=True)
    body = "".join(f"    {line}\n" for line in code.strip().splitlines())
    (folder / "sitecustomize.py").write_text(_WHOSE[whose] + body)
    return {"PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])}


@contextlib.contextmanager
def real_flight(
    folder: Path,
    patch: str = "pass",
    file_limit: int | None = None,
    wind_m_s: float = 5.0,
    route_text: str = ROUTE_TEXT,
    hear: Callable[[Any], None] | None = None,
    whose: Whose = "first",
    settings: str = "",
    networked: bool = False,
) -> Iterator[RealFlight]:
    """Start vehicle and navigator; both are gone at the end.

    Args:
        folder: of everything that is written.
        patch: code that breaks the navigator.
        file_limit: no file can grow beyond so many bytes: a full disk.
        wind_m_s: with gusts.
        route_text: what is flown.
        hear: is called with messages of the link, through a relay.
        whose: the first navigator is broken, those that follow it, or all.
        settings: of the navigator, as `--config` takes them.
        networked: the camera is in a network, as a real one may be.
    """
    link, truth = free_ports(2)
    truth_url = f"udpout:127.0.0.1:{truth}"
    config = VehicleConfig(
        home_lat_deg=HOME.lat_deg, home_lon_deg=HOME.lon_deg, home_alt_amsl_m=HOME.alt_amsl_m,
        companion_url=f"udpout:127.0.0.1:{link}", truth_url=f"udpin:127.0.0.1:{truth}",
        ground_url="", wind_m_s=wind_m_s,
    )  # fmt: skip
    route = folder / "route.txt"
    route.write_text(route_text)
    config_path = folder / "vwnav.toml"
    config_path.write_text(settings)
    vehicle_url = f"udpin://127.0.0.1:{link}"
    relay = None if hear is None else Relay(vehicle_url, hear)

    def limit() -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # what a shell starts behind it ignores it
        if file_limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_limit, file_limit))

    env = os.environ | broken(patch, folder / "patch", whose)
    with contextlib.ExitStack() as stack:
        stack.enter_context(start_vehicle(config))
        camera = _network_camera(folder, truth_url, stack) if networked else None
        video = "sim:default" if camera is None else camera.url
        command = [
            sys.executable, "-m", "vwnav", "fly", "--video", video, "--map", "sim:default",
            "--route", str(route), "--config", str(config_path),
            "--home", f"{HOME.lat_deg},{HOME.lon_deg}",
            "--connection", vehicle_url if relay is None else relay.url,
            "--truth", truth_url, "-o", str(folder / "run"),
        ]  # fmt: skip
        if camera is not None:
            command += ["--camera", str(folder / _CALIBRATION)]
        log = stack.enter_context((folder / "log").open("wb"))
        process = subprocess.Popen(
            command, stdout=log, stderr=log, env=env, cwd=ROOT, preexec_fn=limit
        )
        reader = TruthReader(truth_url)
        try:
            yield RealFlight(command, process, folder / "run", folder / "log", reader, camera)
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.send_signal(signal.SIGCONT)
                process.kill()
            process.wait()
            reader.close()
            if relay is not None:
                relay.close()


def _network_camera(folder: Path, truth_url: str, stack: contextlib.ExitStack) -> NetworkCamera:
    save_camera(default_camera(), folder / _CALIBRATION)
    camera = NetworkCamera("sim:default", default_camera(), truth_url)
    stack.callback(camera.close)
    return camera
