"""The autopilot on a real link, by MAVSDK: opened, and looked at before a flight."""

import time
from collections.abc import Callable

from vwnav.errors import LinkError
from vwnav.mavlink.autopilot import LinkedAutopilot
from vwnav.mavlink.link_budget import bytes_per_s
from vwnav.mavlink.ports.mavsdk_port import MavlinkPort
from vwnav.vehicle import Finding

HEARD_WITHIN_S = 20.0
_FIRST_HEARTBEAT_S = 5.0
_STEP_S = 0.02
_FINDINGS_STEPS = 250  # 5 s; longer where the machine is slow at steps, for each asks one question


class MavsdkAutopilot(LinkedAutopilot):
    """The autopilot on a MAVSDK link; opening it waits until an autopilot is heard.

    Args:
        url: `udpin://0.0.0.0:14540`, `udpout://HOST:PORT`, `tcpout://HOST:PORT`,
            `serial:///dev/ttyAMA0:921600`, or the watchdog's `navigator_url`.
        timeout_s: how long an autopilot is waited for.
        as_ground_station: show ourselves as a ground station. PX4 then sends its texts on this
            link, but also believes that a ground station watches: its failsafe for losing the real
            one would never act. For the bench, not for flight.
        clock: monotonic clock, in seconds.
        link_url: the autopilot's own link, when `url` is that of a relay in front of it.
        ground_station_ids: of those that may command the navigator; nobody may when empty.
        system_id: of the autopilot that is wanted; 0 for the first that is heard.

    Raises:
        LinkError: no PX4 or ArduPilot is on the link.
    """

    def __init__(
        self,
        url: str,
        timeout_s: float = HEARD_WITHIN_S,
        as_ground_station: bool = False,
        clock: Callable[[], float] = time.monotonic,
        link_url: str | None = None,
        ground_station_ids: tuple[int, ...] = (),
        system_id: int = 0,
    ) -> None:
        capacity_bytes_s = bytes_per_s(link_url or url)
        port = MavlinkPort(url, as_ground_station, timeout_s, clock, system_id, link_url)
        super().__init__(port, clock, capacity_bytes_s, ground_station_ids)
        until_s = time.monotonic() + _FIRST_HEARTBEAT_S
        while self.kind is None:
            if time.monotonic() > until_s:
                port.close()
                raise LinkError(f"the autopilot on {link_url or url} is neither PX4 nor ArduPilot")
            time.sleep(_STEP_S)


def wait_for_findings(autopilot: LinkedAutopilot) -> tuple[Finding, ...]:
    """Step the link until its parameters are read; before a flight, where nobody else does.

    Raises:
        LinkError: the autopilot answers no question for a parameter.
    """
    for _ in range(_FINDINGS_STEPS):
        autopilot.step(time.monotonic())
        if autopilot.findings is not None:
            return autopilot.findings
        time.sleep(_STEP_S)
    raise LinkError("the autopilot answers no parameter request: is the link two-way?")
