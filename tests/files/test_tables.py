"""Tables of any kind: what is read of them, and one line where they cannot be."""

from pathlib import Path

import pytest

from vwnav.bench.track_drift import compare
from vwnav.cameras.metadata_table import read_metadata_table
from vwnav.errors import MapError, SourceError, VwnavError
from vwnav.files.tables import named_rows, numbered_rows
from vwnav.maps.build.image_files import read_corners
from vwnav.recording.recorded_flight_log import _truth
from vwnav.recording.telemetry_files import load_telemetry

PATH = Path("t.csv")
TOO_LONG = "x" * 140_000
READERS = {
    "image,agl_m\na.jpg,{}\n": read_metadata_table,
    "t_s,height_m\n0,{}\n": load_telemetry,
    "file,north,west,south,east\na,{},22,59,23\n": read_corners,
    "t_s,north_m,east_m,alt_amsl_m\n0,0,0,{}\n": _truth,
    "t_s,lat_deg,lon_deg\n0,60,{}\n": lambda path: compare(path, path),
}


def test_rows_have_their_lines_and_cells_no_spaces():
    lines = ["a, b\n", "\n", ' 1 ,"x\n', 'y" \n', "2\n"]
    assert list(numbered_rows(lines, PATH, SourceError)) == [
        (1, ["a", "b"]), (4, ["1", "x\ny"]), (5, ["2"]),
    ]  # fmt: skip


def test_what_a_short_row_lacks_is_empty_and_what_is_beyond_left_out():
    columns, rows = named_rows(["a,b,c", "1", "1,2,3,4"], PATH, SourceError)
    assert columns == ["a", "b", "c"]
    assert [row for _, row in rows] == [
        {"a": "1", "b": "", "c": ""},
        {"a": "1", "b": "2", "c": "3"},
    ]


@pytest.mark.parametrize(
    ("text", "read"),
    [
        ("image,yaw_deg,yaw_deg\na.jpg,1,2\n", read_metadata_table),
        ("t_s,roll_deg,t_s\n0,1,2\n", load_telemetry),
        ("file,north,west,South,east, south\na,61,22,59,23,60\n", read_corners),
    ],
)
def test_two_columns_of_one_name_are_refused(tmp_path: Path, text: str, read):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(VwnavError, match=r"t\.csv: has two columns (yaw_deg|t_s|South); leave"):
        read(tmp_path / "t.csv")


def test_columns_without_a_name_may_be_several():
    columns, rows = named_rows(["a,,", "1,2,3"], PATH, SourceError)
    assert columns == ["a", "", ""]
    assert [row["a"] for _, row in rows] == ["1"]


def test_an_empty_table_has_no_columns():
    columns, rows = named_rows([], PATH, MapError)
    assert (columns, list(rows)) == ([], [])


@pytest.mark.parametrize("text", READERS)
def test_a_cell_longer_than_any_is_one_line_with_its_place(tmp_path: Path, text: str):
    (tmp_path / "t.csv").write_text(text.format(TOO_LONG))
    with pytest.raises(VwnavError, match=r"t\.csv, line [12]: no row of a CSV table") as caught:
        READERS[text](tmp_path / "t.csv")
    assert len(str(caught.value)) < 250


def test_a_trajectory_with_a_short_row_is_one_line(tmp_path: Path):
    (tmp_path / "t.csv").write_text("t_s,lat_deg,lon_deg\n0,60\n")
    with pytest.raises(SourceError, match="no columns of time"):
        compare(tmp_path / "t.csv", tmp_path / "t.csv")


def test_a_truth_of_a_spreadsheet_begins_with_a_mark(tmp_path: Path):
    text = "\ufefft_s,north_m,east_m,alt_amsl_m\n0,1,2,3\n"
    (tmp_path / "t.csv").write_text(text, encoding="utf-8")
    (row,) = _truth(tmp_path / "t.csv")
    assert row.t_s == 0.0
