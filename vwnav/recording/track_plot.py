"""An image of the flight over the map: estimate, fixes, one-sigma ellipses, and truth if known."""

from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.files.whole import write_whole
from vwnav.geometry.geodesy import LocalFrame, Window, mercator_px, mercator_px_per_m
from vwnav.maps.pack import MapPack
from vwnav.seams import StepResult
from vwnav.types import Array, MapFix

MARGIN_M = 60.0
MAX_SIDE_PX = 1600
ELLIPSE_EVERY_S = 2.0
MOST_POINTS = 10_000  # of a line: after an hour of images at 10 Hz one every 0.4 s
_ESTIMATE_BGR = (0, 200, 255)
_FIX_BGR = (90, 220, 60)
_TRUTH_BGR = (255, 255, 255)
_SUBPIXEL_BITS = 4
_FARTHEST_PX = 20_000.0


Item = TypeVar("Item")


class Thinned(Generic[Item]):
    """At most `most` of a sequence, spread evenly: when it is full, every second one goes.

    Attributes:
        items: those that are kept, oldest first.
    """

    def __init__(self, most: int) -> None:
        self.items: list[Item] = []
        self._most = most
        self._every = 1
        self._added = 0

    def add(self, item: Item) -> None:
        """The next one."""
        if self._added % self._every == 0:
            self.items.append(item)
        self._added += 1
        if len(self.items) > self._most:
            del self.items[1::2]
            self._every *= 2


class _Spot(NamedTuple):
    """Where an estimate was: (3,) and (2, 2)."""

    t_s: float
    position_ned_m: Array
    covariance_ne_m2: Array


class TrackPlot:
    """Collects a track and draws it at the end; a long one with fewer points, not with more."""

    def __init__(self, pack: MapPack, local_frame: LocalFrame) -> None:
        self._pack = pack
        self._local_frame = local_frame
        self._track: Thinned[_Spot] = Thinned(MOST_POINTS)
        self._fixes: Thinned[tuple[float, float]] = Thinned(MOST_POINTS)
        self._truth_ned_m: Thinned[Array] = Thinned(MOST_POINTS)

    def add(self, step: StepResult) -> None:
        """One image of the flight."""
        estimate = step.estimate
        if estimate is not None and estimate.t_last_fix_s is not None:
            covariance_ne_m2 = estimate.covariance[:2, :2].copy()  # a view would keep all of it
            self._track.add(_Spot(estimate.t_s, estimate.position_ned_m, covariance_ne_m2))
        if isinstance(step.outcome, MapFix):
            self._fixes.add((step.outcome.lat_deg, step.outcome.lon_deg))

    def add_truth(self, ned_m: Array) -> None:
        """The true position (3,), from a simulator."""
        self._truth_ned_m.add(ned_m)

    def save(self, path: Path) -> None:
        """Draw and write a PNG, whole or not at all.

        Raises:
            OSError: it cannot be written.
        """
        write_whole(path, cv2.imencode(".png", self.draw())[1].tobytes())

    def draw(self) -> NDArray[np.uint8]:
        """The image, BGR, no larger than `MAX_SIDE_PX`; without any position of the whole map.

        A track that leaves the map is drawn as far as the map goes: an estimate that ran away must
        not ask for an image of the way to the moon.
        """
        track = self._lat_lon([spot.position_ned_m for spot in self._track.items])
        fixes = np.array(self._fixes.items).reshape(-1, 2)
        truth = self._lat_lon(self._truth_ned_m.items)
        south, west, north, east = self._bounds(np.vstack([track, fixes, truth]))
        zoom = self._zoom(south, west, north, east)
        x0, y0 = (int(v) for v in mercator_px(north, west, zoom))
        x1, y1 = (int(v) + 1 for v in mercator_px(south, east, zoom))
        x1, y1 = min(x1, x0 + MAX_SIDE_PX), min(y1, y0 + MAX_SIDE_PX)
        # A little darker, so that the lines stand out.
        image = self._pack.colour_image(zoom, Window(x0, y0, x1, y1))
        canvas = (image.bgr * 0.8).astype(np.uint8)

        def pixels(lat_lon: Array) -> Array:
            x, y = mercator_px(lat_lon[:, 0], lat_lon[:, 1], zoom)
            return np.stack([np.asarray(x) - x0 - 0.5, np.asarray(y) - y0 - 0.5], axis=-1)

        _line(canvas, pixels(truth), _TRUTH_BGR, 5)
        for uv in _on_paper(pixels(fixes)):
            _dot(canvas, uv, 2.5, _FIX_BGR)
        _line(canvas, pixels(track), _ESTIMATE_BGR, 1)
        self._draw_ellipses(canvas, pixels(track), zoom)
        _legend(canvas, north, zoom, bool(len(truth)))
        return canvas

    def _lat_lon(self, ned_m: list[Array]) -> Array:
        if not ned_m:
            return np.zeros((0, 2))
        lat_deg, lon_deg, _ = self._local_frame.to_geodetic(np.array(ned_m))
        return np.stack([lat_deg, lon_deg], axis=-1)

    def _bounds(self, lat_lon: Array) -> tuple[float, float, float, float]:
        south, west, north, east = self._pack.bounds
        margin_lat = MARGIN_M / 111_000.0
        margin_lon = margin_lat / max(0.01, np.cos(np.radians(south)))
        near = (lat_lon > [south - margin_lat, west - margin_lon]) & (
            lat_lon < [north + margin_lat, east + margin_lon]
        )
        lat_lon = lat_lon[near.all(axis=1)]
        if not len(lat_lon):
            return self._pack.bounds
        low, high = lat_lon.min(axis=0), lat_lon.max(axis=0)
        return (
            float(low[0] - margin_lat),
            float(low[1] - margin_lon),
            float(high[0] + margin_lat),
            float(high[1] + margin_lon),
        )

    def _zoom(self, south: float, west: float, north: float, east: float) -> int:
        """The finest level at which the image is not too large."""
        zooms = sorted(level.zoom for level in self._pack.levels)
        fitting = [z for z in zooms if _side_px(south, west, north, east, z) <= MAX_SIDE_PX]
        return fitting[-1] if fitting else zooms[0]

    def _draw_ellipses(self, canvas: NDArray[np.uint8], uv: Array, zoom: int) -> None:
        last_s = -np.inf
        for spot, at in zip(self._track.items, uv, strict=True):
            if spot.t_s - last_s < ELLIPSE_EVERY_S or not len(_on_paper(at[None])):
                continue
            last_s = spot.t_s
            variances, axes = np.linalg.eigh(spot.covariance_ne_m2)
            px_per_m = mercator_px_per_m(self._local_frame.lat_deg, zoom)[0]
            semi_px = np.sqrt(np.maximum(variances, 0.0)) * px_per_m
            # Columns are (north, east): on the image east is right and north is up.
            angle_deg = float(np.degrees(np.arctan2(-axes[0, 1], axes[1, 1])))
            scale = 1 << _SUBPIXEL_BITS
            centre = tuple(round(v * scale) for v in at)
            size = tuple(max(scale, round(min(v, _FARTHEST_PX) * scale)) for v in semi_px[::-1])
            cv2.ellipse(
                canvas, centre, size, angle_deg, 0, 360, _ESTIMATE_BGR, 1, cv2.LINE_AA,
                _SUBPIXEL_BITS,
            )  # fmt: skip


def _side_px(south: float, west: float, north: float, east: float, zoom: int) -> float:
    x0, y0 = mercator_px(north, west, zoom)
    x1, y1 = mercator_px(south, east, zoom)
    return float(max(x1 - x0, y1 - y0))


def _on_paper(uv: Array) -> Array:
    """What of (n, 2) points OpenCV's fixed-point drawing can hold; the rest is far outside."""
    return uv[(np.abs(uv) < _FARTHEST_PX).all(axis=1)]  # NaN is not smaller than anything


def _line(canvas: NDArray[np.uint8], uv: Array, bgr: tuple[int, int, int], width: int) -> None:
    uv = _on_paper(uv)
    if len(uv) > 1:
        points = np.round(uv * (1 << _SUBPIXEL_BITS)).astype(np.int32)[:, None]
        cv2.polylines(canvas, [points], False, bgr, width, cv2.LINE_AA, _SUBPIXEL_BITS)


def _dot(canvas: NDArray[np.uint8], uv: Array, radius: float, bgr: tuple[int, int, int]) -> None:
    scale = 1 << _SUBPIXEL_BITS
    centre = (round(uv[0] * scale), round(uv[1] * scale))
    cv2.circle(canvas, centre, int(radius * scale), bgr, -1, cv2.LINE_AA, _SUBPIXEL_BITS)


def _legend(canvas: NDArray[np.uint8], lat_deg: float, zoom: int, with_truth: bool) -> None:
    """Scale bar of 100 m, and what the colours mean."""
    bar_px = round(100.0 * mercator_px_per_m(lat_deg, zoom)[0])
    y = canvas.shape[0] - 16
    cv2.rectangle(canvas, (8, y - 14), (430 + bar_px, y + 12), (40, 40, 40), -1)
    cv2.line(canvas, (16, y), (16 + bar_px, y), (255, 255, 255), 3)
    entries = [("100 m", (255, 255, 255)), ("estimate, 1 sigma", _ESTIMATE_BGR), ("fix", _FIX_BGR)]
    if with_truth:
        entries.append(("truth", _TRUTH_BGR))
    x = 24 + bar_px
    for text, bgr in entries:
        cv2.putText(canvas, text, (x, y + 5), cv2.FONT_HERSHEY_SIMPLEX, 0.5, bgr, 1, cv2.LINE_AA)
        x += cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)[0][0] + 18
