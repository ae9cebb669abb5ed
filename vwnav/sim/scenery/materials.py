"""What surfaces look like: colours as functions of place, moisture, season and resolution."""

import numpy as np
from numpy.typing import NDArray

from vwnav.sim.scenery.drawing import Canvas, Patch
from vwnav.sim.scenery.landscape import Cell
from vwnav.sim.scenery.looks import CROPS, Crop, Look, Ramp
from vwnav.sim.scenery.noise import Field, noise_1d
from vwnav.types import Array

# Salts of persistent fields: the same on both days. Fields of one day add the look's seed.
MOISTURE, SOIL, RELIEF, STONES, EDGES = 1, 2, 3, 4, 5
_DAY = 100
_PERIOD_M: dict[Crop, float] = {
    "bare": 0.32,
    "stubble": 0.25,
    "green": 0.25,
    "ripe": 0.25,
    "rape": 0.5,
    "maize": 0.75,
}


def day_salt(look: Look, salt: int) -> int:
    """A salt whose field differs between the days."""
    return _DAY + salt + 50 * (look.seed % 1000)


def moisture(canvas: Canvas) -> Field:
    """Persistent wetness (h, w), about unit variance: hollows, drains, old river arms."""
    broad = canvas.noise.fractal(102.4, 12.8, 0.62, MOISTURE)
    fine = canvas.noise.fractal(12.8, 0.8, 0.9, SOIL)
    return np.asarray(0.7 * broad + 0.7 * fine, np.float32)


def relief(canvas: Canvas, look: Look) -> Field:
    """Shading (h, w) of small bumps, 1 on the level: the sun's side is the brighter one."""
    height = canvas.noise.fractal(12.8, 0.8, 0.5, RELIEF)
    to_sun = look.sun()
    slope_south, slope_e = np.gradient(height, canvas.window.m_per_px)
    tilt = slope_south * np.float32(to_sun[0]) - slope_e * np.float32(to_sun[1])
    return np.asarray(np.clip(1.0 + np.float32(0.02) * tilt, 0.75, 1.25), np.float32)


def ramp(colours: Ramp, dryness: Field) -> NDArray[np.float32]:
    """Colours (h, w, 3) BGR along a ramp; dryness -1 is its wet end and 1 its dry one."""
    stops = np.array(colours, np.float32)[:, ::-1]
    position = np.linspace(-1.0, 1.0, 256)
    table = np.stack([np.interp(position, [-1.0, 0.0, 1.0], stops[:, k]) for k in range(3)], axis=1)
    index = np.clip(dryness * 127.5 + 127.5, 0.0, 255.0).astype(np.uint8)
    return np.asarray(table.astype(np.float32)[index], np.float32)


def grass(canvas: Canvas, look: Look) -> NDArray[np.float32]:
    """Unmown grass over the whole canvas (h, w, 3)."""
    noise = canvas.noise
    clumps = noise.fractal(6.4, 0.8, 0.75, day_salt(look, 1))
    blades = noise.fractal(0.4, 0.025, 0.8, day_salt(look, 2))
    dryness = 0.6 * -moisture(canvas) + 0.04 * clumps
    colour = ramp(look.grass(), dryness)
    # Weeds and tussocks, dark on every day, and molehills and bare spots, light on every day.
    spots = noise.fractal(1.6, 0.8, 0.8, STONES)
    dark, light = (np.clip(sign * spots - 1.7, 0.0, 1.0) for sign in (1.0, -1.0))
    value = relief(canvas, look) * (1.0 + 0.02 * clumps + 0.10 * blades)
    value *= 1.0 - 0.34 * dark + 0.26 * light
    colour *= value[..., None]
    return colour


def crop(canvas: Canvas, patch: Patch, cell: Cell, look: Look) -> NDArray[np.float32]:
    """A field's colours (h, w, 3) under a patch: soil, rows, tramlines and working passes."""
    kind = look.crop(cell.seed)
    noise = canvas.noise
    rng = np.random.default_rng([cell.seed, look.seed, 1])
    fine = patch.cut(noise.fractal(0.4, 0.025, 0.8, day_salt(look, 2)))
    stand = patch.cut(noise.fractal(25.6, 1.6, 0.65, day_salt(look, 3)))
    dryness = 0.6 * -patch.cut(moisture(canvas)) + 0.05 * stand + rng.normal(0.0, 0.18)
    colour = ramp(CROPS[kind], np.asarray(dryness, np.float32))
    rows = _rows(canvas, patch, cell, look, kind)
    colour *= (patch.cut(relief(canvas, look)) * (1.0 + rows + 0.07 * fine))[..., None]
    return colour


def _rows(canvas: Canvas, patch: Patch, cell: Cell, look: Look, kind: Crop) -> Field:
    """Relative brightness (h, w) of what repeats across the rows, antialiased."""
    window = canvas.window
    rng = np.random.default_rng([cell.seed, look.seed, 2])
    turn = cell.row_rad + rng.normal(0.0, 0.012) + (np.pi / 2 if rng.uniform() < 0.12 else 0.0)
    centre = cell.polygon.mean(axis=0)
    north = (window.north_m()[patch.rows] - centre[0]).astype(np.float32)
    east = (window.east_m()[patch.cols] - centre[1]).astype(np.float32)
    across = -np.sin(turn) * north[:, None] + np.cos(turn) * east[None, :]
    across += np.float32(0.25) * patch.cut(canvas.noise.fractal(51.2, 12.8, 0.5, EDGES))
    reach = float(np.abs(across).max()) + 1.0
    step = float(np.clip(window.m_per_px / 5.0, 0.01, 0.06))
    steps = np.arange(np.floor(-reach / step), np.ceil(reach / step))
    t = np.asarray(steps * step, np.float64)
    table = _row_table(t, rng, kind)
    width = max(1, round(window.m_per_px / step)) | 1  # the pixel's own averaging
    table = np.convolve(table, np.full(width, 1.0 / width), mode="same")
    index = ((across - t[0]) / step).astype(np.int32)
    return np.asarray(table.astype(np.float32)[np.clip(index, 0, len(t) - 1)], np.float32)


def _row_table(t: Array, rng: np.random.Generator, kind: Crop) -> Array:
    period = _PERIOD_M[kind]
    depth = {"maize": 0.30, "bare": 0.10, "stubble": 0.08}.get(kind, 0.10)
    width = float(rng.choice([3.0, 4.0, 6.0]))
    salt = int(rng.integers(2**31))
    passes = lattice_steps(t, width, salt) * (0.03 if kind != "stubble" else 0.05)
    table = depth * np.sin(2.0 * np.pi * t / period) + passes
    table += 0.02 * noise_1d(t, 0.8, salt + 1)
    if kind in ("green", "ripe", "rape"):
        tram = float(rng.choice([18.0, 24.0, 27.0]))
        offset = (t + rng.uniform(0.0, tram)) % tram - tram / 2.0
        wheels = np.exp(-(((np.abs(offset) - 0.9) / 0.2) ** 2))
        table += (-0.16 if kind == "green" else -0.22) * wheels
    return np.asarray(table, np.float64)


def lattice_steps(t: Array, width_m: float, salt: int) -> Array:
    """Piecewise constant noise (n,): one value for each pass of a machine `width_m` wide."""
    fine = noise_1d(np.floor(t / width_m) + 0.5, 1.0, salt)
    seam = np.exp(-(((t % width_m) / 0.25) ** 2))
    return np.asarray(0.7 * fine - 0.9 * seam, np.float64)


def asphalt(canvas: Canvas, look: Look, level: float) -> NDArray[np.float32]:
    """Old asphalt (h, w, 3) of mean grey `level`: patchy, with grain."""
    noise = canvas.noise
    patches = noise.fractal(12.8, 0.8, 0.7, STONES)
    grain = noise.fractal(0.4, 0.025, 0.9, STONES)
    day = noise.fractal(6.4, 0.4, 0.7, day_salt(look, 4))
    value = np.float32(level) * (1.0 + 0.04 * patches + 0.05 * grain + 0.018 * day)
    return np.asarray(value[..., None] * np.array([0.99, 1.0, 1.01], np.float32), np.float32)


def gravel(canvas: Canvas, look: Look, level: float) -> NDArray[np.float32]:
    """Gravel or bare earth (h, w, 3)."""
    noise = canvas.noise
    value = 1.0 + 0.07 * noise.fractal(3.2, 0.4, 0.7, SOIL)
    value += 0.09 * noise.fractal(0.4, 0.025, 0.9, day_salt(look, 5))
    tint = np.array([0.80, 0.93, 1.0], np.float32)
    return np.asarray(np.float32(level) * value[..., None] * tint, np.float32)


def water(canvas: Canvas, look: Look) -> NDArray[np.float32]:
    """Still water (h, w, 3): dark, with weeds and a little sky."""
    weeds = canvas.noise.fractal(12.8, 0.8, 0.6, day_salt(look, 6))
    ripple = canvas.noise.fractal(0.8, 0.1, 0.8, day_salt(look, 7))
    base = np.array([52.0, 60.0, 50.0], np.float32) + np.float32(look.haze)
    return np.asarray(base * (1.0 + 0.14 * weeds + 0.05 * ripple)[..., None], np.float32)


def gravel_tone(look: Look) -> NDArray[np.float32]:
    """Colour (3,) BGR of bare trodden earth on that day."""
    wet = 0.85 if look.season in ("autumn", "spring", "winter") else 1.0
    return np.array([104.0, 128.0, 146.0], np.float32) * np.float32(wet)


def stripes(
    canvas: Canvas, patch: Patch, heading_rad: float, width_m: float, depth: float, look: Look
) -> None:
    """Alternate light and dark bands, as a mower leaves them."""
    window = canvas.window
    north = window.north_m()[patch.rows].astype(np.float32)[:, None]
    east = window.east_m()[patch.cols].astype(np.float32)[None, :]
    across = -np.sin(heading_rad) * north + np.cos(heading_rad) * east
    wobble = patch.cut(canvas.noise.fractal(25.6, 12.8, 0.5, day_salt(look, 8)))
    phase = np.sin(np.pi / width_m * (across + np.float32(0.3) * wobble))
    sharp = np.float32(min(width_m / window.m_per_px / 3.0, 4.0))
    band = np.clip(phase * sharp, -1.0, 1.0)
    strength = 0.75 + 0.3 * wobble
    gain = 1.0 + np.float32(depth) * patch.alpha * band * strength
    canvas.bgr[patch.rows, patch.cols] *= gain[..., None]
