"""Links for the autopilot's tests: a peer on one end, `MavsdkAutopilot` on the other."""

import time
from collections.abc import Iterator

import numpy as np
from link_peer import Peer, free_port, wait_for

from vwnav.drivers.autopilot import MavsdkAutopilot
from vwnav.geometry.rotations import quat_from_rotation, rotation_from_euler
from vwnav.types import Estimate

HOME = (60.403, 22.461, 40.0)


def link(kind: int) -> Iterator[tuple[Peer, MavsdkAutopilot]]:
    port = free_port()
    with Peer(port, kind) as peer:
        autopilot = MavsdkAutopilot(f"udpin://127.0.0.1:{port}", timeout_s=10.0)
        yield peer, autopilot
        start_s = time.monotonic()
        autopilot.close()
        assert time.monotonic() - start_s < 2.0


def estimate(yaw_rad: float = 0.0, fix: float | None = 1.0) -> Estimate:
    covariance = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    quat = quat_from_rotation(rotation_from_euler(0.1, -0.2, yaw_rad))
    velocity = np.array([4.0, 5.0, -6.0])
    position = np.array([10.0, -20.0, -30.0])
    now_s = time.monotonic()
    return Estimate(now_s, position, velocity, covariance, quat, 0.1, 30.0, 1.0, fix, 258)


def has_origin(peer: Peer, autopilot: MavsdkAutopilot) -> None:
    peer.heard.clear()
    autopilot.set_origin(*HOME)
    autopilot.send_estimate(estimate())
    assert not peer.of("VISION_POSITION_ESTIMATE"), "sent before the origin was agreed upon"
    wait_for(lambda: autopilot._origin.offset_ned_m is not None)
