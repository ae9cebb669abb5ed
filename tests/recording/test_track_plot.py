"""The image of a track over the map, whatever the track."""

import sys
import tracemalloc
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "maps"))
from map_samples import SiftStub, textured

from vwnav.geometry.geodesy import LocalFrame
from vwnav.maps.build.builder import BuildOptions, build_pack
from vwnav.maps.build.raster import array_source, local_georeference
from vwnav.maps.pack import MapPack
from vwnav.recording.track_plot import MAX_SIDE_PX, Thinned, TrackPlot
from vwnav.types import Estimate

HOME = LocalFrame(60.4, 22.5, 0.0)


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "place.mbtiles"
    georeference = local_georeference(HOME, (150.0, -150.0), 0.5)
    source = array_source(textured(600, 600), georeference, name="place")
    build_pack([source], path, [SiftStub()], BuildOptions(name="place"))
    with MapPack.open(path) as opened:
        yield opened


def flown(pack: MapPack, places_ned_m, sigma_m: float = 1.0) -> TrackPlot:
    image = TrackPlot(pack, HOME)
    for i, place in enumerate(places_ned_m):
        image.add(step(float(i), place, sigma_m))
    return image


def step(t_s: float, place, sigma_m: float = 1.0) -> SimpleNamespace:
    estimate = Estimate(
        t_s=t_s, position_ned_m=np.array(place), velocity_ned_m_s=np.zeros(3),
        covariance=np.eye(6) * sigma_m**2, quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]),
        sigma_yaw_rad=0.1, agl_m=50.0, sigma_agl_m=1.0, t_last_fix_s=0.0, reset_counter=0,
    )  # fmt: skip
    return SimpleNamespace(estimate=estimate, outcome=None)


def test_a_track_is_drawn_around_where_it_went(pack):
    drawn = flown(pack, [[0.0, 0.0, -50.0], [40.0, 20.0, -50.0]]).draw()
    assert max(drawn.shape) < 700
    assert np.any((drawn == (0, 200, 255)).all(axis=-1)), "no line of the estimate"


def test_an_estimate_that_ran_away_is_drawn_as_far_as_the_map_goes(pack, tmp_path):
    away = [[20.0 * 1.2**i, 0.0, -50.0] for i in range(60)]
    flown(pack, away).save(tmp_path / "track.png")
    drawn = cv2.imread(str(tmp_path / "track.png"))
    assert max(drawn.shape) <= MAX_SIDE_PX


absurd = st.one_of(st.floats(-1e7, 1e7), st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e300]))


@settings(deadline=None, max_examples=25)
@given(st.lists(st.tuples(absurd, absurd), max_size=6), st.floats(0.0, 1e8))
def test_no_track_is_too_absurd_to_be_drawn(pack, places, sigma_m):
    drawn = flown(pack, [[n, e, -50.0] for n, e in places], sigma_m).draw()
    assert max(drawn.shape) <= MAX_SIDE_PX


def test_a_flight_of_hours_is_kept_in_as_little_as_one_of_minutes(pack):
    image = TrackPlot(pack, HOME)
    tracemalloc.start()
    for i in range(60_000):
        image.add(step(0.1 * i, [0.002 * i, 20.0 * np.sin(0.001 * i), -50.0]))
    kept_bytes = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert kept_bytes < 6e6
    drawn = (image.draw() == (0, 200, 255)).all(axis=-1)
    assert np.ptp(np.flatnonzero(drawn.any(axis=1))) > 200, "the way north is drawn whole"


@given(st.integers(2, 9), st.integers(0, 200))
def test_what_is_thinned_is_spread_evenly_from_the_first_on(most, count):
    thinned = Thinned[int](most)
    for i in range(count):
        thinned.add(i)
    every = thinned.items[1] if len(thinned.items) > 1 else 1
    assert thinned.items == list(range(0, count, every))
    assert len(thinned.items) <= most
