"""What only real processes show: ends, stops, exceptions in threads, cameras and disks that fail.

Bounds are wide: these machines are shared. The narrow ones are measured (docs/flying.md).
"""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from real_flight import real_flight

AFTER_TICKS_ON_ROUTE = """
import vwnav.flight as flight
whole = flight.Flight.tick
def tick(self, t_s, navigation):
    self.count = getattr(self, "count", 0) + (self.phase is flight.Phase.ROUTE)
    if self.count > 80:
        raise RuntimeError("broken on purpose")
    return whole(self, t_s, navigation)
flight.Flight.tick = tick
"""
CAMERA_FAILS = """
import time
import vwnav.sim.camera_source as camera
whole = camera.SimulatedCamera.next_frame
def next_frame(self):
    self.count = getattr(self, "count", 0) + 1
    if self.count > 700:
        raise OSError("the cable is off")
    return whole(self)
camera.SimulatedCamera.next_frame = next_frame
"""
CAMERA_UPSIDE_DOWN = """
from dataclasses import replace
import numpy as np
import vwnav.sim.camera_source as camera
whole = camera.SimulatedCamera.next_frame
def next_frame(self):
    frame = whole(self)
    return frame and replace(frame, image=np.ascontiguousarray(frame.image[::-1, ::-1]))
camera.SimulatedCamera.next_frame = next_frame
"""
LINK_STEPS_FAIL = """
import vwnav.mavlink.autopilot as autopilot
whole = autopilot.LinkedAutopilot.take_measurements
def take_measurements(self):
    self.count = getattr(self, "count", 0) + 1
    if self.count % 7 == 0:
        raise ValueError("broken on purpose")
    return whole(self)
autopilot.LinkedAutopilot.take_measurements = take_measurements
"""
LINK_HANGS = """
import signal
import threading
import vwnav.mavlink.autopilot as autopilot
whole = autopilot.LinkedAutopilot.take_measurements
hangs = threading.Event()
signal.signal(signal.SIGUSR1, lambda *_: hangs.set())
def take_measurements(self):
    if hangs.is_set():
        threading.Event().wait()
    return whole(self)
autopilot.LinkedAutopilot.take_measurements = take_measurements
"""
SCREEN_CLOSED = """
import os
import vwnav.flight as flight
whole = flight.Flight.tick
def tick(self, t_s, navigation):
    self.count = getattr(self, "count", 0) + (self.phase is flight.Phase.ROUTE)
    if self.count == 20:
        reads, writes = os.pipe()
        os.close(reads)
        for number in (1, 2):
            os.dup2(writes, number)
    return whole(self, t_s, navigation)
flight.Flight.tick = tick
"""
SCREEN_STALLS = """
import os
import vwnav.flight as flight
whole = flight.Flight.tick
def tick(self, t_s, navigation):
    self.count = getattr(self, "count", 0) + (self.phase is flight.Phase.ROUTE)
    if self.count == 20:
        _, writes = os.pipe()
        os.set_blocking(writes, False)
        try:
            while True:
                os.write(writes, bytes(4096))
        except BlockingIOError:
            os.set_blocking(writes, True)
        os.dup2(writes, 2)
    return whole(self, t_s, navigation)
flight.Flight.tick = tick
"""
DISK_HANGS = """
import os, time
def hang(event, arguments):
    makes = event == "os.mkdir" or (event == "open" and arguments[2] & os.O_ACCMODE)
    while makes and os.sep + "successor" in str(arguments[0]):
        time.sleep(1.0)
sys.addaudithook(hang)
"""
LOADED = "100/100"  # drawing the site is what it does last


def succeeded_m(flight):
    """Kill the navigator; how far off it comes down, on the estimates of a second one."""
    flight.signal(signal.SIGKILL)
    killed_at = flight.place_ned_m()
    told = "estimates are handed on again"
    flight.wait(lambda: told in (flight.folder / "watchdog.log").read_text(), 10.0)
    flight.wait_until_down(90.0)
    return np.hypot(*(flight.place_ned_m() - killed_at)[:2])


def test_a_navigator_that_is_killed_is_landed_and_a_second_one_tells_the_autopilot_where(tmp_path):
    with real_flight(tmp_path) as flight:
        flight.wait_until_on_route()
        flight.signal(signal.SIGKILL)
        killed_at = flight.place_ned_m()
        flight.wait_until_down(90.0)
        assert np.hypot(*(flight.place_ned_m() - killed_at)[:2]) < 40.0
        assert flight.fastest_m_s() < 15.0
        successor = (flight.folder / "watchdog.log").read_text()
    assert "the navigator ended in flight" in successor


@pytest.mark.long
def test_a_second_navigator_whose_disk_takes_nothing_tells_the_autopilot_where_it_is(tmp_path):
    with real_flight(tmp_path, DISK_HANGS, whose="others") as flight:
        flight.wait_until_on_route()
        flight.wait(lambda: LOADED in (flight.folder / "watchdog.log").read_text(), 60.0)
        assert succeeded_m(flight) < 40.0
        assert not (flight.folder / "successor").exists()


@pytest.mark.long
def test_a_second_navigator_knows_at_once_how_the_camera_hangs_that_the_first_one_found(tmp_path):
    with real_flight(tmp_path, CAMERA_UPSIDE_DOWN, whose="all") as flight:
        flight.wait_until_on_route()
        assert flight.said("hangs turned by 180 degrees")
        assert succeeded_m(flight) < 15.0


@pytest.mark.long
@pytest.mark.parametrize(("fails", "mended"), [("unplug", "plug_in"), ("hang", "go_on")])
def test_a_camera_that_is_gone_for_3_s_is_flown_on_without_and_opened_anew(tmp_path, fails, mended):
    with real_flight(tmp_path, networked=True) as flight:
        flight.wait_until_on_route()
        getattr(flight.camera, fails)()
        time.sleep(3.0)
        getattr(flight.camera, mended)()
        flight.wait(lambda: flight.said("descending"), 90.0)
        assert np.hypot(*flight.place_ned_m()[:2]) < 3.0


@pytest.mark.long
def test_a_second_navigator_tells_where_it_is_though_the_camera_is_not_there(tmp_path):
    with real_flight(tmp_path, networked=True) as flight:
        flight.wait_until_on_route()
        time.sleep(9.0)  # the wind is learned
        flight.camera.unplug()
        time.sleep(0.5)
        assert succeeded_m(flight) < 50.0


@pytest.mark.long
def test_a_mission_that_breaks_is_landed_on_its_estimates_and_its_error_is_told(tmp_path):
    with real_flight(tmp_path, AFTER_TICKS_ON_ROUTE) as flight:
        flight.wait(lambda: flight.said("broken on purpose"), 150.0)
        broke_at = flight.place_ned_m()
        flight.wait_until_down(90.0)
        assert np.hypot(*(flight.place_ned_m() - broke_at)[:2]) < 20.0
        assert flight.process.wait(30.0) == 1
    run = json.loads((flight.folder / "run.json").read_text())
    assert not run["completed"]
    assert run["score"]["error_at_landing_m"] < 5.0


@pytest.mark.long
def test_a_navigator_that_sleeps_for_20_s_is_ended_and_landed_on_the_second_ones_estimates(
    tmp_path,
):
    with real_flight(tmp_path) as flight:
        flight.wait_until_on_route()
        flight.signal(signal.SIGSTOP)
        stopped_at = flight.place_ned_m()
        time.sleep(20.0)
        flight.signal(signal.SIGCONT)
        flight.wait_until_down(90.0)
        assert flight.fastest_m_s() < 15.0
        assert np.hypot(*(flight.place_ned_m() - stopped_at)[:2]) < 40.0
        assert flight.process.wait(1.0) == -signal.SIGKILL
        watchdog = (flight.folder / "watchdog.log").read_text()
    assert "it is ended, and a second one gives the estimates" in watchdog
    assert "estimates are handed on again" in watchdog


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_second_navigator_that_ends_or_hangs_is_followed_by_a_third(tmp_path, number):
    """The third is loaded while the second serves; to find the place it takes some height."""
    with real_flight(tmp_path, route_text="1,45,0,60\n2,45,-40,60\n") as flight:

        def watchdog_said(text: str) -> int:
            return (flight.folder / "watchdog.log").read_text(errors="replace").count(text)

        flight.wait_until_on_route()
        flight.signal(signal.SIGKILL)
        killed_at = flight.place_ned_m()
        flight.wait(lambda: watchdog_said("estimates are handed on again") == 1, 20.0)
        flight.wait(lambda: watchdog_said(LOADED) == 2, 30.0)
        second, _ = flight.successor_pids()
        os.kill(second, number)
        flight.wait(lambda: watchdog_said("estimates are handed on again") == 2, 10.0)
        flight.wait_until_down(120.0)
        assert np.hypot(*(flight.place_ned_m() - killed_at)[:2]) < 40.0


@pytest.mark.long
def test_started_again_in_flight_it_joins_the_watchdog_and_a_person_gives_it_the_aircraft(tmp_path):
    with real_flight(tmp_path) as flight:
        flight.wait_until_on_route()
        flight.signal(signal.SIGKILL)
        killed_at = flight.place_ned_m()
        with flight.started_again() as again:
            again.wait(lambda: again.said("lands it, and a second navigator gives"), 60.0)
            again.wait_until_down(90.0)
            assert np.hypot(*(again.place_ned_m() - killed_at)[:2]) < 40.0
            again.wait(lambda: again.said("its watchdog has left"), 30.0)
            again.wait(lambda: again.said("ready: press Enter, or arm"), 60.0)
            time.sleep(5.0)  # with --truth it would have armed by itself
            assert again.process.poll() is None
            assert (again.folder / "flight.mcap").exists()
            assert -again.place_ned_m()[2] < 0.5
            assert not again.said("taking off")


@pytest.mark.long
def test_the_same_aircraft_flies_a_second_time(tmp_path):
    """PX4 goes back to Offboard once it is down, where it is not ready to arm."""
    with real_flight(tmp_path) as flight:
        flight.wait(lambda: flight.process.poll() is not None, 300.0)
        assert flight.process.returncode == 0
        with flight.started_again(after_its_end=True) as again:
            again.wait(lambda: again.process.poll() is not None, 300.0)
            assert again.process.returncode == 0, again.log.read_text()[-3000:]
            assert again.said("on route")
            assert np.hypot(*again.place_ned_m()[:2]) < 1.0


@pytest.mark.long
def test_a_link_that_hangs_while_the_mission_goes_on_is_landed_on_the_second_ones_estimates(
    tmp_path,
):
    with real_flight(tmp_path, LINK_HANGS) as flight:
        flight.wait_until_on_route()
        flight.signal(signal.SIGUSR1)
        hung_at = flight.place_ned_m()
        flight.wait_until_down(90.0)
        assert flight.fastest_m_s() < 15.0
        assert np.hypot(*(flight.place_ned_m() - hung_at)[:2]) < 40.0
        assert flight.said("the loop of the link hangs")


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_flight_that_is_told_to_end_lands_first(tmp_path, number):
    with real_flight(tmp_path) as flight:
        flight.wait_until_on_route()
        told_at = flight.place_ned_m()
        flight.signal(number)
        assert flight.process.wait(90.0) == 1
        place = flight.place_ned_m()
        assert -place[2] < 0.5
        assert np.hypot(*(place - told_at)[:2]) < 15.0
        assert flight.said("interrupted by the operator")


@pytest.mark.long
def test_a_camera_that_fails_for_good_brings_the_aircraft_down_near_by(tmp_path):
    with real_flight(tmp_path, CAMERA_FAILS) as flight:
        flight.wait(lambda: flight.said("camera fails"), 150.0)
        failed_at = flight.place_ned_m()
        flight.wait_until_down(75.0)
        assert np.hypot(*(flight.place_ned_m() - failed_at)[:2]) < 50.0
        assert flight.process.wait(30.0) == 1
        assert flight.said("the camera shows nothing")


@pytest.mark.long
def test_a_disk_that_is_full_changes_nothing_in_the_air(tmp_path):
    with real_flight(tmp_path, file_limit=200_000) as flight:
        flight.wait_until_on_route()
        assert flight.process.wait(150.0) == 0, flight.log.read_text()[-2000:]
        assert np.hypot(*flight.place_ned_m()[:2]) < 5.0
        assert flight.said("recording")


@pytest.mark.long
def test_a_terminal_that_is_closed_changes_nothing_in_the_air(tmp_path):
    """`vwnav fly | tee log`, and `tee` ends: each line that is said from then on raises."""
    with real_flight(tmp_path, SCREEN_CLOSED) as flight:
        flight.wait_until_on_route()
        flight.process.wait(150.0)
        assert np.hypot(*flight.place_ned_m()[:2]) < 5.0
        run = json.loads((flight.folder / "run.json").read_text())
    assert run["completed"], run["reason"]


@pytest.mark.long
def test_a_terminal_that_stands_still_changes_nothing_in_the_air(tmp_path):
    """Ctrl-S, or `vwnav fly |& less`: whoever writes to it waits, and nobody of the flight does."""
    with real_flight(tmp_path, SCREEN_STALLS) as flight:
        flight.wait_until_on_route()
        assert flight.process.wait(150.0) == 0
        assert np.hypot(*flight.place_ned_m()[:2]) < 5.0
        run = json.loads((flight.folder / "run.json").read_text())
    assert run["completed"], run["reason"]


@pytest.mark.long
def test_steps_of_the_link_that_fail_now_and_then_are_flown_through(tmp_path):
    with real_flight(tmp_path, LINK_STEPS_FAIL) as flight:
        assert flight.process.wait(240.0) == 0, flight.log.read_text()[-2000:]
        assert np.hypot(*flight.place_ned_m()[:2]) < 5.0


@pytest.mark.long
def test_a_watchdog_that_is_killed_is_replaced_and_it_flies_on(tmp_path):
    """To the end of the route, unless the machine is too busy for images: then it lands."""
    with real_flight(tmp_path) as flight:
        flight.wait_until_on_route()
        os.kill(flight.watchdog_pid(), signal.SIGKILL)
        code = flight.process.wait(180.0)
        log = flight.log.read_text()
        assert code == 0 or flight.said("the camera shows nothing"), log[-2000:]
        # An event of the flight, which goes to the recording and the ground stations too.
        assert re.search(r"[0-9] s  the watchdog .* another one has taken its place", log), log
        assert not flight.said("failsafe")
    run = json.loads((flight.folder / "run.json").read_text())
    assert run["score"]["error_at_landing_m"] < 5.0


@pytest.mark.long
def test_a_watchdog_that_hangs_is_replaced_and_the_aircraft_lands_near_by(tmp_path):
    """The link is silent for two seconds: too long to go on with the route."""
    with real_flight(tmp_path) as flight:
        flight.wait_until_on_route()
        os.kill(flight.watchdog_pid(), signal.SIGSTOP)
        stopped_at = flight.place_ned_m()
        flight.wait_until_down(90.0)
        assert flight.said("another one has taken its place")
        assert flight.fastest_m_s() < 15.0
        assert np.hypot(*(flight.place_ned_m() - stopped_at)[:2]) < 30.0


@pytest.mark.long
def test_where_all_watchdogs_are_killed_the_aircraft_lands_near_by(tmp_path):
    """The navigator starts another: until then the autopilot flies its failsafe, blind."""
    with real_flight(tmp_path) as flight:
        flight.wait_until_on_route()
        killed_at = flight.place_ned_m()
        for each in flight.watchdogs():
            os.kill(each, signal.SIGKILL)
        flight.wait_until_down(120.0)
        assert flight.said("nobody guards the aircraft")
        assert flight.said("another one has taken its place")
        assert flight.fastest_m_s() < 15.0
        assert np.hypot(*(flight.place_ned_m() - killed_at)[:2]) < 40.0


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_watchdog_that_ends_or_hangs_after_its_navigator_is_followed_by_one_that_lands(
    tmp_path, number
):
    """And whoever gives the estimates by then goes on."""
    with real_flight(tmp_path, route_text="1,45,0,60\n2,45,-40,60\n") as flight:

        def watchdog_said(text: str) -> int:
            return (flight.folder / "watchdog.log").read_text(errors="replace").count(text)

        flight.wait_until_on_route()
        flight.wait(lambda: watchdog_said(LOADED) == 1, 60.0)
        watchdog = flight.watchdog_pid()
        flight.signal(signal.SIGKILL)
        killed_at = flight.place_ned_m()
        flight.wait(lambda: watchdog_said("estimates are handed on again") == 1, 20.0)
        os.kill(watchdog, number)
        flight.wait_until_down(120.0)
        assert np.hypot(*(flight.place_ned_m() - killed_at)[:2]) < 40.0
        assert flight.fastest_m_s() < 15.0
        assert len(list((flight.folder).glob("successor*"))) == 1


def _hear_at_once() -> None:
    """The relay's thread goes first: an autopilot hears on a processor of its own."""
    [relay] = (thread for thread in threading.enumerate() if thread.name == "relay")
    assert relay.native_id is not None
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, relay.native_id, -20)


THERE_AND_BACK = "".join(f"{i},{90 * (i % 2)},{-10 * (i % 3)},32\n" for i in range(1, 41))


def _gaps_s(
    tmp_path, kinds: tuple[str, ...], settings: str = "", begin=lambda: None
) -> dict[str, np.ndarray]:
    """Between messages of each kind to the autopilot, over ten minutes of a route."""
    times_s: dict[str, list[float]] = {kind: [] for kind in kinds}

    def note(message) -> None:
        if message.get_type() in times_s:
            times_s[message.get_type()].append(time.monotonic())

    with real_flight(tmp_path, route_text=THERE_AND_BACK, hear=note, settings=settings) as flight:
        flight.wait_until_on_route()
        begin()
        begun_s = time.monotonic()
        flight.wait(lambda: time.monotonic() - begun_s > 600.0, 620.0)
        end_s = time.monotonic()
    gaps_s = {}
    for kind, found_s in times_s.items():
        sent_s = [t_s for t_s in found_s if begun_s <= t_s <= end_s]
        assert sent_s[-1] - sent_s[0] > 590.0
        gaps_s[kind] = np.diff(sent_s)
        p999_s, longest_s = np.percentile(gaps_s[kind], 99.9), gaps_s[kind].max()
        print(f"{kind}: p99.9 {p999_s:.3f} s, longest {longest_s:.3f} s")
    return gaps_s


SLOW_BOARD = """
import os, threading
os.sched_setaffinity(0, {0})
started = threading.Thread._bootstrap_inner
def start(self):
    simulated = self.name in ("simulated camera", "tiles", "truth")
    os.sched_setaffinity(threading.get_native_id(), {1 if simulated else 0})
    started(self)
threading.Thread._bootstrap_inner = start
"""
LOAD = """
import os
os.sched_setaffinity(0, {0})
try:
    os.nice(-5)
except PermissionError:
    pass
while True:
    pass
"""


@pytest.mark.long
@pytest.mark.alone
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="the simulated world has a core of its own")
def test_on_a_core_that_five_others_share_estimates_keep_coming_and_the_route_is_flown(tmp_path):
    """As on a slow board: what reads images wants more than there is, and the link goes first."""
    times_s: list[float] = []

    def note(message) -> None:
        if message.get_type() in ("VISION_POSITION_ESTIMATE", "ODOMETRY"):
            times_s.append(time.monotonic())

    with real_flight(tmp_path, SLOW_BOARD, hear=note) as flight:
        flight.wait_until_on_route()
        begun_s = time.monotonic()
        others = [subprocess.Popen([sys.executable, "-c", LOAD]) for _ in range(5)]
        try:
            flight.wait(lambda: flight.said("landing"), 120.0)
            end_s = time.monotonic()
            flight.wait(lambda: flight.process.poll() is not None, 120.0)
        finally:
            for each in others:
                each.kill()
        log = flight.log.read_text(errors="replace")
        assert flight.process.returncode == 0, log[-3000:]
        home_m = np.hypot(*flight.place_ned_m()[:2])
    gaps_s = np.diff([t_s for t_s in times_s if begun_s < t_s < end_s])
    p99_s, holds = np.percentile(gaps_s, 99), log.count("holding")
    print(f"gaps: median {np.median(gaps_s):.3f}, 99 % {p99_s:.3f}, longest {gaps_s.max():.3f} s")
    assert home_m < 1.0
    assert holds == 0, log[-3000:]
    assert p99_s < 0.2  # longer ones stop an autopilot's fusion


@pytest.mark.long
@pytest.mark.alone
def test_setpoints_come_steadily_for_ten_minutes_beside_a_busy_loop(tmp_path):
    busy = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        gaps_s = _gaps_s(tmp_path, ("SET_POSITION_TARGET_LOCAL_NED",))
    finally:
        busy.kill()
    assert np.percentile(gaps_s["SET_POSITION_TARGET_LOCAL_NED"], 99.9) <= 0.1


@pytest.mark.long
@pytest.mark.alone
def test_the_link_keeps_its_rate_for_ten_minutes_while_the_matcher_takes_both_cores(tmp_path):
    flat_out = "[features]\nthreads = 2\n[pipeline]\nfix_interval_s = 0.0\n"
    kinds = ("SET_POSITION_TARGET_LOCAL_NED", "VISION_POSITION_ESTIMATE")
    gaps_s = _gaps_s(tmp_path, kinds, flat_out, begin=_hear_at_once)
    slow = {kind: p999_s for kind in kinds if (p999_s := np.percentile(gaps_s[kind], 99.9)) > 0.06}
    if slow:  # all else has to hold; what stands in the way of this: docs/benchmarks.md
        pytest.xfail(f"0.06 s are asked: {slow}")
