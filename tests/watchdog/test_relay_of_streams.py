"""What one read of a stream brings reaches MAVSDK whole, through a real watchdog over TCP."""

import json
import socket
import subprocess
import sys
import threading
import time

import pytest
from link_peer import wait_for
from pymavlink.dialects.v20 import all as mavlink

from vwnav.mavlink.ports.mavsdk_port import MavlinkPort

AUTOPILOT = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
IN_A_BURST = 100  # 4 kB: what comes in a tenth of a second from an autopilot that streams its IMU


@pytest.fixture
def far_end():
    """The connection that a watchdog opened, and the port on which it has a navigator."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"tcpout://127.0.0.1:{server.getsockname()[1]}"
        command = [sys.executable, "-m", "vwnav.watchdog", "--connection", url]
        watchdog = subprocess.Popen([*command, "--starts-left", "0"], stdout=subprocess.PIPE)
        connection, _ = server.accept()
        try:
            yield connection, json.loads(watchdog.stdout.readline())["ready"]["navigator_port"]
        finally:
            watchdog.kill()
            watchdog.wait()
            connection.close()


def beat(connection: socket.socket, stop: threading.Event) -> None:
    kind = (mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4)
    message = mavlink.MAVLink_heartbeat_message(*kind, 0x51, 4, 4, 3)
    while not stop.wait(0.2):
        connection.sendall(bytes(message.pack(AUTOPILOT)))


def test_a_burst_of_4_kilobytes_is_heard_whole(far_end):
    connection, navigator_port = far_end
    stop, heard = threading.Event(), []
    threading.Thread(target=beat, args=(connection, stop), daemon=True).start()
    port = MavlinkPort(f"udpout://127.0.0.1:{navigator_port}", False, 20.0, time.monotonic)
    try:
        port.subscribe("ATTITUDE", lambda name, fields, t_s: heard.append(fields["time_boot_ms"]))
        time.sleep(0.5)
        for burst in range(3):
            messages = (
                mavlink.MAVLink_attitude_message(IN_A_BURST * burst + n, 0.1, 0.2, 0.3, 0, 0, 0)
                for n in range(IN_A_BURST)
            )
            connection.sendall(b"".join(bytes(each.pack(AUTOPILOT)) for each in messages))
            time.sleep(0.3)
        wait_for(lambda: len(heard) == 3 * IN_A_BURST)
    finally:
        stop.set()
        port.close()
