"""The whole pipeline over a real video, begun anywhere: how soon it is found, and how wrongly.

Forwards, backwards and from random starts, without any position, each with a stretch that shows
nothing. Truth is the track of the ground below, as in `flight_scenes`, without those places through
which nothing flies. Every estimate is held against its own sigma as well.
"""

import csv
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vwnav.assemble import assemble, choose_features
from vwnav.bench.features.scenes import generator
from vwnav.cameras.video_file import VideoFile
from vwnav.config import Config, with_features
from vwnav.errors import ConfigError
from vwnav.geometry.camera import Camera
from vwnav.geometry.geodesy import LocalFrame, horizontal_distance_m
from vwnav.maps.build.builder import BuildOptions, build_pack
from vwnav.maps.pack import MapPack
from vwnav.seams import InlineExecutor
from vwnav.types import Array, Frame, Gray, MapFix
from vwnav.vision.features.load import load_features

EVERY = 3  # of the video's 30 frames a second: 10
HFOV_DEG = 70.0  # nobody knows it; places do not depend on it
BLACK_S = 5.0
STARTS, START_S = 20, 15.0  # random starts, and how long each is followed
NEAR_M, WRONG_M = 8.0, 20.0
MANY_SIGMAS = 3.0
MOST_M_S2 = 20.0  # two g, between neighbours of the track


Say = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class _Film:
    """Frames (n, h, w), their times and the places (n, 2) of the ground below, degrees."""

    gray: list[Gray]
    t_s: NDArray[np.float64]
    lat_lon: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Honesty:
    """How errors of place compare with the larger semi-axis of the ellipse that was told.

    Attributes:
        worst_sigmas: the largest error in its own sigmas.
        within_1, within_2: share of the errors within so many of their sigmas.
        over_3_s: the longest time without an error within three.
        median_sigma_m: of several runs their mean.
    """

    worst_sigmas: float
    within_1: float
    within_2: float
    over_3_s: float
    median_sigma_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceScore:
    """Of one run, or of several together.

    Attributes:
        near: share of the frames from the first fix on, dark ones too, that are within 8 m.
        first_fix_s: of video until the first fix; of several runs the longest.
        fixes: that were believed.
        wrong: of them more than 20 m off.
        worst_m: the largest error of any estimate after the first fix.
        honesty: of those estimates.
    """

    name: str
    near: float
    first_fix_s: float
    fixes: int
    wrong: int
    worst_m: float
    honesty: Honesty


def bench_sequence(folder: Path | None, model: Path | None, say: Say) -> list[SequenceScore]:
    """Run all of them.

    Raises:
        ConfigError: there is no such video.
        VwnavError: of the model, the video or the map.
    """
    flight = None if folder is None else folder / "flights" / "islamabad"
    if flight is None or not flight.is_dir():
        raise ConfigError("--sequence wants flights/islamabad of the data folder: give --data")
    from vwnav.maps.build.geotiff import RasterFile

    cv2.setNumThreads(1)
    film = _film(flight)
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "map.mbtiles"
        extractors = [load_features("learned", model), load_features("sift")]
        build_pack([RasterFile(flight / "1.tif")], path, extractors, BuildOptions())
        with MapPack.open(path) as pack:
            scores = []
            for name, chosen in _runs(len(film.gray)):
                scores.append(_run(name, film, chosen, pack, model))
                say(f"bench: {name}")
    starts = [each for each in scores if each.name.startswith("start")]
    return [*scores[:2], _together(f"{len(starts)} random starts", starts)]


def _film(flight: Path) -> _Film:
    rows = list(csv.DictReader((flight / "sift_track_every10.csv").open()))
    numbers = np.array([int(row["frame"]) for row in rows])
    places = np.array([(float(row["lat"]), float(row["lon"])) for row in rows])
    flown = possible(np.array([float(row["t"]) for row in rows]), places)
    numbers, places = numbers[flown], places[flown]
    gray, indices, times = [], [], []
    video = VideoFile(flight / "our_data.mp4")
    while (frame := video.next_frame()) is not None and frame.index <= numbers[-1]:
        if frame.index % EVERY == 0:
            gray.append(np.asarray(cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY), np.uint8))
            indices.append(frame.index)
            times.append(frame.t_s)
    video.close()
    lat_lon = np.column_stack([np.interp(indices, numbers, places[:, i]) for i in (0, 1)])
    return _Film(gray, np.array(times), lat_lon)


def possible(t_s: Array, lat_lon: Array) -> NDArray[np.bool_]:
    """(n,) which places (n, 2) of a track an aircraft can have flown through.

    The others ask for more than two g beside their neighbours. They are left out one by one, the
    worst first: a wrong place makes the right ones next to it look wrong.
    """
    frame = LocalFrame(float(lat_lon[0, 0]), float(lat_lon[0, 1]), 0.0)
    ne_m = np.array([frame.to_ned(float(lat), float(lon), 0.0)[:2] for lat, lon in lat_lon])
    left = np.arange(len(t_s))
    while len(left) > 2:
        needed_m_s2 = _accelerations(t_s[left], ne_m[left])
        worst = int(np.argmax(needed_m_s2))
        if needed_m_s2[worst] <= MOST_M_S2:
            break
        left = np.delete(left, worst + 1)
    return np.isin(np.arange(len(t_s)), left)


def _accelerations(t_s: Array, ne_m: Array) -> Array:
    """(n - 2,) that lead through each place but the first and the last, m/s^2."""
    velocity_m_s = np.diff(ne_m, axis=0) / np.diff(t_s)[:, None]
    change_m_s = np.diff(velocity_m_s, axis=0)
    return np.asarray(np.hypot(*change_m_s.T) / (0.5 * (t_s[2:] - t_s[:-2])))


def honesty(t_s: Array, errors_m: Array, sigmas_m: Array) -> Honesty:
    """Of estimates in order of time: their errors and the sigmas that they told, (n,) each."""
    ratios = errors_m / sigmas_m
    begun_s, longest_s = None, 0.0
    for at_s, ratio in zip(t_s, ratios, strict=True):
        if ratio <= MANY_SIGMAS:
            begun_s = None
            continue
        begun_s = at_s if begun_s is None else begun_s
        longest_s = max(longest_s, float(at_s - begun_s))
    return Honesty(
        worst_sigmas=float(ratios.max()),
        within_1=float(np.mean(ratios <= 1.0)),
        within_2=float(np.mean(ratios <= 2.0)),
        over_3_s=longest_s,
        median_sigma_m=float(np.median(sigmas_m)),
    )


def _runs(count: int) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """Names, and the frames in their order."""
    yield "forwards", np.arange(count)
    yield "backwards", np.arange(count)[::-1]
    length = round(START_S * 30.0 / EVERY)
    rng = generator("sequence", 0)
    for number in range(STARTS):
        start = int(rng.integers(0, count - length))
        order = np.arange(start, start + length)
        yield f"start {number}", order if rng.random() < 0.5 else order[::-1]


def _run(
    name: str, film: _Film, chosen: NDArray[np.int64], pack: MapPack, model: Path | None
) -> SequenceScore:
    h, w = film.gray[0].shape
    frame = LocalFrame(*pack.middle, 0.0)
    config = with_features(Config(), "learned", model)
    config = config.model_copy(update={"ekf": config.ekf.without_telemetry()})
    camera = Camera.from_hfov(w, h, HFOV_DEG)
    features = choose_features(config.features, lambda _: None)
    executor = InlineExecutor()
    assembled = assemble(*features, pack, camera, frame, config, executor, lambda _: None)
    t_s = np.abs(film.t_s[chosen] - film.t_s[chosen[0]])
    dark = (t_s >= t_s[-1] / 2.0) & (t_s < t_s[-1] / 2.0 + BLACK_S)
    at, errors_m, sigmas_m, fixed_s, fix_errors_m = [], [], [], [], []
    for number, (i, at_s) in enumerate(zip(chosen, t_s, strict=True)):
        image = np.zeros_like(film.gray[i]) if dark[number] else film.gray[i]
        step = assembled.pipeline.step(Frame(float(at_s), image, number))
        if isinstance(step.outcome, MapFix):
            fixed_s.append(float(at_s))
            place = step.outcome.lat_deg, step.outcome.lon_deg
            fix_errors_m.append(horizontal_distance_m(*place, *film.lat_lon[i]))
        if fixed_s and step.estimate is not None:
            lat_deg, lon_deg, _ = frame.to_geodetic(step.estimate.position_ned_m)
            place = float(lat_deg), float(lon_deg)
            errors_m.append(horizontal_distance_m(*place, *film.lat_lon[i]))
            sigmas_m.append(step.estimate.sigma_horizontal_m)
            at.append(float(at_s))
    errors, sigmas = np.array(errors_m or [np.inf]), np.array(sigmas_m or [1.0])
    return SequenceScore(
        name=name,
        near=float(np.mean(errors <= NEAR_M)),
        first_fix_s=fixed_s[0] if fixed_s else float("inf"),
        fixes=len(fixed_s),
        wrong=int(np.count_nonzero(np.array(fix_errors_m) > WRONG_M)),
        worst_m=float(errors.max()),
        honesty=honesty(np.array(at or [0.0]), errors, sigmas),
    )


def _together(name: str, scores: list[SequenceScore]) -> SequenceScore:
    return SequenceScore(
        name=name,
        near=float(np.mean([each.near for each in scores])),
        first_fix_s=max(each.first_fix_s for each in scores),
        fixes=sum(each.fixes for each in scores),
        wrong=sum(each.wrong for each in scores),
        worst_m=max(each.worst_m for each in scores),
        honesty=Honesty(
            worst_sigmas=max(each.honesty.worst_sigmas for each in scores),
            within_1=float(np.mean([each.honesty.within_1 for each in scores])),
            within_2=float(np.mean([each.honesty.within_2 for each in scores])),
            over_3_s=max(each.honesty.over_3_s for each in scores),
            median_sigma_m=float(np.mean([each.honesty.median_sigma_m for each in scores])),
        ),
    )


def as_json(scores: list[SequenceScore]) -> dict[str, object]:
    """Plain values."""
    return {"near_m": NEAR_M, "wrong_m": WRONG_M, "runs": [asdict(each) for each in scores]}


def rows(scores: list[SequenceScore]) -> Iterator[tuple[str, str]]:
    """A line of a table for each."""
    for each in scores:
        told = each.honesty
        yield (
            each.name,
            f"{each.near:.1%} within {NEAR_M:.0f} m, first fix after {each.first_fix_s:.1f} s, "
            f"{each.fixes} fixes, {each.wrong} wrong; worst {each.worst_m:.1f} m, "
            f"{told.worst_sigmas:.1f} sigmas; {told.within_1:.0%} within 1, {told.within_2:.0%} "
            f"within 2, at most {told.over_3_s:.1f} s over 3; median {told.median_sigma_m:.2f} m",
        )
