from pathlib import Path

import pytest

from vwnav.cameras.metadata_table import read_metadata_table
from vwnav.errors import SourceError


def table(tmp_path: Path, text: str) -> dict[str, dict[str, float]]:
    path = tmp_path / "table.csv"
    path.write_text(text, encoding="utf-8")
    return read_metadata_table(path)


def test_what_is_given_is_read_and_what_is_empty_is_unknown(tmp_path: Path):
    found = table(tmp_path, "image, agl_m, yaw_deg\na.jpg, 50, -3.5\nb.jpg, , 4\n")
    assert found == {"a.jpg": {"agl_m": 50.0, "yaw_deg": -3.5}, "b.jpg": {"yaw_deg": 4.0}}


def test_a_byte_order_mark_and_short_rows_are_no_error(tmp_path: Path):
    assert table(tmp_path, "\ufeffimage,agl_m\na.jpg\n") == {"a.jpg": {}}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "expected the columns"),
        ("file,agl_m\n", "expected the columns"),
        ("image,altitude\n", "altitude"),
        ("image,agl_m\na.jpg,high\n", "line 2: agl_m is 'high'"),
        ("image,agl_m\na.jpg,nan\n", "line 2"),
        ("image,agl_m\na.jpg,0\n", "line 2: agl_m is '0'; expected metres above 0"),
        ("image,agl_m\na.jpg,50\nb.jpg,-3\n", "line 3: agl_m is '-3'"),
        ("image,sigma_m\na.jpg,0\n", "line 2: sigma_m is '0'"),
        ("image,sigma_m\na.jpg,-1\n", "line 2: sigma_m is '-1'"),
        ("image,lat_deg\na.jpg,47\n", "belong together"),
        ("agl_m,image\n50\n", "line 2: names no image"),
        ("agl_m,image\n50, \n", "line 2: names no image"),
    ],
)
def test_what_cannot_be_understood_is_one_line(tmp_path: Path, text: str, says: str):
    with pytest.raises(SourceError, match=says) as caught:
        table(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_rows_of_a_spreadsheet_that_say_nothing_are_no_error(tmp_path: Path):
    assert table(tmp_path, "agl_m,image\n50,a.jpg\n,\n\n") == {"a.jpg": {"agl_m": 50.0}}


def test_a_missing_or_binary_table_is_one_line(tmp_path: Path):
    with pytest.raises(SourceError, match="cannot be read"):
        read_metadata_table(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(SourceError, match="cannot be read"):
        read_metadata_table(tmp_path / "binary.csv")
