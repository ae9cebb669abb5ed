from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from geotiff_samples import LEFT_M, PIXEL_M, TOP_M, UTM, marked_rgb, texture_rgb, write_tiff
from map_samples import ORIGIN_PX, ZOOM, SiftStub, small_pack, textured
from rasterio.crs import CRS
from rasterio.shutil import copy as copy_raster
from test_geotiff import pack_of, worst_mark_error_px

from vwnav.errors import MapError
from vwnav.geometry.geodesy import Window
from vwnav.maps.build.builder import BuildOptions, build_pack
from vwnav.maps.build.sources import default_options, open_sources
from vwnav.maps.pack import MapPack


def write_world_image(folder: Path, suffix: str, world: str, *, prj: bool) -> Path:
    """A marked image whose world file names the centre of its first pixel."""
    path = folder / f"marks{suffix}"
    cv2.imwrite(str(path), np.moveaxis(marked_rgb(), 0, -1), [cv2.IMWRITE_JPEG_QUALITY, 98])
    numbers = (PIXEL_M, 0, 0, -PIXEL_M, LEFT_M + PIXEL_M / 2, TOP_M - PIXEL_M / 2)
    path.with_suffix(world).write_text("\n".join(f"{number:.6f}" for number in numbers))
    if prj:
        path.with_suffix(".prj").write_text(CRS.from_string(UTM).to_wkt(version="WKT1_ESRI"))
    return path


@pytest.mark.parametrize(
    ("suffix", "world"),
    [(".jpg", ".jgw"), (".jpg", ".wld"), (".png", ".pgw"), (".png", ".wld"), (".tif", ".tfw")],
)
@pytest.mark.parametrize("prj", [True, False])
def test_an_image_with_a_world_file_lies_in_its_place(tmp_path, suffix, world, prj):
    path = write_world_image(tmp_path, suffix, world, prj=prj)
    (source,) = open_sources([path], None if prj else UTM)
    build_pack([source], tmp_path / "a.mbtiles", [])
    with MapPack.open(tmp_path / "a.mbtiles") as pack:
        assert worst_mark_error_px(pack) < 0.2


def test_a_world_file_without_a_coordinate_system_is_asked_about(tmp_path: Path):
    path = write_world_image(tmp_path, ".jpg", ".jgw", prj=False)
    with pytest.raises(MapError, match="--crs EPSG"):
        open_sources([path])


def test_a_damaged_prj_is_one_clear_error(tmp_path: Path):
    path = write_world_image(tmp_path, ".jpg", ".jgw", prj=False)
    path.with_suffix(".prj").write_text("nonsense")
    with pytest.raises(MapError, match="not a coordinate system"):
        open_sources([path])


def test_a_folder_stands_for_its_table_or_its_rasters(tmp_path: Path):
    write_tiff(tmp_path / "b.tif", texture_rgb())
    write_world_image(tmp_path, ".jpg", ".jgw", prj=True)
    (tmp_path / "notes.csv").write_text("a,b\n1,2\n")
    assert [source.name for source in open_sources([tmp_path])] == ["b.tif", "marks.jpg"]
    (tmp_path / "map.csv").write_text("file,north,west,south,east\nmarks.jpg,60,22,59,23\n")
    assert [source.name for source in open_sources([tmp_path])] == ["marks.jpg"]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("corners.csv", "file,north,west,south,east\na.png,60,22,59,x\n", "line 2: a corner"),
        ("Map.csv", "file,north,west,south\na.png,60,22,59\n", "no column for east"),
    ],
)
def test_a_folder_is_not_built_without_the_table_that_is_in_it(tmp_path, name, content, message):
    write_tiff(tmp_path / "b.tif", texture_rgb())
    (tmp_path / name).write_text(content)
    with pytest.raises(MapError, match=message):
        open_sources([tmp_path])


def test_hidden_files_are_no_sources_of_a_folder(tmp_path: Path):
    write_tiff(tmp_path / "b.tif", texture_rgb())
    write_world_image(tmp_path, ".jpg", ".jgw", prj=True)
    for name in ("._b.tif", "._marks.jpg", "._marks.jgw", "._map.csv"):
        (tmp_path / name).write_bytes(b"\0\5\x16\7")
    (tmp_path / "dir.tif").mkdir()
    assert [source.name for source in open_sources([tmp_path])] == ["b.tif", "marks.jpg"]


def test_images_may_be_listed_beside_their_table(tmp_path: Path):
    (tmp_path / "tables").mkdir()
    table = tmp_path / "tables" / "map.csv"
    table.write_text("file,north,west,south,east\na.png,60,22,59,23\n")
    cv2.imwrite(str(tmp_path / "a.png"), textured(30, 30))
    assert [source.name for source in open_sources([tmp_path / "a.png", table])] == ["a.png"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("none.tif", "no such file"),
        ("empty", "holds no GeoTIFF"),
        ("lonely.png", "not georef"),
    ],
)
def test_what_is_no_source_is_one_clear_error(tmp_path: Path, name: str, message: str):
    (tmp_path / "empty").mkdir()
    cv2.imwrite(str(tmp_path / "lonely.png"), textured(30, 30))
    with pytest.raises(MapError, match=message):
        open_sources([tmp_path / name])


def rebuilt(path: Path, extractor: SiftStub) -> None:
    sources = open_sources([path])
    build_pack(sources, path, [extractor], default_options([path], sources))


def test_a_pack_is_rebuilt_from_itself_pixel_for_pixel(tmp_path: Path):
    mask = np.ones((600, 700), bool)
    mask[:200, :150] = False
    path = small_pack(tmp_path / "a.mbtiles", mask=mask)
    x, y = ORIGIN_PX
    window = Window(x - 5, y - 5, x + 705, y + 605)
    with MapPack.open(path) as pack:
        before = pack.colour_image(ZOOM, window)
    rebuilt(path, SiftStub())
    with MapPack.open(path) as pack:
        after = pack.colour_image(ZOOM, window)
    assert np.array_equal(before.mask, after.mask)
    assert np.array_equal(before.bgr, after.bgr)


def test_a_rebuilt_pack_keeps_what_it_says_and_has_the_new_features(tmp_path: Path):
    options = BuildOptions(name="field", attribution="(c)", georeference_sigma_m=0.3)
    path = small_pack(tmp_path / "a.mbtiles", options=options)
    said = "name", "attribution", "georeference_sigma_m", "bounds", "levels", "sources"
    with MapPack.open(path) as pack:
        before = [getattr(pack, what) for what in said]
    rebuilt(path, SiftStub("sift-test-2"))
    with MapPack.open(path) as pack:
        assert [getattr(pack, what) for what in said] == before
        pack.check_features(SiftStub("sift-test-2"))


def test_imagery_of_another_program_in_mbtiles_is_a_source(tmp_path: Path):
    with pack_of(write_tiff(tmp_path / "a.tif", marked_rgb())) as pack:
        path = pack.path
    foreign = tmp_path / "foreign.mbtiles"
    with rasterio.open(path) as ours:
        copy_raster(ours, foreign, driver="MBTiles")
    sources = open_sources([foreign])
    build_pack(sources, tmp_path / "b.mbtiles", [], default_options([foreign], sources))
    with MapPack.open(tmp_path / "b.mbtiles") as pack:
        assert worst_mark_error_px(pack) < 0.3


def test_the_first_path_gives_the_name(tmp_path: Path):
    path = write_tiff(tmp_path / "campus.tif", texture_rgb())
    assert default_options([path], open_sources([path])).name == "campus"
