"""How a flight is put together: the link."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "watchdog"))

from link_peer import Peer, free_port

from vwnav.clock import WallClock
from vwnav.mission.config import FlightConfig
from vwnav.onboard.program import connect
from vwnav.watchdog.launch import start_watchdog


def test_the_watchdog_is_told_which_autopilot_the_navigator_follows():
    port = free_port()
    url = f"udpin://127.0.0.1:{port}"
    with Peer(port, system_id=5), start_watchdog(url) as watchdog:
        assert watchdog.keepalive.system_id == 0
        autopilot = connect(watchdog, url, WallClock(), FlightConfig())
        assert watchdog.keepalive.system_id == 5
        autopilot.close()
