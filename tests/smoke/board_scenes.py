"""Images of the board by a projection of our own, which shares nothing with OpenCV's."""

from dataclasses import dataclass

import cv2
import numpy as np

from vwnav.calibration.board import COLUMNS, ROWS, board_image

SQUARE_PX = 60
SUPERSAMPLED = 2  # rays a pixel, each way


@dataclass(frozen=True)
class Lens:
    """A lens: its numbers, and the pixel of a ray (x, y, 1)."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    k: tuple[float, ...]
    fisheye: bool = False

    def distorted(self, x, y):
        r2 = x * x + y * y
        if self.fisheye:
            r = np.sqrt(r2)
            angle = np.arctan(r)
            bent = angle * (1 + sum(k * angle ** (2 * i + 2) for i, k in enumerate(self.k)))
            ratio = np.where(r > 1e-9, bent / np.maximum(r, 1e-9), 1.0)
            return x * ratio, y * ratio
        k1, k2, p1, p2, k3 = self.k
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )

    def rays(self, u, v):
        """(x, y) of pixels, by fixed-point iteration of the distortion."""
        seen_x, seen_y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        x, y = seen_x.copy(), seen_y.copy()
        for _ in range(25):
            bent_x, bent_y = self.distorted(x, y)
            x, y = x + (seen_x - bent_x), y + (seen_y - bent_y)
        return x, y


def rotation(axis_angle) -> np.ndarray:
    """Rodrigues' formula."""
    angle = float(np.linalg.norm(axis_angle))
    x, y, z = np.asarray(axis_angle) / max(angle, 1e-12)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


class Studio:
    """Photographs the board with a lens; the rays are worked out once."""

    def __init__(self, lens: Lens, seed: int = 0) -> None:
        self.lens, self.rng = lens, np.random.default_rng(seed)
        n = SUPERSAMPLED
        step = (np.arange(n) + 0.5) / n - 0.5
        u = (np.arange(lens.width)[:, None] + step).ravel()
        v = (np.arange(lens.height)[:, None] + step).ravel()
        coarse = np.meshgrid(u, v)
        self.x, self.y = (ray.astype(np.float32) for ray in lens.rays(*coarse))
        margin = SQUARE_PX
        self.paper = cv2.copyMakeBorder(
            board_image(SQUARE_PX), *[margin] * 4, cv2.BORDER_CONSTANT, value=255
        )

    def photograph(self, R: np.ndarray, t: np.ndarray, noise: float = 2.0) -> np.ndarray:
        """Gray image of the board whose point X (squares) is at R X + t in camera axes."""
        normal = R[:, 2]
        n0, n1, n2 = normal.astype(np.float32)
        depth = np.float32(normal @ t) / (n0 * self.x + n1 * self.y + n2)
        map_u, map_v = (
            (depth * (a * self.x + b * self.y + c) + np.float32(1 - axis @ t))
            * np.float32(SQUARE_PX)
            - np.float32(0.5)
            for axis in (R[:, 0], R[:, 1])
            for a, b, c in [axis.astype(np.float32)]
        )
        sharp = cv2.remap(
            self.paper, map_u, map_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT,
            borderValue=120,
        )  # fmt: skip
        small = cv2.resize(sharp, (self.lens.width, self.lens.height), interpolation=cv2.INTER_AREA)
        grey = 20 + 0.78 * small + self.rng.normal(0, noise, small.shape)
        return np.clip(grey, 0, 255).astype(np.uint8)

    def view(self, number: int, tilt_deg: float = 32.0) -> np.ndarray:
        """One of the poses that a person would show: about the image, turned, tilted."""
        rng = np.random.default_rng([7, number])
        lens = self.lens
        lean = np.radians(tilt_deg) * rng.uniform(0.3, 1.0)
        towards = number * 2.4
        R = rotation(np.array([0, 0, rng.uniform(-0.4, 0.4) + np.pi / 2 * (number % 2)]))
        R = rotation(lean * np.array([np.cos(towards), np.sin(towards), 0])) @ R
        z = rng.uniform(1.1, 2.0) * ROWS * lens.fx / lens.width
        u, v = (number * 0.618) % 1.0, (number * 0.382 * 2) % 1.0
        aim = np.array([(0.15 + 0.7 * u) * lens.width - lens.cx, 0, 0])
        aim[1] = (0.15 + 0.7 * v) * lens.height - lens.cy
        middle = np.array([aim[0] / lens.fx, aim[1] / lens.fy, 1.0]) * z
        return self.photograph(R, middle - R @ [COLUMNS / 2, ROWS / 2, 0])
