"""Sites by name, as commands take them (`sim:SITE`), and their map look as a raster."""

import math
import os
import re
from pathlib import Path

import numpy as np

from vwnav.errors import ConfigError
from vwnav.geometry.geodesy import LocalFrame, Window
from vwnav.maps.build.raster import DrawnSource, local_georeference
from vwnav.maps.image import MapImage
from vwnav.sim.site import Site, generator_fingerprint

SITE_PREFIX = "sim:"
DEFAULT_SEED = 1
UNRELATED_SEED = 2
# Every site has an airfield about its home, and airfields resemble each other. The unrelated one
# lies so that the default home is among its fields: nothing that the camera sees is on its map.
UNRELATED_HOME_NE_M = (-330.0, -380.0)
NAMED_SEEDS = {"default": DEFAULT_SEED, "unrelated": UNRELATED_SEED}
MAP_NORTH_M = 1180.0  # size of the map, home in the middle
MAP_EAST_M = 1580.0
MAP_M_PER_PX = 0.3
MAP_SIGMA_M = 0.5
_PATTERN = re.compile(r"sim:(\w+)(?:@(-?[\d.]+),(-?[\d.]+))?")


def is_site(text: str) -> bool:
    """Whether a command's argument names a generated site."""
    return text.startswith(SITE_PREFIX)


def parse_site(text: str) -> Site:
    """The site of `sim:default`, `sim:unrelated` or `sim:SEED`, each with `@LAT,LON` of its home.

    Raises:
        ConfigError: it is none of these.
    """
    found = _PATTERN.fullmatch(text)
    name = found[1] if found else ""
    if found is None or not (name in NAMED_SEEDS or name.isdecimal()):
        raise ConfigError(
            f"no site {text!r}: expected sim:default, sim:unrelated or sim:SEED, "
            "with @LAT,LON after it to put it elsewhere"
        )
    seed = NAMED_SEEDS[name] if name in NAMED_SEEDS else int(name)
    if found[2] is None:
        return _unrelated_site() if name == "unrelated" else Site(seed)
    try:
        lat_deg, lon_deg = float(found[2]), float(found[3])
    except ValueError as error:
        raise ConfigError(f"{text!r}: LAT,LON are not numbers") from error
    if not (abs(lat_deg) < 80.0 and abs(lon_deg) <= 180.0):
        raise ConfigError(f"{text!r}: latitude within 80, longitude within 180 degrees")
    return Site(seed, lat_deg, lon_deg)


def _unrelated_site() -> Site:
    home = Site(DEFAULT_SEED)
    frame = LocalFrame(home.home_lat_deg, home.home_lon_deg, 0.0)
    lat_deg, lon_deg, _ = frame.to_geodetic(np.array([*UNRELATED_HOME_NE_M, 0.0]))
    return Site(UNRELATED_SEED, float(lat_deg), float(lon_deg))


def map_raster(site: Site) -> DrawnSource:
    """The map look of a site as a raster; drawn window by window when it is read."""
    frame = LocalFrame(site.home_lat_deg, site.home_lon_deg, 0.0)
    north0_m, east0_m = MAP_NORTH_M / 2.0, -MAP_EAST_M / 2.0
    size_wh = (math.ceil(MAP_EAST_M / MAP_M_PER_PX), math.ceil(MAP_NORTH_M / MAP_M_PER_PX))

    def draw(window: Window) -> MapImage:
        height, width = window.shape
        bgr = site.render(
            "map",
            north0_m - window.y0 * MAP_M_PER_PX,
            east0_m + window.x0 * MAP_M_PER_PX,
            (width, height),
            MAP_M_PER_PX,
        )
        return MapImage(bgr, np.ones((height, width), np.bool_))

    georeference = local_georeference(frame, (north0_m, east0_m), MAP_M_PER_PX)
    return DrawnSource(f"sim:{site.seed}", size_wh, georeference, draw)


def cache_folder() -> Path:
    """The user's own for what is drawn once: `$XDG_CACHE_HOME/vwnav`, else `~/.cache/vwnav`.

    Raises:
        ConfigError: this user has none, or may not make it: in a container, say.
    """
    root = os.environ.get("XDG_CACHE_HOME")
    try:
        folder = (Path(root) if root else Path.home() / ".cache") / "vwnav"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError) as error:  # Python knows no home of this user
        raise ConfigError(
            f"no place for what is drawn of a site ({error}): set XDG_CACHE_HOME to a folder that "
            "may be written"
        ) from error
    return folder


def tiles_folder(site: Site) -> Path:
    """Where the tiles of a site are kept, until it is drawn otherwise."""
    return cache_folder() / f"site-{site.seed}-{generator_fingerprint()}"
