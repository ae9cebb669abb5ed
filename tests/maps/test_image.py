import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vwnav.geometry.geodesy import Tile, Window, lat_lon_from_mercator_px, mercator_px
from vwnav.maps.image import MapImage, assemble

zooms = st.integers(0, 22)
edges = st.tuples(*[st.integers(-600, 1400)] * 4)


@st.composite
def tiles(draw: st.DrawFn) -> Tile:
    zoom = draw(zooms)
    index = st.integers(0, 2**zoom - 1)
    return Tile(zoom, draw(index), draw(index))


@given(tiles())
def test_rows_are_counted_from_the_south_and_back(tile: Tile):
    assert 0 <= tile.row < 2**tile.zoom
    assert 2**tile.zoom - 1 - tile.row == tile.y


def test_the_known_tile_of_greenwich_observatory_has_its_published_numbers():
    # 51.4778 N, 0.0015 W at zoom 14: x 8191, y 5450 (XYZ), so row 10933 (TMS).
    x, y = mercator_px(51.4778, -0.0015, 14)
    tile = Tile(14, int(x // 256), int(y // 256))
    assert (tile.x, tile.y, tile.row) == (8191, 5450, 10933)


@given(tiles())
def test_the_centre_of_a_tile_lies_in_that_tile(tile: Tile):
    window = tile.window
    lat, lon = lat_lon_from_mercator_px(window.x0 + 128.0, window.y0 + 128.0, tile.zoom)
    x, y = mercator_px(lat, lon, tile.zoom)
    assert (int(x // 256), int(y // 256)) == (tile.x, tile.y)


@given(edges)
def test_the_tiles_of_a_window_are_those_that_share_a_pixel_with_it(corners):
    window = Window(*corners)
    every = [Tile(2, x, y) for y in range(4) for x in range(4)]
    assert set(window.tiles(2)) == {
        tile for tile in every if 0 not in tile.window.clipped(window).shape
    }


@given(edges, st.integers(60, 900))
def test_the_parts_of_a_window_cover_every_pixel_once(corners, size_px: int):
    window = Window(*corners)
    covered = np.zeros(window.shape, int)
    for part in window.parts(size_px):
        covered[part.y0 - window.y0 : part.y1 - window.y0][
            :, part.x0 - window.x0 : part.x1 - window.x0
        ] += 1
    assert (covered == 1).all()


def test_halving_averages_only_pixels_with_data():
    bgr = np.zeros((2, 4, 3), np.uint8)
    bgr[0], bgr[1, :2] = 100, 50
    mask = np.array([[True, True, True, False], [True, True, False, False]])
    half = MapImage(bgr, mask).halved()
    assert half.bgr[0, 0].tolist() == [75, 75, 75]
    assert half.mask.tolist() == [[True, False]]


def test_assembling_leaves_missing_tiles_without_data():
    full = MapImage(np.full((256, 256, 3), 9, np.uint8), np.ones((256, 256), bool))
    image = assemble(3, Window(200, 0, 300, 10), lambda tile: full if tile.x == 0 else None)
    assert image.mask[:, :56].all()
    assert not image.mask[:, 56:].any()


def test_an_image_whose_mask_has_another_size_is_refused():
    with pytest.raises(ValueError, match="expected bgr"):
        MapImage(np.zeros((4, 5, 3), np.uint8), np.zeros((5, 4), bool))
