"""A simulated camera: images drawn from the ground truth that any simulator sends."""

import math
import threading
import time

import numpy as np

from vwnav.clock import Clock
from vwnav.errors import SourceError
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import rotation_from_quat
from vwnav.sim.lockstep_camera import Renderer
from vwnav.sim.truth import TruthReader
from vwnav.sim.truth_state import TruthState
from vwnav.types import Frame

FRAME_HZ = 15.0
_TRUTH_POLL_S = 0.002
_TRUTH_PATIENCE_S = 1.0  # of the wall clock
_TRUTH_GONE_S = 1.0  # a simulator that has told nothing for so long will tell nothing more
FIRST_TRUTH_TIMEOUT_S = 20.0
LONGEST_TRUTH_LAG_S = 0.1  # later than that the newest state is shown, with its own time
TRUTH_LAG_S = 0.03  # an image shows a moment this old, so that truth around it can be interpolated


class SimulatedCamera:
    """A `FrameSource` that behaves like a real camera: the newest image wins.

    Args:
        flown_m: how high the vehicle is above the site's ground as this begins.
    """

    def __init__(
        self,
        renderer: Renderer,
        truth: TruthReader,
        site_home: tuple[float, float],
        clock: Clock,
        flown_m: float = 0.0,
        rate_hz: float = FRAME_HZ,
    ) -> None:
        first = _wait_for(truth)
        ground_m = first.alt_amsl_m - flown_m
        self._site_frame = LocalFrame(*site_home, ground_m)
        self._renderer = renderer
        self._truth = truth
        self._clock = clock
        self._period_s = 1.0 / rate_hz
        self._newest: Frame | None = None
        self._arrived = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._expose, name="simulated camera", daemon=True)
        self._thread.start()

    def next_frame(self) -> Frame | None:
        """The newest image that was not handed out yet; waits for one. None once closed."""
        with self._arrived:
            self._arrived.wait_for(lambda: self._newest is not None or self._closed)
            frame, self._newest = self._newest, None
            return frame

    def close(self) -> None:
        """Stop rendering."""
        with self._arrived:
            self._closed = True
            self._arrived.notify_all()
        self._thread.join(timeout=2.0)

    def _expose(self) -> None:
        clock, participant = self._clock, self._clock.join("camera")
        index, next_s, shown_s = 0, clock(), -math.inf
        while not self._closed:
            state = self._true_state(clock() - TRUTH_LAG_S)
            if state is not None and state.t_s > shown_s:
                frame = Frame(state.t_s, self._render(state), index)
                index, shown_s = index + 1, state.t_s
                with self._arrived:
                    self._newest = frame
                    self._arrived.notify_all()
            next_s = max(next_s + self._period_s, clock())
            participant.until(next_s + self._period_s)
            clock.wait_until(next_s)
        participant.leave()

    def _true_state(self, t_s: float) -> TruthState | None:
        """At the exposure: what is told of the time about it may still be on its way.

        Of a simulator that is late the newest state: it is exposed when that was so. Once dated
        by when it should have been, images were up to 0.2 s wrong on a busy machine, and their ways
        contradicted the IMU.

        It waits by the wall: a simulated time stands while the camera is late. For a simulator
        that tells nothing any more it does not wait.
        """
        gone_t_s, until_s = t_s - _TRUTH_GONE_S, time.monotonic() + _TRUTH_PATIENCE_S
        while (newest := self._truth.latest()) is not None and gone_t_s <= newest.t_s < t_s:
            late = self._clock() >= t_s + LONGEST_TRUTH_LAG_S
            if late or time.monotonic() >= until_s:
                break
            time.sleep(_TRUTH_POLL_S)
        return self._truth.at(t_s)

    def _render(self, state: TruthState) -> np.ndarray:
        return self._renderer.render(
            self._site_frame.to_ned(state.lat_deg, state.lon_deg, state.alt_amsl_m),
            rotation_from_quat(np.array(state.quat_wxyz)),
            state.t_s,
            np.array(state.velocity_ned_m_s),
            np.array(state.rates_rad_s),
        )


def _wait_for(truth: TruthReader) -> TruthState:
    state = truth.wait(FIRST_TRUTH_TIMEOUT_S)
    if state is not None:
        return state
    raise SourceError(
        f"no ground truth within {FIRST_TRUTH_TIMEOUT_S:.0f} s: does the simulator send "
        "HIL_STATE_QUATERNION or SIM_STATE to the URL of --truth?"
    )
