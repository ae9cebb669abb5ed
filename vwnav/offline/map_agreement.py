"""Holds the overlapping sources of a map against each other, block by block.

As a picture is found on the map, a block of the one source is looked for on the other: by the same
features, and believed where the agreement of its matches cannot be chance.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from vwnav.geometry.geodesy import Window, lat_lon_from_mercator_px, mercator_px_per_m
from vwnav.geometry.homography import transform_points
from vwnav.maps.build.agreement import (
    Agreement,
    Apart,
    Overlap,
    overlaps,
    pair_agreement,
)
from vwnav.maps.build.builder import BuildOptions, Progress
from vwnav.maps.build.keypoints import usable_features
from vwnav.maps.build.raster import RasterSource
from vwnav.maps.build.warp import PlacedRaster, compose
from vwnav.maps.image import MapImage
from vwnav.types import FEATURE_NAMES, FeatureExtractor, Features
from vwnav.vision.candidates import MAX_RIVALRY
from vwnav.vision.config import LocalizerConfig
from vwnav.vision.consensus import Consensus, SimilarityBounds, find_consensus
from vwnav.vision.matching import match

REACH_M = 25.0  # what lies farther apart is not found
MOST_BLOCKS = 200  # that are looked at, of all pairs together
LEAST_SIGMA_M = 0.1  # no map is taken to be better by what is estimated
WORTH_A_LOOK_M = 5.0  # apart: the place is named
_FAR_MORE = 2.0  # times what was given: that is said
_TRIES = 4  # so many blocks are drawn for each that is to have data
_MARGIN_PX = 32  # extracted around a block
_KEYPOINTS_PER_PX = 1.0 / 150.0
_THRESHOLD_PX = 4.0  # of agreement: waves bend a block by more than a picture
_MAX_STRETCH = 1.15
_NEAR_IDENTITY = SimilarityBounds(1.06, math.radians(4.0))
_SAME_PICTURE = 0.97  # correlation from which on two sources are one picture, and no two witnesses
_LEAST_DATA = 0.5  # of a block, in both
_SEED = 7


def agreement_of(
    sources: Sequence[RasterSource],
    extractors: Sequence[FeatureExtractor],
    progress: Progress | None = None,
) -> Agreement | None:
    """How well the sources of a map agree where they overlap.

    Args:
        sources: of a build.
        extractors: of the build; the learned one looks if it is there, else SIFT, else ORB.
        progress: called with (what, done, total).

    Returns:
        None where no two overlap, or nothing is known by it: too few places where they show the
        same ground, or one picture twice.

    Raises:
        MapError: a source cannot be read.
    """
    found = overlaps([PlacedRaster.of(source) for source in sources])
    if not found or not extractors:
        return None
    extractor = min(extractors, key=lambda each: FEATURE_NAMES.index(each.name))
    report = progress or (lambda what, done, total: None)
    share = MOST_BLOCKS // len(found)
    total, pairs = share * len(found), []
    for number, overlap in enumerate(found):
        places: list[Apart] = []
        for looked, images in enumerate(_drawn(overlap, share)):
            place = _apart(overlap, *images, extractor)
            places += [] if place is None else [place]
            report("agreement", number * share + looked + 1, total)
        report("agreement", (number + 1) * share, total)
        names = overlap.first.source.name, overlap.second.source.name
        pair = pair_agreement(names, places)
        pairs += [] if pair is None else [pair]
    return Agreement(tuple(sorted(pairs, key=lambda pair: -pair.rms_m))) if pairs else None


def with_agreement(options: BuildOptions, agreement: Agreement) -> tuple[BuildOptions, list[str]]:
    """What a pack is told of its error by how its sources agree, and the lines that say so.

    A sigma that was given stands.
    """
    stated_m, sigma_m = options.georeference_sigma_m, max(agreement.sigma_m, LEAST_SIGMA_M)
    lines = []
    if stated_m is None:
        lines.append(f"{_summary(agreement)}: good to {sigma_m:.1f} m (1 sigma)")
        options = replace(
            options, georeference_sigma_m=round(sigma_m, 2), georeference_basis="estimated"
        )
    elif sigma_m > _FAR_MORE * stated_m:
        lines.append(
            f"{_summary(agreement)}, which speaks for {sigma_m:.1f} m (1 sigma); "
            f"the {stated_m:g} m that was given stands"
        )
    pair = max(agreement.pairs, key=lambda each: each.worst.distance_m)
    if pair.worst.distance_m > WORTH_A_LOOK_M:
        lines.append(
            f"{' and '.join(pair.names)} are {pair.worst.distance_m:.1f} m apart at "
            f"{pair.worst.lat_deg:.6f},{pair.worst.lon_deg:.6f}, the most there is: look there"
        )
    return options, lines


def _summary(agreement: Agreement) -> str:
    """The sources and how far they are apart, in words."""
    worst, count = agreement.pairs[0], len(agreement.pairs)
    north_m, east_m = worst.shift_ne_m
    shift = (
        f"shift {abs(north_m):.1f} m {'north' if north_m >= 0.0 else 'south'} and "
        f"{abs(east_m):.1f} m {'east' if east_m >= 0.0 else 'west'}, waves of {worst.waves_m:.1f} m"
    )
    names, places = " and ".join(worst.names), f"at {len(worst.places)} places"
    if count == 1:
        return f"{names} agree to {agreement.rms_m:.1f} m ({shift}, {places})"
    return (
        f"{count} pairs of sources agree to {agreement.rms_m:.1f} m "
        f"(the worst: {names}, {shift}, {places})"
    )


def _drawn(overlap: Overlap, count: int) -> Iterator[tuple[Window, MapImage, MapImage]]:
    """At most `count` blocks that have data, with their images."""
    drawn = 0
    for block in islice(overlap.blocks(_SEED), _TRIES * count):
        images = _images(overlap, block)
        if images is not None:
            yield block, *images
            drawn += 1
            if drawn == count:
                return


def _reach_px(overlap: Overlap) -> int:
    return math.ceil(REACH_M / overlap.m_per_px)


def _images(overlap: Overlap, block: Window) -> tuple[MapImage, MapImage] | None:
    """The block on the first source, and it with all around that is searched on the second."""
    near, reach_px = block.grown(_MARGIN_PX), _reach_px(overlap)
    first = compose([overlap.first], overlap.zoom, near)
    if first.mask.mean() < _LEAST_DATA:
        return None
    second = compose([overlap.second], overlap.zoom, near.grown(reach_px))
    there = second.mask[reach_px:-reach_px, reach_px:-reach_px]
    return None if (first.mask & there).mean() < _LEAST_DATA else (first, second)


def _is_one_picture(first: MapImage, second: MapImage, reach_px: int) -> bool:
    """Whether both show the very same picture in the same place."""
    inner = slice(reach_px, -reach_px)
    shared = first.mask & second.mask[inner, inner]
    here, there = first.gray[shared], second.gray[inner, inner][shared]
    if here.std() == 0.0 or there.std() == 0.0:
        return False
    return bool(np.corrcoef(here.astype(np.float64), there)[0, 1] > _SAME_PICTURE)


def _apart(
    overlap: Overlap,
    block: Window,
    first: MapImage,
    second: MapImage,
    extractor: FeatureExtractor,
) -> Apart | None:
    """How far apart both show the block; None where that is not known."""
    reach_px = _reach_px(overlap)
    if _is_one_picture(first, second, reach_px):
        return None
    near, around = (
        usable_features(image, extractor, round(image.mask.size * _KEYPOINTS_PER_PX))
        for image in (first, second)
    )
    h, w = first.mask.shape
    consensus = _consensus(_inner(near, (w, h)), around, (w, h), extractor)
    if consensus is None:
        return None
    uv = consensus.uv_view
    mapped = transform_points(consensus.H_map_view, uv)
    moved_px = mapped - reach_px - uv
    x, y = np.array(block[:2]) - _MARGIN_PX + uv.mean(axis=0) + 0.5
    lat_deg, lon_deg = lat_lon_from_mercator_px(float(x), float(y), overlap.zoom)
    px_per_m = np.array(mercator_px_per_m(lat_deg, overlap.zoom))
    east_m, south_m = moved_px.mean(axis=0) / px_per_m
    apart_ne_m = np.array([-south_m, east_m])
    if np.linalg.norm(apart_ne_m) > REACH_M:
        return None
    scatter_px = math.sqrt(float(np.mean((mapped - consensus.uv_map) ** 2)))
    m_per_px = 1.0 / float(px_per_m.mean())
    return Apart(
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        apart_ne_m=apart_ne_m,
        within_m=math.sqrt(float(moved_px.var(axis=0).mean())) * m_per_px,
        sigma_m=scatter_px / math.sqrt(consensus.cells) * m_per_px,
    )


def _inner(features: Features, size_wh: tuple[int, int]) -> Features:
    """Those inside of the margin."""
    low, high = _MARGIN_PX - 0.5, np.array(size_wh) - _MARGIN_PX - 0.5
    inside = ((features.uv >= low) & (features.uv < high)).all(axis=1)
    return features.take(np.asarray(inside, np.bool_))


def _consensus(
    first: Features, second: Features, size_wh: tuple[int, int], extractor: FeatureExtractor
) -> Consensus | None:
    """What the matches agree upon, None where it may be chance or another place as well."""
    pairs = match(first, second)
    settings = LocalizerConfig()
    consensus = find_consensus(
        first.uv[pairs[:, 0]].astype(np.float64),
        second.uv[pairs[:, 1]].astype(np.float64),
        size_wh,
        _NEAR_IDENTITY,
        _THRESHOLD_PX,
        _MAX_STRETCH,
        _SEED,
    )
    if consensus is None:
        return None
    decades = -consensus.log10_nfa / extractor.log10_per_decade
    believed = decades >= settings.min_decades
    alone = consensus.rival_cells <= MAX_RIVALRY * consensus.cells
    return consensus if believed and alone else None
