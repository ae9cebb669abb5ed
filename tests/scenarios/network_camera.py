"""A simulated camera behind a network: JPEG over RTSP, which can be pulled out and put back."""

import threading
from collections.abc import Iterator

import cv2
import numpy as np
from rtsp_server import RtspServer

from vwnav.clock import WallClock
from vwnav.geometry.camera import Camera
from vwnav.sim.camera_source import FRAME_HZ, SimulatedCamera
from vwnav.sim.lens import RenderConfig
from vwnav.sim.named_sites import parse_site, tiles_folder
from vwnav.sim.renderer import CameraRenderer
from vwnav.sim.truth import TruthReader

_WAIT_S = 0.5
_LATE_S = 1.0 / FRAME_HZ  # an image is sent so long after it was exposed, as cameras do


class NetworkCamera:
    """Draws `site` from a simulator's truth, as `camera` sees it, for whoever asks."""

    def __init__(self, site: str, camera: Camera, truth_url: str) -> None:
        place, self._truth = parse_site(site), TruthReader(truth_url)
        rng, look = np.random.default_rng(1), RenderConfig(color=False)
        self._renderer = CameraRenderer(place, camera, look, rng, tiles_folder(place))
        home = (place.home_lat_deg, place.home_lon_deg)
        self._source = SimulatedCamera(self._renderer, self._truth, home, WallClock())
        self._sent = (0.0, b"")
        self._made = threading.Condition()
        self._is_in, self._hangs = True, False
        self._size_wh = (camera.width_px, camera.height_px)
        self._server = self._serve()
        self.url = self._server.url
        self._thread = threading.Thread(target=self._encode, daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        """Who looks at it gets no more, and nobody is let in."""
        self._is_in = False
        self._server.shutdown()
        self._server.server_close()

    def plug_in(self) -> None:
        """At the same address as before."""
        self._is_in = True
        self._server = self._serve(self._server.server_address[1])

    def hang(self) -> None:
        """Who looks at it, or begins to, gets no more images; nobody is told that it is gone."""
        self._hangs = True

    def go_on(self) -> None:
        """With what it sees now."""
        self._hangs = False

    def close(self) -> None:
        """Switch it off."""
        if self._is_in:
            self.unplug()
        self._source.close()
        self._thread.join()
        self._truth.close()
        self._renderer.close()

    def _serve(self, port: int = 0) -> RtspServer:
        server = RtspServer(self._images, self._size_wh, port)
        threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
        return server

    def _images(self) -> Iterator[tuple[float, bytes]]:
        seen_s = self._sent[0]
        while self._is_in:
            with self._made:
                if self._sent[0] <= seen_s:
                    self._made.wait(_WAIT_S)
                sent_s, jpeg = self._sent
            if sent_s > seen_s and not self._hangs:
                seen_s = sent_s
                yield sent_s, jpeg

    def _encode(self) -> None:
        while (frame := self._source.next_frame()) is not None:
            image = cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR)  # 4:2:0
            jpeg = cv2.imencode(".jpg", image)[1].tobytes()
            with self._made:
                self._sent = (frame.t_s + _LATE_S, jpeg)
                self._made.notify_all()
