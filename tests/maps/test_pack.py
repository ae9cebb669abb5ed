import logging
import shutil
import sqlite3
import threading
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from map_samples import ORIGIN_PX, ZOOM, SiftStub, small_pack, textured

from vwnav.errors import MapError, ModelError
from vwnav.geometry.geodesy import Window, lat_lon_from_mercator_px
from vwnav.maps.pack import MapPack
from vwnav.maps.schema import is_pack

X, Y = ORIGIN_PX


def changed(pack_file: Path, folder: Path, *statements: str) -> Path:
    """A copy of a pack on which SQL was run."""
    copy = shutil.copy(pack_file, folder / "changed.mbtiles")
    with closing(sqlite3.connect(copy)) as database, database:
        for statement in statements:
            assert database.execute(statement).rowcount != 0
    return Path(copy)


def test_features_lie_on_the_image_they_were_found_in(sift_pack: MapPack):
    found = sift_pack.features_in(ZOOM, X + 100, Y + 100, X + 400, Y + 400, SiftStub())
    assert found.origin_px.tolist() == [X + 100, Y + 100]
    direct = SiftStub().extract(
        np.ascontiguousarray(sift_pack.image(ZOOM, X, Y, X + 700, Y + 600)[0]), 5000
    )
    globally = found.features.uv[:, None] + found.origin_px - np.array([X, Y])
    distance = np.linalg.norm(globally - direct.uv[None], axis=2)
    nearest = distance.argmin(axis=1)
    assert np.mean(distance.min(axis=1) < 0.1) > 0.95
    same = (found.features.descriptors * direct.descriptors[nearest]).sum(axis=1)
    assert np.median(same) > 0.99


@settings(max_examples=30)
@given(st.tuples(*[st.integers(-200, 900)] * 4))
def test_features_lie_inside_the_window_that_was_asked_for(sift_pack_file, corners):
    u0, u1 = sorted(corners[:2])
    v0, v1 = sorted(corners[2:])
    with MapPack.open(sift_pack_file) as pack:
        found = pack.features_in(ZOOM, X + u0, Y + v0, X + u1, Y + v1, SiftStub())
    corner = found.features.uv + 0.5 + found.origin_px - (X, Y)
    assert ((corner >= (u0, v0)) & (corner <= (u1, v1))).all()
    assert (np.diff(found.features.scores) <= 0).all()


def test_a_query_reads_the_tiles_under_it_once_and_no_others(sift_pack: MapPack):
    statements: list[str] = []
    sift_pack._connection.set_trace_callback(statements.append)
    window = Window(X // 256 * 256 + 10, Y // 256 * 256 + 10, X // 256 * 256 + 500, Y + 100)
    for _ in range(3):
        sift_pack.features_in(ZOOM, *window, SiftStub())
    assert len(statements) == len(window.tiles(ZOOM))
    statements.clear()
    sift_pack.image(ZOOM, *window)
    sift_pack.image(ZOOM, *window)
    assert len(statements) == len(window.tiles(ZOOM))


def test_a_tile_is_found_by_its_index_however_large_the_map(sift_pack: MapPack):
    for table in ("tiles", "vwnav_features", "vwnav_tiles"):
        extra = "set_name = 'sift' AND " if table == "vwnav_features" else ""
        (plan,) = sift_pack._connection.execute(
            f"EXPLAIN QUERY PLAN SELECT * FROM {table} WHERE {extra}zoom_level = 1 "
            "AND tile_column = 1 AND tile_row = 1"
        ).fetchall()
        assert plan[3].startswith(f"SEARCH {table} USING INDEX")


def test_a_query_gives_at_most_what_is_asked_spread_over_the_tiles(sift_pack: MapPack):
    found = sift_pack.features_in(
        ZOOM, X, Y, X + 700, Y + 600, SiftStub(), max_keypoints=60
    ).features
    assert len(found) == 60
    assert np.ptp(found.uv, axis=0).min() > 400


def test_a_window_beside_the_map_has_no_features_and_no_data(sift_pack: MapPack):
    found = sift_pack.features_in(ZOOM, X - 5000, Y, X - 4000, Y + 500, SiftStub())
    assert len(found.features) == 0
    gray, mask = sift_pack.image(ZOOM, X - 5000, Y, X - 4000, Y + 500)
    assert gray.shape == mask.shape == (500, 1000)
    assert not mask.any()


@pytest.mark.parametrize("window", [(0, 0, 0, 5), (5, 5, 4, 9), (0, 0, 100_000, 100_000)])
def test_an_image_without_end_is_refused(sift_pack: MapPack, window):
    with pytest.raises(ValueError, match="expected 1 to"):
        sift_pack.image(ZOOM, *window)
    with pytest.raises(ValueError, match="levels"):
        sift_pack.image(3, 0, 0, 5, 5)


def test_a_name_of_any_bytes_can_be_opened(sift_pack_file: Path, tmp_path: Path):
    old = tmp_path / "m\udcfc 100%?#.mbtiles"  # in Latin-1, from an old stick
    shutil.copy(sift_pack_file, old)
    with MapPack.open(old) as pack:
        assert pack.levels
    assert is_pack(old)


def test_places_on_the_imagery_are_covered_and_others_are_not(sift_pack: MapPack):
    south, west, north, east = sift_pack.bounds
    assert sift_pack.covers((south + north) / 2, (west + east) / 2)
    for lat, lon in [(south - 1e-4, west), (north + 1e-4, east), (0.0, 0.0), (float("nan"), 9.0)]:
        assert not sift_pack.covers(lat, lon)


def test_the_bounds_are_those_of_the_imagery(sift_pack: MapPack):
    north, west = lat_lon_from_mercator_px(float(X), float(Y), ZOOM)
    south, east = lat_lon_from_mercator_px(X + 700.0, Y + 600.0, ZOOM)
    assert sift_pack.bounds == pytest.approx((south, west, north, east), abs=1e-8)


def test_a_missing_set_is_extracted_with_one_warning_and_kept(tmp_path: Path, caplog):
    stub = SiftStub()
    window = (ZOOM, X + 20, Y + 20, X + 300, Y + 300)
    with MapPack.open(small_pack(tmp_path / "a.mbtiles")) as pack:
        first = pack.features_in(*window, stub)
        calls = stub.calls
        again = pack.features_in(*window, stub)
    assert stub.calls == calls <= 4
    assert len(first.features) > 100
    assert np.array_equal(first.features.uv, again.features.uv)
    warnings = [record.message for record in caplog.records if record.levelno == logging.WARNING]
    assert len(warnings) == 1
    assert "vwnav map build" in warnings[0]


def test_features_extracted_in_flight_are_those_of_the_build(sift_pack: MapPack, tmp_path: Path):
    window = (ZOOM, X, Y, X + 700, Y + 600)
    built = sift_pack.features_in(*window, SiftStub())
    with MapPack.open(small_pack(tmp_path / "a.mbtiles")) as pack:
        extracted = pack.features_in(*window, SiftStub())
    assert len(built.features) == len(extracted.features)
    difference = np.sort(built.features.uv, axis=0) - np.sort(extracted.features.uv, axis=0)
    assert np.abs(difference).max() < 0.01


def test_features_of_another_model_are_refused_with_the_command_that_repairs(sift_pack: MapPack):
    other = SiftStub("sift-test-2")
    with pytest.raises(ModelError, match=r"sift-test-1.*sift-test-2") as caught:
        sift_pack.check_features(other)
    path = sift_pack.path
    assert f"vwnav map build {path} -o {path} --features sift" in str(caught.value)
    with pytest.raises(ModelError):
        sift_pack.features_in(ZOOM, X, Y, X + 9, Y + 9, other)


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE vwnav_features SET data = zeroblob(length(data))",
        "UPDATE vwnav_features SET data = 'text'",
        "UPDATE vwnav_features SET data = substr(data, 1, 100)",
        "UPDATE vwnav_features SET crc32 = 'text'",
    ],
)
def test_damaged_features_cost_their_tile_and_one_warning(sift_pack_file, tmp_path, damage, caplog):
    where = f" WHERE zoom_level = {ZOOM} AND tile_column = {X // 256 + 1}"
    window = (ZOOM, X, Y, X + 700, Y + 600)
    with MapPack.open(changed(sift_pack_file, tmp_path, damage + where)) as pack:
        for _ in range(2):
            found = pack.features_in(*window, SiftStub())
    columns = (found.features.uv[:, 0] + 0.5 + found.origin_px[0]) // 256 - X // 256
    assert set(columns.tolist()) == {0, 2}
    assert sum("damaged" in record.message for record in caplog.records) == 3


@pytest.mark.parametrize("damage", ["zeroblob(500)", "NULL", "'text'"])
def test_a_damaged_image_is_no_data_with_one_warning(sift_pack_file, tmp_path, damage, caplog):
    statement = f"UPDATE tiles SET tile_data = {damage} WHERE zoom_level = {ZOOM}"
    with MapPack.open(changed(sift_pack_file, tmp_path, statement)) as pack:
        _, mask = pack.image(ZOOM, X + 300, Y + 300, X + 310, Y + 310)
        pack.image(ZOOM, X + 300, Y + 300, X + 310, Y + 310)
    assert not mask.any()
    assert sum("damaged" in record.message for record in caplog.records) == 1


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("UPDATE vwnav_metadata SET value = '2' WHERE name = 'schema_version'", "schema 2"),
        ("UPDATE vwnav_metadata SET value = '9.0' WHERE name = 'georeference_sigma_m'", "checksum"),
        ("UPDATE metadata SET value = '0,0,1,1' WHERE name = 'bounds'", "checksum"),
        ("UPDATE vwnav_feature_sets SET feature_set_id = 'x'", "checksum"),
        ("DROP TABLE vwnav_metadata", "imagery without features"),
        ("DROP TABLE vwnav_feature_sets", "damaged"),
        ("DELETE FROM vwnav_tiles", "has no tiles"),
    ],
)
def test_a_changed_pack_is_refused_with_one_line(sift_pack_file, tmp_path, statement, message):
    with pytest.raises(MapError, match=message) as caught:
        MapPack.open(changed(sift_pack_file, tmp_path, statement))
    assert "\n" not in str(caught.value)
    assert "vwnav map build" in str(caught.value)


@pytest.mark.parametrize("share", [0.0, 0.00002, 0.3, 0.999])
def test_a_cut_off_pack_is_refused(sift_pack_file: Path, tmp_path: Path, share: float):
    data = sift_pack_file.read_bytes()
    cut = tmp_path / "cut.mbtiles"
    cut.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(MapError, match=r"not a map pack|cut off"):
        MapPack.open(cut)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_random_damage_is_an_error_at_opening_or_lost_tiles(sift_pack_file, tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    data = bytearray(sift_pack_file.read_bytes())
    for start in rng.integers(0, len(data), 4):
        data[start : start + 700] = rng.bytes(len(data[start : start + 700]))
    broken = tmp_path_factory.mktemp("broken") / "broken.mbtiles"
    broken.write_bytes(data)
    try:
        pack = MapPack.open(broken)
    except MapError:
        return
    with pack:
        found = pack.features_in(ZOOM, X, Y, X + 700, Y + 600, SiftStub())
        pack.image(ZOOM, X, Y, X + 700, Y + 600)
    assert np.isfinite(found.features.descriptors).all()


def test_what_is_no_pack_is_refused(tmp_path: Path):
    foreign, text = tmp_path / "foreign.db", tmp_path / "text.mbtiles"
    with closing(sqlite3.connect(foreign)) as database, database:
        database.execute("CREATE TABLE birds (name TEXT)")
    text.write_text("hello")
    for path, message in [
        (foreign, "another kind"),
        (text, "not a map pack"),
        (tmp_path / "none.mbtiles", "no such map pack"),
        (tmp_path, "no such map pack"),
    ]:
        with pytest.raises(MapError, match=message):
            MapPack.open(path)


def test_a_pack_is_opened_from_a_read_only_folder_with_an_odd_name(sift_pack_file, tmp_path):
    folder = tmp_path / "sd card #1?%20"
    folder.mkdir()
    copy = shutil.copy(sift_pack_file, folder / "field.mbtiles")
    Path(copy).chmod(0o444)
    folder.chmod(0o555)
    try:
        with MapPack.open(copy) as pack:
            assert pack.name == "field"
        assert [file.name for file in folder.iterdir()] == ["field.mbtiles"]
    finally:
        folder.chmod(0o755)


def test_threads_may_share_a_pack(sift_pack: MapPack):
    counts, expected = [], textured(600, 700).mean()

    def work() -> None:
        for _ in range(20):
            gray, _ = sift_pack.image(ZOOM, X, Y, X + 700, Y + 600)
            counts.append(abs(gray.mean() - expected) < 5)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert counts == [True] * 80


def test_memory_stays_bounded_however_much_is_read(sift_pack: MapPack):
    for level in sift_pack.levels:
        for x in range(X - 3000, X + 3000, 256):
            sift_pack.covers(*lat_lon_from_mercator_px(float(x), float(Y), ZOOM))
            sift_pack.features_in(level.zoom, x, Y, x + 256, Y + 256, SiftStub())
    assert len(sift_pack._images._values) <= 64
    assert len(sift_pack._features._values) <= 192
