"""`vwnav doctor --connection`: the real command, and an autopilot to look at."""

import json
import os
import subprocess
import sys
import termios

from link_peer import Peer, free_port
from pymavlink.dialects.v20 import ardupilotmega as mavlink


def checks(kind: int, params: dict[str, tuple[float, int]]) -> dict[str, str]:
    port = free_port()
    with Peer(port, kind) as peer:
        peer.params = params
        return doctor(f"udpin://127.0.0.1:{port}")


def doctor(url: str, *words: str) -> dict[str, str]:
    return {name: check["detail"] for name, check in table(url, *words).items()}


def table(url: str, *words: str) -> dict[str, dict[str, str]]:
    command = [sys.executable, "-m", "vwnav", "doctor", "--json", "--connection", url, *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    return {check["name"]: check for check in json.loads(done.stdout)["checks"]}


def test_doctor_names_a_px4_and_what_is_missing():
    real = mavlink.MAV_PARAM_TYPE_REAL32
    found = checks(mavlink.MAV_AUTOPILOT_PX4, {"COM_OF_LOSS_T": (5.0, real)})
    assert found["autopilot"].startswith("PX4 on udpin://")
    assert found["COM_OF_LOSS_T"].startswith("is 5, should be 1 s or less")
    assert found["EKF2_EV_CTRL"].startswith("is missing, should be")


def test_doctor_asks_for_as_full_a_battery_as_the_flight_of_these_settings_will(tmp_path):
    """The battery is at 87 %."""
    (tmp_path / "full.toml").write_text("[safety]\nbattery_takeoff_ratio = 0.9\n")
    port = free_port()
    with Peer(port) as peer:
        peer.params = {"COM_OF_LOSS_T": (5.0, mavlink.MAV_PARAM_TYPE_REAL32)}
        found = table(f"udpin://127.0.0.1:{port}", "--config", str(tmp_path / "full.toml"))
    assert found["battery"]["verdict"] == "FAIL"
    assert found["battery"]["detail"] == "87 %, 90 % is wanted: charge it"


def test_doctor_names_an_arducopter():
    kind = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    found = checks(kind, {"VISO_TYPE": (1.0, mavlink.MAV_PARAM_TYPE_INT8)})
    assert found["autopilot"].startswith("ArduPilot on udpin://")
    assert "VISO_TYPE" not in found


def test_doctor_leaves_a_port_alone_that_a_watchdog_has():
    far, slave = os.openpty()
    url = f"serial://{os.ttyname(slave)}:57600"
    command = [sys.executable, "-m", "vwnav.watchdog", "--connection", url]
    command += ["--starts-left", "0"]  # nobody follows who is killed
    watchdog = subprocess.Popen(command, stdout=subprocess.PIPE)
    try:
        assert b"ready" in watchdog.stdout.readline()
        before = termios.tcgetattr(slave)
        assert doctor(url)["autopilot"].startswith("a watchdog has that link")
        assert termios.tcgetattr(slave) == before
    finally:
        watchdog.kill()
        watchdog.wait()
        os.close(far)


def test_doctor_says_what_is_wrong_with_a_serial_port():
    assert "check the URL and the device" in doctor("serial:///dev/no-such-port:57600")["autopilot"]
