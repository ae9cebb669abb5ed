"""A generated site: one landscape, seen on two days, at any place and resolution."""

import hashlib
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.sim.scenery.drawing import Canvas
from vwnav.sim.scenery.ground import paint_ground
from vwnav.sim.scenery.landscape import Landscape, LookName
from vwnav.sim.scenery.layout import lay_out
from vwnav.sim.scenery.looks import Look, flight_look, map_look
from vwnav.sim.scenery.noise import NedWindow
from vwnav.sim.scenery.objects import near, paint_objects
from vwnav.sim.scenery.runway import paint_airfield

FIRST_TRAINING_SEED = 1000  # sites from here on may be trained on; lower seeds are for flying
_TILE_PX = 512
_JPEG_BLOCK_PX = 16


@lru_cache(maxsize=1)
def generator_fingerprint() -> str:
    """Changes whenever the drawing code does: the key of everything drawn that is kept on disk."""
    here = Path(__file__)
    digest = hashlib.sha256(cv2.__version__.encode())
    for source in (here, *sorted((here.parent / "scenery").glob("*.py"))):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:12]


class Site:
    """A place that exists only as a seed, in local metres about its home.

    Attributes:
        seed: of the landscape and both its looks.
        home_lat_deg, home_lon_deg: where the origin lies; north and east are those of
            `LocalFrame(home_lat_deg, home_lon_deg, ...)`, and the ground is its level plane.
        landscape: the vectors, for whoever wants to know what stands where.
    """

    def __init__(self, seed: int, home_lat_deg: float = 60.4, home_lon_deg: float = 22.5) -> None:
        if seed < 0:
            raise ValueError(f"expected a seed >= 0, got {seed}")
        self.seed = seed
        self.home_lat_deg = home_lat_deg
        self.home_lon_deg = home_lon_deg
        self.landscape: Landscape = lay_out(seed)
        self.looks: dict[LookName, Look] = {"map": map_look(seed), "flight": flight_look(seed)}

    def render(
        self,
        look: LookName,
        north0_m: float,
        east0_m: float,
        size: tuple[int, int],
        m_per_px: float,
    ) -> NDArray[np.uint8]:
        """Draw a north-up window; about a microsecond per pixel.

        Args:
            look: "map" (another year, from a satellite) or "flight" (today, as it is).
            north0_m: of the window's upper edge; row v shows `north0_m - (v + 0.5) * m_per_px`.
            east0_m: of its left edge; column u shows `east0_m + (u + 0.5) * m_per_px`.
            size: width and height in pixels.
            m_per_px: 0.02 to 2 metres per pixel.

        Returns:
            (height, width, 3) BGR uint8.
        """
        if m_per_px <= 0.0 or min(size) < 1:
            raise ValueError(f"expected a window, got {size} px of {m_per_px} m")
        return _render(
            self.landscape,
            self.looks[look],
            NedWindow(north0_m, east0_m, size[0], size[1], m_per_px),
        )


def _render(land: Landscape, look: Look, window: NedWindow) -> NDArray[np.uint8]:
    """Draw a window with the margin that blur and JPEG blocks need, and cut it off again."""
    left, top, right, bottom = _margins(look, window)
    r = window.m_per_px
    wide = NedWindow(
        window.north0_m + top * r,
        window.east0_m - left * r,
        window.width + left + right,
        window.height + top + bottom,
        r,
    )
    image = np.empty((wide.height, wide.width, 3), np.uint8)
    for v in range(0, wide.height, _TILE_PX):
        for u in range(0, wide.width, _TILE_PX):
            part = NedWindow(
                wide.north0_m - v * r,
                wide.east0_m + u * r,
                min(_TILE_PX, wide.width - u),
                min(_TILE_PX, wide.height - v),
                r,
            )
            image[v : v + part.height, u : u + part.width] = _draw(land, look, part)
    image = _deliver(image, look, window.m_per_px)
    return np.ascontiguousarray(image[top : top + window.height, left : left + window.width])


def _margins(look: Look, window: NedWindow) -> tuple[int, int, int, int]:
    """Left, top, right, bottom pixels to add.

    JPEG blocks sit on a grid of the ground, so that windows on it agree to the last bit.
    """
    if look.jpeg_quality is None:
        return 0, 0, 0, 0
    r, block = window.m_per_px, _JPEG_BLOCK_PX
    left = round(window.east0_m / r) % block + block
    top = round(-window.north0_m / r) % block + block
    right = -(left + window.width) % block + block
    bottom = -(top + window.height) % block + block
    return left, top, right, bottom


def _draw(land: Landscape, look: Look, window: NedWindow) -> NDArray[np.uint8]:
    canvas = Canvas(window, land.seed)
    turf = paint_ground(canvas, land, look)
    paint_airfield(canvas, land.airfield, look, turf)
    paint_objects(canvas, near(land, canvas, look), look)
    np.clip(canvas.bgr, 0.0, 255.0, out=canvas.bgr)
    tone = 255.0 * (canvas.bgr / 255.0) ** np.float32(look.gamma)
    grey = cv2.transform(tone, np.full((1, 3), 1.0 / 3.0))[..., None]
    tone = grey + (tone - grey) * np.float32(look.saturation)
    tone = tone * np.array(look.gain, np.float32) * (1.0 - look.haze / 255.0) + look.haze
    return np.clip(np.round(tone), 0.0, 255.0).astype(np.uint8)


def _deliver(image: NDArray[np.uint8], look: Look, m_per_px: float) -> NDArray[np.uint8]:
    """What the satellite's sensor and the map's supplier leave of an image."""
    sigma_px = look.blur_m / m_per_px
    if sigma_px > 0.2:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), min(sigma_px, 4.0)), np.uint8)
    if look.jpeg_quality is not None:
        code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, look.jpeg_quality])[1]
        image = np.asarray(cv2.imdecode(code, cv2.IMREAD_COLOR), np.uint8)
    return image
