"""Names that a spreadsheet would compute stay names in exported tables, and numbers stay numbers."""

from __future__ import annotations

import csv
from pathlib import Path

from kilter_files.robots import Described, read_robot
from kilter_service.robots.exporters.registry import export
from tests.service.exporters.test_exporters import calibrated

NAMES = ["=1+1", "+SUM(A1)", "-j3", "@cmd", "'quoted", "j6"]


def test_no_cell_of_a_table_is_a_formula_and_names_are_read_back(tmp_path: Path) -> None:
    joints = [{"name": name, "limits_deg": [-100.0, 100.0]} for name in NAMES]
    written = export("mdh-csv", calibrated({"theta_offset_2": -1e-3}, joints=joints)[0])
    header, *rows = csv.reader(line for line in written.text.splitlines() if not line.startswith("#"))
    column = header.index("joint")
    assert [row[column] for row in rows] == [f"'{name}" for name in NAMES[:5]] + ["j6"]
    numbers = [cell for row in rows for cell in row[2:] if cell]
    assert [str(float(cell)) for cell in numbers if cell.startswith("-")], "no number to be harmed"
    assert not [cell for cell in numbers if cell.startswith("'")]
    path = tmp_path / "arm.csv"
    path.write_text(written.text)
    again = read_robot(path, Described("again", convention="mdh"))
    assert [joint["name"] for joint in again["joints"]] == NAMES
