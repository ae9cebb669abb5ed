"""The simulated vehicle as a process that speaks MAVLink 2 over UDP as PX4 or ArduCopter does.

`python -m vwnav.sim.vehicle --help`, or `start_vehicle(config)` from a program.
"""

import argparse
import dataclasses
import logging
import multiprocessing
import os
import select
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Self

from vwnav.clock import Clock
from vwnav.errors import LinkError, VwnavError
from vwnav.machine.priority import go_first
from vwnav.pace import clock_of
from vwnav.sim.config import PilotPlan, VehicleConfig
from vwnav.sim.core import Peer, Role, VehicleCore
from vwnav.sim.mavlink.link import VehicleUdpLink
from vwnav.sim.multirotor.simulated import STEP_S

__all__ = ["PilotPlan", "VehicleConfig", "VehicleProcess", "run_vehicle", "start_vehicle"]

_log = logging.getLogger(__name__)
_STEPS_AT_ONCE = 50
_MAX_LAG_S = 0.5  # a longer stall shifts the clock instead of flying it blind
_LATE_S = 0.02  # behind the time that waits for it
_SHORTEST_WAIT_S = 0.0005  # for a time that stands
_READY_TIMEOUT_S = 60.0  # on a busy machine; one that ends is noticed at once
_STOP_TIMEOUT_S = 5.0


_HELP = {
    "manners": "px4, px4-1.16 or copter: whose ways it has",
    "home_lat_deg": "where it stands",
    "home_lon_deg": "where it stands",
    "home_alt_amsl_m": "height of the ground above mean sea level",
    "heading_deg": "true heading on the ground, 0 = north",
    "companion_url": "link of the navigator, udpout:HOST:PORT or udpin:HOST:PORT",
    "ground_url": "link of a ground station, '' for none",
    "truth_url": "link that carries the truth, '' for none",
    "truth_rate_hz": "truth states per simulated second",
    "system_id": "MAVLink system",
    "speed": "simulated seconds per second",
    "seed": "of noise, biases and gusts",
    "wind_m_s": "mean wind at 10 m and above",
    "wind_from_deg": "where the wind comes from",
    "gust_m_s": "one sigma of the gusts; by default a tenth of the wind",
    "baro_drift_m": "one sigma of the barometer after ten minutes",
    "heading_bias_deg": "error of the compass",
    "imu_noise": "scale of the sensors' noise and biases",
    "range_most_m": "how far the rangefinder reaches, 0 for none",
    "battery_start": "charge at start, 0..1",
    "battery_drain_s": "seconds in flight from full to empty",
    "clock_file": "file of a simulated time that waits for it (vwnav.pace), '' for the wall clock",
    "autopilot_defaults": "start with the autopilot's own parameters: GPS expected, vision ignored",
}
_PILOT_HELP = {
    "takes_over_at_s": "pushes the stick forward at T",
    "switch_at_s": "flips the mode switch to Position (ArduCopter: Loiter) at T",
    "rc_lost_at_s": "switches the transmitter off at T",
    "rc_back_at_s": "switches it on again at T",
}


class VehicleServer:
    """The vehicle with its UDP links, run by the clock (times `config.speed`)."""

    def __init__(self, config: VehicleConfig) -> None:
        self._config = config
        self._clock: Clock = clock_of(config.clock_file)
        self._links: list[VehicleUdpLink] = []
        peers = []
        for url, role in (
            (config.companion_url, Role.COMPANION),
            (config.ground_url, Role.GROUND),
            (config.truth_url, Role.TRUTH),
        ):
            if url:
                self._links.append(VehicleUdpLink(url, config.system_id))
                peers.append(Peer(self._links[-1], role))
        self._core = VehicleCore(config, peers, lambda: self._clock() * config.speed)

    def run(self, keep_on: Callable[[], bool]) -> None:
        """Fly until `keep_on` says no."""
        core, speed = self._core, self._config.speed
        sockets = [link.socket for link in self._links]
        participant = self._clock.join("vehicle")
        core.wait(core.lag_s)
        while keep_on():
            if core.lag_s > _MAX_LAG_S * speed:
                _log.info("stood still for %.2f s; the clock waits", core.lag_s / speed)
                core.wait(core.lag_s)
            core.step_to_now(_STEPS_AT_ONCE)
            wait_s = (STEP_S - core.lag_s) / speed
            participant.until(self._clock() + wait_s + _LATE_S)
            readable, _, _ = select.select(sockets, [], [], max(_SHORTEST_WAIT_S, wait_s))
            if readable:
                core.hear()
        participant.leave()

    def close(self) -> None:
        """Free the ports."""
        for link in self._links:
            link.close()


def run_vehicle(config: VehicleConfig, ready: Callable[[], None]) -> None:
    """Run a vehicle in this process until SIGTERM or the death of the parent.

    Raises:
        LinkError: a port is taken.
    """
    parent = os.getppid()
    stopped = False

    def stop(*_: object) -> None:
        nonlocal stopped
        stopped = True

    signal.signal(signal.SIGTERM, stop)
    server = VehicleServer(config)
    ready()
    try:
        server.run(lambda: not stopped and os.getppid() == parent)
    finally:
        server.close()


def _child(config: VehicleConfig, pipe: Connection) -> None:
    # Ctrl-C, a closed terminal and `timeout` are for the navigator: it has to land this vehicle.
    os.setsid()
    go_first()  # an autopilot has a processor of its own
    try:
        run_vehicle(config, lambda: pipe.send(""))
    except VwnavError as error:
        pipe.send(str(error))


class VehicleProcess:
    """A running vehicle; a context manager that stops it."""

    def __init__(self, process: multiprocessing.process.BaseProcess) -> None:
        self._process = process

    @property
    def pid(self) -> int | None:
        """Of the vehicle's process."""
        return self._process.pid

    def is_alive(self) -> bool:
        """Whether it still runs."""
        return self._process.is_alive()

    def stop(self) -> None:
        """End it, by force if it does not listen."""
        self._process.terminate()
        self._process.join(_STOP_TIMEOUT_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(_STOP_TIMEOUT_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def start_vehicle(config: VehicleConfig) -> VehicleProcess:
    """Start a vehicle in its own process and wait until its ports are open.

    Raises:
        LinkError: a port is taken, or the process did not start.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_child, args=(config, theirs), daemon=True, name="vehicle")
    process.start()
    theirs.close()
    vehicle = VehicleProcess(process)
    try:
        problem = ours.recv() if ours.poll(_READY_TIMEOUT_S) else "it did not start in time"
    except EOFError:
        problem = f"it ended at once with code {process.exitcode}"
    if problem:
        vehicle.stop()
        raise LinkError(f"simulated vehicle: {problem}")
    return vehicle


def _parser() -> argparse.ArgumentParser:
    """One option per field of VehicleConfig and PilotPlan."""
    parser = argparse.ArgumentParser(
        prog="python -m vwnav.sim.vehicle",
        description="A simulated quadrotor that speaks MAVLink 2 over UDP as PX4 or ArduCopter.",
        epilog="Example: python -m vwnav.sim.vehicle --wind-m-s 5 --param COM_OBL_RC_ACT=5",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    for field in dataclasses.fields(VehicleConfig):
        if field.name in ("parameters", "pilot", "relief"):
            continue
        option, text = "--" + field.name.replace("_", "-"), _HELP[field.name]
        if field.type is bool:
            parser.add_argument(option, action="store_true", help=text)
        else:
            kind = type(field.default) if isinstance(field.default, (int, str)) else float
            metavar = "URL" if field.name.endswith("_url") else "X"
            parser.add_argument(
                option, type=kind, default=field.default, help=text, metavar=metavar
            )
    parser.add_argument("--rc-on", action="store_true", help="a radio is bound and on")
    for name, text in _PILOT_HELP.items():
        option = "--pilot-" + name.replace("_", "-")
        parser.add_argument(option, type=float, metavar="T", help=text)
    parser.add_argument(
        "--param", action="append", default=[], metavar="NAME=VALUE", help="set a parameter"
    )
    return parser


def main() -> None:
    """Run a vehicle from the command line."""
    parser = _parser()
    options = vars(parser.parse_args())
    pilot = {
        name.removeprefix("pilot_"): options.pop(name)
        for name in list(options)
        if name.startswith("pilot_")
    }
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        pairs = tuple(_pair(text) for text in options.pop("param"))
        plan = PilotPlan(rc_on=options.pop("rc_on"), **pilot)
        config = VehicleConfig(parameters=pairs, pilot=plan, **options)
        run_vehicle(config, lambda: _log.info("vehicle ready, companion %s", config.companion_url))
    except KeyboardInterrupt:
        _log.info("stopped")
    except VwnavError as error:
        parser.exit(1, f"{error}\n")
    except ValueError as error:
        parser.error(str(error))


def _pair(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    return name, float(value)


if __name__ == "__main__":
    main()
