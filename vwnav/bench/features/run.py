"""`vwnav bench features`: scenes in, one report out."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

import vwnav
from vwnav.bench.features.flight_scenes import (
    BRIGHTON_M_PER_PX,
    BRIGHTON_PRIOR_M,
    ISLAMABAD_M_PER_PX,
    ISLAMABAD_PRIOR_M,
    brighton_shots,
    flight_scenes,
    islamabad_shots,
)
from vwnav.bench.features.methods import FeatureSet, feature_sets
from vwnav.bench.features.pair_scenes import (
    evaluation_pairs,
    generated_pairs,
    single_images,
    view_pairs,
)
from vwnav.bench.features.scenes import Scene
from vwnav.bench.features.scoring import FeatureScore, Judge, SceneResult, score
from vwnav.bench.features.thesis import ThesisRow, thesis_rows
from vwnav.bench.features.timing import SIZES_WH, Times, measure
from vwnav.cameras.image_folder import read_image
from vwnav.errors import ConfigError, SourceError
from vwnav.machine.extras import how_to_install
from vwnav.sim.site import FIRST_TRAINING_SEED, Site
from vwnav.types import Gray

ALL = "all"
GENERATED = "generated"
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Report:
    """Everything that was measured.

    Attributes:
        sets: the feature sets, for what their networks cost.
        groups: scores by group and method; the group "all" holds every scene.
        units: of each group's places, "m" or "px".
        timing: by size of the image, such as "640x480", and feature set.
        thesis: by feature set.
        samples: all methods on one scene of each group, to be drawn.
        skipped: one line for each thing that was left out.
    """

    sets: list[FeatureSet]
    groups: dict[str, dict[str, FeatureScore]]
    units: dict[str, str]
    timing: dict[str, dict[str, Times]]
    thesis: dict[str, ThesisRow]
    samples: dict[str, list[SceneResult]]
    skipped: list[str]


def data_folder(given: Path | None) -> Path | None:
    """The folder to judge on: the argument, else VWNAV_DATA, else ../shared/data if it is there.

    Raises:
        ConfigError: the one that was named holds nothing to judge on.
    """
    named = given or (Path(os.environ["VWNAV_DATA"]) if os.environ.get("VWNAV_DATA") else None)
    beside = Path(vwnav.__file__).parents[2] / "shared" / "data"
    folder = named or beside
    if (folder / "eval").is_dir() or (folder / "flights").is_dir():
        return folder
    if named:
        raise ConfigError(f"no eval/ and no flights/ in {named}: give the data folder with --data")
    return None


def bench_features(
    folder: Path | None, models: list[Path], views: int, repeats: int, progress: Progress
) -> Report:
    """Run everything on one thread.

    Args:
        folder: holds eval/, flights/ and pairs.json; generated places are judged on where None.
        models: ONNX graphs; the released ones where empty.
        views: scenes of each group, at most.
        repeats: of each time measurement.
        progress: told what is done.

    Raises:
        VwnavError: of a model or an image.
    """
    cv2.setNumThreads(1)
    sets, skipped = feature_sets(models)
    groups = dict(_groups(folder, views, skipped))
    if not groups:
        raise SourceError(f"nothing to judge on in {folder}: it has no pairs, pictures or flights")
    total = sum(len(scenes) for scenes in groups.values())
    outcomes: dict[str, dict[str, list[SceneResult]]] = {}
    samples: dict[str, list[SceneResult]] = {}
    done = 0
    for group, scenes in groups.items():
        judge, of_group = Judge(sets), outcomes.setdefault(group, {})
        for index, scene in enumerate(scenes):
            found = list(judge.judge(scene))
            for outcome in found:
                of_group.setdefault(outcome.method, []).append(outcome)
            if index == len(scenes) // 2:
                samples[group] = found
            done += 1
            progress("scenes", done, total)
    flown = next((s for s in groups.values() if s[0].map_.unit == "m"), None)
    return Report(
        sets=sets,
        groups=_scores(outcomes),
        units={name: scenes[0].map_.unit for name, scenes in groups.items()},
        timing=_timing(sets, _timing_images(folder), repeats, progress),
        thesis=thesis_rows(sets, flown or next(iter(groups.values()))),
        samples=samples,
        skipped=skipped,
    )


def _groups(
    folder: Path | None, views: int, skipped: list[str]
) -> Iterator[tuple[str, list[Scene]]]:
    if folder is None:
        skipped.append("no data folder (--data, VWNAV_DATA): judged on generated places only")
        yield GENERATED, list(view_pairs(GENERATED, generated_pairs(), views))
        return
    pairs = evaluation_pairs(folder)
    for name, of_source in pairs.items():
        yield name, list(view_pairs(name, of_source, views))
    if not pairs:
        skipped.append("no evaluation pairs in pairs.json")
    for name, place in (("keioSFC", "drone"), ("single", "single")):
        images = single_images(folder / "eval" / place)
        if images:
            yield name, list(view_pairs(name, images, views, same_day=True))
        else:
            skipped.append(f"no pictures in eval/{place}")
    yield from _flights(folder / "flights", views, skipped)


def _flights(folder: Path, views: int, skipped: list[str]) -> Iterator[tuple[str, list[Scene]]]:
    try:
        from vwnav.maps.build.geotiff import RasterFile
    except ImportError:
        skipped.append(f"flights need rasterio: {how_to_install('maps')}")
        return

    if (folder / "islamabad").is_dir():
        shots = islamabad_shots(folder / "islamabad", views)
        raster = RasterFile(folder / "islamabad" / "1.tif")
        for m_per_px in ISLAMABAD_M_PER_PX:
            name = f"islamabad_{m_per_px:.2f}"
            scenes = flight_scenes(name, shots, raster, m_per_px, ISLAMABAD_PRIOR_M)
            yield name, list(scenes)
    else:
        skipped.append("no flights/islamabad")
    if (folder / "brighton_beach").is_dir():
        shots = brighton_shots(folder / "brighton_beach")[:views]
        raster = RasterFile(folder / "brighton_beach" / "map_even_frames.tif")
        name = "brighton_beach"
        scenes = flight_scenes(name, shots, raster, BRIGHTON_M_PER_PX, BRIGHTON_PRIOR_M)
        yield name, list(scenes)
    else:
        skipped.append("no flights/brighton_beach")


def _scores(
    outcomes: dict[str, dict[str, list[SceneResult]]],
) -> dict[str, dict[str, FeatureScore]]:
    everything: dict[str, list[SceneResult]] = {}
    for of_group in outcomes.values():
        for method, found in of_group.items():
            everything.setdefault(method, []).extend(found)
    return {
        group: {method: score(found) for method, found in of_group.items()}
        for group, of_group in [*outcomes.items(), (ALL, everything)]
    }


def _timing(
    sets: list[FeatureSet], images: tuple[Gray, Gray], repeats: int, progress: Progress
) -> dict[str, dict[str, Times]]:
    times = {}
    for number, (w, h) in enumerate(SIZES_WH, 1):
        image, other = (np.ascontiguousarray(each[:h, :w]) for each in images)
        times[f"{w}x{h}"] = measure(sets, image, other, repeats)
        progress("times", number, len(SIZES_WH))
    return times


def _timing_images(folder: Path | None) -> tuple[Gray, Gray]:
    """Two overlapping images of at least 640 x 480: real ones, else of a generated place."""
    found = sorted((folder / "eval" / "drone").glob("**/*.jpg")) if folder else []
    if found:
        first = read_image(found[0])
        second = np.roll(first, (40, 40), (0, 1))
    else:
        site, size = Site(FIRST_TRAINING_SEED - 1), (640, 480)
        first = site.render("flight", 70.0, -100.0, size, 0.3)
        second = site.render("map", 80.0, -90.0, size, 0.3)
    gray0, gray1 = (cv2.cvtColor(each, cv2.COLOR_BGR2GRAY) for each in (first, second))
    return np.asarray(gray0, np.uint8), np.asarray(gray1, np.uint8)
