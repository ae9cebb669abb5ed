import math

import cv2
import numpy as np
import pytest
from bench_scenes import ground

from vwnav.bench.features.flight_scenes import Shot, flight_scenes
from vwnav.bench.features.methods import FeatureSet, Method
from vwnav.bench.features.pair_scenes import Registered, view_pairs
from vwnav.bench.features.scenes import image_side, look_at, map_side
from vwnav.bench.features.scoring import Judge
from vwnav.errors import SourceError
from vwnav.geometry.geodesy import LocalFrame
from vwnav.geometry.rotations import rotation_from_euler
from vwnav.maps.build.raster import array_source, local_georeference
from vwnav.vision.features.opencv import SiftFeatures

SIFT = FeatureSet("sift", SiftFeatures().extract, [Method("sift")])


def test_sides_hold_the_size_and_fit_the_extractors():
    assert [image_side(s) for s in (1, 32, 33.0, 700)] == [32, 32, 64, 704]
    assert [map_side(s) for s in (384, 640, 641, 1152, 1153)] == [384, 640, 1152, 1152, 1664]


def test_a_shrunk_view_keeps_places_to_a_fraction_of_a_pixel():
    dot = np.zeros((400, 400), np.uint8)
    cv2.circle(dot, (200, 120), 9, 255, -1, cv2.LINE_AA)
    H_source_view = np.diag([3.0, 3.0, 1.0])
    view, mask = look_at(dot, np.ones_like(dot, np.bool_), H_source_view, (160, 128))
    rows, columns = np.indices(view.shape)
    weight = view / view.sum()
    centre = ((columns * weight).sum(), (rows * weight).sum())
    assert centre == pytest.approx((200 / 3, 120 / 3), abs=0.05)
    assert mask[:133, :133].all()
    assert not mask[:, 135:].any()


def test_a_pair_of_views_is_related_by_its_homography():
    image = ground(600, 700)
    pair = Registered("one", image, image, np.eye(3))
    (scene,) = view_pairs("group", [pair], 1)
    back = cv2.warpPerspective(scene.map_.gray, np.linalg.inv(scene.H_1_0), (384, 384))
    inner = slice(120, 264)
    difference = back[inner, inner].astype(float) - scene.image[inner, inner]
    assert np.abs(difference).mean() < 8.0
    assert np.abs(back[inner, inner].astype(float).mean() - back.mean()) < 60.0


def test_scenes_are_the_same_every_time_and_differ_from_each_other():
    pair = Registered("one", ground(600, 700), ground(600, 700, seed=1), np.eye(3))
    first, second = view_pairs("group", [pair], 2, same_day=True)
    again, _ = view_pairs("group", [pair], 2, same_day=True)
    assert np.array_equal(first.map_.gray, again.map_.gray)
    assert not np.array_equal(first.image, second.image)


def test_images_that_share_no_ground_are_an_error():
    away = np.array([[1.0, 0.0, 5000.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    with pytest.raises(SourceError, match="share"):
        list(view_pairs("group", [Registered("one", ground(), ground(), away)], 1))


@pytest.mark.parametrize("heading_deg", [0.0, 75.0, 200.0])
def test_a_frame_of_a_flight_is_placed_where_it_was_taken(heading_deg):
    """A frame cut from the map itself, in any heading: upright SIFT finds it within decimetres."""
    map_bgr, m_per_px = ground(900, 900, seed=3), 0.4
    frame = LocalFrame(47.0, 8.0, 0.0)
    raster = array_source(
        map_bgr, local_georeference(frame, (180.0, -180.0), m_per_px), name="drawn"
    )
    north_m, east_m, width_px, agl_m = 20.0, -35.0, 640, 200.0
    heading = math.radians(heading_deg)
    forward, right = (
        np.array([math.cos(heading), math.sin(heading)]),
        np.array([-math.sin(heading), math.cos(heading)]),
    )
    # Focal length = width, so a pixel is agl / width; of north, east: columns and rows.
    step_m = agl_m / width_px
    ground_ne = [
        np.array([north_m, east_m]) + step_m * (u * right - v * forward)
        for u, v in ((-300, -200), (300, -200), (300, 200), (-300, 200))
    ]
    on_map = [((e + 180.0) / m_per_px - 0.5, (180.0 - n) / m_per_px - 0.5) for n, e in ground_ne]
    in_frame = np.array([[20, 40], [620, 40], [620, 440], [20, 440]]) - 0.5
    H = cv2.getPerspectiveTransform(in_frame.astype(np.float32), np.array(on_map, np.float32))
    image = cv2.warpPerspective(map_bgr, np.linalg.inv(H), (640, 480))
    lat_deg, lon_deg, _ = frame.to_geodetic(np.array([north_m, east_m, 0.0]))
    shot = Shot(
        name="frame",
        image=image,
        mask=np.ones((480, 640), np.bool_),
        lat_deg=float(lat_deg),
        lon_deg=float(lon_deg),
        R_ned_body=rotation_from_euler(0.0, 0.0, heading),
        agl_m=agl_m,
        focal_ratio=1.0,
    )
    (scene,) = flight_scenes("drawn", [shot], raster, m_per_px, 30.0)
    (found,) = Judge([SIFT]).judge(scene)
    assert found.right.sum() > 50
    assert found.place_error < 0.4
