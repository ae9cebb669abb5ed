import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from map_samples import textured

from vwnav.errors import MapError
from vwnav.geometry.geodesy import LocalFrame, Window, mercator_px
from vwnav.maps.build.raster import (
    array_source,
    corner_georeference,
    level_georeference,
    local_georeference,
)
from vwnav.maps.build.warp import PlacedRaster, render

ZOOM = 18


def aligned(bgr: np.ndarray, x0: int = 37_000_000, y0: int = 19_000_000) -> PlacedRaster:
    return PlacedRaster.of(array_source(bgr, level_georeference(ZOOM, x0, y0), name="a"))


@given(st.floats(-75, 75), st.floats(-179, 179), st.floats(-2000, 2000), st.floats(-2000, 2000))
def test_local_pixels_and_places_are_inverse(lat, lon, u, v):
    georeference = local_georeference(LocalFrame(lat, lon, 120.0), (500.0, -300.0), 0.3)
    places = georeference.lat_lon_from_pixel(np.array([u]), np.array([v]))
    back = georeference.pixel_from_lat_lon(*places)
    assert np.allclose(back, ([u], [v]), atol=1e-4)


@given(st.floats(-84, 84), st.floats(-179, 178.9), st.floats(0, 1000), st.floats(0, 800))
def test_corner_pixels_and_places_are_inverse(south, west, u, v):
    georeference = corner_georeference((south, west, south + 0.01, west + 0.02), (1000, 800))
    places = georeference.lat_lon_from_pixel(np.array([u]), np.array([v]))
    back = georeference.pixel_from_lat_lon(*places)
    assert np.allclose(back, ([u], [v]), atol=1e-4)


def test_the_corners_of_an_image_are_its_outer_corners():
    georeference = corner_georeference((60.0, 22.0, 60.01, 22.02), (1000, 800))
    u, v = georeference.pixel_from_lat_lon(np.array([60.01, 60.0]), np.array([22.0, 22.02]))
    assert np.allclose((u, v), ([0, 1000], [0, 800]), atol=1e-6)


def test_pixels_that_coincide_with_the_level_are_copied():
    bgr = textured(300, 280)
    image = render(aligned(bgr), ZOOM, Window(37_000_000, 19_000_000, 37_000_280, 19_000_300))
    assert np.array_equal(image.bgr, bgr)


def test_what_lies_elsewhere_renders_as_nothing():
    window = Window(36_000_000, 19_000_000, 36_000_256, 19_000_256)
    assert render(aligned(textured(64, 64)), ZOOM, window) is None


def test_neighbouring_blocks_meet_without_a_seam():
    frame = LocalFrame(46.8, -92.0, 200.0)
    source = array_source(
        textured(500, 500), local_georeference(frame, (60.0, -70.0), 0.25), name="a"
    )
    raster = PlacedRaster.of(source)
    x, y = (int(value) for value in mercator_px(46.8, -92.0, 19))
    whole = render(raster, 19, Window(x - 150, y - 150, x + 150, y + 150))
    left = render(raster, 19, Window(x - 150, y - 150, x + 7, y + 150))
    right = render(raster, 19, Window(x + 7, y - 150, x + 150, y + 150))
    joined = np.concatenate([left.bgr, right.bgr], axis=1)
    assert whole.mask.all()
    assert np.abs(joined.astype(int) - whole.bgr).max() <= 2


def test_a_much_finer_raster_is_averaged_not_picked():
    checker = (np.indices((512, 512)).sum(axis=0) % 2 * 200).astype(np.uint8)
    raster = aligned(np.repeat(checker[..., None], 3, axis=2), 37_000_192, 19_000_192)
    image = render(raster, ZOOM - 3, Window(4_625_024, 2_375_024, 4_625_088, 2_375_088))
    inner = image.bgr[4:-4, 4:-4]
    assert image.mask[4:-4, 4:-4].all()
    assert np.abs(inner.astype(int) - 100).max() <= 2


def test_missing_data_do_not_bleed_into_the_image():
    mask = np.ones((200, 200), bool)
    mask[80:120, 80:120] = False
    bgr = np.where(mask[..., None], 200, 0).astype(np.uint8).repeat(3, axis=2)
    frame = LocalFrame(46.8, -92.0, 0.0)
    georeference = local_georeference(frame, (20.0, -20.0), 0.2)
    raster = PlacedRaster.of(array_source(bgr, georeference, name="a", mask=mask))
    x, y = (int(value) for value in mercator_px(46.8, -92.0, 20))
    image = render(raster, 20, Window(x - 100, y - 100, x + 100, y + 100))
    assert 500 < (~image.mask[30:-30, 30:-30]).sum() < 12_000
    assert np.abs(image.bgr[image.mask].astype(int) - 200).max() <= 6


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ((84.0, 10.0, 86.0, 11.0), "beyond 85.05"),
        ((10.0, 179.0, 11.0, 181.0), "180th meridian"),
        ((10.0, 20.0, 10.0, 20.0), "without a size"),
        ((10.0, 20.0, 10.0 + 5e-8, 20.0 + 5e-8), r"pixels are 0\.5\d mm wide by its georeference"),
    ],
)
def test_rasters_that_have_no_place_on_the_map_are_refused(bounds, message: str):
    south, west, north, east = bounds

    def lat_lon(u, v):
        return north + v / 10 * (south - north), west + u / 10 * (east - west)

    georeference = level_georeference(3, 0, 0)
    georeference = type(georeference)(georeference.pixel_from_lat_lon, lat_lon)
    with pytest.raises(MapError, match=message) as caught:
        PlacedRaster.of(array_source(textured(10, 10), georeference, name="a"))
    assert "\n" not in str(caught.value)
