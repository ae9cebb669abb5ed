"""Writes pairs of images of one place on two days, to train features that outlast a season.

`python -m vwnav.sim.pairs -o DIR --count N --seed0 S` writes `NNNN_a.jpg` (the map's day) and
`NNNN_b.jpg` (the day of the flight) of the same window: pixel for pixel the same ground.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

from vwnav.sim.scenery.draft import HALF_EAST_M, HALF_NORTH_M
from vwnav.sim.scenery.landscape import LookName
from vwnav.sim.site import FIRST_TRAINING_SEED, Site

_PAIRS_PER_SITE = 8
_M_PER_PX = (0.15, 0.6)
_JPEG_QUALITY = 92


def write_pairs(folder: Path, count: int, seed0: int, size_px: int = 512) -> None:
    """Write `count` pairs from the sites `seed0`, `seed0 + 1`, ... at random places and scales.

    Raises:
        ValueError: a seed below `FIRST_TRAINING_SEED`: those sites are kept for flying.
    """
    if seed0 < FIRST_TRAINING_SEED:
        raise ValueError(
            f"expected seed0 >= {FIRST_TRAINING_SEED}, got {seed0}: lower ones are kept for flying"
        )
    folder.mkdir(parents=True, exist_ok=True)
    for first in range(0, count, _PAIRS_PER_SITE):
        seed = seed0 + first // _PAIRS_PER_SITE
        site, rng = Site(seed), np.random.default_rng([0x9A12, seed])
        for number in range(first, min(first + _PAIRS_PER_SITE, count)):
            m_per_px = float(np.exp(rng.uniform(*np.log(_M_PER_PX))))
            centre = _place(rng, m_per_px * size_px)
            _write(folder / f"{number:04d}", site, centre, m_per_px, size_px)


def _place(rng: np.random.Generator, side_m: float) -> tuple[float, float]:
    """North and east of a window's centre: a quarter of them near home, the rest anywhere."""
    if rng.uniform() < 0.25:
        return float(rng.normal(0.0, 70.0)), float(rng.normal(0.0, 130.0))
    reach = np.array([HALF_NORTH_M, HALF_EAST_M]) - side_m / 2.0
    north, east = rng.uniform(-reach, reach)
    return float(north), float(east)


def _write(
    stem: Path, site: Site, centre: tuple[float, float], m_per_px: float, size_px: int
) -> None:
    half_m = size_px * m_per_px / 2.0
    corner = (centre[0] + half_m, centre[1] - half_m)
    looks: dict[str, LookName] = {"a": "map", "b": "flight"}
    for letter, look in looks.items():
        image = site.render(look, *corner, (size_px, size_px), m_per_px)
        name = stem.with_name(f"{stem.name}_{letter}.jpg")
        cv2.imwrite(str(name), image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])


def main() -> None:
    """Read the command line and write the pairs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write to")
    parser.add_argument("--count", type=int, default=100, help="how many pairs")
    parser.add_argument("--seed0", type=int, default=FIRST_TRAINING_SEED, help="first site's seed")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    write_pairs(options.output, options.count, options.seed0)


if __name__ == "__main__":
    main()
