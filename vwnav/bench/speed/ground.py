"""What is looked at: a generated place on two days, its maps, and images taken over it."""

import math
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.maps.build.builder import BuildOptions, build_pack
from vwnav.maps.build.raster import array_source, local_georeference
from vwnav.maps.pack import MapPack
from vwnav.sim.lens import RenderConfig
from vwnav.sim.named_sites import MAP_M_PER_PX, parse_site
from vwnav.sim.renderer import CameraRenderer, default_camera
from vwnav.types import FeatureExtractor, Frame, Gray, Prior

SITE = "sim:default"
SIDE_PX = 1200  # of the map, home in its middle
HEADINGS = 8  # a view is north-up: turned by 45 degrees it is twice as large
CIRCLE_M, CIRCLE_S = 1.0, 4.0  # what is flown for the latency: 1.6 m/s
PRIOR_SIGMA_M, OFF_M = 3.0, 2.0
_SEED = 0


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """An image that is to be located, and what is known of it."""

    frame: Frame
    prior: Prior


class TrialGround:
    """The place. Images are drawn, and packs made, when they are first asked for."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        """Draw the map.

        Args:
            folder: where packs go.
            stack: closes what is opened.
        """
        self._folder, self._stack = folder, stack
        self._site = parse_site(SITE)
        self.camera = default_camera()
        self.local_frame = LocalFrame(self._site.home_lat_deg, self._site.home_lon_deg, 0.0)
        half_m = SIDE_PX * MAP_M_PER_PX / 2.0
        size_wh = (SIDE_PX, SIDE_PX)
        bgr = self._site.render("map", half_m, -half_m, size_wh, MAP_M_PER_PX)
        georeference = local_georeference(self.local_frame, (half_m, -half_m), MAP_M_PER_PX)
        self._source = array_source(bgr, georeference, name=SITE)
        self._packs: dict[str, MapPack] = {}
        rng = np.random.default_rng(_SEED)
        config = RenderConfig(color=False, background=False)
        self._renderer = CameraRenderer(self._site, self.camera, config, rng)
        stack.callback(self._renderer.close)

    def pack(self, extractor: FeatureExtractor) -> MapPack:
        """The map with the features of an extractor."""
        name = extractor.feature_set_id
        if name not in self._packs:
            path = self._folder / f"{name}.mbtiles"
            build_pack([self._source], path, [extractor], BuildOptions(name=SITE))
            self._packs[name] = self._stack.enter_context(MapPack.open(path))
        return self._packs[name]

    def agl_m(self, m_per_px: float, size_wh: tuple[int, int]) -> float:
        """From so high an image shows so much of a map."""
        image_px = self.camera.width_px * self.camera.height_px
        ratio = math.sqrt(size_wh[0] * size_wh[1] / image_px)
        return float(self.camera.K[0, 0]) * m_per_px * ratio

    def sights(self, agl_m: float) -> list[Sight]:
        """Images with headings all around, level, with priors that are a little off."""
        sights = []
        for index in range(HEADINGS):
            yaw_rad = 2.0 * math.pi * index / HEADINGS
            off_m = OFF_M * np.array([math.cos(3.0 * yaw_rad), math.sin(3.0 * yaw_rad), 0.0])
            at_ned_m = np.array([2.0 * index - HEADINGS, 0.0, -agl_m])
            frame = Frame(float(index), self._image(at_ned_m, yaw_rad), index)
            lat_deg, lon_deg, _ = self.local_frame.to_geodetic(at_ned_m + off_m)
            prior = Prior(
                lat_deg=float(lat_deg), lon_deg=float(lon_deg), sigma_m=PRIOR_SIGMA_M,
                yaw_rad=yaw_rad, sigma_yaw_rad=0.05, agl_m=agl_m, sigma_agl_ratio=0.03,
                roll_rad=0.0, pitch_rad=0.0,
            )  # fmt: skip
            sights.append(Sight(frame, prior))
        return sights

    def circle(self, agl_m: float, camera_hz: float) -> list[Gray]:
        """Images of one round of a small circle about home, heading north."""
        count = round(CIRCLE_S * camera_hz)
        angles = 2.0 * np.pi * np.arange(count) / count
        way_m = CIRCLE_M * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        return [self._image(np.array([*ne_m, -agl_m]), 0.0) for ne_m in way_m]

    def _image(self, at_ned_m: np.ndarray, yaw_rad: float) -> Gray:
        R_ned_body, still = rotation_from_euler(0.0, 0.0, yaw_rad), np.zeros(3)
        return self._renderer.render(at_ned_m, R_ned_body, 0.0, still, still)
