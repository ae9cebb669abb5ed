import logging
from pathlib import Path

import cv2
import numpy as np
import pytest
from map_samples import textured

from vwnav.errors import MapError
from vwnav.maps.build.builder import build_pack
from vwnav.maps.build.image_files import corner_images, is_corner_table, read_corners
from vwnav.maps.build.warp import PlacedRaster
from vwnav.maps.pack import MapPack

WILD = """Filename, Top_left_lat,Top_left_lon,Bottom_right_lat,Bottom_right_long
"a.png",   60.403962,    22.460441,   60.402409,    22.464059
"b.png",  60.403963,  22.464054,  60.402409,  22.467672
"""


def write_table(folder: Path, text: str = WILD, images: str = "ab") -> Path:
    for name in images:
        cv2.imwrite(str(folder / f"{name}.png"), textured(160, 184, ord(name)))
    (folder / "map.csv").write_text(text)
    return folder / "map.csv"


@pytest.mark.parametrize(
    "header",
    [
        "Filename, Top_left_lat,Top_left_lon,Bottom_right_lat,Bottom_right_long",
        "file;top left latitude;top left longitude;bottom right latitude;bottom right longitude",
        "\ufeffIMAGE\tTL_Lat (deg)\tTL_Lon (deg)\tBR_Lat (deg)\tBR_Lng (deg)",
        "name,north,west,south,east",
    ],
)
def test_any_usual_spelling_of_the_header_is_understood(tmp_path: Path, header: str):
    mark = next(sign for sign in (";", "\t", ",") if sign in header)
    line = mark.join(["'x.jpg'", "60.2", " 22.1 ", '"60.1"', "22.3"])
    (tmp_path / "map.csv").write_text(f"{header}\n\n{line}\n", encoding="utf-8")
    (row,) = read_corners(tmp_path / "map.csv")
    assert (row.file, row.bounds) == ("x.jpg", (60.1, 22.1, 60.2, 22.3))


def test_columns_may_come_in_any_order(tmp_path: Path):
    (tmp_path / "m.csv").write_text("east,note,south,file,west,north\n22.3,x,60.1,a.png,22.1,60.2")
    (row,) = read_corners(tmp_path / "m.csv")
    assert row.bounds == (60.1, 22.1, 60.2, 22.3)


@pytest.mark.parametrize(
    ("mark", "first", "encoding"),
    [(";", "sep=;\n", "utf-8"), ("|", "SEP=|\r\n", "utf-8-sig"), ("\t", "", "utf-16")],
)
def test_a_table_as_excel_writes_it_is_understood(tmp_path: Path, mark, first, encoding):
    lines = f"{first}file,north,west,south,east\nü.png,60.2,22.1,60.1,22.3\nb.png,60,22,59,x"
    (tmp_path / "m.csv").write_text(lines.replace(",", mark), encoding=encoding)
    assert is_corner_table(tmp_path / "m.csv")
    with pytest.raises(MapError, match=f"line {3 + bool(first)}: a corner is no number"):
        read_corners(tmp_path / "m.csv")


def test_missing_images_are_passed_over_with_a_warning(tmp_path: Path, caplog):
    table = write_table(tmp_path, images="b")
    with caplog.at_level(logging.WARNING):
        found = corner_images(table)
    assert [source.name for source in found] == ["b.png"]
    assert "a.png" in caplog.text


def test_images_listed_elsewhere_are_found_by_their_name(tmp_path: Path):
    table = write_table(tmp_path, images="")
    elsewhere = tmp_path / "pictures"
    elsewhere.mkdir()
    cv2.imwrite(str(elsewhere / "a.png"), textured(20, 20))
    assert [source.name for source in corner_images(table, [elsewhere / "a.png"])] == ["a.png"]


def test_images_meet_in_the_pack_without_a_gap(tmp_path: Path):
    sources = corner_images(write_table(tmp_path))
    build_pack(sources, tmp_path / "a.mbtiles", [])
    with MapPack.open(tmp_path / "a.mbtiles") as pack:
        zoom = pack.levels[0].zoom
        rows, columns = np.nonzero(pack.colour_image(zoom, pack.window(zoom)).mask)
        area = (np.ptp(rows) + 1) * (np.ptp(columns) + 1)
        assert len(rows) > 0.99 * area
        assert pack.covers(60.4032, 22.4640565)


def test_an_image_lies_between_its_corners(tmp_path: Path):
    source = corner_images(write_table(tmp_path))[0]
    placed = PlacedRaster.of(source)
    assert placed.bounds == pytest.approx((60.402409, 22.460441, 60.403962, 22.464059), abs=1e-9)
    assert placed.m_per_px == pytest.approx(1.08, abs=0.02)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no column for file"),
        ("file,north,west,south\n", "no column for east"),
        ("file,north,west,south,east\na.png,60,22,59\n", "line 2: has 4 columns of 5"),
        ("file,north,west,south,east\na.png,60,22,59,x\n", "line 2: a corner is no number"),
        ("file,north,west,south,east\na.png,59,22,60,23\n", "line 2: the top left corner"),
        ("file,north,west,south,east\na.png,nan,22,59,23\n", "line 2"),
        ("file,north,west,south,east\n,60,22,59,23\n", "line 2: a file name"),
        ("file,north,west,south,east\nq.png,60,22,59,23\n", "none of its 1 pictures"),
        ("file,north,west,south,east\n", "none of its 0 pictures"),
    ],
)
def test_a_table_that_makes_no_sense_is_one_clear_error(tmp_path: Path, text: str, message: str):
    with pytest.raises(MapError, match=message):
        corner_images(write_table(tmp_path, text))


def test_a_damaged_image_is_one_clear_error(tmp_path: Path):
    table = write_table(tmp_path)
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(MapError, match=r"a\.png"):
        corner_images(table)


def test_other_tables_are_not_taken_for_corner_tables(tmp_path: Path):
    (tmp_path / "photos.csv").write_text("Filename,Latitude,Longitude\na.jpg,60,22\n")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x80")
    assert is_corner_table(write_table(tmp_path))
    assert not is_corner_table(tmp_path / "photos.csv")
    assert not is_corner_table(tmp_path / "binary.csv")


@pytest.mark.parametrize(
    "content",
    [
        b"file,north,west,south,east\na.png,60,22,59,x\n",
        b"file;north;west;south;east\na.png;60,2;22;59;23\n",
        b"file,north,west,south,east\na.png,60,,59,23\n",
        b"file,north,west,south,east\n\xfc.png,60,22,59,23\n",  # Windows' own letters
    ],
)
def test_a_table_with_something_wrong_in_a_line_is_still_one(tmp_path: Path, content: bytes):
    (tmp_path / "corners.csv").write_bytes(content)
    assert is_corner_table(tmp_path / "corners.csv")
    with pytest.raises(MapError, match=r"corners\.csv(, line 2: a corner|: .*UTF-8)"):
        read_corners(tmp_path / "corners.csv")


def test_the_wildnav_table_is_read_as_it_is(data_folder: Path):
    rows = read_corners(data_folder / "maps" / "wildnav" / "map.csv")
    assert len(rows) == 12
    assert rows[0].file == "sat_map_00.jpg"
    assert rows[0].bounds == (60.402409, 22.460441, 60.403962, 22.464059)
