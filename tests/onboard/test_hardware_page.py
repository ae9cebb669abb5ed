"""docs/hardware.md says what the geometry says."""

import math
import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "hardware.md").read_text()
ROW = re.compile(r"^\| (\d+) degrees \| [^|]+ \| (.+) \|$", re.MULTILINE)
CELL = re.compile(r"([\d.]+) m/px, (\d+) x (\d+) m")


@pytest.mark.parametrize("row", ROW.findall(PAGE), ids=lambda row: row[0])
def test_the_table_of_lenses_and_heights(row):
    cells = [tuple(map(float, cell)) for cell in CELL.findall(row[1])]
    widths_m = [2.0 * h * math.tan(math.radians(float(row[0]) / 2.0)) for h in (25, 50, 120)]
    assert [c[0] for c in cells] == pytest.approx([w / 640 for w in widths_m], abs=5e-4)
    assert [c[1] for c in cells] == pytest.approx(widths_m, abs=0.51)
    assert [c[2] for c in cells] == pytest.approx([0.75 * w for w in widths_m], abs=0.51)


def test_the_table_is_there():
    assert len(ROW.findall(PAGE)) == 5
