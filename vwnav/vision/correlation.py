"""A second opinion on a placement that owes nothing to keypoints: do the images correlate there?

Edges of the view and of the map are compared by their direction, modulo half a turn, so that a
field that was dark and is light now agrees with itself. Roads that happen to run alike agree at
every shift along them; the right place agrees at one.

Where a view shows too few keypoints to be placed by them, as from 25 m on a map of 0.3 m/px, it is
placed by the shift at which it correlates best, if no other comes near.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.types import Array, Gray

BLUR_PX = 1.5
# Of 490 unrelated pairs of overhead images 90, 99 and 99.9 % were below 2.8, 3.9 and 4.5;
# ORB's and SIFT's places reach 5.0 and 4.6.
CHANCE_SIGMAS = 2.0
SIGMAS_PER_DECADE = 1.0
CENTER_PX = 2.5  # shifts that count as no shift
RING_PX = (7.0, 28.0)  # shifts that tell what chance makes
# Of the best of 61 x 61 shifts. On real overhead images 90, 99 and 99.8 % of 662 unrelated pairs
# were below 3.8, 4.5 and 4.9, and of 573 pairs of different parts of one image, where fields and
# streets repeat, below 3.9, 4.7 and 6.0.
SHIFT_CHANCE_SIGMAS = 3.2
SHIFT_SIGMAS_PER_DECADE = 0.75
_CALIBRATED_REACH_PX = 30
_MIN_PIXELS = 1000
_MIN_KNOWN = 0.9  # of what the view shows that the map must know, at a shift that counts


@dataclass(frozen=True, slots=True, eq=False)
class Peak:
    """The shift at which a view correlates best with a piece of map.

    Attributes:
        shift_uv: (2,) of the view against where it was expected, map pixels.
        sigmas: standard deviations of the correlation above its mean, over the shifts elsewhere.
        rival_sigmas: the same of the best shift elsewhere.
    """

    shift_uv: Array
    sigmas: float
    rival_sigmas: float


def best_shift(
    view: Gray, seen: NDArray[np.bool_], map_: Gray, known: NDArray[np.bool_], reach_px: int
) -> Peak | None:
    """Look for a view at every shift within reach; None where there is too little to compare.

    Args:
        view: (h, w) uint8.
        seen: (h, w) where the view shows the image.
        map_: (h + 2 reach, w + 2 reach) uint8, the map about where the view is expected.
        known: the same shape, where the map has data.
        reach_px: largest shift along each axis; more than the ring about a peak.
    """
    weight = _inner(seen)
    if np.count_nonzero(weight) < _MIN_PIXELS:
        return None
    edges0, edges1 = _directions(view) * weight, _directions(map_) * known
    size = (cv2.getOptimalDFTSize(map_.shape[0]), cv2.getOptimalDFTSize(map_.shape[1]))
    shown = np.conj(np.fft.fft2(weight.astype(np.float32), size))

    def slide(spectrum: NDArray[np.complex128]) -> Array:
        return np.real(np.fft.ifft2(spectrum))[: 2 * reach_px + 1, : 2 * reach_px + 1]

    product = slide(np.fft.fft2(edges1, size) * np.conj(np.fft.fft2(edges0, size)))
    energy = slide(np.fft.fft2(np.abs(edges1) ** 2, size) * shown)
    covered = slide(np.fft.fft2(known.astype(np.float32), size) * shown)
    if float(covered.min()) < _MIN_KNOWN * np.count_nonzero(weight):
        return None
    correlation = product / np.sqrt(np.maximum(energy, 1e-3 * float(energy.max()) + 1e-9))
    v, u = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    rows, columns = np.indices(correlation.shape)
    elsewhere = correlation[np.hypot(rows - v, columns - u) > RING_PX[0]]
    mean, deviation = float(elsewhere.mean()), max(float(elsewhere.std()), 1e-9)
    fine = np.array([_vertex(correlation[v], int(u)), _vertex(correlation[:, u], int(v))])
    return Peak(
        shift_uv=np.array([u, v]) + fine - reach_px,
        sigmas=(float(correlation[v, u]) - mean) / deviation,
        rival_sigmas=(float(elsewhere.max()) - mean) / deviation,
    )


def _vertex(values: Array, peak: int) -> float:
    """Of the parabola through a peak and its neighbours, from the peak."""
    if not 0 < peak < len(values) - 1:
        return 0.0
    before, at, after = (float(value) for value in values[peak - 1 : peak + 2])
    bend = before - 2.0 * at + after
    return 0.5 * (before - after) / bend if bend < 0.0 else 0.0


def _inner(shown: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Away from the edge of what is shown, which is an edge on one of the images alone."""
    return cv2.erode(shown.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0


def peak_and_rival(
    view: Gray, seen: NDArray[np.bool_], map_: Gray, known: NDArray[np.bool_]
) -> tuple[float, float]:
    """How far the correlation without shift stands above that with one, in standard deviations.

    And how far the best one with a shift does; nothing and all where there is too little to see.

    Args:
        view: (h, w) uint8.
        seen: (h, w) where the view shows the image.
        map_: (h, w) uint8, the map warped onto the view.
        known: (h, w) where the map has data.
    """
    weight = _inner(seen & known)
    if np.count_nonzero(weight) < _MIN_PIXELS:
        return 0.0, math.inf
    edges0, edges1 = (_directions(image) * weight for image in (view, map_))
    h, w = view.shape
    reach = int(RING_PX[1]) + 1
    size = (cv2.getOptimalDFTSize(h + reach), cv2.getOptimalDFTSize(w + reach))
    spectrum = np.fft.fft2(edges0, size) * np.conj(np.fft.fft2(edges1, size))
    correlation = np.real(np.fft.ifft2(spectrum))
    shifts = np.arange(-reach, reach + 1)
    near = correlation[np.ix_(shifts, shifts)]
    distance = np.hypot(*np.meshgrid(shifts, shifts))
    ring = near[(distance >= RING_PX[0]) & (distance <= RING_PX[1])]
    mean, deviation = float(ring.mean()), max(float(ring.std()), 1e-9)
    peak, rival = float(near[distance <= CENTER_PX].max()), float(ring.max())
    return (peak - mean) / deviation, (rival - mean) / deviation


def _directions(image: Gray) -> NDArray[np.complex64]:
    """Gradients as complex numbers of twice their angle, their length compressed."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), BLUR_PX)
    du = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=3)
    dv = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=3)
    gradient = du + 1j * dv
    length = np.abs(gradient)
    # The median, sorted: np.median takes four times as long.
    ranked, n = np.sort(length, axis=None), length.size
    typical = float((ranked[(n - 1) // 2] + ranked[n // 2]) / np.float32(2.0)) + 1e-6
    # Twice the angle, and no edge counts for more than a few typical ones.
    return np.asarray(gradient**2 / (length + 1e-6) / (length + typical), np.complex64)


def decades_of_correlation(sigmas: float) -> float:
    """How rarely unrelated images correlate so well, as a power of ten."""
    return max(0.0, (sigmas - CHANCE_SIGMAS) / SIGMAS_PER_DECADE)


def decades_of_shift(sigmas: float, reach_px: int) -> float:
    """The same of the best of all shifts within reach: the more there are, the higher chance is."""
    more = math.log10(((2 * reach_px + 1) / (2 * _CALIBRATED_REACH_PX + 1)) ** 2)
    return max(0.0, (sigmas - SHIFT_CHANCE_SIGMAS) / SHIFT_SIGMAS_PER_DECADE - more)
