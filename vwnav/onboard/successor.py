"""The second navigator: gives the autopilot estimates when the first one has ended in flight.

The watchdog starts it beside the flight (`vwnav fly ... --standby`) and wakes it by one line on
stdin. Until then it has loaded all that takes long and waits. It never steers, and the watchdog
would let nothing of that pass: an autopilot that loses its position comes down blind (PX4 after
4.6 s, measured: 57 m off from 50 m in calm air), and that is what it prevents.
"""

import json
import sys
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from vwnav.assemble import Assembled, about_run, assemble
from vwnav.clock import WallClock
from vwnav.errors import VwnavError
from vwnav.estimation.beginning.starts import Start
from vwnav.estimation.inputs import learned_of
from vwnav.geometry.geodesy import LocalFrame
from vwnav.machine.never_waits import stderr_that_never_waits
from vwnav.machine.priority import take_short_turns
from vwnav.machine.signals import heeding_signals
from vwnav.mavlink.mavsdk_autopilot import MavsdkAutopilot
from vwnav.onboard.aboard import first_state, put_aboard
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
from vwnav.onboard.succession import start_after
from vwnav.recording.run_folder import unused
from vwnav.sim.renderer import CameraRenderer
from vwnav.types import Array
from vwnav.vehicle import Learned
from vwnav.watchdog.keepalive import KeepAlive, UdpChannel

_REASON = "the navigator ended in flight: this one only sends estimates until the aircraft is down"


@dataclass(frozen=True, slots=True, eq=False)
class Handover:
    """Where the first navigator left off.

    Attributes:
        connection: where the link is to be had.
        keepalive_port: where the watchdog hears that it lives.
        observer: where truth may be listened to, on a simulator.
        place: (lat_deg, lon_deg), height above the origin, time and reset counter of the last good
            estimate; None when there was none.
        learned: in flight, until then.
        system_id: of the autopilot; 0 where none was heard.
    """

    connection: str
    keepalive_port: int
    observer: str
    lat_lon_deg: tuple[float, float] | None
    height_m: float
    t_s: float
    reset_counter: int
    velocity_ne_m_s: Array
    learned: Learned | None
    system_id: int

    @staticmethod
    def read(line: str) -> "Handover":
        """The watchdog's word.

        Raises:
            VwnavError: it is none.
        """
        try:
            return _handover(json.loads(line))
        except (ValueError, KeyError, TypeError) as error:
            raise VwnavError(f"not what a watchdog wakes its successor with: {line!r}") from error


def _handover(told: dict[str, Any]) -> Handover:
    position, origin = told["position"], told["origin"]
    velocity = np.array(told["velocity_ne_m_s"], np.float64)
    ways = str(told["connection"]), int(told["keepalive_port"]), str(told["observer"])
    learned = None if told["learned"] is None else learned_of(*told["learned"])
    knows = velocity, learned, int(told["system_id"])
    if position is None or origin is None:
        return Handover(*ways, None, 0.0, 0.0, 0, *knows)
    frame = LocalFrame(origin["lat_deg"], origin["lon_deg"], origin["alt_amsl_m"])
    lat_deg, lon_deg, _ = frame.to_geodetic(np.array(position["position_ned_m"]))
    return Handover(
        *ways, (float(lat_deg), float(lon_deg)),
        -float(position["position_ned_m"][2]), float(position["t_s"]),
        int(position["reset_counter"]), *knows,
    )  # fmt: skip


def stand_by(options: FlyOptions) -> None:
    """Load everything, wait to be woken, then send estimates until the aircraft is down."""
    take_short_turns()  # the watchdog says how far it goes before others
    cv2.setNumThreads(1)
    keep_heap_small()
    with ExitStack() as stack:
        stack.enter_context(stderr_that_never_waits())
        plan = plan_flight(options, stack)
        executor = stack.enter_context(ThreadPoolExecutor(1, "map matching"))
        notices = deque[str]()
        assembled = assemble(
            *plan.features, plan.pack, plan.camera, plan.local_frame,
            plan.config, executor, notices.append,
        )  # fmt: skip
        stack.callback(assembled.pipeline.give_up)
        renderer = draw_camera(options, plan, stack)
        line = sys.stdin.readline()
        if line:
            handover = Handover.read(line)
            _succeed(options, plan, assembled, notices, renderer, handover, stack)


def _succeed(
    options: FlyOptions,
    plan: FlightPlan,
    assembled: Assembled,
    notices: deque[str],
    renderer: CameraRenderer | None,
    handover: Handover,
    stack: ExitStack,
) -> None:
    clock = WallClock()
    autopilot = MavsdkAutopilot(
        handover.connection, clock=clock, link_url=options.connection,
        system_id=handover.system_id,
    )  # fmt: skip
    stack.callback(autopilot.close)
    frame = plan.local_frame
    autopilot.set_origin(frame.lat_deg, frame.lon_deg, frame.alt_amsl_m)
    truth = open_truth(options.truth, str(options.connection), handover.observer, clock, stack)
    source = open_camera(options, plan, renderer, truth, clock, stack, handover.height_m)
    assert options.output is not None  # the watchdog names it
    folder = unused(options.output)  # another one may have come before
    record = FlightRecord(
        folder, about_run(assembled, plan.config.features.name, "nadir"), plan.pack, plan.config,
        truth, clock, at_once=False,
    )  # fmt: skip
    assembled.ekf.record(record.input_log.input)
    vehicle = first_state(autopilot, clock)
    if handover.lat_lon_deg is not None:
        assembled.pipeline.begin(_start(plan, handover, handover.lat_lon_deg, vehicle.t_s))
    keep_alive = KeepAlive(UdpChannel(handover.keepalive_port, listens=False), clock)
    stack.callback(keep_alive.close)
    watch = watch_camera(source, plan.camera)
    aboard = put_aboard(
        plan, assembled.pipeline, autopilot, keep_alive, watch, record, notices, arms=False,
        first_counter=handover.reset_counter,
    )  # fmt: skip
    aboard.flight.ride(vehicle.t_s, _REASON)
    hold_exposure(source, plan, lambda: aboard.runtime.navigation, notices.append)
    try:
        with heeding_signals(aboard.runtime.interrupt):
            aboard.runtime.run(source, clock)
    finally:
        record.close(options, assembled.pipeline, plan.pack.name)


def _start(
    plan: FlightPlan, handover: Handover, lat_lon_deg: tuple[float, float], t_s: float
) -> Start:
    position = plan.local_frame.to_ned(*lat_lon_deg, plan.local_frame.alt_amsl_m)
    position[2] = -handover.height_m
    return start_after(position, handover.velocity_ne_m_s, handover.t_s, t_s, handover.learned)
