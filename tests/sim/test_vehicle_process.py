"""The vehicle's process: it says when it is ready, stops when told, and dies with its parent."""

import os
import signal
import socket
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from px4_client import Companion, free_port, make_config
from pymavlink.dialects.v20 import development as mavlink

from vwnav.errors import LinkError
from vwnav.sim.vehicle import start_vehicle

TESTS = Path(__file__).parent
ROOT = TESTS.parents[1]


def is_running(pid: int) -> bool:
    """A zombie does not run."""
    status = Path(f"/proc/{pid}/stat")
    try:
        return status.read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def heartbeat() -> bytes:
    message = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=191)))


def run_command(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "vwnav.sim.vehicle", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=ROOT)


def test_it_is_ready_when_started_and_gone_when_stopped() -> None:
    config = make_config(companion_url=f"udpin:127.0.0.1:{free_port()}")
    with start_vehicle(config) as vehicle:
        pid = vehicle.pid
        assert vehicle.is_alive()
    assert pid is not None
    assert not is_running(pid)


def test_a_taken_port_says_so() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        url = f"udpin:127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(LinkError, match="another vehicle"):
            start_vehicle(make_config(truth_url=url))


@pytest.fixture
def parent(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A program with a vehicle, as from a terminal; it prints the vehicle's process id."""
    script = tmp_path / "parent.py"
    script.write_text(
        textwrap.dedent(f"""
        import signal, sys, time
        sys.path[:0] = [{str(ROOT)!r}, {str(TESTS)!r}]
        from px4_client import make_config
        from vwnav.sim.vehicle import start_vehicle
        if __name__ == "__main__":
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                signal.signal(number, lambda *_: None)
            print(start_vehicle(make_config()).pid, flush=True)
            while True:
                time.sleep(60)
        """)
    )
    process = subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    yield process
    process.kill()
    process.wait()


def vehicle_of(parent: subprocess.Popen[str]) -> int:
    assert parent.stdout is not None
    return int(parent.stdout.readline())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_what_a_terminal_sends_to_all_does_not_drop_the_vehicle(parent, number) -> None:
    pid = vehicle_of(parent)
    os.killpg(parent.pid, number)
    time.sleep(0.3)
    assert is_running(pid)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_it_dies_with_its_parent(parent) -> None:
    pid = vehicle_of(parent)
    parent.kill()
    parent.wait()
    end = time.monotonic() + 5.0
    while is_running(pid) and time.monotonic() < end:
        time.sleep(0.02)
    assert not is_running(pid)


def test_help_names_its_options() -> None:
    done = run_command("--help")
    assert done.returncode == 0
    options = ("--manners", "--wind-m-s", "--autopilot-defaults", "--pilot-switch-at-s", "--param")
    for option in options:
        assert option in done.stdout


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (("--speed", "0"), 1, "speed=0.0 makes no sense"),
        (("--param", "NOT_THERE=1"), 1, "no parameter NOT_THERE"),
        (("--companion-url", "telepathy"), 1, "udpin:HOST:PORT"),
        (("--param", "A=x"), 2, "could not convert"),
    ],
)
def test_a_wrong_option_is_one_line(arguments: tuple[str, ...], code: int, text: str) -> None:
    done = run_command(*arguments)
    assert done.returncode == code
    assert text in done.stderr
    assert "Traceback" not in done.stderr


def test_a_reboot_takes_up_changed_parameters() -> None:
    config = make_config(speed=1.0)
    with start_vehicle(config):
        c = Companion(config)
        c.wait(lambda c: c.t_s > 2.0, 10.0)
        c.set_parameter("MIS_TAKEOFF_ALT", 7.0)
        assert c.command(246, 1) == 0
        assert c.wait(lambda c: c.t_s < 2.0, 5.0)
        c.set_parameter("MIS_TAKEOFF_ALT", float("nan"))  # refused: answers what it has
        assert c.wait(lambda c: c.latest["PARAM_VALUE"].param_value == 7.0, 5.0)
        c.close()


def test_two_peers_hear_the_same_vehicle() -> None:
    config = make_config(speed=1.0, companion_url=f"udpin:127.0.0.1:{free_port()}")
    port = int(config.companion_url.rsplit(":", 1)[1])
    with start_vehicle(config):
        sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
        for peer in sockets:
            peer.settimeout(3.0)
            peer.sendto(heartbeat(), ("127.0.0.1", port))
        assert all(len(peer.recv(1000)) > 10 for peer in sockets)
        for peer in sockets:
            peer.close()
