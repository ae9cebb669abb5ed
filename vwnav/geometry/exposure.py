"""How long an image may be exposed while the body moves."""

from collections import deque

import numpy as np

from vwnav.geometry.rotations import rotation_from_quat, vector_from_rotation
from vwnav.types import Estimate

MOST_BLUR_PX = 1.5  # an image that is blurred by more tells less
_LEAST_AGL_M = 1.0
_LEAST_BLUR_PX_S = 1.0
_MOST_TURN_RAD_S = 2.0  # what turns an estimate faster is a correction of it
_REMEMBERED_S = 2.0  # of how fast it was: an exposure comes a while after it is asked for


def blur_px_s(focal_px: float, speed_m_s: float, agl_m: float, turn_rad_s: float = 0.0) -> float:
    """How fast the ground moves through the image of a camera that looks down, at its middle."""
    return focal_px * (speed_m_s / max(agl_m, _LEAST_AGL_M) + turn_rad_s)


class BlurLimit:
    """The longest exposure that does not blur, by how the aircraft moved in the last two seconds.

    Before there is an estimate, and when there is none any more: by how it is going to.
    """

    def __init__(self, focal_px: float, cruise_m_s: float, lowest_m: float) -> None:
        """Without an estimate.

        Args:
            focal_px: of the camera.
            cruise_m_s: along the route.
            lowest_m: above ground, of the route.
        """
        self._focal_px, self._planned_px_s = focal_px, blur_px_s(focal_px, cruise_m_s, lowest_m)
        self._seen: deque[tuple[float, float]] = deque()  # (t_s, px a second)
        self._before: Estimate | None = None

    def most_s(self, now: Estimate | None) -> float:
        """Ask it some ten times a second."""
        before, self._before = self._before, now
        if now is None:
            self._seen.clear()
            return MOST_BLUR_PX / self._planned_px_s
        speed_m_s = float(np.linalg.norm(now.velocity_ned_m_s))
        turn_rad_s = 0.0 if before is None else _turn_rad_s(before, now)
        self._seen.append((now.t_s, blur_px_s(self._focal_px, speed_m_s, now.agl_m, turn_rad_s)))
        while now.t_s - self._seen[0][0] > _REMEMBERED_S:
            self._seen.popleft()
        return MOST_BLUR_PX / max(_LEAST_BLUR_PX_S, *(px_s for _, px_s in self._seen))


def _turn_rad_s(before: Estimate, now: Estimate) -> float:
    """How fast the body turned from one to the other, about whatever axis."""
    gap_s = now.t_s - before.t_s
    if gap_s <= 0.0:
        return 0.0
    R0, R1 = rotation_from_quat(before.quat_wxyz), rotation_from_quat(now.quat_wxyz)
    turn_rad_s = float(np.linalg.norm(vector_from_rotation(R0.T @ R1))) / gap_s
    return min(turn_rad_s, _MOST_TURN_RAD_S)
