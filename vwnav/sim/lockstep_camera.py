"""A camera in simulated time: exposures at a steady rate, images that arrive a while later."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.rotations import rotation_from_quat
from vwnav.sim.multirotor.airframe import Airframe
from vwnav.types import Array, Frame


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Where the body was at an exposure: NED about the site's home, quat_wxyz of R_ned_body."""

    t_s: float
    index: int
    position_ned_m: Array
    quat_wxyz: Array
    velocity_ned_m_s: Array
    rate_body_rad_s: Array


class Renderer(Protocol):
    """What draws the images: `vwnav.sim.renderer.CameraRenderer`."""

    def render(
        self,
        position_ned_m: Array,
        R_ned_body: Array,
        t_s: float,
        velocity_ned_m_s: Array,
        rate_body_rad_s: Array,
    ) -> NDArray[np.uint8]:
        """The image of a moment."""
        ...


# What becomes of an image: another one, or None when it is lost. It may raise, as a driver does.
Trouble = Callable[[Frame], Frame | None]


class LockstepCamera:
    """The newest image wins, as with `SimulatedCamera`; those never looked at are not drawn.

    Attributes:
        renderer, home_ned_m: what is seen, and (3,) where in it the vehicle's start place lies.
        period_s: between exposures.
        latency_s: from the exposure to the image. late_s: by how much its date is late.
        troubles: of its images, one after the other, each by the `id` of who makes it.
        R_body_mount: (3, 3) by which it was knocked out of its mount.
        drawn: how many images were.
    """

    def __init__(
        self,
        renderer: Renderer,
        home_ned_m: Array,
        period_s: float,
        latency_s: float,
        late_s: float = 0.0,
    ) -> None:
        self.renderer = renderer
        self.home_ned_m = home_ned_m
        self.period_s = period_s
        self.latency_s = latency_s + max(late_s, 0.0)
        self.late_s = late_s
        self.troubles: dict[int, Trouble] = {}
        self.R_body_mount: Array = np.eye(3)
        self.drawn = 0
        self._index = 0
        self._next_s = 0.0
        self._waiting: deque[tuple[float, Pose]] = deque()

    def step(self, t_s: float, body: Airframe) -> None:
        """Expose when it is time to."""
        if t_s < self._next_s:
            return
        self._next_s = max(self._next_s + self.period_s, t_s)
        pose = Pose(
            t_s,
            self._index,
            self.home_ned_m + np.array([body.n, body.e, body.d]),
            np.array([body.qw, body.qx, body.qy, body.qz]),
            np.array([body.vn, body.ve, body.vd]),
            np.array([body.p, body.q, body.r]),
        )
        self._index += 1
        self._waiting.append((t_s + self.latency_s, pose))

    def arrived(self, t_s: float) -> bool:
        """Whether an image is there."""
        return bool(self._waiting) and self._waiting[0][0] <= t_s

    def take(self, t_s: float) -> Frame | None:
        """The newest image that is there; None when it got lost or none is.

        Raises:
            Exception: whatever its trouble raises.
        """
        pose = None
        while self.arrived(t_s):
            pose = self._waiting.popleft()[1]
        if pose is None:
            return None
        frame: Frame | None = Frame(pose.t_s + self.late_s, self._draw(pose), pose.index)
        for trouble in list(self.troubles.values()):
            frame = None if frame is None else trouble(frame)
        return frame

    def _draw(self, pose: Pose) -> NDArray[np.uint8]:
        self.drawn += 1
        return self.renderer.render(
            pose.position_ned_m,
            rotation_from_quat(pose.quat_wxyz) @ self.R_body_mount,
            pose.t_s,
            pose.velocity_ned_m_s,
            self.R_body_mount.T @ pose.rate_body_rad_s,
        )
