from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
from geotiff_samples import (
    LEFT_M,
    TOP_M,
    TRANSFORM,
    found_mark,
    marked_rgb,
    marks_lat_lon,
    texture_rgb,
    write_palette_tiff,
    write_tiff,
)
from map_samples import SiftStub
from rasterio.transform import Affine
from rasterio.warp import Resampling, reproject, transform_bounds

from vwnav.errors import MapError
from vwnav.geometry.geodesy import Window, mercator_px
from vwnav.maps.build.builder import build_pack
from vwnav.maps.build.geotiff import RasterFile, read_heights
from vwnav.maps.build.warp import PlacedRaster
from vwnav.maps.pack import MapPack


def pack_of(path: Path, extractors=(), crs: str | None = None) -> MapPack:
    output = path.with_suffix(".mbtiles")
    build_pack([RasterFile(path, crs)], output, extractors)
    return MapPack.open(output)


def worst_mark_error_px(pack: MapPack, level: int = 0) -> float:
    zoom = pack.levels[level].zoom
    window = pack.window(zoom)
    gray, _ = pack.image(zoom, *window)
    errors = []
    for lat_deg, lon_deg in marks_lat_lon():
        x, y = mercator_px(lat_deg, lon_deg, zoom)
        expected = np.array([x - window.x0, y - window.y0]) - 0.5
        errors.append(np.linalg.norm(found_mark(gray, expected) - expected))
    return max(errors)


@pytest.mark.parametrize("level", [0, 1])
def test_marks_in_utm_lie_in_the_pack_where_pyproj_puts_them(tmp_path: Path, level: int):
    with pack_of(write_tiff(tmp_path / "marks.tif", marked_rgb())) as pack:
        assert worst_mark_error_px(pack, level) < 0.2


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:3857", "EPSG:3413"])
def test_marks_survive_a_change_of_coordinate_system(tmp_path: Path, crs: str):
    with rasterio.open(write_tiff(tmp_path / "utm.tif", marked_rgb())) as utm:
        left, bottom, right, top = transform_bounds(utm.crs, crs, *utm.bounds)
        size = 450
        transform = Affine((right - left) / size, 0, left, 0, (bottom - top) / size, top)
        bands = np.zeros((3, size, size), np.uint8)
        reproject(
            rasterio.band(utm, (1, 2, 3)),
            bands,
            dst_transform=transform,
            dst_crs=crs,
            resampling=Resampling.cubic,
        )
    with pack_of(write_tiff(tmp_path / "o.tif", bands, crs=crs, transform=transform)) as pack:
        assert worst_mark_error_px(pack) < 0.25


def test_a_rotated_raster_lies_where_its_transform_says(tmp_path: Path):
    transform = TRANSFORM @ Affine.rotation(30.0)
    path = write_tiff(tmp_path / "rotated.tif", texture_rgb(), transform=transform)
    u, v = np.array([0.0, 320.0, 100.0]), np.array([0.0, 300.0, 20.5])
    georeference = RasterFile(path).georeference
    back = georeference.pixel_from_lat_lon(*georeference.lat_lon_from_pixel(u, v))
    assert np.allclose(back, (u, v), atol=1e-3)


def test_a_palette_is_expanded_through_its_colours(tmp_path: Path):
    rgb = texture_rgb()
    image = RasterFile(write_palette_tiff(tmp_path / "p.tif", rgb)).window(Window(0, 0, 320, 300))
    expected = np.moveaxis((rgb // 64) * 64 + 32, 0, -1)[..., ::-1]
    assert np.array_equal(image.bgr, expected)
    assert image.mask.all()


def test_a_hole_in_a_palette_has_no_data(tmp_path: Path):
    raster = RasterFile(write_palette_tiff(tmp_path / "p.tif", texture_rgb(), transparent=5))
    mask = raster.window(Window(0, 0, 320, 300)).mask
    assert not mask[100:160, 100:180].any()
    assert mask.sum() == 320 * 300 - 60 * 80


def test_alpha_and_declared_no_data_become_the_mask(tmp_path: Path):
    rgb = texture_rgb()
    alpha = np.full((1, 300, 320), 255, np.uint8)
    alpha[:, :, :40] = 0
    holed = np.where(alpha > 0, rgb, 7).astype(np.uint8)
    files = [
        write_tiff(tmp_path / "a.tif", np.concatenate([rgb, alpha]), alpha=True),
        write_tiff(tmp_path / "n.tif", holed, nodata=7),
    ]
    for path in files:
        assert np.array_equal(RasterFile(path).window(Window(0, 0, 320, 300)).mask, alpha[0] > 0)


def test_black_corners_without_any_declaration_make_no_features(tmp_path: Path):
    rgb = texture_rgb(600, 600)
    v, u = np.mgrid[:600, :600]
    corner = u + v < 400
    with pack_of(
        write_tiff(tmp_path / "c.tif", np.where(corner, 0, rgb).astype(np.uint8)), [SiftStub()]
    ) as pack:
        zoom = pack.levels[0].zoom
        window = pack.window(zoom)
        found = pack.features_in(zoom, *window, SiftStub()).features.uv
        mask = np.pad(pack.colour_image(zoom, window).mask, 20)
    near = [mask[int(v) + 5 : int(v) + 36, int(u) + 5 : int(u) + 36].all() for u, v in found]
    assert len(found) > 500
    assert all(near)


def test_sixteen_bits_are_stretched_and_gray_becomes_colour(tmp_path: Path):
    ramp = np.linspace(200, 3000, 320)[None, None].repeat(300, axis=1).astype(np.uint16)
    image = RasterFile(write_tiff(tmp_path / "d.tif", ramp)).window(Window(0, 0, 320, 300))
    assert image.bgr[0, 10, 0] < 20 < 235 < image.bgr[0, -10, 0]
    assert (np.diff(image.bgr[0, :, 0].astype(int)) >= 0).all()
    assert np.array_equal(image.bgr[..., 0], image.bgr[..., 2])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e300, -3.4e38])
def test_values_that_are_none_or_far_off_are_no_warning_and_hide_nothing(tmp_path: Path, wrong):
    ramp = np.linspace(200, 3000, 320)[None, None].repeat(300, axis=1)
    ramp[0, 100:105, 100:120] = wrong
    image = RasterFile(write_tiff(tmp_path / "d.tif", ramp)).window(Window(0, 0, 320, 300))
    assert image.bgr[0, 10, 0] < 20 < 235 < image.bgr[0, -10, 0]
    assert image.mask[:99, 20:-20].all()


@pytest.mark.filterwarnings("error")
def test_a_raster_of_one_value_says_that_it_shows_nothing(tmp_path: Path):
    with pytest.raises(MapError, match="holds no imagery"):
        pack_of(write_tiff(tmp_path / "flat.tif", np.full((1, 300, 320), 300, np.uint16)))


@pytest.mark.parametrize("photometric", ["rgb", "minisblack"])
def test_infrared_in_a_fourth_band_is_left_out(tmp_path: Path, photometric: str):
    bands = np.concatenate([texture_rgb(), np.full((1, 300, 320), 255, np.uint8)])
    path = write_tiff(tmp_path / "nir.tif", bands, photometric=photometric, ALPHA="NO")
    image = RasterFile(path).window(Window(0, 0, 320, 300))
    assert np.array_equal(image.bgr[..., ::-1], np.moveaxis(bands[:3], 0, -1))
    assert image.mask.all()


def test_a_raster_that_lies_nowhere_is_refused(tmp_path: Path):
    path = write_tiff(tmp_path / "none.tif", texture_rgb(), crs=None, transform=None)
    with pytest.raises(MapError, match="not georeferenced"):
        RasterFile(path)


def test_a_missing_coordinate_system_can_be_said(tmp_path: Path):
    path = write_tiff(tmp_path / "marks.tif", marked_rgb(), crs=None)
    with pytest.raises(MapError, match="--crs EPSG"):
        RasterFile(path)
    with pack_of(path, crs="EPSG:32643") as pack:
        assert worst_mark_error_px(pack) < 0.2
    with pytest.raises(MapError, match="--crs nonsense"):
        RasterFile(path, "nonsense")


def test_a_cut_off_raster_is_one_error_and_leaves_nothing(tmp_path: Path):
    path = write_tiff(tmp_path / "cut.tif", texture_rgb(), alpha=False)
    path.write_bytes(path.read_bytes()[:150_000])
    with pytest.raises(MapError, match="damaged or cut off"):
        pack_of(path)
    assert [file.name for file in tmp_path.iterdir()] == ["cut.tif"]


def test_a_name_that_is_not_utf8_is_one_line(tmp_path: Path):
    (tmp_path / "t\udcfc.tif").touch()
    with pytest.raises(MapError, match="not UTF-8; rename it"):
        RasterFile(tmp_path / "t\udcfc.tif")
    with pytest.raises(MapError, match="not UTF-8; rename it"):
        read_heights(tmp_path / "t\udcfc.tif", (0.0, 0.0, 0.1, 0.1))


@pytest.mark.parametrize("content", [b"", b"II*\0 no raster", b"hello"])
def test_what_is_no_raster_is_refused(tmp_path: Path, content: bytes):
    (tmp_path / "x.tif").write_bytes(content)
    with pytest.raises(MapError, match="not a raster"):
        RasterFile(tmp_path / "x.tif")


def test_heights_are_read_where_the_map_lies(tmp_path: Path):
    slope = (300.0 + 0.1 * (np.arange(200)[None, :] + 0.5)).repeat(180, axis=0)[None]
    path = write_tiff(tmp_path / "dem.tif", slope.astype(np.float32))
    lat, lon = RasterFile(path).georeference.lat_lon_from_pixel(
        np.array([20.0, 160.0]), np.array([150.0, 20.0])
    )
    heights = read_heights(path, (lat[0], lon[0], lat[1], lon[1]))
    assert heights.at((lat[0] + lat[1]) / 2, (lon[0] + lon[1]) / 2) == pytest.approx(309.0, abs=0.1)
    assert heights.at(lat[0] - 0.01, lon[0]) is None


def heights_around(path: Path) -> np.ndarray:
    """The heights of a DEM as large as `texture_rgb` under most of it."""
    image = RasterFile(write_tiff(path.with_name("image.tif"), texture_rgb()))
    lat, lon = image.georeference.lat_lon_from_pixel(
        np.array([20.0, 300.0]), np.array([280.0, 20.0])
    )
    return read_heights(path, (lat[0], lon[0], lat[1], lon[1])).heights_m


@pytest.mark.parametrize("void", [-9999.0, -32768.0, 9999.0, -3.4e38, np.inf, np.nan])
def test_a_void_that_nothing_declares_is_a_hole_and_no_terrain(tmp_path: Path, caplog, void: float):
    dem = np.full((1, 300, 320), 300.0, np.float32)
    dem[0, 100:200, 100:200] = void
    heights = heights_around(write_tiff(tmp_path / "dem.tif", dem))
    assert np.isnan(heights).any()
    assert set(heights[np.isfinite(heights)]) == {300.0}
    told = [record.getMessage() for record in caplog.records]
    assert len(told) == (0 if np.isnan(void) else 1)
    assert all("dem.tif: 10000 of " in line and "taken for holes" in line for line in told)


def test_the_lowest_and_the_highest_ground_there_is_are_no_voids(tmp_path: Path, caplog):
    dem = np.full((1, 300, 320), -430.0, np.float32)
    dem[0, :, 160:] = 8849.0
    heights = heights_around(write_tiff(tmp_path / "dem.tif", dem))
    assert (heights.min(), heights.max()) == (-430.0, 8849.0)
    assert not caplog.records


def test_heights_are_multiplied_and_moved_as_their_band_says(tmp_path: Path):
    path = write_tiff(tmp_path / "dem.tif", np.full((1, 300, 320), 4000, np.int16), nodata=-1)
    with rasterio.open(path, "r+") as dem:
        dem.scales, dem.offsets = (0.1,), (-50.0,)
    assert set(heights_around(path).ravel()) == {350.0}


FEET_CRS = "EPSG:32643+6360"  # UTM, and NAVD88 height in US survey feet


@pytest.mark.parametrize(
    ("unit", "crs", "height_m"),
    [
        ("m", "EPSG:32643", 1000.0),
        ("metre", FEET_CRS, 1000.0),  # the band speaks of its own values
        ("ft", "EPSG:32643", 304.8),
        ("foot", "EPSG:32643", 304.8),
        ("US survey foot", "EPSG:32643", 304.8006),
        (None, FEET_CRS, 304.8006),
        (None, "EPSG:32643+5703", 1000.0),  # NAVD88 height in metres
        ("cm", "EPSG:32643", 10.0),
    ],
)
def test_heights_are_of_the_unit_that_band_or_vertical_system_names(
    tmp_path: Path, unit: str | None, crs: str, height_m: float
):
    path = write_tiff(tmp_path / "dem.tif", np.full((1, 300, 320), 1000.0, np.float32), crs=crs)
    if unit is not None:
        with rasterio.open(path, "r+") as dem:
            dem.units = (unit,)
    assert heights_around(path).ravel() == pytest.approx(height_m, abs=1e-3)


@pytest.mark.parametrize(
    ("unit", "crs"),
    [("furlong", "EPSG:32643"), ("dB", "EPSG:32643"), (None, "EPSG:32643+6357")],  # a depth
)
def test_what_is_no_height_in_a_known_unit_is_one_line(tmp_path: Path, unit: str | None, crs: str):
    path = write_tiff(tmp_path / "dem.tif", np.full((1, 300, 320), 100.0, np.float32), crs=crs)
    if unit is not None:
        with rasterio.open(path, "r+") as dem:
            dem.units = (unit,)
    with pytest.raises(MapError, match=r"dem\.tif: .*(furlong|dB|depth)") as caught:
        heights_around(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("unit", [None, "m"])
@pytest.mark.parametrize("flat", ["EPSG:4326", "EPSG:32643"])
def test_heights_above_the_ellipsoid_are_one_line(tmp_path: Path, flat: str, unit: str | None):
    crs = pyproj.CRS.from_user_input(flat).to_3d().to_wkt()
    path = write_tiff(tmp_path / "dem.tif", np.full((1, 300, 320), 100.0, np.float32), crs=crs)
    with rasterio.open(path, "r+") as dem:
        dem.units = (unit,)
        if flat == "EPSG:4326":
            dem.transform = Affine(1e-3, 0.0, 72.8, 0.0, -1e-3, 33.8)
    with pytest.raises(MapError, match=r"dem\.tif: .* above the ellipsoid") as caught:
        heights_around(path)
    assert "\n" not in str(caught.value)


def test_ridges_of_a_long_map_are_as_high_as_those_of_a_short_one(tmp_path: Path):
    """Slopes of 45 degrees between nodes that are 10 m apart: no more than 5 m are lost."""
    rows = np.arange(2000)
    heights_m = 560.0 - 10.0 * np.abs((rows + 6) % 13 - 6)  # a crest at every thirteenth
    dem = np.tile(heights_m.astype(np.float32)[:, None], 200)[None]
    place = Affine(10.0, 0.0, LEFT_M, 0.0, -10.0, TOP_M)
    path = write_tiff(tmp_path / "dem.tif", dem, transform=place)
    crests = rows[13:-13:13] + 0.5
    lat, lon = RasterFile(path).georeference.lat_lon_from_pixel(np.full(len(crests), 100.0), crests)
    margin = 2e-4
    bounds = (lat[-1] - margin, lon.min() - margin, lat[0] + margin, lon.max() + margin)
    assert read_heights(path, bounds).at_each(lat, lon).min() > 554.0


@pytest.mark.parametrize("upright", [False, True])
def test_a_raster_of_many_more_heights_than_nodes_is_read_thinned(tmp_path: Path, upright: bool):
    dem = np.tile((300.0 + 0.05 * np.arange(40_000)).astype(np.float32), (60, 1))
    dem[:, 20_000:20_200] = -9999.0  # a void of 100 m that nothing declares
    place = Affine(5e-6, 0.0, 8.0, 0.0, -5e-6, 47.0)
    bands = (dem.T.copy() if upright else dem)[None]
    path = write_tiff(tmp_path / "dem.tif", bands, crs="EPSG:4326", transform=place)
    along = np.linspace(100.0, 39_900.0, 400)
    across = np.full(400, 30.0)
    lon, lat = place @ ((across, along) if upright else (along, across))
    margin = 5e-5
    heights = read_heights(
        path, (lat.min() - margin, lon.min() - margin, lat.max() + margin, lon.max() + margin)
    )
    off_m = heights.at_each(lat, lon) - (300.0 + 0.05 * along)
    assert set(np.flatnonzero(np.isnan(off_m))) <= {199, 200, 201, 202}
    assert np.isnan(off_m).any()
    assert np.nanmax(np.abs(off_m)) < 0.2


def test_nothing_but_voids_is_refused(tmp_path: Path):
    path = write_tiff(tmp_path / "dem.tif", np.full((1, 300, 320), -9999, np.int16))
    with pytest.raises(MapError, match="no heights under the map"):
        heights_around(path)


LOCAL = 'LOCAL_CS["site",UNIT["metre",1]]'


def test_a_coordinate_system_that_lies_nowhere_on_earth_is_one_line(tmp_path: Path):
    raster = RasterFile(write_tiff(tmp_path / "local.tif", texture_rgb(), crs=LOCAL))
    places = np.array([10.0]), np.array([20.0])
    for convert in (
        raster.georeference.lat_lon_from_pixel,
        raster.georeference.pixel_from_lat_lon,
        lambda *_: read_heights(tmp_path / "local.tif", (47.0, 8.0, 47.1, 8.1)),
    ):
        with pytest.raises(MapError, match=r"local\.tif: .*latitude and longitude") as caught:
            convert(*places)
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("crs", "is_told"),
    [
        ("EPSG:2379", True),  # Xian 1980
        ("+proj=utm +zone=43 +ellps=bessel +units=m", True),
        ("+proj=utm +zone=43 +ellps=bessel +towgs84=598,73,418 +units=m", False),
        ("+proj=utm +zone=43 +ellps=GRS80 +units=m", False),
        ("+proj=utm +zone=43 +ellps=WGS84 +units=m", False),
        ("EPSG:4491", False),  # of CGCS2000, which is a satellites' datum
        ("EPSG:25832", False),
        ("EPSG:32643", False),
        ("EPSG:3857", False),
        ("EPSG:31467", False),  # its better shift is not installed, but there is another
    ],
)
def test_a_datum_of_which_nobody_knows_the_shift_is_told_in_one_line(
    tmp_path, caplog, crs, is_told
):
    RasterFile(write_tiff(tmp_path / "a.tif", texture_rgb(), crs=crs))
    told = [record.getMessage() for record in caplog.records]
    assert len(told) == is_told
    assert all("a.tif: no datum shift to WGS 84 is known" in line for line in told)
    assert not any("\n" in line for line in told)


def test_heights_of_an_unknown_datum_are_told_once(tmp_path: Path, caplog):
    crs = "+proj=utm +zone=43 +ellps=krass +units=m"
    path = write_tiff(tmp_path / "dem.tif", np.ones((1, 300, 320), np.float32), crs=crs)
    heights_around(path)
    (told,) = (record.getMessage() for record in caplog.records)
    assert "dem.tif: no datum shift to WGS 84 is known" in told


@pytest.mark.parametrize(
    ("left_deg", "west_deg"), [(200.5, -159.5), (-181.0, 179.0), (178.9, 178.9)]
)
def test_longitudes_that_go_on_beyond_half_a_turn_are_counted_back(tmp_path, left_deg, west_deg):
    place = Affine(1e-5, 0.0, left_deg, 0.0, -1e-5, 20.0)
    path = write_tiff(tmp_path / "a.tif", texture_rgb(), crs="EPSG:4326", transform=place)
    raster = PlacedRaster.of(RasterFile(path))
    assert raster.bounds == pytest.approx((19.997, west_deg, 20.0, west_deg + 0.0032), abs=1e-9)
    u, v = raster.source.georeference.pixel_from_lat_lon(
        np.array([19.999]), np.array([west_deg + 0.002])
    )
    assert (u[0], v[0]) == pytest.approx((200.0, 100.0), abs=1e-4)
    dem = write_tiff(
        tmp_path / "dem.tif", np.full((1, 300, 320), 7.0, np.float32), crs="EPSG:4326",
        transform=place,
    )  # fmt: skip
    assert read_heights(dem, raster.bounds).at(19.999, west_deg + 0.002) == 7.0


def test_heights_elsewhere_are_refused(tmp_path: Path):
    path = write_tiff(tmp_path / "dem.tif", np.ones((1, 50, 50), np.float32))
    with pytest.raises(MapError, match="no heights under the map"):
        read_heights(path, (10.0, 10.0, 10.1, 10.1))


@pytest.mark.parametrize(
    ("name", "share"),
    [("islamabad/1.tif", 0.65), ("brighton_beach/map_even_frames.tif", 0.58)],
)
def test_the_black_surroundings_of_real_orthophotos_are_holes(data_folder: Path, name, share):
    raster = RasterFile(data_folder / "flights" / name)
    image = raster.window(Window(0, 0, *raster.size_wh))
    assert image.mask.mean() == pytest.approx(share, abs=0.01)
    assert image.bgr[image.mask].min(axis=1).mean() > 40
