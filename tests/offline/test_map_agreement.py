"""Two looks of a generated site, drawn as maps with a known error, held against each other."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from vwnav.cli.map import app
from vwnav.geometry.geodesy import LocalFrame
from vwnav.maps.build.agreement import Agreement, Apart, pair_agreement
from vwnav.maps.build.builder import BuildOptions
from vwnav.maps.build.raster import DrawnSource, array_source, local_georeference
from vwnav.offline.map_agreement import agreement_of, with_agreement
from vwnav.sim.map_warp import MapWarp
from vwnav.sim.site import Site
from vwnav.types import Features, Gray
from vwnav.vision.features.load import load_features

SITE = Site(1)
FRAME = LocalFrame(SITE.home_lat_deg, SITE.home_lon_deg, 0.0)
NORTH0_M, EAST0_M, SIDE_PX, M_PER_PX = 240.0, -60.0, 800, 0.3
Picture = np.ndarray


def look(site: Site, name: str) -> Picture:
    return site.render(name, NORTH0_M, EAST0_M, (SIDE_PX, SIDE_PX), M_PER_PX)


@pytest.fixture(scope="module")
def looks() -> tuple[Picture, Picture]:
    """Of two days."""
    return look(SITE, "map"), look(SITE, "flight")


def grid() -> tuple[np.ndarray, np.ndarray]:
    v, u = np.mgrid[:SIDE_PX, :SIDE_PX].astype(np.float32) + np.float32(0.5)
    return np.float32(NORTH0_M) - v * np.float32(M_PER_PX), np.float32(EAST0_M) + u * np.float32(
        M_PER_PX
    )


def warped(bgr: Picture, warp: MapWarp) -> Picture:
    """The picture with everything where the map shows it."""
    north_m, east_m = grid()
    shown_n, shown_e = north_m, east_m
    for _ in range(4):
        apart = warp.at_m(shown_n, shown_e)
        shown_n, shown_e = north_m - apart[..., 0], east_m - apart[..., 1]
    u, v = (shown_e - EAST0_M) / M_PER_PX - 0.5, (NORTH0_M - shown_n) / M_PER_PX - 0.5
    where = u.astype(np.float32), v.astype(np.float32)
    return cv2.remap(bgr, *where, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


def source(bgr: Picture, name: str, north0_m=NORTH0_M, east0_m=EAST0_M) -> DrawnSource:
    return array_source(bgr, local_georeference(FRAME, (north0_m, east0_m), M_PER_PX), name=name)


def drawn_sigma_m(sigma_m: float) -> float:
    """Of one of a pair's maps over the ground that they show, per axis."""
    first, second = (MapWarp(sigma_m=sigma_m, seed=seed) for seed in (3, 4))
    return float(np.sqrt(np.mean((second.at_m(*grid()) - first.at_m(*grid())) ** 2) / 2.0))


def pair(looks: tuple[Picture, Picture], sigma_m: float, seed: int = 3) -> list[Picture]:
    return [warped(bgr, MapWarp(sigma_m=sigma_m, seed=seed + i)) for i, bgr in enumerate(looks)]


@pytest.mark.parametrize(
    ("features", "sigma_m"),
    [*[("learned", sigma_m) for sigma_m in (0.5, 1.0, 2.0, 3.0)], ("sift", 0.5), ("sift", 2.0)],
)
def test_sigma_is_that_of_the_errors_that_were_drawn(looks, features: str, sigma_m: float):
    first, second = (MapWarp(sigma_m=sigma_m, seed=seed) for seed in (3, 4))
    truly_ne_m = (second.at_m(*grid()) - first.at_m(*grid())).reshape(-1, 2)
    sources = [source(bgr, name) for bgr, name in zip(pair(looks, sigma_m), "ab", strict=True)]
    found = agreement_of(sources, [load_features(features)])
    assert found is not None
    assert found.sigma_m == pytest.approx(drawn_sigma_m(sigma_m), rel=0.3)
    (only,) = found.pairs
    assert np.allclose(only.shift_ne_m, truly_ne_m.mean(axis=0), atol=0.2 + 0.15 * sigma_m)
    assert only.waves_m == pytest.approx(np.sqrt(truly_ne_m.var(axis=0).mean()), rel=0.3)


@pytest.mark.parametrize("features", ["learned", "sift"])
def test_what_shows_other_ground_tells_nothing(looks, features: str):
    sources = [source(looks[0], "a"), source(look(Site(2), "flight"), "elsewhere")]
    assert agreement_of(sources, [load_features(features)]) is None


class Noise:
    """Features of nothing: whatever of their matches agrees does so by chance."""

    name, feature_set_id, log10_per_decade = "sift", "noise", 1.5

    def extract(self, gray: Gray, max_keypoints: int) -> Features:
        rng = np.random.default_rng(int(gray.sum(dtype=np.int64)))
        descriptors = rng.standard_normal((max_keypoints, 16)).astype(np.float32)
        descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
        uv = rng.uniform(0.0, 1.0, (max_keypoints, 2)) * gray.shape[::-1] - 0.5
        scores = np.ones(max_keypoints, np.float32)
        return Features(uv.astype(np.float32), descriptors, scores)


def test_what_agrees_by_chance_tells_nothing():
    """Without the test of significance eighteen of these 64 blocks are believed."""
    rng = np.random.default_rng(0)
    sources = [
        source(rng.integers(20, 230, (1600, 1600, 3), dtype=np.uint8), name) for name in "ab"
    ]
    assert agreement_of(sources, [Noise()]) is None


class NeverAsked:
    """Features that no image may be asked for."""

    name, feature_set_id, log10_per_decade = "sift", "never", 1.5

    def extract(self, gray: Gray, max_keypoints: int):
        raise AssertionError("nothing overlaps")


def test_sources_that_touch_tell_nothing(looks):
    beside = source(looks[1], "b", east0_m=EAST0_M + SIDE_PX * M_PER_PX)
    assert agreement_of([source(looks[0], "a"), beside], [NeverAsked()]) is None


def test_one_picture_is_no_witness_for_itself(looks):
    """Tiles of one mosaic, or a pack and what it was made of, agree and prove nothing."""
    parts = [looks[0][:, :600], looks[0][:, 150:]]
    sources = [
        source(parts[0], "west"),
        source(parts[1], "east", east0_m=EAST0_M + 150 * M_PER_PX),
    ]
    assert agreement_of(sources, [load_features("sift")]) is None


def test_the_learned_features_look_where_they_are_built(looks):
    sources = [source(bgr, name) for bgr, name in zip(looks, "ab", strict=True)]
    assert agreement_of(sources, [NeverAsked(), load_features("learned")]) is not None


def places_of(seed: int, sigma_m: float) -> list[Apart]:
    north_m, east_m = np.meshgrid(
        np.arange(-400, 401, 60, dtype=np.float32), np.arange(-400, 401, 60, dtype=np.float32)
    )
    first, second = (MapWarp(sigma_m=sigma_m, seed=seed + i).at_m(north_m, east_m) for i in (0, 1))
    return [
        Apart(lat_deg=60.0, lon_deg=22.0, apart_ne_m=each, within_m=0.0, sigma_m=0.0)
        for each in (second - first).reshape(-1, 2).astype(np.float64)
    ]


def test_over_many_maps_sigma_is_that_of_one_source():
    rms_m = [pair_agreement(("a", "b"), places_of(seed, 2.0)).rms_m for seed in range(0, 120, 2)]
    assert np.sqrt(np.mean(np.square(rms_m)) / 2.0) == pytest.approx(2.0, rel=0.15)


def test_a_place_far_from_all_others_counts_for_neither_and_is_named():
    places = places_of(3, 0.5)
    before = pair_agreement(("a", "b"), places)
    askew = Apart(
        lat_deg=60.1, lon_deg=22.1, apart_ne_m=np.array([20.0, 0.0]), within_m=0.0, sigma_m=0.0
    )
    after = pair_agreement(("a", "b"), [*places, askew])
    assert after.rms_m == pytest.approx(before.rms_m, rel=0.01)
    assert after.worst is askew


def test_four_places_are_too_few():
    assert pair_agreement(("a", "b"), places_of(3, 0.5)[:4]) is None


# The real command


def run(*words: str | Path):
    done = CliRunner().invoke(app, [str(word) for word in words])
    if done.exception and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done


def written(folder: Path, pictures: list[Picture]) -> Path:
    """Pictures with the table of their corners."""
    corners = np.array([[NORTH0_M, EAST0_M, 0.0]] * 2)
    corners[1, :2] += np.array([-1.0, 1.0]) * SIDE_PX * M_PER_PX
    (north, south), (west, east), _ = FRAME.to_geodetic(corners)
    lines = ["file,north,west,south,east"]
    for name, bgr in zip("ab", pictures, strict=True):
        cv2.imwrite(str(folder / f"{name}.png"), bgr)
        lines.append(f"{name}.png,{north:.9f},{west:.9f},{south:.9f},{east:.9f}")
    (folder / "map.csv").write_text("\n".join(lines) + "\n")
    return folder


def info(pack: Path) -> dict:
    return json.loads(run("info", pack, "--json").stdout)


WORDS = ("--features", "sift", "--levels", "18")


def test_a_build_says_how_good_the_map_is_and_a_rebuild_keeps_it(looks, tmp_path: Path):
    maps, pack = written(tmp_path, pair(looks, 2.0)), tmp_path / "site.mbtiles"
    built = run("build", maps, "-o", pack, *WORDS)
    (line,) = [line for line in built.stderr.splitlines() if "agree to" in line]
    assert line.startswith("map: a.png and b.png agree to ")
    told_m = float(line.split("good to ")[1].split(" m")[0])
    assert told_m == pytest.approx(drawn_sigma_m(2.0), rel=0.3)
    assert "1 sigma, estimated" in built.stdout
    said = info(pack)
    assert said["georeference_basis"] == "estimated"
    assert said["georeference_sigma_m"] == pytest.approx(drawn_sigma_m(2.0), rel=0.3)
    again = run("build", pack, "-o", pack, *WORDS)
    assert "agree to" not in again.stderr
    assert info(pack) | {"created_utc": "", "bytes": 0} == said | {"created_utc": "", "bytes": 0}


def test_what_the_operator_gives_stands_and_a_contradiction_is_said(looks, tmp_path: Path):
    maps, pack = written(tmp_path, pair(looks, 3.0)), tmp_path / "site.mbtiles"
    built = run("build", maps, "-o", pack, *WORDS, "--georeference-sigma-m", "0.5")
    said = info(pack)
    assert (said["georeference_sigma_m"], said["georeference_basis"]) == (0.5, "given")
    (line,) = [line for line in built.stderr.splitlines() if "agree to" in line]
    assert line.endswith("the 0.5 m that was given stands")
    (there,) = [line for line in built.stderr.splitlines() if "look there" in line]
    lat_deg, lon_deg = (float(each) for each in there.split(" at ")[1].split(",")[:2])
    assert said["south_deg"] < lat_deg < said["north_deg"]
    assert said["west_deg"] < lon_deg < said["east_deg"]


def test_a_given_sigma_that_fits_what_overlaps_says_nothing():
    found = Agreement((pair_agreement(("a", "b"), places_of(3, 0.5)),))
    options = BuildOptions(georeference_sigma_m=0.5)
    assert with_agreement(options, found) == (options, [])


def test_where_nothing_overlaps_a_metre_is_assumed(looks, tmp_path: Path):
    pack = tmp_path / "site.mbtiles"
    maps = written(tmp_path, list(looks))
    table = (maps / "map.csv").read_text().splitlines()
    (maps / "map.csv").write_text("\n".join(table[:2]) + "\n")
    (maps / "b.png").unlink()
    run("build", maps, "-o", pack, *WORDS)
    assert (info(pack)["georeference_sigma_m"], info(pack)["georeference_basis"]) == (1, "assumed")
