import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from map_samples import DotFinder, SiftStub, textured

from vwnav.geometry.geodesy import Tile
from vwnav.maps.build.keypoints import (
    KEYPOINTS_PER_TILE,
    NODATA_RADIUS_PX,
    block_of,
    block_tiles,
    extract_block,
    spread,
    usable_mask,
)
from vwnav.maps.image import MapImage
from vwnav.types import Features

WORLD = MapImage(textured(1024, 1024), np.ones((1024, 1024), bool))  # all of zoom 2


def world_with_hole() -> MapImage:
    mask = np.ones((1024, 1024), bool)
    mask[300:420, 260:700] = False
    return MapImage(np.where(mask[..., None], WORLD.bgr, 0).astype(np.uint8), mask)


def reader(world: MapImage):
    margin = 64
    padded = MapImage(
        np.pad(world.bgr, ((margin, margin), (margin, margin), (0, 0))),
        np.pad(world.mask, margin),
    )

    def read(window):
        return padded.crop(type(window)(*(edge + margin for edge in window)))

    return read


def global_keypoints(world: MapImage, extractor) -> np.ndarray:
    found = []
    for block in (Tile(2, x, y) for x in (0, 2) for y in (0, 2)):
        for tile, features in extract_block(reader(world), block, extractor).items():
            found.append(features.uv + tile.window[:2])
    return np.concatenate(found)


@given(st.integers(0, 1000), st.integers(0, 1000))
def test_every_tile_belongs_to_the_block_that_lists_it(x: int, y: int):
    tile = Tile(10, x, y)
    assert tile in list(block_tiles(block_of(tile)))


def test_tile_and_block_borders_neither_double_nor_lose_keypoints():
    dots = np.full((1024, 1024, 3), 90, np.uint8)
    places = np.r_[20:1000:60, 255, 256, 511, 512, 767, 768]
    dots[np.ix_(places, places)] = 255
    found = global_keypoints(MapImage(dots, WORLD.mask), DotFinder())
    expected = {(u, v) for u in places.tolist() for v in places.tolist()}
    assert len(found) == len(expected)
    assert {(u, v) for u, v in found.tolist()} == expected


def test_no_keypoint_lies_within_a_descriptor_radius_of_missing_data():
    world = world_with_hole()
    uv = global_keypoints(world, SiftStub())
    rows, columns = np.nonzero(~world.mask)
    distance = np.maximum(
        np.maximum(columns.min() - uv[:, 0], uv[:, 0] - columns.max()),
        np.maximum(rows.min() - uv[:, 1], uv[:, 1] - rows.max()),
    )
    assert len(uv) > 1000
    assert distance.min() > NODATA_RADIUS_PX - 0.5
    assert uv.min() > NODATA_RADIUS_PX - 0.5
    assert uv.max() < 1023.5 - NODATA_RADIUS_PX


def test_a_block_without_data_asks_the_extractor_for_nothing():
    stub = SiftStub()
    assert extract_block(reader(MapImage.empty((1024, 1024))), Tile(2, 0, 0), stub) == {}
    assert stub.calls == 0


def test_a_tile_holds_no_more_than_its_budget_strongest_first():
    for features in extract_block(reader(WORLD), Tile(2, 0, 0), SiftStub()).values():
        assert len(features) == KEYPOINTS_PER_TILE
        assert (np.diff(features.scores) <= 0).all()


def test_keypoints_are_spread_even_where_one_corner_outshines_the_rest():
    rng = np.random.default_rng(3)
    strong, weak = rng.uniform(0, 60, (500, 2)), rng.uniform(0, 255, (500, 2))
    uv = np.concatenate([strong, weak]).astype(np.float32)
    scores = np.concatenate([np.full(500, 9.0), np.full(500, 1.0)]).astype(np.float32)
    chosen = spread(Features(uv, np.zeros((1000, 4), np.float32), scores), 160)
    assert len(set(chosen.tolist())) == 160
    assert (uv[chosen] > 64).any(axis=1).sum() >= 140


@given(st.integers(0, 60), st.integers(1, 80))
def test_spreading_keeps_as_many_as_are_wanted_or_there_are(count: int, wanted: int):
    rng = np.random.default_rng(count)
    uv = rng.uniform(-0.5, 255.4, (count, 2)).astype(np.float32)
    features = Features(uv, np.zeros((count, 4), np.float32), rng.random(count, np.float32))
    chosen = spread(features, wanted)
    assert len(set(chosen.tolist())) == min(count, wanted)
    assert (np.diff(features.scores[chosen]) <= 0).all()


def test_the_edge_of_an_image_itself_is_usable():
    assert usable_mask(np.ones((50, 50), bool)).all()
