from pathlib import Path

import numpy as np
import pytest
import rasterio
from geotiff_samples import marked_rgb, write_tiff
from map_samples import ORIGIN_PX, ZOOM, small_pack
from rasterio.shutil import copy as copy_raster
from rasterio.warp import transform_bounds
from test_geotiff import pack_of, worst_mark_error_px

from vwnav.geometry.geodesy import Window
from vwnav.maps.pack import MapPack

# GDAL's MBTiles driver stands for all other software that opens these files.
WORLD_M = 2 * 20037508.342789244


@pytest.fixture
def holed_pack_file(tmp_path: Path) -> Path:
    mask = np.ones((600, 700), bool)
    mask[:200, :150] = False
    return small_pack(tmp_path / "holed.mbtiles", mask=mask)


def test_gdal_reads_the_same_pixels_at_the_same_place(holed_pack_file: Path):
    with rasterio.open(holed_pack_file) as file, MapPack.open(holed_pack_file) as pack:
        assert file.driver == "MBTiles"
        x0 = round((file.bounds.left / WORLD_M + 0.5) * 256 * 2**ZOOM)
        y0 = round((0.5 - file.bounds.top / WORLD_M) * 256 * 2**ZOOM)
        image = pack.colour_image(ZOOM, Window(x0, y0, x0 + file.width, y0 + file.height))
        rgba = np.moveaxis(file.read(), 0, -1)
    assert np.array_equal(rgba[..., 3] > 0, image.mask)
    assert image.mask.sum() > 380_000
    assert np.array_equal(rgba[image.mask][:, 2::-1], image.bgr[image.mask])


def test_gdal_puts_imagery_that_is_off_the_grid_where_the_pack_does(tmp_path: Path):
    with pack_of(write_tiff(tmp_path / "a.tif", marked_rgb())) as pack:
        copy = tmp_path / "copy.tif"
        with rasterio.open(pack.path) as file:
            copy_raster(file, copy, driver="GTiff")
    with pack_of(copy) as pack:
        assert worst_mark_error_px(pack) < 0.2


def test_gdal_finds_the_coarser_levels_as_overviews(holed_pack_file: Path):
    with rasterio.open(holed_pack_file) as file:
        assert file.crs.to_epsg() == 3857
        assert file.overviews(1) == [2, 4]
        assert file.res[0] == pytest.approx(WORLD_M / 256 / 2**ZOOM)


def test_gdal_and_the_pack_agree_on_the_bounds(holed_pack_file: Path):
    with rasterio.open(holed_pack_file) as file, MapPack.open(holed_pack_file) as pack:
        west, south, east, north = transform_bounds(file.crs, "EPSG:4326", *file.bounds)
        assert (south, west, north, east) == pytest.approx(pack.bounds, abs=1e-5)


def test_the_metadata_are_those_of_mbtiles_1_3(holed_pack_file: Path):
    with rasterio.open(holed_pack_file) as file:
        tags = file.tags()
    assert tags["format"] == "png"
    assert (tags["minzoom"], tags["maxzoom"]) == (str(ZOOM - 2), str(ZOOM))
    assert {"name", "bounds", "center", "attribution", "description", "type"} <= set(tags)
    header = holed_pack_file.read_bytes()[:100]
    assert header[68:72] == b"MPBX"


def test_a_hole_in_the_map_lies_where_the_mask_says(holed_pack_file: Path):
    x, y = ORIGIN_PX
    with MapPack.open(holed_pack_file) as pack:
        mask = pack.colour_image(ZOOM, Window(x, y, x + 700, y + 600)).mask
    assert not mask[:200, :150].any()
    assert mask.sum() == 700 * 600 - 200 * 150
