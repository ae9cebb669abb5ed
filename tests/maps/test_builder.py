import os
import signal
import sqlite3
import subprocess
import sys
import tracemalloc
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from map_samples import ORIGIN_PX, ZOOM, SiftStub, small_pack, textured

from vwnav.errors import MapError
from vwnav.geometry.geodesy import Window, ground_resolution_m_per_px
from vwnav.maps.build.builder import BuildOptions, build_pack, default_levels
from vwnav.maps.build.raster import DrawnSource, array_source, level_georeference
from vwnav.maps.heights import HeightGrid
from vwnav.maps.image import MapImage
from vwnav.maps.pack import MapPack


class Failing(SiftStub):
    def __init__(self, error: BaseException) -> None:
        super().__init__()
        self._error = error

    def extract(self, gray, max_keypoints):
        if self.calls:
            raise self._error
        return super().extract(gray, max_keypoints)


@pytest.mark.parametrize("m_per_px", [0.05, 0.08, 0.2, 0.31, 0.5, 1.5])
def test_the_finest_level_keeps_the_resolution_and_two_coarser_follow(m_per_px: float):
    levels = default_levels(m_per_px, 46.8)
    finest = ground_resolution_m_per_px(46.8, levels[0])
    assert 0.6 * m_per_px - 1e-9 <= finest <= 1.2 * m_per_px
    assert levels == (levels[0], levels[0] - 1, levels[0] - 2)


def test_a_pack_shows_the_image_it_was_built_from(tmp_path: Path):
    with MapPack.open(small_pack(tmp_path / "a.mbtiles")) as pack:
        x, y = ORIGIN_PX
        image = pack.colour_image(ZOOM, Window(x, y, x + 700, y + 600))
    assert image.mask.all()
    assert np.array_equal(image.bgr, textured(600, 700))


def test_a_coarser_level_is_the_mean_of_the_finer_one(tmp_path: Path):
    with MapPack.open(small_pack(tmp_path / "a.mbtiles")) as pack:
        x, y = ORIGIN_PX
        image = pack.colour_image(ZOOM - 1, Window(x // 2, y // 2, x // 2 + 350, y // 2 + 300))
    expected = textured(600, 700).reshape(300, 2, 350, 2, 3).mean(axis=(1, 3))
    assert np.abs(image.bgr - expected).max() <= 0.51


def test_levels_that_do_not_follow_each_other_are_rendered_from_the_source(tmp_path: Path):
    options = BuildOptions(levels=(ZOOM, ZOOM - 2))
    with MapPack.open(small_pack(tmp_path / "a.mbtiles", options=options)) as pack:
        x, y = (value // 4 for value in ORIGIN_PX)
        image = pack.colour_image(ZOOM - 2, Window(x, y, x + 175, y + 150))
        assert [level.zoom for level in pack.levels] == [ZOOM, ZOOM - 2]
    expected = textured(600, 700).reshape(150, 4, 175, 4, 3).mean(axis=(1, 3))
    assert np.abs(image.bgr - expected).max() <= 1.0


def test_the_first_source_wins_where_two_overlap(tmp_path: Path):
    x, y = ORIGIN_PX
    red, blue = (np.full((300, 300, 3), colour, np.uint8) for colour in ((0, 0, 200), (200, 0, 0)))
    sources = [
        array_source(red, level_georeference(ZOOM, x, y), name="red"),
        array_source(blue, level_georeference(ZOOM, x + 200, y), name="blue"),
    ]
    build_pack(sources, tmp_path / "a.mbtiles", [], BuildOptions(levels=(ZOOM,)))
    with MapPack.open(tmp_path / "a.mbtiles") as pack:
        row = pack.colour_image(ZOOM, Window(x, y + 100, x + 500, y + 101)).bgr[0]
    assert (row[:300] == (0, 0, 200)).all()
    assert (row[300:] == (200, 0, 0)).all()


def test_progress_is_told_for_every_part_up_to_its_end(tmp_path: Path):
    told: dict[str, list[tuple[int, int]]] = {}
    source = array_source(textured(300, 300), level_georeference(ZOOM, *ORIGIN_PX), name="a")
    build_pack(
        [source],
        tmp_path / "a.mbtiles",
        [SiftStub()],
        progress=lambda what, done, total: told.setdefault(what, []).append((done, total)),
    )
    assert list(told) == [f"level {ZOOM - i}" for i in range(3)] + ["sift features"]
    assert all(steps[-1][0] == steps[-1][1] == len(steps) for steps in told.values())


@pytest.mark.parametrize("error", [KeyboardInterrupt(), MapError("x"), RuntimeError("x")])
def test_an_error_or_interrupt_leaves_the_old_pack_and_nothing_else(tmp_path: Path, error):
    path = small_pack(tmp_path / "a.mbtiles")
    before = path.read_bytes()
    with pytest.raises(type(error)):
        small_pack(path, (Failing(error),))
    assert [file.name for file in tmp_path.iterdir()] == ["a.mbtiles"]
    assert path.read_bytes() == before


KILLED = """
import sys; sys.path.insert(0, {tests!r})
from pathlib import Path
from map_samples import SiftStub, small_pack
class Stuck(SiftStub):
    def extract(self, gray, count):
        if self.calls: print("busy", flush=True); sys.stdin.read()
        return super().extract(gray, count)
small_pack(Path({path!r}), (Stuck(),))
"""


def test_what_a_killed_build_leaves_is_removed_by_the_next(tmp_path: Path):
    path = tmp_path / "a.mbtiles"
    script = KILLED.format(tests=str(Path(__file__).parent), path=str(path))
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as build:
        assert build.stdout.readline() == b"busy\n"
        build.kill()
    assert not path.exists()
    assert len(list(tmp_path.iterdir())) == 1
    small_pack(path)
    assert [file.name for file in tmp_path.iterdir()] == ["a.mbtiles"]


def test_an_interrupted_process_leaves_nothing(tmp_path: Path):
    path = tmp_path / "a.mbtiles"
    script = KILLED.format(tests=str(Path(__file__).parent), path=str(path))
    with subprocess.Popen(
        [sys.executable, "-c", script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as build:
        assert build.stdout.readline() == b"busy\n"
        os.kill(build.pid, signal.SIGINT)
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_another_kind_is_not_overwritten(tmp_path: Path):
    photo = tmp_path / "photo.tif"
    photo.write_bytes(b"II*\0" + bytes(50))
    with pytest.raises(MapError, match="is no map pack"):
        small_pack(photo)
    assert photo.stat().st_size == 54


def database(path: Path) -> Path:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE gpkg_contents (table_name TEXT)")
        connection.execute("INSERT INTO gpkg_contents VALUES ('precious')")
    return path


def test_neither_is_the_database_of_another_program(tmp_path: Path):
    other = database(tmp_path / "other.gpkg")
    before = other.read_bytes()
    with pytest.raises(MapError, match="is no map pack"):
        small_pack(other)
    assert other.read_bytes() == before


def test_neither_is_a_damaged_database_nor_what_is_no_file(tmp_path: Path):
    damaged = database(tmp_path / "damaged.mbtiles")
    damaged.write_bytes(damaged.read_bytes()[:100] + bytes(900))
    os.mkfifo(tmp_path / "pipe.mbtiles")
    for path in (damaged, tmp_path / "pipe.mbtiles"):
        with pytest.raises(MapError, match="is no map pack"):
            small_pack(path)


def test_an_empty_file_is_replaced(tmp_path: Path):
    (tmp_path / "a.mbtiles").touch()
    MapPack.open(small_pack(tmp_path / "a.mbtiles")).close()


@pytest.mark.parametrize(("name", "message"), [("no/a.mbtiles", "no folder"), (".", "a folder")])
def test_an_output_that_cannot_be_is_refused(tmp_path: Path, name: str, message: str):
    with pytest.raises(MapError, match=message):
        small_pack(tmp_path / name)


def test_no_sources_and_no_imagery_are_refused(tmp_path: Path):
    with pytest.raises(MapError, match="no map sources"):
        build_pack([], tmp_path / "a.mbtiles", [])
    with pytest.raises(MapError, match="holds no imagery"):
        small_pack(tmp_path / "a.mbtiles", mask=np.zeros((600, 700), bool))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("levels", [(31,), (-1, 3)])
def test_levels_that_no_grid_has_are_refused(tmp_path: Path, levels):
    with pytest.raises(MapError, match="zooms from 0 to 30"):
        small_pack(tmp_path / "a.mbtiles", options=BuildOptions(levels=levels))


def test_a_level_far_too_fine_is_refused_before_the_disk_is_full(tmp_path: Path):
    with pytest.raises(MapError, match="would need"):
        small_pack(tmp_path / "a.mbtiles", options=BuildOptions(levels=(28,)))


def test_a_large_raster_is_read_in_parts_of_bounded_size(tmp_path: Path):
    largest = 0

    def draw(window: Window) -> MapImage:
        nonlocal largest
        h, w = window.shape
        largest = max(largest, h * w)
        return MapImage(np.full((h, w, 3), 99, np.uint8), np.ones((h, w), bool))

    georeference = level_georeference(ZOOM, *ORIGIN_PX)
    source = DrawnSource("huge", (12_000, 12_000), georeference, draw)
    tracemalloc.start()
    build_pack([source], tmp_path / "a.mbtiles", [], BuildOptions(levels=(ZOOM - 4,)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert largest < 2_500_000
    assert peak < 200e6


def test_what_is_said_about_a_pack_is_kept(tmp_path: Path):
    heights = HeightGrid((60.0, 22.0, 60.1, 22.2), np.full((4, 5), 31.5, np.float32))
    options = BuildOptions(
        name="field",
        attribution="(c) survey",
        georeference_sigma_m=0.4,
        created_utc="2026-01-02T03:04:05Z",
        heights=heights,
    )
    with MapPack.open(small_pack(tmp_path / "a.mbtiles", options=options)) as pack:
        assert (pack.name, pack.attribution) == ("field", "(c) survey")
        assert (pack.georeference_sigma_m, pack.created_utc) == (0.4, "2026-01-02T03:04:05Z")
        assert pack.sources == ("field.png",)
        assert pack.elevation_m(60.05, 22.1) == pytest.approx(31.5)
        assert pack.elevation_m(59.0, 22.1) is None


@pytest.mark.parametrize(
    ("options", "sigma_m", "basis"),
    [
        (BuildOptions(), 1.0, "assumed"),
        (BuildOptions(georeference_sigma_m=0.4), 0.4, "given"),
        (BuildOptions(georeference_sigma_m=0.4, georeference_basis="estimated"), 0.4, "estimated"),
        (BuildOptions(georeference_sigma_m=0.4, georeference_basis=None), 0.4, None),
    ],
)
def test_a_pack_says_how_its_error_is_known_or_is_as_packs_were(
    tmp_path: Path, options: BuildOptions, sigma_m: float, basis: str | None
):
    with MapPack.open(small_pack(tmp_path / "a.mbtiles", options=options)) as pack:
        assert (pack.georeference_sigma_m, pack.georeference_basis) == (sigma_m, basis)


def test_the_same_sources_give_the_same_file(tmp_path: Path):
    first = small_pack(tmp_path / "a.mbtiles", (SiftStub(),))
    second = small_pack(tmp_path / "b.mbtiles", (SiftStub(),))
    assert first.read_bytes() == second.read_bytes()
