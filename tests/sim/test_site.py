"""The generated site: the same everywhere and every time, and hard in the way it is meant to be."""

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vwnav.sim.pairs import write_pairs
from vwnav.sim.scenery.drawing import Canvas
from vwnav.sim.scenery.landscape import Plant, inset, rectangle, to_ne
from vwnav.sim.scenery.layout import polygon_area_m2
from vwnav.sim.scenery.looks import flight_look
from vwnav.sim.scenery.markings import white_marks
from vwnav.sim.scenery.noise import NedWindow, NoiseBank
from vwnav.sim.scenery.trees import paint_plant
from vwnav.sim.site import FIRST_TRAINING_SEED, Site, generator_fingerprint

angles = st.floats(-3.1, 3.1)


@pytest.fixture(scope="module")
def site() -> Site:
    return Site(1)


def gray(image: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)


def strip_centre(site: Site, along: float, across: float) -> tuple[float, float]:
    north, east = site.landscape.airfield.to_ne(np.array([[along, across]]))[0]
    return float(north), float(east)


def around(
    site: Site, look: str, centre: tuple[float, float], size: tuple[int, int], r: float
) -> np.ndarray:
    north0, east0 = centre[0] + size[1] * r / 2, centre[1] - size[0] * r / 2
    return site.render(look, north0, east0, size, r)  # type: ignore[arg-type]


def upright_root_sift(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    sift = cv2.SIFT_create(500)
    keypoints = [cv2.KeyPoint(*k.pt, k.size, 0) for k in sift.detect(image.astype(np.uint8))]
    keypoints, found = sift.compute(image.astype(np.uint8), keypoints)
    return np.array([k.pt for k in keypoints]), np.sqrt(found / found.sum(1, keepdims=True))


def sift_inliers(site: Site, centre: tuple[float, float]) -> int:
    """Mutual neighbours of the two looks that are right, out of a view as from 50 m."""
    (uv0, d0), (uv1, d1) = (
        upright_root_sift(gray(around(site, look, centre, (233, 177), 0.3)))
        for look in ("map", "flight")
    )
    forth, back = (d0 @ d1.T).argmax(1), (d0 @ d1.T).argmax(0)
    mutual = np.flatnonzero(back[forth] == np.arange(len(d0)))
    return int((np.hypot(*(uv0[mutual] - uv1[forth[mutual]]).T) < 2.5).sum())


def test_a_seed_always_draws_the_same_place(site: Site) -> None:
    window = (40.0, -40.0, (200, 200), 0.4)
    again = Site(1)
    for look in ("map", "flight"):
        np.testing.assert_array_equal(site.render(look, *window), again.render(look, *window))


def test_another_seed_is_another_place(site: Site) -> None:
    here, there = (
        gray(s.render("flight", 100.0, -100.0, (200, 200), 1.0)) for s in (site, Site(2))
    )
    assert np.corrcoef(here.ravel(), there.ravel())[0, 1] < 0.5


@pytest.mark.parametrize("look", ["map", "flight"])
def test_windows_of_one_pixel_grid_agree(site: Site, look: str) -> None:
    r = 0.25
    large = site.render(look, 100.0, -150.0, (640, 600), r)  # type: ignore[arg-type]
    part = site.render(look, 100.0 - 117 * r, -150.0 + 203 * r, (200, 210), r)  # type: ignore[arg-type]
    apart = np.abs(large[117:327, 203:403].astype(int) - part.astype(int))
    assert apart.mean() < 0.4  # but for the anti-aliasing of edges, a quarter of a sub-pixel off
    assert np.quantile(apart, 0.9) <= 1
    assert apart.max() < 40


@pytest.mark.parametrize("centre", [(0.0, 0.0), (-220.0, 160.0), (180.0, -300.0)])
def test_resolutions_of_one_place_agree(site: Site, centre: tuple[float, float]) -> None:
    fine = cv2.resize(around(site, "flight", centre, (800, 800), 0.1), None, fx=0.25, fy=0.25,
                      interpolation=cv2.INTER_AREA)  # fmt: skip
    coarse = around(site, "flight", centre, (200, 200), 0.4)
    assert np.corrcoef(gray(fine).ravel(), gray(coarse).ravel())[0, 1] > 0.95
    assert abs(float(fine.mean()) - float(coarse.mean())) < 2.0


@pytest.mark.parametrize("look", ["map", "flight"])
@pytest.mark.parametrize("end", [-1.0, 1.0])
def test_paint_is_where_the_vectors_are(site: Site, look: str, end: float) -> None:
    north, east = strip_centre(site, end * (site.landscape.airfield.length_m / 2 - 30.0), 0.0)
    window = NedWindow(north + 20.0, east - 20.0, 400, 400, 0.1)
    canvas = Canvas(window, 0)
    for mark in white_marks(site.landscape.airfield):
        canvas.blend(canvas.polygon(mark), np.ones(3))
    expected = cv2.GaussianBlur(canvas.bgr[..., 0], (0, 0), 2.0)[20:-20, 20:-20]
    drawn = gray(site.render(look, window.north0_m, window.east0_m, (400, 400), 0.1))  # type: ignore[arg-type]
    fit = cv2.matchTemplate(drawn, expected, cv2.TM_CCOEFF_NORMED)
    assert np.abs(np.array(cv2.minMaxLoc(fit)[3]) - 20).max() <= 1  # 0.1 m


def test_the_looks_share_their_geometry(site: Site) -> None:
    for along in (-200.0, 0.0, 200.0):
        centre = strip_centre(site, along, 0.0)
        edges = [
            cv2.GaussianBlur(np.abs(cv2.Laplacian(gray(around(site, look, centre, (256, 256), 0.3)),
                                                  cv2.CV_32F, ksize=5)), (0, 0), 1.5)
            for look in ("map", "flight")
        ]  # fmt: skip
        shift, _ = cv2.phaseCorrelate(*edges, cv2.createHanningWindow((256, 256), cv2.CV_32F))
        assert np.hypot(*shift) < 0.7


def test_the_looks_differ_in_tone_shadows_and_crops(site: Site) -> None:
    views = [gray(around(site, look, (0.0, 0.0), (200, 150), 2.0)) for look in ("map", "flight")]
    assert np.corrcoef(views[0].ravel(), views[1].ravel())[0, 1] < 0.75
    days = site.looks["map"], site.looks["flight"]
    assert days[0].season != days[1].season
    assert abs(days[0].sun_azimuth_rad - days[1].sun_azimuth_rad) > np.radians(35.0)
    fields = [c for c in site.landscape.cells if c.land == "arable"]
    changed = [days[0].crop(c.seed) != days[1].crop(c.seed) for c in fields]
    assert np.mean(changed) > 0.5


def test_grass_starves_sift_and_the_threshold_feeds_it(site: Site) -> None:
    airfield = site.landscape.airfield
    grass = [strip_centre(site, a * airfield.length_m, -55.0) for a in (-0.4, -0.2, 0.2, 0.4)]
    assert np.median([sift_inliers(site, place) for place in grass]) <= 8
    assert sift_inliers(site, strip_centre(site, airfield.length_m / 2 - 25.0, 0.0)) >= 25


def test_grass_is_not_featureless(site: Site) -> None:
    contrast = []
    for along in (-0.3, 0.3):
        view = around(site, "map", strip_centre(site, along * 600.0, -50.0), (200, 150), 0.3)
        smooth = [cv2.GaussianBlur(gray(view), (0, 0), sigma) for sigma in (1.5, 12.0)]
        contrast.append(float(np.std(smooth[0] - smooth[1])))
    assert min(contrast) > 1.5


def test_home_and_runway_are_on_the_site(site: Site) -> None:
    apron = site.landscape.airfield.apron.astype(np.float32)
    assert cv2.pointPolygonTest(apron, (0.0, 0.0), False) > 0
    assert np.abs(site.landscape.airfield.strip).max() < 500.0


def test_nothing_stands_on_the_runway(site: Site) -> None:
    field = site.landscape.airfield
    half = np.array([field.length_m / 2.0, field.width_m / 2.0])
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * half
    runway = field.to_ne(corners).astype(np.float32)
    for thing in (*site.landscape.plants, *site.landscape.buildings):
        assert cv2.pointPolygonTest(runway, (thing.north_m, thing.east_m), True) < -5.0


@given(st.floats(-40, 40), st.floats(-40, 40), st.floats(3, 30), st.floats(3, 30), angles)
@settings(max_examples=30, deadline=None)
def test_a_polygon_covers_its_area(n: float, e: float, a: float, c: float, turn: float) -> None:
    canvas = Canvas(NedWindow(100.0, -100.0, 400, 400, 0.5), 0)
    patch = canvas.polygon(rectangle(np.array([n, e]), a, c, turn))
    assert patch is not None
    # OpenCV fills the outline too: up to a sub-pixel, 0.125 m, on each side.
    outline_m2 = 0.125 * 2 * (a + c)
    assert float(patch.alpha.sum()) * 0.25 == pytest.approx(a * c, abs=outline_m2 + 0.6)


@given(st.floats(20, 80), st.floats(0.05, 6.0), angles)
@settings(max_examples=30, deadline=None)
def test_a_ribbon_covers_length_times_width(length: float, width: float, turn: float) -> None:
    canvas = Canvas(NedWindow(100.0, -100.0, 400, 400, 0.5), 0)
    ends = to_ne(np.array([[-length / 2, 0.0], [length / 2, 0.0]]), np.zeros(2), turn)
    patch = canvas.ribbon(ends, width)
    assert patch is not None
    # Up to a sub-pixel, 0.125 m, on each side; a line drawn wider than it is is wrong by less.
    edges = 0.125 * 2 * (length + width) * min(1.0, width / 0.3) + 0.4
    assert float(patch.alpha.sum()) * 0.25 == pytest.approx(length * width, abs=edges)


@given(st.floats(-500, 500), st.floats(-500, 500), angles)
def test_a_frame_keeps_distances(n: float, e: float, turn: float) -> None:
    points = np.array([[0.0, 0.0], [3.0, 4.0]])
    moved = to_ne(points, np.array([n, e]), turn)
    assert np.hypot(*(moved[1] - moved[0])) == pytest.approx(5.0)
    np.testing.assert_allclose(moved[0], [n, e])


@given(st.floats(20, 200), st.floats(20, 200), angles, st.floats(0.5, 8.0))
def test_an_inset_takes_its_margin_off_every_side(
    a: float, c: float, turn: float, margin: float
) -> None:
    inner = inset(rectangle(np.zeros(2), a, c, turn), margin)
    assert polygon_area_m2(inner) == pytest.approx((a - 2 * margin) * (c - 2 * margin))


@pytest.mark.parametrize("m_per_px", [0.05, 0.3, 1.7])
def test_noise_has_unit_variance_where_it_is_resolved(m_per_px: float) -> None:
    bank = NoiseBank(NedWindow(0.0, 0.0, 700, 700, m_per_px), 3)
    cells = m_per_px * 64
    field = bank.fractal(cells, cells / 16.0, 1.0, 5)
    assert float(field.std()) == pytest.approx(1.0, abs=0.25)


def test_noise_is_one_field_seen_through_every_window() -> None:
    large = NoiseBank(NedWindow(30.0, -50.0, 300, 300, 0.1), 3).fractal(12.8, 0.1, 0.8, 5)
    part = NoiseBank(NedWindow(20.0, -45.0, 120, 90, 0.1), 3).fractal(12.8, 0.1, 0.8, 5)
    np.testing.assert_allclose(large[100:190, 50:170], part, atol=0.02)


@pytest.mark.filterwarnings("error")
def test_the_roughest_crown_has_no_hole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Texture 4 sigmas below its mean made pixels of it no number: black on the map."""
    canvas = Canvas(NedWindow(10.0, -10.0, 40, 40, 0.5), 1)
    shape = canvas.bgr.shape[:2]
    canvas.bgr[:] = 100.0
    rough = SimpleNamespace(fractal=lambda *_: np.full(shape, -4.0, np.float32))
    monkeypatch.setattr(canvas, "noise", rough)
    paint_plant(canvas, Plant(0.0, 0.0, 1.0, 4.0, "broadleaf", 3), flight_look(1))
    assert np.isfinite(canvas.bgr).all()
    assert (canvas.bgr != 100.0).any()


def test_windows_that_make_no_image_are_refused(site: Site) -> None:
    with pytest.raises(ValueError, match="expected a window"):
        site.render("flight", 0.0, 0.0, (0, 10), 0.3)
    with pytest.raises(ValueError, match="expected a window"):
        site.render("flight", 0.0, 0.0, (10, 10), -1.0)


def test_pairs_are_written_for_training_sites_only(tmp_path: Path) -> None:
    write_pairs(tmp_path, 2, FIRST_TRAINING_SEED, size_px=96)
    names = sorted(p.name for p in tmp_path.iterdir())
    assert names == ["0000_a.jpg", "0000_b.jpg", "0001_a.jpg", "0001_b.jpg"]
    assert cv2.imread(str(tmp_path / names[0])).shape == (96, 96, 3)
    with pytest.raises(ValueError, match="kept for flying"):
        write_pairs(tmp_path, 1, 1)


def test_the_fingerprint_is_short_and_steady() -> None:
    assert len(generator_fingerprint()) == 12
    assert generator_fingerprint() == generator_fingerprint()
