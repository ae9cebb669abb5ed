"""Short flights low over sparse ground: found by one image alone, or by several joined.

Frames are cut along a straight line from one date of a registered pair, or from one day of a
drawing; the map shows the other. So low each shows little, and many are too weak alone. As many
flights are over places that the map does not show. After an outage place, heading and height are
known roughly; of every fourth flight nothing is known but the height.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vwnav.bench.features.scenes import generator
from vwnav.bench.localizer.boards import (
    LEVELS,
    map_source,
    pose_of,
    seen_ground,
    shuffled_pairs,
    strange_photos,
)
from vwnav.bench.localizer.images import LEAST_SIDE_PX, Pair, Photo, apart, read_gray
from vwnav.bench.localizer.looks import (
    CAMERA,
    TILT_RAD,
    ZOOM,
    Board,
    Cut,
    LookCase,
    LookKind,
    SeenGround,
    cut_at,
    map_pixel,
    rough_prior,
    without_place,
)
from vwnav.bench.localizer.repeating import DRAWN_PX, KINDS, TEXTURE, drawn, sand
from vwnav.geometry.geodesy import ground_resolution_m_per_px
from vwnav.types import (
    OdometryMotion,
    Rejected,
    RejectReason,
)

SEQUENCES = "sequences"
IMAGES = 10
SEARCHED_EVERY = 4  # flights: a search takes as long as ten looks with a prior
OUTAGE_M = 40.0  # one sigma of the place
SHOWN = 3  # pairs on a map
FOOTPRINT_PX = (155.0, 190.0)  # width of the ground of a frame
STEP = 0.5  # of it, between two frames
# One sigma of what odometry errs by: share of a step, and of the heading a step, radians.
STEP_RATIO, STEP_YAW_RAD = 0.01, math.radians(0.3)
# Nothing but texture; more of it that only one day has is sparser.
SAND, SAND_TEXTURES = "sand", ((9.0, 5.0), (9.0, 6.0), (9.0, 7.0), (9.0, 8.0))
_CELL_PX = 1152
_ATTEMPTS = 200


@dataclass(frozen=True, slots=True, eq=False)
class ShortFlight:
    """Images of one flight.

    Attributes:
        looks: one image each; their truth is None where the map does not show the place.
        motions: (n,) between them, the first of nothing.
        yaws_rad: (n,) headings as odometry counts them.
    """

    looks: list[LookCase]
    motions: list[OdometryMotion | Rejected]
    yaws_rad: list[float]


FlownBoard = tuple[Board, list[ShortFlight]]


def flight_boards(folder: Path, flights: int) -> Iterator[FlownBoard]:
    """Maps of a few pairs of the training images, and flights over them and over other places.

    Raises:
        VwnavError: of an image.
    """
    ordered = shuffled_pairs(folder, "train")
    strangers, sources = strange_photos(folder, "train", ordered), list(ordered)
    made = number = 0
    while made < flights and number < flights * len(sources):
        names = [sources[(SHOWN * number + i) % len(sources)] for i in range(SHOWN)]
        shown = [ordered[name][number % len(ordered[name])] for name in dict.fromkeys(names)]
        board, flown = _board(number, shown, strangers)
        made += sum(each.looks[0].truth is not None for each in flown)
        number += 1
        if flown:
            yield board, flown


def drawn_boards(flights: int) -> Iterator[FlownBoard]:
    """Drawn maps of sand, and of each kind of ground that repeats; so many flights over each.

    Others are over another drawing of the same kind.
    """
    for number in range(flights):
        for kind, draw in (KINDS | {SAND: sand}).items():
            corner_px = map_pixel((0, 0))
            texture = SAND_TEXTURES[number % len(SAND_TEXTURES)] if kind == SAND else TEXTURE
            source, ground = drawn(kind, draw, number, corner_px, texture)
            _, other = drawn(kind, draw, flights + number, corner_px, texture)
            searched = number % SEARCHED_EVERY == 0
            found = _flights(kind, f"{number}", ground, corner_px, DRAWN_PX, searched)
            name = f"{flights + number} on {number}"
            strange = _flights(kind, name, other, corner_px, DRAWN_PX, searched)
            yield Board([source], LEVELS, []), [*found, *map(_astray, strange)]


def _astray(flight: ShortFlight) -> ShortFlight:
    """The same on a map that does not show it."""
    wrong: dict[LookKind, LookKind] = {"prior": "wrong", "search": "wrong_search"}
    looks = [replace(each, kind=wrong[each.kind], truth=None) for each in flight.looks]
    return replace(flight, looks=looks)


def _board(number: int, shown: list[Pair], strangers: list[Photo]) -> FlownBoard:
    sources, flown = [], []
    elsewhere = [p for p in strangers if all(apart(p.place, pair.frame.place) for pair in shown)]
    for index, pair in enumerate(shown):
        corner_px = map_pixel((_CELL_PX * index, 0))
        gray, mask = read_gray(pair.map_)
        sources.append(map_source(pair, corner_px, mask))
        ground, label_px = seen_ground(pair, gray, mask)
        name = f"{pair.frame.path.stem} {number}"
        searched = number % SEARCHED_EVERY == 0
        flown += _flights(pair.source, name, ground, corner_px, label_px, searched)
        rng = generator(f"{SEQUENCES} elsewhere", number, index)
        photo = elsewhere[int(rng.integers(len(elsewhere)))]
        gray, mask = read_gray(photo)
        strange = SeenGround(gray, mask, np.eye(3), mask)
        name = f"{photo.path.stem} on {name}"
        flown += map(_astray, _flights("elsewhere", name, strange, corner_px, 0.0, searched))
    return Board(sources, LEVELS, []), flown


def _flights(
    group: str,
    name: str,
    ground: SeenGround,
    corner_px: tuple[int, int],
    label_px: float,
    searched: bool,
) -> list[ShortFlight]:
    """A flight over a ground, and the same without place and heading; none where it is small."""
    rng = generator(f"{SEQUENCES} {group} {name}", 0)
    cuts = _cuts(ground, rng) if min(ground.gray.shape) >= LEAST_SIDE_PX else None
    if cuts is None:
        return []
    # Odometry counts headings from anywhere.
    counted_rad = float(rng.uniform(-math.pi, math.pi))
    yaws_rad = counted_rad + np.cumsum(rng.normal(0.0, STEP_YAW_RAD, len(cuts)))
    off_rad = counted_rad - cuts[0].rpy_rad[2]
    motions: list[OdometryMotion | Rejected] = [Rejected(0.0, RejectReason.NOT_TRIED)]
    motions += [
        _motion(i, cuts, off_rad, 1.0 + rng.normal(0.0, STEP_RATIO)) for i in range(1, len(cuts))
    ]
    looks = [_look(cut, (group, name, i), corner_px, label_px) for i, cut in enumerate(cuts)]
    found = [ShortFlight(looks, motions, yaws_rad.tolist())]
    if searched:
        without = [replace(e, kind="search", prior=without_place(e.prior)) for e in looks]
        found.append(ShortFlight(without, motions, yaws_rad.tolist()))
    return found


def _cuts(ground: SeenGround, rng: np.random.Generator) -> list[Cut] | None:
    """Frames along a straight line, ahead; None where no line stays over the ground."""
    h, w = ground.map_mask.shape
    for _ in range(_ATTEMPTS):
        width_px = float(rng.uniform(*FOOTPRINT_PX))
        agl_px = width_px * CAMERA.K[0, 0] / CAMERA.width_px
        yaw_rad = float(rng.uniform(-math.pi, math.pi))
        step_uv = STEP * width_px * np.array([math.sin(yaw_rad), -math.cos(yaw_rad)])
        first_uv = rng.uniform((0.0, 0.0), (w, h))
        ends_uv = first_uv + (IMAGES - 1) * step_uv
        if not (0.0 <= ends_uv[0] < w and 0.0 <= ends_uv[1] < h):
            continue
        tilts = rng.normal(0.0, TILT_RAD, (IMAGES, 2))
        places = [first_uv + i * step_uv for i in range(IMAGES)]
        cuts = []
        for place, (roll_rad, pitch_rad) in zip(places, tilts.tolist(), strict=True):
            cut = cut_at(ground, place, (roll_rad, pitch_rad, yaw_rad), agl_px)
            if cut is None:
                break
            cuts.append(cut)
        if len(cuts) == IMAGES:
            return cuts
    return None


def _look(
    cut: Cut, name: tuple[str, str, int], corner_px: tuple[int, int], label_px: float
) -> LookCase:
    """An image of a flight; `name` is its group, the flight's name and its number.

    The prior is wrong by the same in all of them.
    """
    group, flight, number = name
    pose = pose_of(cut, corner_px)
    rng = generator(f"{SEQUENCES} {group} {flight}", 1)
    return LookCase(
        group=group,
        name=f"{flight}.{number}",
        kind="prior",
        image=cut.image,
        camera=CAMERA,
        prior=rough_prior(pose, cut.rpy_rad[:2], OUTAGE_M, rng),
        seed=number,
        truth=pose,
        unit_m=(unit_m := ground_resolution_m_per_px(pose.lat_deg, ZOOM)),
        label_m=label_px * unit_m,
    )


def _motion(number: int, cuts: list[Cut], off_rad: float, stretched: float) -> OdometryMotion:
    """The way to an image as odometry tells it: turned, and a little too long or short."""
    (du, dv), agl_px = cuts[number].nadir_uv - cuts[number - 1].nadir_uv, cuts[number].agl_px
    c, s = math.cos(off_rad), math.sin(off_rad)
    way_px = stretched * np.array([c * -dv - s * du, s * -dv + c * du, 0.0])
    return OdometryMotion(
        t0_s=float(number - 1),
        t1_s=float(number),
        displacement_ned_m=way_px,
        covariance_ned_m2=(STEP_RATIO * STEP * agl_px) ** 2 * np.eye(3),
        yaw_increment_rad=0.0,
        sigma_yaw_rad=STEP_YAW_RAD,
        agl_m=agl_px,
        tracks=100,
    )
