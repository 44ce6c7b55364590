"""Text exports of trackers and CMMs in the dialects people have."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from openpyxl import Workbook
from scipy.spatial.transform import Rotation

from kilter_client import FileError
from kilter_files.formats.reader import Hints
from kilter_files.formats.readers.tracker_text import read_tracker
from kilter_files.look.drafts import inspect

EXPORTS = [
    ("spatialanalyzer", "// SA 2023\n// Units: mm\nA, G1, P1, 1.5, 2.5, 3.5\nA, G1, P2, 4, 5, 6\n", "utf-8",
     [1.5, 2.5, 3.5], 3),
    ("spatialanalyzer", "// Frame: WORLD\nColl Grp P1 1.5 2.5 3.5\nColl Grp P2 4 5 6\n", "utf-8", [1.5, 2.5, 3.5], 2),
    ("faro", "Name;X [m];Y [m];Z [m]\nP1;0,0015;0,0025;0,0035\nP2;1;2;3\n", "latin-1", [1.5, 2.5, 3.5], 2),
    ("polyworks", "\ufeffPoint\tMeas X\tMeas Y\tMeas Z\tDev\n\tmm\tmm\tmm\tmm\nA\t1.5\t2.5\t3.5\t0.1\nB\t4\t5\t6\t0\n",
     "utf-8", [1.5, 2.5, 3.5], 3),
    ("leica", "Meßpunkt;X;Y;Z\n1;1,5;2,5;3,5\n2;4,0;5,0;6,0\n", "latin-1", [1.5, 2.5, 3.5], 2),
    ("generic", "Units: inch\n\nid,x,y,z\n1,1,2,3\n2,4,5,6\n", "utf-16", [25.4, 50.8, 76.2], 4),
]  # fmt: skip


@pytest.mark.parametrize(("preset", "text", "encoding", "first", "line"), EXPORTS)
def test_dialects(tmp_path: Path, preset: str, text: str, encoding: str, first: list[float], line: int) -> None:
    path = tmp_path / "export.txt"
    path.write_bytes(text.encode(encoding))
    table = read_tracker(path, preset)
    assert [table.columns[f"{axis}_mm"][0] for axis in "xyz"] == pytest.approx(first)
    assert table.lines[0] == line
    assert len(table) == 2


def test_u95_is_two_standard_deviations(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("x [mm],y [mm],z [mm],Ux [um],Uy [um],Uz [um]\n1,2,3,20,30,40\n1,2,4,20,30,40\n")
    assert [read_tracker(path).columns[f"s{a}_mm"][0] for a in "xyz"] == pytest.approx([0.01, 0.015, 0.02])
    path.write_text("X [m];Y [m];Z [m];U95\n0,1;0,2;0,3;0,00002\n1;2;3;0,00002\n")
    assert read_tracker(path).columns["sx_mm"][0] == pytest.approx(0.02 / 2 / math.sqrt(3))


@pytest.mark.parametrize(
    ("preset", "euler", "order"), [("leica", None, "XYZ"), ("spatialanalyzer", None, "xyz"), ("generic", "ZYX", "ZYX")]
)
def test_angles(tmp_path: Path, preset: str, euler: str | None, order: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text("x,y,z,rx,ry,rz\n1,2,3,10,-20,30\n1,2,4,40,50,-170\n")
    columns = read_tracker(path, preset, euler).columns
    got = Rotation.from_quat(np.stack([columns[f"q{p}"] for p in "xyzw"], 1))
    wanted = Rotation.from_euler(order, [[10, -20, 30], [40, 50, -170]], degrees=True)
    assert (got * wanted.inv()).magnitude().max() < 1e-12


def test_quaternions(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("x,y,z,q0,q1,q2,q3\n1,2,3,1,0,0,0\n1,2,4,0.5,0.5,0.5,0.5\n")
    assert read_tracker(path).columns["qw"] == [1.0, 0.5]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x,y,z,rx,ry,rz\n1,2,3,4,5,6\n1,2,3,4,5,6\n", "three angles, but their order is not known. Give it"),
        ("x,y,z,rx [rad],ry [rad],rz [rad]\n1,2,3,0,0,0\n1,2,3,0,90,0\n",
         r"line 3, column 'ry': more than a full turn, declared as rad: are these degrees"),
        ("x,y,z,q0,q1,q2,q3\n1,2,3,1,0,0,0\n3,1,0,0,0,2,9\n",
         r"line 3, column 'q0': not a unit quaternion .* columns shifted here"),
        ("x,y,z,u95\n1,2,3,0.1\n1,2,3,-4\n", r"line 3, column 'u95': a negative uncertainty"),
        ("x,y,z\n1,2,3\n1,2,3\nx,y,z\n1,2,3\n", r"line 4: a second header is here: two recordings are concatenated"),
        ("x,y,z\n1,2,3\n1,2,3\n1,2,3,4\n", r"line 4: 4 cells where the first row has 3"),
        ("name,a,b\nP1,1,2\nP2,1,2\n", "no columns x, y and z among name, a, b. Write a column map .*--draft"),
    ],
)  # fmt: skip
def test_bad_exports(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(FileError, match=words):
        read_tracker(path, "generic", "XYZ" if "rad" in text else None)


def test_rows_without_a_measurement_are_left_out_and_named(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("id,x,y,z\n1,1,2,3\n2,,,\n3,0,0,0\n4,4,5,6\n")
    table = read_tracker(path)
    assert table.lines == [2, 5]
    assert any("2 rows left out" in text and "line 3" in text for text in table.warnings)


def test_ipa_by_the_leica_preset_agrees_with_its_own_importer(shared_data: Path) -> None:
    from kilter_files.formats.readers.ipa_lasertracker import read_ipa_lasertracker

    path = shared_data / "ipa-ur10-lasertracker/Series_B/measurements_joint_configurations.csv"
    got, wanted = read_tracker(path, "leica"), read_ipa_lasertracker(path)
    for name in ("x_mm", "z_mm", "qw", "qz", "sy_mm", "temperature_c"):
        np.testing.assert_allclose(got.columns[name], wanted.columns[name], atol=1e-12)


@pytest.mark.parametrize("sign", ["'", ""])
def test_time_stamps_with_and_without_a_spreadsheets_apostrophe(tmp_path: Path, sign: str) -> None:
    rows = [f"P{k};{sign}12:59:{59 + k if k < 1 else k - 1:02d},5;{100 + k};200;{300 - k}" for k in range(4)]
    rows = [row.replace("12:59", "13:00") if k else row for k, row in enumerate(rows)]
    path = tmp_path / "points.csv"
    path.write_text("\n".join(["Name;Time;X [mm];Y [mm];Z [mm]", *rows]) + "\n")
    table = read_tracker(path)
    assert table.columns["t_s"] == [0, 1, 2, 3]
    assert table.columns["x_mm"] == [100, 101, 102, 103]
    path.write_text("\n".join(["Name;Time;X [mm];Y [mm];Z [mm]", rows[0], "P9;soon;1;2;3"]) + "\n")
    with pytest.raises(FileError, match=r"line 3, column 'Time': 'soon' is not a time stamp such as 12:00:01.5"):
        read_tracker(path)


def test_time_stamps_of_a_recording_are_refused_with_the_remedy(tmp_path: Path) -> None:
    head = ["Frame", "Time", *(f"M{k} {a} [mm]" for k in (1, 2, 3) for a in "XYZ")]
    rows = [[str(k), f"'12:00:0{k // 10}.{k % 10}", *(f"{100.0 * m + k:.3f}" for m in range(9))] for k in range(40)]
    path = tmp_path / "frames.csv"
    path.write_text("\n".join(",".join(row) for row in [head, *rows]) + "\n")
    with pytest.raises(FileError, match=r"is a time stamp. Recordings need seconds: .* take the column out .*--rate"):
        inspect(path)
    path.write_text("\n".join(",".join([row[0], *row[2:]]) for row in [head, *rows]) + "\n")
    assert inspect(path, Hints(rate_hz=10.0))["frames"] == 40


def test_tables_that_no_device_writes_are_shown_with_the_way_in(tmp_path: Path) -> None:
    rows = [f'{k},"[0.{k},\n 0.2]","[1 2\n {k}]"' for k in range(5)]
    path = tmp_path / "lists of a lab.csv"
    path.write_text("\n".join(["id,joints,pos", *rows]) + "\n")
    found = inspect(path)
    assert (found["kind"], found["rows"]) == ("table", 5)
    assert [c["name"] for c in found["columns"]] == ["id", "joints[0]", "joints[1]", "pos[0]", "pos[1]", "pos[2]"]
    assert found["columns"][1]["high"] == 0.4
    assert f"kilter measure inspect '{path}' --draft columns.toml" in found["notes"][-1]
    book = Workbook()
    assert book.active is not None
    for row in (["Gelenk 1 [°]", "x"], [1.5, 2], [2.5, 3]):
        book.active.append(row)
    book.save(tmp_path / "Maße.xlsx")
    found = inspect(tmp_path / "Maße.xlsx")
    assert (found["kind"], found["rows"], found["columns"][0]["unit"]) == ("table", 2, "deg")
