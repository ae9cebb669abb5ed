"""Maps of registered images, and frames cut from their other dates to be found on them."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from vwnav.bench.features.scenes import Mask, generator
from vwnav.bench.localizer.images import (
    LEAST_SIDE_PX,
    Pair,
    Photo,
    Split,
    apart,
    other_photos,
    read_gray,
    registered_pairs,
)
from vwnav.bench.localizer.labels import corrected
from vwnav.bench.localizer.looks import (
    CAMERA,
    PRIOR_PX,
    ZOOM,
    Board,
    Cut,
    LookCase,
    SeenGround,
    TruePose,
    cut_frame,
    map_pixel,
    place_of_pixel,
    rough_prior,
    without_place,
)
from vwnav.cameras.image_folder import read_image
from vwnav.geometry.geodesy import ground_resolution_m_per_px
from vwnav.maps.build.raster import DrawnSource, array_source, level_georeference
from vwnav.types import Array, Gray

ELSEWHERE = "elsewhere"
LOOKS_AN_IMAGE = 4  # with a prior
SEARCHES_AN_IMAGE = 1  # without: each takes as long as ten others
LEVELS = (ZOOM, ZOOM - 1, ZOOM - 2)
_CELL_PX = 1152  # images of a map lie so far apart: the largest and a gap without data
_COLUMNS = 3
_ATTEMPTS = 100


def boards(folder: Path, split: Split, looks: int, only: str | None) -> Iterator[Board]:
    """Maps of one image of each source, until each source has so many looks with a prior.

    Args:
        folder: of the data.
        split: which pairs.
        looks: with a prior, for each source; a quarter as many without, and as many of all sources
            together at wrong places.
        only: this source alone.
    """
    ordered = shuffled_pairs(folder, split)
    strangers = strange_photos(folder, split, ordered)
    for number in range(-(-looks // LOOKS_AN_IMAGE)):
        shown = [pairs[number % len(pairs)] for pairs in ordered.values()]
        yield _board(split, number, shown, strangers, only)


def shuffled_pairs(folder: Path, split: Split) -> dict[str, list[Pair]]:
    """The pairs by their source, in an order of no meaning."""
    by_source: dict[str, list[Pair]] = {}
    for pair in registered_pairs(folder, split):
        by_source.setdefault(pair.source, []).append(pair)
    rng = generator(split, 0)
    return {
        source: [pairs[i] for i in rng.permutation(len(pairs))]
        for source, pairs in sorted(by_source.items())
    }


def strange_photos(folder: Path, split: Split, ordered: dict[str, list[Pair]]) -> list[Photo]:
    """Images that may be looked for where they are not."""
    paired = [pair.frame for pairs in ordered.values() for pair in pairs]
    return list(dict.fromkeys(paired)) + other_photos(folder, split)


def _board(
    split: Split, number: int, shown: list[Pair], strangers: list[Photo], only: str | None
) -> Board:
    sources: list[DrawnSource] = []
    looks: list[LookCase] = []
    masks = []
    for index, pair in enumerate(shown):
        corner_px = map_pixel((_CELL_PX * (index % _COLUMNS), _CELL_PX * (index // _COLUMNS)))
        gray, mask = read_gray(pair.map_)
        sources.append(map_source(pair, corner_px, mask))
        masks.append((corner_px, mask))
        if only in (None, pair.source):
            ground, label_px = seen_ground(pair, gray, mask)
            name = f"{pair.frame.path.stem} {number}"
            looks += pair_looks(pair.source, name, ground, corner_px, label_px)
    if only in (None, ELSEWHERE):
        places = [pair.frame.place for pair in shown]
        elsewhere = [photo for photo in strangers if all(apart(photo.place, p) for p in places)]
        looks += _wrong_looks(f"{split} {number}", elsewhere, masks)
    return Board(sources, LEVELS, looks)


def map_source(pair: Pair, corner_px: tuple[int, int], mask: Mask) -> DrawnSource:
    """The map's image of a pair, its first pixel at a global one of `ZOOM`."""
    image, georeference = read_image(pair.map_.path), level_georeference(ZOOM, *corner_px)
    return array_source(image, georeference, name=pair.map_.path.stem, mask=mask)


def seen_ground(pair: Pair, map_gray: Gray, map_mask: Mask) -> tuple[SeenGround, float]:
    """The other image of a pair, its label corrected, and one sigma of that, pixels."""
    frame, mask = read_gray(pair.frame)
    H_map_frame, label_px = corrected(frame, mask, map_gray, map_mask, pair.H_map_frame)
    return SeenGround(frame, mask, np.asarray(np.linalg.inv(H_map_frame)), map_mask), label_px


def pair_looks(
    group: str,
    name: str,
    ground: SeenGround,
    corner_px: tuple[int, int],
    label_px: float,
    searches: int = SEARCHES_AN_IMAGE,
) -> Iterator[LookCase]:
    """Frames of a place that the map shows, with a rough prior, and some without place."""
    for number in range(LOOKS_AN_IMAGE):
        rng = generator(f"{group} {name}", number)
        cut = cut_frame(ground, rng)
        if cut is None:
            continue
        pose = pose_of(cut, corner_px)
        m_per_px = ground_resolution_m_per_px(pose.lat_deg, ZOOM)
        prior = rough_prior(pose, cut.rpy_rad[:2], PRIOR_PX * m_per_px, rng)
        look = LookCase(
            group=group,
            name=f"{name}.{number}",
            kind="prior",
            image=cut.image,
            camera=CAMERA,
            prior=prior,
            seed=number,
            truth=pose,
            unit_m=m_per_px,
            label_m=label_px * m_per_px,
        )
        yield look
        if number < searches:
            yield replace(look, kind="search", prior=without_place(prior))


def pose_of(cut: Cut, corner_px: tuple[int, int]) -> TruePose:
    """Where a frame was cut, of a map's image at a global pixel of `ZOOM`."""
    lat_deg, lon_deg = place_of_pixel(corner_px, cut.nadir_uv)
    agl_m = cut.agl_px * ground_resolution_m_per_px(lat_deg, ZOOM)
    return TruePose(lat_deg, lon_deg, cut.rpy_rad[2], agl_m)


def _wrong_looks(
    name: str, photos: list[Photo], masks: list[tuple[tuple[int, int], np.ndarray]]
) -> Iterator[LookCase]:
    """Frames of other places, said to be at a random place of the map."""
    for number in range(LOOKS_AN_IMAGE * len(masks)):
        rng = generator(f"{ELSEWHERE} {name}", number)
        found = stranger(photos, rng)
        if found is None:
            return
        photo, cut = found
        corner_px, mask = masks[int(rng.integers(len(masks)))]
        uv = np.argwhere(mask)[int(rng.integers(np.count_nonzero(mask)))][::-1]
        lat_deg, lon_deg = place_of_pixel(corner_px, uv.astype(np.float64))
        m_per_px = ground_resolution_m_per_px(lat_deg, ZOOM)
        pose = TruePose(lat_deg, lon_deg, cut.rpy_rad[2], cut.agl_px * m_per_px)
        yield from wrong_looks(f"{photo.path.stem} on {name}", cut, pose, m_per_px, rng, number)


def wrong_looks(
    name: str, cut: Cut, pose: TruePose, m_per_px: float, rng: np.random.Generator, seed: int
) -> Iterator[LookCase]:
    """A frame that the map does not show, with a rough prior and without place."""
    prior = rough_prior(pose, cut.rpy_rad[:2], PRIOR_PX * m_per_px, rng)
    look = LookCase(
        group=ELSEWHERE,
        name=f"{name}.{seed}",
        kind="wrong",
        image=cut.image,
        camera=CAMERA,
        prior=prior,
        seed=seed,
        truth=None,
        unit_m=m_per_px,
        label_m=0.0,
    )
    yield look
    if seed % LOOKS_AN_IMAGE == 0:
        yield replace(look, kind="wrong_search", prior=without_place(prior))


def stranger(photos: list[Photo], rng: np.random.Generator) -> tuple[Photo, Cut] | None:
    """A frame of one of the images, of each place as likely as of another; None if none will."""
    places = sorted({photo.place for photo in photos})
    for _ in range(_ATTEMPTS if places else 0):
        place = places[int(rng.integers(len(places)))]
        of_place = [photo for photo in photos if photo.place == place]
        photo = of_place[int(rng.integers(len(of_place)))]
        cut = cut_of(photo, rng)
        if cut is not None:
            return photo, cut
    return None


def cut_of(photo: Photo, rng: np.random.Generator) -> Cut | None:
    """A frame of an image alone; None where it is too small or holds too little ground."""
    gray, mask = read_gray(photo)
    if min(gray.shape) < LEAST_SIDE_PX:
        return None
    # The camera hangs over the image as if it were the map.
    identity: Array = np.eye(3)
    return cut_frame(SeenGround(gray, mask, identity, mask), rng)
