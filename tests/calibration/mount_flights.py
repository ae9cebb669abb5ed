"""Flights of a wrongly mounted, late, rolling camera: matched points by a projection of our own."""

from dataclasses import dataclass

import numpy as np

from vwnav.calibration.mount.problem import Sighting
from vwnav.types import Attitude, Range

W, H, F, CX, CY, K1 = 640, 480, 381.0, 322.0, 238.0, -0.11
DT_S = 0.01


def euler(roll, pitch, yaw) -> np.ndarray:
    """R_ned_body (n, 3, 3), Z-Y-X."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    zero, one = np.zeros_like(cr), np.ones_like(cr)
    X = np.array([[one, zero, zero], [zero, cr, -sr], [zero, sr, cr]])
    Y = np.array([[cp, zero, sp], [zero, one, zero], [-sp, zero, cp]])
    Z = np.array([[cy, -sy, zero], [sy, cy, zero], [zero, zero, one]])
    return np.einsum("ijn,jkn,kln->nil", Z, Y, X)


def quats(R) -> np.ndarray:
    """(n, 4) of rotations that turn by less than half a turn about none of the odd axes."""
    w = np.sqrt(np.maximum(1 + R[:, 0, 0] + R[:, 1, 1] + R[:, 2, 2], 1e-12)) / 2
    x, y, z = (R[:, i, j] - R[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0)))
    return np.column_stack([w, x / (4 * w), y / (4 * w), z / (4 * w)])


def wander(rng, n, sigma, tau_s) -> np.ndarray:
    """A first-order Gauss-Markov sequence (n,) of stationary sigma."""
    keep = np.exp(-DT_S / tau_s)
    kicks, out = rng.normal(0, sigma * np.sqrt(1 - keep**2), n), np.zeros(n)
    out[0] = rng.normal(0, sigma)
    for i in range(1, n):
        out[i] = keep * out[i - 1] + kicks[i]
    return out


@dataclass(frozen=True)
class Truth:
    """How the camera is: Euler angles of the mount, lateness, read-out, focal length's factor."""

    mount_rpy_deg: tuple[float, float, float] = (2.5, -3.0, 4.0)
    offset_s: float = 0.06
    readout_s: float = 0.022
    focal: float = 1.0
    bank_deg: float = 25.0
    turns: bool = True
    rangefinder: bool = True
    images: int = 120
    seconds: float = 120.0
    sigma_px: float = 0.8
    carried: bool = False  # the level's error turns with the nose


@dataclass
class MountFlight:
    attitudes: list
    ranges: list
    sightings: list
    R_body_camera: np.ndarray  # true, against what the autopilot called level on average


def mount(rpy_deg) -> np.ndarray:
    down = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return euler(*np.radians(rpy_deg)[:, None])[0] @ down


def fly(truth: Truth, seed: int) -> MountFlight:
    rng = np.random.default_rng([11, seed])
    t = np.arange(-2.0, truth.seconds + 2.0, DT_S)
    n = len(t)
    bank = np.radians(truth.bank_deg) * truth.turns
    roll = bank * np.sin(2 * np.pi * t / 17.0 + rng.uniform(0, 6)) + np.radians(1.5) * np.sin(t)
    pitch = np.radians(-4) + 0.6 * bank * np.sin(2 * np.pi * t / 11.0 + rng.uniform(0, 6))
    yaw = rng.uniform(-0.3, 0.3) + 0.2 * np.sin(t / 7.0)
    for number, corner_s in enumerate(np.arange(10.0, truth.seconds, 20.0)):
        side = 1.0 if number % 2 else -1.0  # of 90 degrees, with up to 55 degrees a second
        yaw = yaw + truth.turns * side * 0.8 * np.tanh((t - corner_s) / 0.8)
    R = euler(roll, pitch, yaw)
    speed = 9.0 + 3.0 * np.sin(2 * np.pi * t / 29.0)
    velocity = np.stack([speed * np.cos(yaw), speed * np.sin(yaw), 0.3 * np.sin(t / 3)], 1)
    place = np.cumsum(velocity, 0) * DT_S + [0, 0, -55.0]
    drift = np.stack([wander(rng, n, np.radians(0.4), 20.0) for _ in range(2)], 1)
    heading = np.radians(3.0) * rng.normal() + np.cumsum(
        rng.normal(0, np.radians(0.05) * np.sqrt(DT_S), n)
    )
    if truth.carried:
        c, s = np.cos(yaw), np.sin(yaw)
        north, east = drift.T
        drift = np.stack([c * north - s * east, s * north + c * east], 1)
    told = euler(drift[:, 0], drift[:, 1], heading) @ R
    attitudes = [Attitude(float(s), q) for s, q in zip(t[::3], quats(told[::3]), strict=True)]
    ranges = []
    if truth.rangefinder:
        bias = rng.normal(0, 0.05)
        for i in range(0, n, 10):
            metres = -place[i, 2] / R[i, 2, 2] * (1 + 0.01 * rng.normal()) + bias
            ranges.append(Range(float(t[i]), float(metres)))
    R_mount = mount(truth.mount_rpy_deg)
    stamps = np.linspace(0.0, truth.seconds, truth.images)
    sightings = [_sighting(truth, rng, s, t, R, place, velocity, R_mount) for s in stamps]
    # Exp(drift) R = told, so R M = told (told^T R) M: what is asked is the mean of told^T R M.
    at = np.searchsorted(t, stamps + truth.offset_s)
    lean = (
        np.swapaxes(told[at], 1, 2) @ euler(0 * heading[at], 0 * heading[at], heading[at]) @ R[at]
    )
    vectors = np.stack([lean[:, 2, 1], lean[:, 0, 2], lean[:, 1, 0]], 1).mean(0)
    mean = euler(*vectors[:, None])[0]
    return MountFlight(attitudes, ranges, sightings, mean @ R_mount)


def _sighting(truth, rng, stamp, t, R, place, velocity, R_mount) -> Sighting:
    """Ground points, each in the row that was read when it was there."""
    middle = stamp + truth.offset_s
    i = int((middle - t[0]) / DT_S)
    about = place[i, :2] + rng.uniform(-45, 45, (60, 2))
    ground = np.column_stack([about, np.zeros(60)])
    v = np.full(60, (H - 1) / 2)
    for _ in range(6):
        seen = middle + truth.readout_s * ((v + 0.5) / H - 0.5)
        j = np.clip(((seen - t[0]) / DT_S).astype(int), 0, len(t) - 2)
        share = (seen - t[j]) / DT_S
        step = np.swapaxes(R[j], 1, 2) @ R[j + 1]
        turn = np.stack([step[:, 2, 1], step[:, 0, 2], step[:, 1, 0]], 1) * share[:, None]
        R_now = R[j] @ euler(*turn.T)
        away = ground - (place[j] + share[:, None] * (place[j + 1] - place[j]))
        X = np.einsum("ni,nij->nj", away, R_now) @ R_mount
        x, y = X[:, 0] / X[:, 2], X[:, 1] / X[:, 2]
        bent = 1 + K1 * truth.focal**2 * (x * x + y * y)  # a lens whose focus moved
        u, v = truth.focal * F * x * bent + CX, truth.focal * F * y * bent + CY
    inside = (u > 5) & (u < W - 6) & (v > 5) & (v < H - 6) & (X[:, 2] > 0)
    inside &= x * x + y * y < 1.3**2  # the polynomial folds back where no lens sees
    uv = np.column_stack([u, v])[inside] + rng.normal(0, truth.sigma_px, (inside.sum(), 2))
    rough = place[i] + rng.normal(0, 2.0, 3)
    return Sighting(float(stamp), uv, ground[inside], len(uv), rough)
