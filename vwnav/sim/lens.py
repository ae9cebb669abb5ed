"""Lens and sensor: vignetting, exposure, motion blur, rolling shutter and noise."""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.geometry.camera import Camera
from vwnav.sim.map_warp import MapWarp
from vwnav.sim.relief import Relief
from vwnav.types import Array

_NOISE_SHEETS = 4
_NOISE_PAD = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderConfig:
    """How good the simulated camera is.

    Attributes:
        color: BGR images; False gives grey ones, which render faster.
        exposure_s: shutter time: sets motion blur.
        readout_s: time from the first row to the last (rolling shutter), 0 for a global one.
        vibration_rad: sigma of the attitude jitter per axis and frame.
        wobble_px, wobble_hz: amplitude and frequency of the motor's shake within a frame.
        psf_px: sigma of the lens' blur.
        vignetting: loss of light in the corners, 0 to 1.
        read_noise: sigma in grey levels in the dark; shot_noise: variance per grey level.
        relief: of the ground.
        map_warp: where the map shows that ground, which is drawn by it.
        light_sigma: relative sigma of the slow change of light (clouds), over `light_tau_s`.
        target_level: mean grey level that automatic exposure aims at, with a lag of `agc_tau_s`.
        background: draw missing tiles in a thread and show coarse ones meanwhile; False draws
            them at once, which stalls but makes every run the same.
    """

    color: bool = True
    exposure_s: float = 0.003
    readout_s: float = 0.008
    vibration_rad: float = 0.0012
    wobble_px: float = 0.25
    wobble_hz: float = 130.0
    psf_px: float = 0.5
    vignetting: float = 0.28
    read_noise: float = 1.6
    shot_noise: float = 0.035
    relief: Relief = field(default_factory=Relief)
    map_warp: MapWarp = field(default_factory=MapWarp)
    light_sigma: float = 0.06
    light_tau_s: float = 15.0
    target_level: float = 112.0
    agc_tau_s: float = 0.6
    background: bool = True


class Sensor:
    """Turns a clean image into what a small camera delivers. Holds exposure and light."""

    def __init__(self, camera: Camera, config: RenderConfig, rng: np.random.Generator) -> None:
        self._config, self._rng, self._camera = config, rng, camera
        h, w = camera.height_px, camera.width_px
        centre = camera.K[:2, 2]
        v, u = np.indices((h, w), np.float32)
        radius2 = ((u - centre[0]) ** 2 + (v - centre[1]) ** 2) / (w**2 + h**2) * 4.0
        self._shading = (1.0 - config.vignetting * radius2).astype(np.float32)
        if config.color:
            self._shading = cv2.merge([self._shading] * 3)
        shape = (h + _NOISE_PAD, w + _NOISE_PAD) + ((3,) if config.color else ())
        self._sheets = [rng.standard_normal(shape, np.float32) for _ in range(_NOISE_SHEETS)]
        levels = np.arange(256, dtype=np.float64)
        deviation = np.sqrt(config.read_noise**2 + config.shot_noise * levels)
        self._deviation = deviation.astype(np.float32)
        self._gain: float | None = None
        self._light, self._t_s = 0.0, 0.0

    def row_times_s(self, rows_v: Array) -> Array:
        """(n,) when rows (n,) of the image are exposed, after the middle one."""
        return (rows_v / self._camera.height_px - 0.5) * self._config.readout_s

    def shaken(self, rays: NDArray[np.float32], times_s: Array) -> NDArray[np.float32]:
        """Rays (n, m, 2), each row of them at its time (n,), while the motors shake."""
        config = self._config
        if config.wobble_px == 0.0:
            return rays
        phase = self._rng.uniform(0.0, 2.0 * np.pi, 2)
        turns = 2.0 * np.pi * config.wobble_hz * times_s[:, None]
        shake = config.wobble_px * np.sin(turns + phase)
        shift = shake / self._camera.K[[0, 1], [0, 1]]
        return rays - shift[:, None, :].astype(np.float32)

    def expose(self, plain: NDArray[np.uint8], flow_px_s: Array, t_s: float) -> NDArray[np.uint8]:
        """The delivered image of a clean one (h, w, 3) that moves by `flow_px_s` (2,)."""
        config = self._config
        if not config.color:
            plain = np.asarray(cv2.cvtColor(plain, cv2.COLOR_BGR2GRAY), np.uint8)
        plain = self._blur(plain, flow_px_s * config.exposure_s)
        gain = self._exposure(plain, t_s)
        bright = cv2.multiply(plain, self._shading, scale=gain, dtype=cv2.CV_8U)
        sheet = self._sheets[int(self._rng.integers(_NOISE_SHEETS))]
        v, u = self._rng.integers(0, _NOISE_PAD, 2)
        noise = sheet[v : v + plain.shape[0], u : u + plain.shape[1]]
        deviation = cv2.LUT(bright, self._deviation)
        return np.asarray(
            cv2.add(bright, cv2.multiply(deviation, noise), dtype=cv2.CV_8U), np.uint8
        )

    def _blur(self, plain: NDArray[np.uint8], motion_px: Array) -> NDArray[np.uint8]:
        config = self._config
        length = float(np.hypot(*motion_px))
        if length > 0.5:
            plain = np.asarray(cv2.filter2D(plain, -1, streak(motion_px)), np.uint8)
        if config.psf_px > 0.0:
            size = (3, 3) if config.psf_px <= 0.7 else (0, 0)
            plain = np.asarray(cv2.GaussianBlur(plain, size, config.psf_px), np.uint8)
        return plain

    def _exposure(self, plain: NDArray[np.uint8], t_s: float) -> float:
        """Gain of this frame: automatic exposure that lags behind the light."""
        config = self._config
        dt_s = max(t_s - self._t_s, 0.0) if self._gain is not None else 0.0
        self._t_s = t_s
        keep = float(np.exp(-dt_s / config.light_tau_s))
        kick = config.light_sigma * np.sqrt(1.0 - keep**2)
        self._light = keep * self._light + float(self._rng.normal(0.0, 1.0)) * float(kick)
        light = float(np.exp(self._light))
        mean = float(np.mean(cv2.mean(plain[::8, ::8])[: 3 if config.color else 1]))
        wanted = float(np.clip(config.target_level / max(mean * light, 4.0), 0.4, 3.0))
        if self._gain is None:
            self._gain = wanted
        self._gain += (wanted - self._gain) * (1.0 - float(np.exp(-dt_s / config.agc_tau_s)))
        return self._gain * light


def streak(motion_px: Array) -> NDArray[np.float32]:
    """Kernel (k, k) that averages along a motion (2,) of the image, k odd, of unit sum."""
    length = float(np.hypot(*motion_px))
    half = int(np.ceil(length / 2.0))
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    for t in np.linspace(-0.5, 0.5, 8 * half + 1):
        u, v = half + t * motion_px[0], half + t * motion_px[1]
        i, j = int(np.floor(v)), int(np.floor(u))
        fv, fu = v - i, u - j
        for di, dj, weight in ((0, 0, (1 - fv) * (1 - fu)), (0, 1, (1 - fv) * fu),
                               (1, 0, fv * (1 - fu)), (1, 1, fv * fu)):  # fmt: skip
            if weight > 1e-9:
                kernel[i + di, j + dj] += np.float32(weight)
    return np.asarray(kernel / kernel.sum(), np.float32)
