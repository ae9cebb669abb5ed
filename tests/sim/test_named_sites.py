"""Sites by name, and their map look as a raster with a true georeference."""

from pathlib import Path

import numpy as np
import pytest

from vwnav.errors import ConfigError
from vwnav.geometry.geodesy import LocalFrame, Window
from vwnav.sim.named_sites import (
    MAP_M_PER_PX,
    MAP_NORTH_M,
    cache_folder,
    is_site,
    map_raster,
    parse_site,
)


def test_the_unrelated_site_has_its_airfield_elsewhere():
    default, unrelated = parse_site("sim:default"), parse_site("sim:unrelated")
    assert default.seed != unrelated.seed
    frame = LocalFrame(default.home_lat_deg, default.home_lon_deg, 0.0)
    home = frame.to_ned(unrelated.home_lat_deg, unrelated.home_lon_deg, 0.0)
    assert np.hypot(*home[:2]) > 400.0


def test_a_site_can_be_put_where_another_simulator_flies():
    site = parse_site("sim:7@60.403,-22.461")
    assert (site.seed, site.home_lat_deg, site.home_lon_deg) == (7, 60.403, -22.461)


@pytest.mark.parametrize("text", ["sim:", "sim:nowhere", "sim:1@95,0", "sim:1@1", "sim:1@1.2.3,4"])
def test_anything_else_is_refused_with_what_is_expected(text):
    with pytest.raises(ConfigError):
        parse_site(text)


def test_only_names_with_the_prefix_are_sites():
    assert is_site("sim:default")
    assert not is_site("/dev/video0")


def test_the_raster_lies_about_home():
    site = parse_site("sim:default")
    raster = map_raster(site)
    u, v = raster.georeference.pixel_from_lat_lon(
        np.array([site.home_lat_deg]), np.array([site.home_lon_deg])
    )
    assert np.allclose([u[0], v[0]], np.array(raster.size_wh) / 2.0, atol=1.0)


def test_the_raster_draws_what_the_site_shows_there():
    site = parse_site("sim:default")
    frame = LocalFrame(site.home_lat_deg, site.home_lon_deg, 0.0)
    raster = map_raster(site)
    drawn = raster.window(Window(1000, 1000, 1064, 1064))
    lat, lon = raster.georeference.lat_lon_from_pixel(np.array([1000.0]), np.array([1000.0]))
    corner = frame.to_ned(lat, lon, 0.0)[0]
    assert corner[0] == pytest.approx(MAP_NORTH_M / 2.0 - 1000 * MAP_M_PER_PX, abs=0.05)
    assert drawn.bgr.shape == (64, 64, 3)
    assert drawn.mask.all()


def test_who_has_no_home_is_told_what_to_set(monkeypatch, tmp_path):
    def nobody() -> None:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", nobody)
    with pytest.raises(ConfigError, match="set XDG_CACHE_HOME"):
        cache_folder()
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(ConfigError, match="set XDG_CACHE_HOME"):
        cache_folder()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert cache_folder().is_dir()
