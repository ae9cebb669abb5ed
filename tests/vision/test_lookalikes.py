import itertools
import math

import numpy as np
import pytest
from vision_scenes import texture

from vwnav.geometry.camera import Camera, Rectification
from vwnav.geometry.pose import MapPose
from vwnav.maps.image import Level, MapFeatures
from vwnav.types import Features, Frame, Prior
from vwnav.vision.candidates import Candidate, Hypothesis
from vwnav.vision.consensus import Consensus, SimilarityBounds
from vwnav.vision.features.load import load_features
from vwnav.vision.matching import share_alike
from vwnav.vision.query import Query, View
from vwnav.vision.registration import Registration, ambiguous

SHIFT_PX = np.array([120.0, 30.0])


def features(uv, seed: int, of: np.ndarray | None = None) -> Features:
    """At places (n, 2), with descriptors of their own or, where `of` names them, of others."""
    directions = np.random.default_rng(seed).normal(size=(500, 64)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    named = np.arange(len(uv)) if of is None else of
    return Features(np.asarray(uv, np.float32), directions[named], np.ones(len(uv), np.float32))


def scattered(seed: int, n: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.0, 400.0, (n, 2))


def likeness(n: int) -> np.ndarray:
    return np.full(n, 0.7, np.float32)


@pytest.mark.parametrize("within_px", [300.0, math.inf])
def test_what_stands_there_twice_is_alike(within_px):
    uv = scattered(0, 60)
    twice = features(np.vstack([uv, uv + SHIFT_PX]), 1, np.tile(np.arange(60), 2))
    assert share_alike(features(uv, 1), likeness(60), twice, within_px) == 1.0


def test_half_of_it_is_half_alike():
    uv = scattered(0, 60)
    half = np.vstack([uv, uv[:30] + SHIFT_PX])
    others = features(half, 1, np.concatenate([np.arange(60), np.arange(30)]))
    assert share_alike(features(uv, 1), likeness(60), others, math.inf) == pytest.approx(
        0.5, abs=0.05
    )


def test_like_things_that_lie_otherwise_are_not_alike():
    uv = scattered(0, 60)
    others = features(np.vstack([uv, scattered(5, 60)]), 1, np.tile(np.arange(60), 2))
    assert share_alike(features(uv, 1), likeness(60), others, math.inf) < 0.15


def test_neither_itself_nor_what_is_too_far_off_counts():
    uv = scattered(0, 60)
    twice = features(np.vstack([uv, uv + SHIFT_PX]), 1, np.tile(np.arange(60), 2))
    assert share_alike(features(uv, 1), likeness(60), twice, 100.0) == 0.0
    assert share_alike(features(uv, 1), likeness(60), features(uv, 1), math.inf) == 0.0


def test_features_that_are_all_alike_by_half_are_not_alike():
    """SIFT's descriptors have no negative values: unrelated ones are alike by half and more."""
    rng = np.random.default_rng(2)
    descriptors = np.sqrt(rng.dirichlet(np.full(128, 0.5), 300)).astype(np.float32)
    uv = rng.uniform(0.0, 60.0, (300, 2)).astype(np.float32)
    everything = Features(uv, descriptors, np.ones(300, np.float32))
    some = Features(uv[:12], descriptors[:12], np.ones(12, np.float32))
    assert share_alike(some, np.full(12, 0.9, np.float32), everything, 30.0) < 0.3


SIZE_WH, ORIGIN_PX, ZOOM = (320, 240), (1000, 2000), 18


def registered(view_gray: np.ndarray, twins_at: tuple[float, float]) -> tuple[Query, Registration]:
    """An image where it belongs on a map whose landmarks have their like at a shift."""
    w, h = SIZE_WH
    frame = Frame(0.0, view_gray, 0)
    prior = Prior(lat_deg=0.0, lon_deg=0.0, sigma_m=64.0, yaw_rad=0.0, agl_m=60.0)
    camera, clock = Camera.from_hfov(w, h, 70.0), itertools.count().__next__
    query = Query(camera, load_features("sift"), frame, prior, 0, clock)
    uv = np.random.default_rng(3).uniform(30.0, 210.0, (40, 2))
    landmarks = features(uv, 1)
    made = Rectification(np.eye(3), SIZE_WH, 0.3, np.array([w, h]) / 2.0, 60.0)
    twice = features(np.vstack([uv, uv + twins_at]), 1, np.tile(np.arange(40), 2))
    candidate = Candidate(
        hypothesis=Hypothesis(0.0, 60.0, SimilarityBounds(1.2, 0.3)), level=Level(ZOOM, 0.3),
        lat_deg=0.0, lon_deg=0.0, radius_m=192.0, max_keypoints=1000,
    )  # fmt: skip
    everyone = np.ones(40, np.bool_)
    found = Registration(
        candidate=candidate,
        view=View(made, np.array([w, h]) / 2.0, view_gray, landmarks),
        piece=MapFeatures(ZOOM, np.array(ORIGIN_PX), twice),
        consensus=Consensus(np.eye(3), uv, uv, everyone, 200, -40.0, 12, 0),
        landmarks=landmarks,
        likeness=likeness(40),
        pose=MapPose(
            nadir_px=np.zeros(2), covariance_ne_m2=np.eye(2), yaw_correction_rad=0.0,
            sigma_yaw_rad=0.1, scale_ratio=1.0, agl_m=60.0, sigma_agl_m=1.0,
        ),
    )  # fmt: skip
    return query, found


class DrawnMap:
    """A map of one image, its first pixel at `ORIGIN_PX`, that has no features but those found."""

    name, levels, georeference_sigma_m = "drawn", (Level(ZOOM, 0.3),), 0.1

    def __init__(self, gray: np.ndarray) -> None:
        self._gray = gray

    def image(self, zoom, x0, y0, x1, y1):
        gray = np.zeros((y1 - y0, x1 - x0), np.uint8)
        known = np.zeros(gray.shape, np.bool_)
        (u, v), (h, w) = np.array(ORIGIN_PX) - (x0, y0), self._gray.shape
        gray[v : v + h, u : u + w], known[v : v + h, u : u + w] = self._gray, True
        return gray, known


def two_days(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """The map, and what the image shows of the same ground."""
    rng, (w, h) = np.random.default_rng(4), SIZE_WH
    columns = np.arange(w)[None] + np.zeros((h, 1))
    rows = 110.0 + 60.0 * (columns % 12 < 5)
    ground = {"rows": rows, "plots": texture(4, w)[:h].astype(np.float64)}[kind]
    days = [ground + rng.normal(0.0, 8.0, ground.shape) for _ in range(2)]
    return tuple(np.clip(day, 0, 255).astype(np.uint8) for day in days)


@pytest.mark.parametrize(
    ("ground", "twins_at", "is_refused"),
    [
        ("plots", (11.0, 5.0), False),
        ("rows", (12.0, 0.0), True),
        ("plots", (60.0, 20.0), True),
    ],
)
def test_the_image_tells_a_place_from_what_is_a_dozen_pixels_beside_it(
    ground, twins_at, is_refused
):
    """Learned landmarks see so far that they are alike there on any ground: it was refused.

    Of rows each is as like the next in the image, too.
    """
    map_gray, view_gray = two_days(ground)
    query, found = registered(view_gray, twins_at)
    refusal = ambiguous(DrawnMap(map_gray), load_features("sift"), query, found)
    assert (refusal is not None) == is_refused
