"""What `vwnav camera` does: what the drone sees, in figures and as an image."""

import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.calibration.held_light import HeldLight
from vwnav.cameras.live import RealTimeSource
from vwnav.cameras.modes import mode_of, trouble_with_mode
from vwnav.cameras.sources import open_source
from vwnav.errors import CalibrationError, SourceError
from vwnav.files.whole import write_whole
from vwnav.geometry.calibration import load_camera
from vwnav.geometry.camera import check_fits, to_gray
from vwnav.screen import LiveLine, print_table
from vwnav.seams import FrameSource
from vwnav.types import Array, Frame, Gray
from vwnav.vision.features.load import load_features

KEYPOINTS = 1000
DARK, BRIGHT = 5, 250  # grey levels beyond which a pixel shows nothing
HISTOGRAM_WH = (128, 64)
_GREEN, _WHITE, _BLACK = (80, 230, 80), (255, 255, 255), (0, 0, 0)


@dataclass(frozen=True, slots=True)
class LookOptions:
    """The command line of `vwnav camera`."""

    source: str
    camera: Path | None
    height_m: float
    seconds: float
    features: str
    output: Path | None


@dataclass(frozen=True, slots=True, eq=False)
class Footage:
    """Some seconds of a source.

    Attributes:
        newest: the last image.
        stamps_s: (n,) of the images.
        latencies_s: (n,) from exposure to here; empty of what is not live.
        dropped: images that came while the one before was worked on.
        exposure: of the newest one, in words; empty of what is not live.
    """

    newest: Frame
    stamps_s: Array
    latencies_s: Array
    dropped: int
    exposure: str


def look(options: LookOptions) -> None:
    """Watch for some seconds; print the figures, and draw the newest image.

    Raises:
        VwnavError: of the source, the calibration, or the image has no place to be written to.
        OSError: the image cannot be written.
    """
    if options.output is not None:
        _check_drawable(options.output)
    calibration = load_camera(options.camera) if options.camera else None
    extractor = load_features(options.features)
    source = open_source(options.source, mode=calibration.sensor_mode if calibration else None)
    try:
        seen = _watch(source, options.seconds, HeldLight(source, calibration, options.height_m))
    finally:
        source.close()
    gray, mode = to_gray(seen.newest.image), mode_of(source)
    rows = [("size", f"{gray.shape[1]} x {gray.shape[0]} px")]
    rows += [("mode of the sensor", str(mode))] if mode is not None else []
    rows += [*_times(seen), *_light(gray)]
    if seen.exposure:
        rows.append(("exposure", seen.exposure))
    found = extractor.extract(gray, KEYPOINTS)
    rows.append((f"keypoints, {options.features}", f"{len(found)} of at most {KEYPOINTS}"))
    if calibration is not None:
        check_fits(calibration, gray.shape[1], gray.shape[0])
        if trouble := trouble_with_mode(source, calibration):
            raise CalibrationError(trouble)
        px_per_m = float(calibration.K[0, 0]) / options.height_m
        rows.append(
            (
                f"at {options.height_m:g} m",
                f"{px_per_m:.1f} px a metre, {1.0 / px_per_m:.3f} m a px, "
                f"{gray.shape[1] / px_per_m:.0f} x {gray.shape[0] / px_per_m:.0f} m of ground",
            )
        )
    if options.output is not None:
        _draw(options.output, seen.newest.image, found.uv, rows)
        rows.append(("picture", str(options.output)))
    print_table(f"camera {options.source}", rows)


def _check_drawable(path: Path) -> None:
    if not (path.parent.is_dir() and _has_writer(path.suffix)):
        raise SourceError(f"cannot write {path}: give a .jpg or .png in a folder that exists")


def _has_writer(suffix: str) -> bool:
    """Never asked of a whole name: OpenCV ends the process at one that is not UTF-8."""
    return suffix.isascii() and bool(cv2.haveImageWriter(f"picture{suffix}"))


def _watch(source: FrameSource, seconds: float, light: HeldLight) -> Footage:
    """Images for so long, or until a file ends."""
    live = isinstance(source, RealTimeSource)
    newest: Frame | None = None
    stamps, latencies = [], []
    until_s = time.monotonic() + seconds
    with LiveLine() as line:
        while time.monotonic() < until_s and (frame := source.next_frame()) is not None:
            newest = frame
            stamps.append(frame.t_s)
            if live:
                latencies.append(time.monotonic() - frame.t_s)
            sharpness = _sharpness(to_gray(frame.image))
            line.show(frame.t_s, f"picture {len(stamps)}  sharpness {sharpness:.0f}")
    if newest is None:
        raise SourceError("no picture came")
    dropped = source.dropped if isinstance(source, RealTimeSource) else 0
    return Footage(newest, np.array(stamps), np.array(latencies), dropped, light.in_words())


def _times(seen: Footage) -> list[tuple[str, str]]:
    rows = []
    if len(seen.stamps_s) > 1:
        gaps_s = np.diff(seen.stamps_s)
        period_s = float(np.median(gaps_s))
        jitter_s = float(np.percentile(np.abs(gaps_s - period_s), 95.0))
        rows.append(("rate", f"{1.0 / max(period_s, 1e-6):.1f} pictures a second"))
        rows.append(("jitter, 95 %", f"{1e3 * jitter_s:.1f} ms"))
    if len(seen.latencies_s):
        typical, worst = 1e3 * np.percentile(seen.latencies_s, [50.0, 99.0])
        rows.append(("latency, 50 and 99 %", f"{typical:.0f}, {worst:.0f} ms by its own stamp"))
        rows.append(("left out meanwhile", str(seen.dropped)))
    return rows


def _sharpness(gray: Gray) -> float:
    """Variance of the Laplacian: falls when the image is out of focus or smeared."""
    return float(cv2.Laplacian(gray, cv2.CV_32F).var())


def _light(gray: Gray) -> list[tuple[str, str]]:
    dark, bright = 100.0 * np.mean(gray <= DARK), 100.0 * np.mean(gray >= BRIGHT)
    return [
        ("sharpness", f"{_sharpness(gray):.0f}"),
        ("brightness, contrast", f"{gray.mean():.0f}, {gray.std():.0f} of 255"),
        ("black, white", f"{dark:.1f}, {bright:.1f} % of the pixels"),
    ]


def _draw(
    path: Path, image: NDArray[np.uint8], uv: NDArray[np.float32], rows: list[tuple[str, str]]
) -> None:
    """The image with its keypoints, its histogram and the figures.

    Raises:
        OSError: it cannot be written.
    """
    canvas = np.asarray(cv2.cvtColor(to_gray(image), cv2.COLOR_GRAY2BGR), np.uint8)
    for u, v in np.round(uv).astype(int).tolist():
        cv2.circle(canvas, (u, v), 3, _GREEN, 1, cv2.LINE_AA)
    _draw_histogram(canvas, to_gray(image))
    canvas[: 16 * len(rows) + 10] //= 2  # darker behind the figures
    for line, (name, value) in enumerate(rows):
        at, text = (8, 18 + 16 * line), f"{name}: {value}"
        cv2.putText(canvas, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, _WHITE, 1, cv2.LINE_AA)
    write_whole(path, cv2.imencode(path.suffix, canvas)[1].tobytes())


def _draw_histogram(canvas: NDArray[np.uint8], gray: Gray) -> None:
    """Of the grey levels, in the lower right corner."""
    w, h = HISTOGRAM_WH
    if gray.shape[1] < 2 * w or gray.shape[0] < 2 * h:
        return
    counts = np.histogram(gray, bins=w, range=(0, 256))[0]
    bars = np.round(h * counts / counts.max()).astype(int)
    left, bottom = gray.shape[1] - w - 8, gray.shape[0] - 8
    cv2.rectangle(canvas, (left - 1, bottom - h - 1), (left + w, bottom + 1), _BLACK, cv2.FILLED)
    for i, bar in enumerate(bars.tolist()):
        cv2.line(canvas, (left + i, bottom), (left + i, bottom - bar), _WHITE, 1)
