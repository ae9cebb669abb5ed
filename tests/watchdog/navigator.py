"""A navigator as a process: flies north at 8 m/s through a watchdog, until something happens to it.

    python navigator.py LINK_URL [JSON list: the successor's command line]

Says the watchdog's process id. SIGUSR1 raises an exception in its loop, SIGUSR2 claims the
aircraft again.
"""

import json
import signal
import socket
import sys
import time

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from vwnav.watchdog.launch import start_watchdog

SPEED_M_S, PERIOD_S = 8.0, 0.02
MAV = mavlink.MAVLink(None, srcSystem=7, srcComponent=191)


def estimate(t_s: float, north_m: float, counter: int) -> bytes:
    place = (north_m, 0.0, -50.0, 0.0, 0.0, 0.0)
    message = mavlink.MAVLink_vision_position_estimate_message(
        int(t_s * 1e6), *place, [0.1] * 21, counter
    )
    return bytes(message.pack(MAV))


def setpoint(north_m_s: float) -> bytes:
    message = mavlink.MAVLink_set_position_target_local_ned_message(
        0, 7, 1, 1, 2503, 0, 0, 0, north_m_s, *[0] * 7
    )
    return bytes(message.pack(MAV))


def connect(url: str) -> socket.socket:
    connection = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    connection.connect(("127.0.0.1", int(url.rpartition(":")[2])))
    return connection


def break_down(*_: object) -> None:
    raise RuntimeError("the camera has died")


def main() -> None:
    signal.signal(signal.SIGUSR1, break_down)
    standby = {"standby": json.loads(sys.argv[2])} if len(sys.argv) > 2 else {}
    with start_watchdog(sys.argv[1], **standby) as watchdog:
        print(watchdog.process.pid, flush=True)
        link = connect(watchdog.navigator_url)
        signal.signal(signal.SIGUSR2, lambda *_: watchdog.keepalive.rejoin())
        start_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            watchdog.keepalive.beat(True, "on route")
            link.send(setpoint(SPEED_M_S))
            link.send(estimate(now_s, SPEED_M_S * (now_s - start_s), 0))
            time.sleep(PERIOD_S)


if __name__ == "__main__":
    main()
