"""What sources of a map that overlap say of its error.

Where two sources show one ground, what stands there lies apart on them by the difference of their
errors. Sources whose errors are independent and of one size each have half of its variance. What
all sources have alike, nothing of this sees: it is a lower bound. Of a shift of the whole source
two of them are one sample.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from vwnav.geometry.geodesy import Window, ground_resolution_m_per_px, zoom_for_resolution
from vwnav.maps.build.raster import Bounds
from vwnav.maps.build.warp import PlacedRaster
from vwnav.types import Array

LEAST_PLACES = 5
_BLOCK_M = 60.0  # side of the ground that one place is measured on; waves of a map are longer
_LEAST_BLOCK_PX = 192  # else too few features
_FINEST_M_PER_PX = 0.3  # finer tells nothing more
_MOST_PAIRS = 20
_CLIP_SIGMAS = 6.0  # waves are no bell curve
_LEAST_SPREAD_M = 0.1
_MEDIAN_SIGMAS = math.sqrt(2.0 * math.log(2.0))  # median distance of a plane's bell curve


@dataclass(frozen=True, slots=True, eq=False)
class Overlap:
    """Two sources that may show one ground.

    Attributes:
        first, second: the sources, as they were named.
        zoom: the level that they are compared at.
        window: of that level, which both may have data in.
    """

    first: PlacedRaster
    second: PlacedRaster
    zoom: int
    window: Window

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of its blocks; a strip narrower than half a block has none."""
        h, w = self.window.shape
        return round(h / self._block_px), round(w / self._block_px)

    @property
    def m_per_px(self) -> float:
        """Of the level, at the middle of the first source."""
        south, _, north, _ = self.first.bounds
        return ground_resolution_m_per_px((south + north) / 2.0, self.zoom)

    def blocks(self, seed: int) -> Iterator[Window]:
        """Its blocks, one after the other, in a random order."""
        rows, columns = self.grid
        h, w = self.window.shape
        for index in np.random.default_rng(seed).permutation(rows * columns):
            row, column = divmod(int(index), columns)
            y0, y1 = (self.window.y0 + h * edge // rows for edge in (row, row + 1))
            x0, x1 = (self.window.x0 + w * edge // columns for edge in (column, column + 1))
            yield Window(x0, y0, x1, y1)

    @property
    def _block_px(self) -> float:
        return max(_BLOCK_M / self.m_per_px, _LEAST_BLOCK_PX)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Apart:
    """How far apart two sources show what stands at one place.

    Attributes:
        lat_deg, lon_deg: the place, as the first source has it.
        apart_ne_m: (2,) north and east, from where the first shows it to where the second does.
        within_m: RMS of what it changes by within the block, per axis.
        sigma_m: of measuring it, per axis.
    """

    lat_deg: float
    lon_deg: float
    apart_ne_m: Array
    within_m: float
    sigma_m: float

    @property
    def distance_m(self) -> float:
        """Horizontal."""
        return float(np.linalg.norm(self.apart_ne_m))


@dataclass(frozen=True, slots=True, eq=False)
class PairAgreement:
    """Two sources, held against each other at `LEAST_PLACES` or more.

    Attributes:
        names: of the first and the second.
        shift_ne_m: (2,) north and east, by how much the second shows all beside the first.
        waves_m: RMS per axis about that.
        places: each that was measured.
    """

    names: tuple[str, str]
    shift_ne_m: Array
    waves_m: float
    places: tuple[Apart, ...]

    @property
    def rms_m(self) -> float:
        """Of what they are apart, per axis."""
        return math.sqrt(float(np.mean(self.shift_ne_m**2)) + self.waves_m**2)

    @property
    def worst(self) -> Apart:
        """The place where they are farthest apart."""
        return max(self.places, key=lambda place: place.distance_m)


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """All pairs that could be held against each other, the one that agrees least first."""

    pairs: tuple[PairAgreement, ...]

    @property
    def rms_m(self) -> float:
        """Of what two sources are apart, per axis: shifts pair by pair, waves place by place."""
        shifts2 = np.array([np.mean(pair.shift_ne_m**2) for pair in self.pairs])
        waves2 = np.array([pair.waves_m**2 for pair in self.pairs])
        places = np.array([len(pair.places) for pair in self.pairs])
        return math.sqrt(float(shifts2.mean() + np.average(waves2, weights=places)))

    @property
    def sigma_m(self) -> float:
        """One sigma of each source's error, per axis, if these are independent and of one size."""
        return self.rms_m / math.sqrt(2.0)


def overlaps(rasters: Sequence[PlacedRaster]) -> list[Overlap]:
    """The pairs of sources that share enough ground to be compared, at most 20, largest first."""
    couples = combinations(rasters, 2)
    found = [_overlap(*couple) for couple in couples if _share(*(each.bounds for each in couple))]
    found = [each for each in found if math.prod(each.grid) >= LEAST_PLACES]
    return sorted(found, key=lambda each: -math.prod(each.grid))[:_MOST_PAIRS]


def pair_agreement(names: tuple[str, str], places: Sequence[Apart]) -> PairAgreement | None:
    """Shift and waves of two sources; None of too few places.

    What is far from the others (a field that was built over, a piece that hangs askew) counts
    for neither, and what measuring adds is taken from the waves.
    """
    if len(places) < LEAST_PLACES:
        return None
    apart_ne_m = np.array([place.apart_ne_m for place in places])
    away_m = np.linalg.norm(apart_ne_m - np.median(apart_ne_m, axis=0), axis=1)
    spread_m = max(float(np.median(away_m)) / _MEDIAN_SIGMAS, _LEAST_SPREAD_M)
    kept = away_m <= _CLIP_SIGMAS * spread_m
    # Blocks level waves out: what one bends by within itself belongs to them.
    added2 = np.array([place.within_m**2 - place.sigma_m**2 for place in places])[kept]
    waves2 = float(np.var(apart_ne_m[kept], axis=0, ddof=1).mean() + added2.mean())
    shift_ne_m = apart_ne_m[kept].mean(axis=0)
    return PairAgreement(names, shift_ne_m, math.sqrt(max(waves2, 0.0)), tuple(places))


def _share(first: Bounds, second: Bounds) -> bool:
    south, west = (max(first[i], second[i]) for i in (0, 1))
    north, east = (min(first[i], second[i]) for i in (2, 3))
    return south < north and west < east


def _overlap(first: PlacedRaster, second: PlacedRaster) -> Overlap:
    middle_deg = (first.bounds[0] + first.bounds[2]) / 2.0
    m_per_px = max(_FINEST_M_PER_PX, first.m_per_px, second.m_per_px)
    zoom = zoom_for_resolution(middle_deg, m_per_px)
    return Overlap(first, second, zoom, first.window(zoom).clipped(second.window(zoom)))
