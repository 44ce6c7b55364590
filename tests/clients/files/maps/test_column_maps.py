"""What column maps say beyond single columns: patterns, a second file, workbooks, lists in cells, time stamps."""

from __future__ import annotations

import csv
import datetime
import io
import re
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from openpyxl import Workbook
from scipy.io import savemat

from kilter_client import FileError, MissingPackageError, UsageError, prepare

POINT = """
x_mm = { from = "x", unit = "mm" }
y_mm = { from = "y", unit = "mm" }
z_mm = { from = "z", unit = "mm" }
"""


def write(path: Path, text: str, encoding: str = "utf-8") -> Path:
    path.write_text(text, encoding=encoding)
    return path


def rows_of(content: bytes) -> list[dict[str, float]]:
    return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(io.StringIO(content.decode()))]


def mapped(folder: Path, data: str, column_map: str, **more: Any) -> list[dict[str, float]]:
    done = prepare(write(folder / "lab.csv", data), column_map=write(folder / "map.toml", column_map), **more)
    return rows_of(done.content)


# Patterns


@pytest.mark.parametrize("key", ["q*", '"q*"', "q*_deg", '"q*_deg"'])
def test_a_pattern_stands_for_every_joint(tmp_path: Path, key: str) -> None:
    head = "A1,A2,A3,A4,A5,A6,E1,x,y,z\n"
    columns = f'[columns]\n{key} = {{ from = "A*", unit = "deg", sign = -1, offset = 10 }}\n{POINT}'
    (row,) = mapped(tmp_path, head + "1,2,3,4,5,6,7,8,9,10\n", columns)
    assert [row[f"q{k}_deg"] for k in range(1, 7)] == [9, 8, 7, 6, 5, 4]
    assert "q7_deg" not in row


def test_signs_and_offsets_may_differ_and_a_single_column_goes_before_the_pattern(tmp_path: Path) -> None:
    columns = f"""[columns]
        q* = {{ from = "J* (rad)", unit = "rad", sign = [1, -1, 1], offset = [0, 0, 0.5] }}
        q2_mm = {{ from = "slide", unit = "m" }}
        {POINT}"""
    (row,) = mapped(tmp_path, "J1 (rad),J2 (rad),J3 (rad),slide,x,y,z\n1,2,3,0.25,0,0,1\n", columns)
    assert (row["q1_rad"], row["q2_mm"], row["q3_rad"]) == (1, 250, 3.5)
    assert "q2_rad" not in row


def test_numbers_from_zero_and_with_leading_zeros(tmp_path: Path) -> None:
    columns = f'[columns]\nq* = {{ from = "j*", unit = "rad" }}\ntau* = {{ from = "tau_*", unit = "Nm" }}\n{POINT}'
    (row,) = mapped(tmp_path, "j0,j1,tau_01,tau_02,x,y,z\n1,2,3,4,0,0,1\n", columns)
    assert (row["q1_rad"], row["q2_rad"], row["tau1_nm"], row["tau2_nm"]) == (1, 2, 3, 4)


def test_markers_directions_and_units_that_become_others(tmp_path: Path) -> None:
    columns = """[columns]
        q* = { from = "q *", unit = "turn" }
        dir* = { from = "v*", still_below = 0.5 }
        m*x_mm = { from = "M*.X", unit = "m" }
        m*y_mm = { from = "M*.Y", unit = "m" }
        m*z_mm = { from = "M*.Z", unit = "m" }
    """
    head = "q 1,q 2,v1,v2,M1.X,M1.Y,M1.Z,M2.X,M2.Y,M2.Z\n"
    (row,) = mapped(tmp_path, head + "0.25,0.5,1,-2,1,2,3,4,5,6\n", columns)
    assert (row["q1_deg"], row["q2_deg"]) == (90, 180)
    assert (row["dir1"], row["dir2"]) == (1, -1)
    assert (row["m1x_mm"], row["m2z_mm"]) == (1000, 6000)


def test_the_place_of_a_load_in_another_unit(tmp_path: Path) -> None:
    column_map = """[columns]
q1_deg = { from = "A1", unit = "deg" }
payload_kg = { from = "m", unit = "g" }
payload_com_x_mm = { from = "cx", unit = "m" }
payload_com_y_mm = { from = "cy", unit = "m" }
payload_com_z_mm = { from = "cz", unit = "m" }
"""
    (row,) = mapped(tmp_path, "A1,m,cx,cy,cz\n1,2500,0.08,-0.05,0.15\n", column_map)
    assert row["payload_kg"] == pytest.approx(2.5)
    assert [row[f"payload_com_{axis}_mm"] for axis in "xyz"] == pytest.approx([80.0, -50.0, 150.0])


def test_a_pattern_takes_columns_of_a_matrix(tmp_path: Path) -> None:
    savemat(tmp_path / "log.mat", {"log": {"q": [[1.0, 2.0], [3.0, 4.0]]}, "p": [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]})
    text = '[columns]\nq* = { from = "log.q(:,*)", unit = "rad" }\nx_mm = { from = "p[:,0]", unit = "mm" }\n'
    (tmp_path / "map.toml").write_text(text.replace("(:,*)", "[:,*]"))
    zero = prepare(tmp_path / "log.mat", column_map=tmp_path / "map.toml")
    (tmp_path / "map.toml").write_text(text)
    one = prepare(tmp_path / "log.mat", column_map=tmp_path / "map.toml")
    assert one.content == zero.content == b"q1_rad,q2_rad,x_mm\n1.0,2.0,1.0\n3.0,4.0,4.0\n"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (
            'q* = { from = "B*", unit = "deg" }',
            r"columns.q\*: no column of .*lab.csv is called 'B\*'.* it has A1, A2, A4, x",
        ),
        ('q* = { from = "A*", unit = "deg" }', r"finds A1, A2, A4, which are not numbered.*q1_deg = { from = \"A1\""),
        ('q* = { from = "A", unit = "deg" }', r"columns.q\*: a pattern has one \* on either side"),
        ('q* = { from = "A*", unit = "kg" }', r"columns.q\*.unit: 'kg' cannot become 'deg'"),
        ('q* = { from = "A*" }', r"columns.q\*: needs the unit the file has it in"),
        ('u* = { from = "A*", unit = "deg" }', r"columns.u\*: is not a pattern of contract columns; those are q\*"),
        ('q* = { from = "A*", unit = "deg", sign = [1, 2] }', "'sign' is 1 or -1"),
        ('q* = { from = "A*", unit = "?" }', "the draft could not determine the unit"),
    ],
)
def test_patterns_that_are_refused(tmp_path: Path, line: str, words: str) -> None:
    with pytest.raises(FileError, match=words):
        mapped(tmp_path, "A1,A2,A4,x,y,z\n1,2,3,4,5,6\n", f"[columns]\n{line}\n{POINT}")


def test_a_list_of_another_length_is_refused(tmp_path: Path) -> None:
    line = 'q* = { from = "A*", unit = "deg", sign = [1, -1, 1] }'
    with pytest.raises(FileError, match="3 numbers under sign, scale, but 2 columns"):
        mapped(tmp_path, "A1,A2,x,y,z\n1,2,4,5,6\n", f"[columns]\n{line}\n{POINT}")


# A second file

POINTS = "Point;x;y;z;Time\nP1;1;2;3;12:00:01,0\nP2;4;5;6;12:00:02,0\nP1;1;2;3;12:00:03,0\n"
JOINTS = "pose,A1,A2,clock\nP2,30,40,12:00:02.01\nP1,10,20,12:00:00.98\nP3,50,60,12:00:03.02\n"
ID = 'by = "id"\nhere = "Point"\nthere = "pose"'
JOIN = """
[file]
delimiter = ";"
[columns]
{point}
[join]
path = "joints.csv"
{how}
[join.columns]
q* = {{ from = "A*", unit = "deg" }}
"""


def joined(folder: Path, how: str, joints: str = JOINTS, **more: Any) -> list[dict[str, float]]:
    write(folder / "joints.csv", joints)
    return mapped(folder, POINTS, JOIN.format(point=POINT, how=how), **more)


def test_joints_of_another_file_by_row(tmp_path: Path) -> None:
    assert [row["q1_deg"] for row in joined(tmp_path, 'by = "row"')] == [30, 10, 50]


def test_a_constant_of_another_file_reaches_its_column(tmp_path: Path) -> None:
    write(tmp_path / "joints.csv", JOINTS)
    column_map = JOIN.format(point=POINT, how='by = "row"') + "payload_kg = { value = 2.5 }\n"
    done = prepare(write(tmp_path / "lab.csv", POINTS), column_map=write(tmp_path / "map.toml", column_map))
    assert {row["payload_kg"] for row in rows_of(done.content)} == {2.5}
    assert "payload_kg = 2.5 in every row, of joints.csv by row" in done.notes


def test_joints_of_another_file_by_id(tmp_path: Path) -> None:
    rows = joined(tmp_path, 'by = "id"\nhere = "Point"\nthere = "pose"')
    assert [(row["x_mm"], row["q1_deg"], row["q2_deg"]) for row in rows] == [(1, 10, 20), (4, 30, 40), (1, 10, 20)]


def test_ids_that_are_numbers_are_one_in_any_spelling(tmp_path: Path) -> None:
    write(tmp_path / "joints.csv", "nr,A1\n2.0,20\n001,10\n")
    how = 'by = "id"\nhere = "n"\nthere = "nr"'
    text = JOIN.format(point=POINT, how=how).replace('delimiter = ";"', "")
    assert [row["q1_deg"] for row in mapped(tmp_path, "n,x,y,z\n1,0,0,1\n2,0,0,2\n", text)] == [10, 20]


def test_joints_of_another_file_by_time(tmp_path: Path) -> None:
    rows = joined(tmp_path, 'by = "time"\nhere = "Time"\nthere = "clock"\nunit = "timestamp"\nwithin_s = 0.1')
    assert [row["q1_deg"] for row in rows] == [10, 30, 50]
    shifted = JOINTS.replace("12:00:", "14:00:")
    how = 'by = "time"\nhere = "Time"\nthere = "clock"\nunit = "timestamp"\nwithin_s = 0.1\noffset_s = 7200'
    assert [row["q1_deg"] for row in joined(tmp_path, how, shifted)] == [10, 30, 50]


def test_the_second_file_may_be_a_program_and_be_named_on_the_way(tmp_path: Path) -> None:
    targets = ["[[1,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]]", "[[2,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]]"]
    text = "MODULE m\n" + "".join(f"CONST jointtarget p{k}:={t};\n" for k, t in enumerate(targets)) + "ENDMODULE\n"
    program = write(tmp_path / "other.mod", text)
    column_map = f'[columns]\n{POINT}\n[join]\nby = "row"\n'
    rows = mapped(tmp_path, "x,y,z\n1,2,3\n4,5,6\n", column_map, joined=program)
    assert [row["q1_deg"] for row in rows] == [1, 2]
    assert rows[0]["q6_deg"] == 6


@pytest.mark.parametrize(
    ("how", "joints", "words"),
    [
        ('by = "row"', "pose,A1\nP1,1\n", r"lab.csv has 3 rows and .*joints.csv 1: joined by row they must be as many"),
        (ID, "pose,A1\nP2,1\nP4,1\n", r"2 of 3 rows have no row of .*\(line 2, 4\).*drop_missing"),
        (ID, "pose,A1\nP1,1\nP2,1\nP1,2\n", r"joints.csv, line 4, .*stands in line 2 already"),
        ('by = "id"', JOINTS, "join: needs 'here', the column of the id"),
        ('by = "name"', JOINTS, "join.by: how rows of both files belong together is one of row, id, time"),
        ('by = "time"\nhere = "Time"\nunit = "s"', JOINTS, "join: by time needs within_s"),
        ('by = "row"\nwithin_s = 1', JOINTS, "'within_s' and 'offset_s' belong to by = \"time\""),
        (ID.replace("id", "time") + '\nunit = "timestamp"\nwithin_s = 1', JOINTS, "line 2, .*: 'P1' is not a time stamp"),
    ],
)  # fmt: skip
def test_joins_that_are_refused(tmp_path: Path, how: str, joints: str, words: str) -> None:
    with pytest.raises(FileError, match=words):
        joined(tmp_path, how, joints)


def test_rows_without_a_partner_can_be_left_out(tmp_path: Path) -> None:
    how = 'by = "id"\nhere = "Point"\nthere = "pose"'
    text = JOIN.format(point=POINT, how=how) + "[rows]\ndrop_missing = true\n"
    write(tmp_path / "joints.csv", "pose,A1,A2\nP2,30,40\nP9,1,1\n")
    done = prepare(write(tmp_path / "lab.csv", POINTS), column_map=write(tmp_path / "map.toml", text))
    assert done.lines == (3,)
    assert "1 rows of joints.csv have no partner and are left out" in done.warnings


def test_several_files_are_joined_one_with_the_orientation(tmp_path: Path) -> None:
    """Joints, places and rotation matrices in a file each, and the temperature in one more, by time."""
    write(tmp_path / "joints.csv", "pose,A1\n2,20\n1,10\n")
    turned = "\n".join(["pose,a,b,c,d,e,f,g,h,i", "1,1,0,0,0,1,0,0,0,1", "2,0,-1,0,1,0,0,0,0,1"])
    write(tmp_path / "turned.csv", turned + "\n")
    write(tmp_path / "climate.csv", "when,deg\n0,20.5\n100,22.5\n")
    text = """[columns]
x_mm = { from = "x", unit = "mm" }
y_mm = { from = "y", unit = "mm" }
z_mm = { from = "z", unit = "mm" }
t_s = { from = "t", unit = "s" }

[[join]]
path = "joints.csv"
by = "id"
here = "pose"
[join.columns]
q1_deg = { from = "A1", unit = "deg" }

[[join]]
path = "turned.csv"
by = "id"
here = "pose"
[join.orientation]
from = ["a", "b", "c", "d", "e", "f", "g", "h", "i"]
matrix = "rows"

[[join]]
path = "climate.csv"
by = "time"
here = "t"
there = "when"
unit = "s"
within_s = 30
[join.columns]
temperature_c = { from = "deg", unit = "C" }
"""
    points = "pose,t,x,y,z\n1,2,100,0,0\n2,98,0,100,0\n"
    one, two = mapped(tmp_path, points, text)
    assert (one["q1_deg"], one["qw"], one["temperature_c"]) == (10, 1, 20.5)
    assert (two["q1_deg"], two["temperature_c"]) == (20, 22.5)
    assert (two["qw"], two["qz"]) == pytest.approx((0.5**0.5, 0.5**0.5))
    with pytest.raises(FileError, match=r"join 3\.path: there is no file .*climate\.txt"):
        mapped(tmp_path, points, text.replace("climate.csv", "climate.txt"))
    with pytest.raises(FileError, match=r"join 2: qw comes from turned\.csv and from a file before it") as refused:
        mapped(tmp_path, points, text.replace("q1_deg = {", 'qw = { from = "A1" }\nq1_deg = {'))
    assert refused.value.context["key"] == "join 2.columns"
    with pytest.raises(FileError, match=r"2 rows have no row of .*climate\.csv .* Under \[join 3\] widen 'within_s'"):
        mapped(tmp_path, points, text.replace("within_s = 30", "within_s = 1"))
    with pytest.raises(FileError, match=r"join 2\.by"):
        mapped(tmp_path, points, text.replace('by = "id"', 'by = "name"').replace('by = "name"', 'by = "id"', 1))


NESTS = """[columns]
q1_deg = { from = "A1", unit = "deg" }
x_mm = { from = "x", unit = "m" }
y_mm = { from = "y", unit = "m" }
z_mm = { from = "z", unit = "m" }
[markers]
from = "nest"
"""


@pytest.mark.parametrize("names", ["ABC", ["1", "2", "3"], ["2", "9", "10"]])
def test_one_reflector_in_nests_that_a_column_names(tmp_path: Path, names: str | list[str]) -> None:
    lines = [f"{pose},{nest},{pose},{k},0" for pose in (1, 2) for k, nest in enumerate(names)]
    text = "\n".join(["A1,nest,x,y,z", *lines]) + "\n"
    write(tmp_path / "nests.csv", text)
    write(tmp_path / "nests.toml", NESTS)
    content = prepare(tmp_path / "nests.csv", column_map=tmp_path / "nests.toml").content.decode()
    rows = list(csv.DictReader(io.StringIO(content)))
    assert [name for name in rows[0] if name.endswith("x_mm")] == ["m1x_mm", "m2x_mm", "m3x_mm"]
    for row, place in zip(rows, [1, 2, 3, 1, 2, 3], strict=True):
        assert [k for k in (1, 2, 3) if row[f"m{k}x_mm"]] == [place]
        assert float(row[f"m{place}x_mm"]) == 1000 * float(row["q1_deg"])


def test_nests_without_a_place_or_a_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="map x_mm, y_mm and z_mm under"):
        mapped(tmp_path, "A1,nest,x,y\n1,A,2,3\n", NESTS.replace('z_mm = { from = "z", unit = "m" }\n', ""))
    with pytest.raises(FileError, match=r"line 3: nest is missing"):
        mapped(tmp_path, "A1,nest,x,y,z\n1,A,2,3,4\n2,,2,3,4\n", NESTS)
    with pytest.raises(FileError, match=r"markers.from: needs 'from'"):
        mapped(tmp_path, "A1,nest,x,y,z\n1,A,2,3,4\n", NESTS.replace('from = "nest"\n', ""))


def test_the_second_file_is_named_or_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"join.path: there is no file .*joints.csv.*--joints"):
        mapped(tmp_path, POINTS, JOIN.format(point=POINT, how='by = "row"'))
    with pytest.raises(FileError, match=r"names no second file. Give 'path', or name it with --joints"):
        mapped(tmp_path, POINTS, JOIN.format(point=POINT, how='by = "row"').replace('path = "joints.csv"', ""))
    other = write(tmp_path / "j.csv", JOINTS)
    with pytest.raises(FileError, match=r"does not say how rows .* Add a table \[join\]"):
        mapped(tmp_path, POINTS, f'[file]\ndelimiter = ";"\n[columns]\n{POINT}', joined=other)
    with pytest.raises(UsageError, match=r"a column map that has a table \[join\]"):
        prepare(other, joined=other)


# Workbooks


def workbook(path: Path, rows: list[list[object]], title: str = "Messung 1") -> Path:
    book = Workbook()
    assert book.active is not None
    book.active.title = "Übersicht"
    sheet = book.create_sheet(title)
    for row in rows:
        sheet.append(row)
    book.save(path)
    return path


HEAD: list[object] = ["Gelenk 1", "Gelenk 2", "Größe x\n[mm]", "y", "z", "Zeit"]
SHEET = """[file]
sheet = "Messung 1"
skip_rows = 1
[columns]
q* = { from = "Gelenk *", unit = "deg" }
x_mm = { from = "Größe x [mm]", unit = "mm" }
y_mm = { from = "y", unit = "mm" }
z_mm = { from = "z", unit = "mm" }
t_s = { from = "Zeit", unit = "timestamp" }
"""


def test_a_sheet_of_a_workbook_with_spaces_and_umlauts(tmp_path: Path) -> None:
    rows = [["vom Montag"], HEAD, *([k, 2.5, 100.1, k, 7, datetime.time(12, 0, k)] for k in range(3))]
    path = workbook(tmp_path / "Maße vom Montag.xlsx", rows)
    done = prepare(path, column_map=write(tmp_path / "Zuordnung für Maße.toml", SHEET))
    assert rows_of(done.content)[2] == {
        "q1_deg": 2, "q2_deg": 2.5, "x_mm": 100.1, "y_mm": 2, "z_mm": 7, "t_s": 2,
    }  # fmt: skip
    assert done.lines == (3, 4, 5)


@pytest.mark.parametrize(
    ("cells", "change", "words"),
    [
        ([1, "1,5", 1, 1, 1], ("", ""), r"'Messung 1', cell B3, column 'Gelenk 2': '1,5' is not a number.*set 'decimal'"),
        ([1, None, 1, 1, 1], ("", ""), r"sheet 'Messung 1', row 3: q2_deg is missing"),
        ([1, "=A3*2", 1, 1, 1], ("", ""), r"sheet 'Messung 1': cell B3 holds a formula without a computed value. Open the"),
        ([1, "#DIV/0!", 1, 1, 1], ("", ""), r"sheet 'Messung 1', cell B3 holds the error #DIV/0!. Correct the formula"),
        ([1, 2, 1, 1, 1], ('"Messung 1"', '"Messung"'), r"no sheet 'Messung' \(did .* Its sheets are 'Übersicht', 'Messung 1'"),
        ([1, 2, 1, 1, 1], ('"Messung 1"', "0"), r"sheet 'Übersicht' holds no rows. Choose another with 'sheet'"),
        ([1, 2, 1, 1, 1], ("[file]", '[file]\nformat = "csv"'), "file.sheet: a sheet belongs to a workbook"),
    ],
)  # fmt: skip
def test_cells_and_sheets_that_are_refused(
    tmp_path: Path, cells: list[object], change: tuple[str, str], words: str
) -> None:
    path = workbook(tmp_path / "a.xlsx", [["title"], HEAD, [*cells, "12:00:00"]])
    with pytest.raises(FileError, match=words):
        prepare(path, column_map=write(tmp_path / "map.toml", SHEET.replace(*change)))


def test_formulas_without_values_are_named_with_their_cells(tmp_path: Path) -> None:
    """A script saves formulas without values: where one is needed nothing is read; elsewhere it does no harm."""
    rows = [[k, f"=A{k + 2}", 100.1, k, 7, datetime.time(12, 0, k), f"=D{k + 2}*2"] for k in range(1, 9)]
    path = workbook(tmp_path / "a.xlsx", [["title"], [*HEAD, "Fehler"], *rows])
    text = SHEET + "[rows]\ndrop_missing = true\n"
    with pytest.raises(FileError, match=r"cells B3, B4, B5, B6, B7 and 3 more hold formulas without computed values"):
        prepare(path, column_map=write(tmp_path / "m.toml", text))
    for row in rows:
        row[1] = row[0]
    path = workbook(tmp_path / "b.xlsx", [["title"], [*HEAD, "Fehler"], *rows])
    assert prepare(path, column_map=write(tmp_path / "m.toml", text)).lines == tuple(range(3, 11))
    path = workbook(tmp_path / "c.xlsx", [["title"], [*HEAD[:-1], '="Zeit"'], *rows])
    with pytest.raises(FileError, match=r"cell F2 holds a formula without a computed value"):
        prepare(path, column_map=write(tmp_path / "m.toml", text))


def test_a_formula_that_was_computed_to_an_empty_text_is_an_empty_cell(tmp_path: Path) -> None:
    rows = [["title"], HEAD, [1, 2, 1, 1, 1, "12:00"], [1, '=""', 1, 1, 1, "12:01"]]
    path = workbook(tmp_path / "a.xlsx", rows)
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    sheet = parts["xl/worksheets/sheet2.xml"]
    parts["xl/worksheets/sheet2.xml"] = re.sub(
        rb'<c r="B4"><f>', b'<c r="B4" t="str"><f>', sheet
    )  # as programs store it
    assert parts["xl/worksheets/sheet2.xml"] != sheet
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    text = SHEET + "[rows]\ndrop_missing = true\n"
    assert prepare(path, column_map=write(tmp_path / "m.toml", text)).lines == (3,)


def test_the_remedies_of_workbooks_work(tmp_path: Path) -> None:
    path = workbook(tmp_path / "a.xlsx", [["title"], HEAD, [1.25, "1,5", 1, 1, 1, "'12:00:00"]])
    text = SHEET.replace("[file]", '[file]\ndecimal = ","')
    assert rows_of(prepare(path, column_map=write(tmp_path / "m.toml", text)).content)[0]["q2_deg"] == 1.5
    path = workbook(tmp_path / "b.xlsx", [["title"], HEAD, [1, None, 1, 1, 1, "12:00"], [1, 2, 1, 1, 1, "12:01"]])
    dropped = prepare(path, column_map=write(tmp_path / "m.toml", SHEET + "[rows]\ndrop_missing = true\n"))
    assert dropped.lines == (4,)


def test_a_workbook_of_contract_columns_needs_no_map(tmp_path: Path) -> None:
    book = Workbook()
    assert book.active is not None
    for row in (["q1_deg", "x_mm", "y_mm", "z_mm"], [1, 2, 3, 4.5]):
        book.active.append(row)
    book.save(tmp_path / "a.xlsx")
    assert prepare(tmp_path / "a.xlsx").content == b"q1_deg,x_mm,y_mm,z_mm\n1.0,2.0,3.0,4.5\n"
    other = workbook(tmp_path / "b.xlsx", [HEAD])
    with pytest.raises(FileError, match=r"b.xlsx.*holds no rows"):
        prepare(other)
    book.active["A1"] = "axis 1"
    book.save(tmp_path / "c.xlsx")
    with pytest.raises(FileError, match=r"not all of its columns are the contract's: 'axis 1'.*--draft columns.toml"):
        prepare(tmp_path / "c.xlsx")


@pytest.mark.parametrize("content", [b"PK\x03\x04nothing", b"\xd0\xcf\x11\xe0old xls", b""])
def test_no_workbook_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.xlsx").write_bytes(content)
    with pytest.raises(FileError, match=r"is not an \.xlsx workbook .*or as CSV"):
        prepare(tmp_path / "a.xlsx")


def test_without_openpyxl_the_remedy_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = workbook(tmp_path / "a.xlsx", [HEAD])
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(MissingPackageError, match=r"need openpyxl. Install it with: pip install openpyxl"):
        prepare(path)


# Cells over several lines, time stamps, units below the header


def test_lists_in_cells_over_several_lines(tmp_path: Path) -> None:
    text = 'id,joints,pos\n1,"[0.1,\n 0.2]","array([1. 2.\n 3.])"\n2,"(0.3, 0.4)","[4; 5; 6]"\n'
    columns = """[columns]
        q* = { from = "joints[*]", unit = "rad" }
        x_mm = { from = "pos[0]", unit = "mm" }
        y_mm = { from = "pos(2)", unit = "mm" }
        z_mm = { from = "pos[2]", unit = "mm" }
    """
    assert [list(row.values()) for row in mapped(tmp_path, text, columns)] == [[0.1, 0.2, 1, 2, 3], [0.3, 0.4, 4, 5, 6]]
    done = prepare(tmp_path / "lab.csv", column_map=tmp_path / "map.toml")
    assert done.lines == (2, 5)  # the first line of each row


@pytest.mark.parametrize(
    ("cell", "source", "words"),
    [
        (
            '"[1,\n2,3]"',
            "joints[0]",
            r"line 5, column 'joints\[0\]': a list of 3 numbers: the first list has 2. Correct",
        ),
        ('"[1,\ntwo]"', "joints[0]", r"line 5, column 'joints\[0\]': '\[1,\\ntwo\]' is not a list of numbers"),
        ('"[1,\n2]"', "joints[2]", r"line 3, column 'joints\[2\]': a list of 2 numbers: has no element 2 \(from 0\)"),
        ('"[1,\n2]"', "joints", r"The cell is a list: name one element, for example from = \"joints\[0\]\""),
        ('"[1,\n2]"', "joint[0]", r"there is no column 'joint\[0\]'"),
    ],
)
def test_lists_that_are_refused(tmp_path: Path, cell: str, source: str, words: str) -> None:
    text = f'joints,x\n\n"[1,\n2]",1\n{cell},1\n'
    with pytest.raises(FileError, match=words):
        mapped(tmp_path, text, f'[columns]\nq1_rad = {{ from = "{source}", unit = "rad" }}\n')


@pytest.mark.parametrize(
    ("stamps", "seconds"),
    [
        (["'12:00:01.5", "'12:00:02.25"], [0, 0.75]),
        (["23:59:59,5", "00:00:01,5"], [0, 2]),
        (["11:59:59 PM", "12:00:01 AM"], [0, 2]),
    ],
)
def test_clocks_without_a_date_count_from_the_first_row(
    tmp_path: Path, stamps: list[str], seconds: list[float]
) -> None:
    assert stamped(tmp_path, stamps) == pytest.approx(seconds, abs=1e-6)


def stamped(tmp_path: Path, stamps: list[str], more: str = "") -> list[float]:
    text = "j;Time\n" + "".join(f"{k};{stamp}\n" for k, stamp in enumerate(stamps))
    columns = '[file]\ndelimiter = ";"\n[columns]\nq1_deg = { from = "j", unit = "deg" }\n'
    columns += f't_s = {{ from = "Time", unit = "timestamp"{more} }}\n'
    return [row["t_s"] for row in mapped(tmp_path, text, columns)]


@pytest.mark.parametrize(
    ("stamps", "began", "more"),
    [
        (["2026-11-22T12:00:00Z", "2026-11-22T14:00:01.5+02:00"], datetime.datetime(2026, 11, 22, 12), ""),
        (["22.11.2026 23:59:59", "23.11.2026 00:00:00,5"], datetime.datetime(2026, 11, 22, 23, 59, 59), ""),
        (["10/27/2026 11:59:59 PM", "10/28/2026 12:00:00.5 AM"], datetime.datetime(2026, 10, 27, 23, 59, 59), ""),
        (["5/3/2026 9:01:00", "5/3/2026 9:01:01.5"], datetime.datetime(2026, 5, 3, 9, 1), "MM/DD/YYYY"),
        (["5/3/26 9:01:00", "5/3/26 9:01:01.5"], datetime.datetime(2026, 3, 5, 9, 1), "dd/mm/yyyy"),
        (["30-04-2026 23:59:59", "01-05-2026 00:00:00.5"], datetime.datetime(2026, 4, 30, 23, 59, 59), ""),
    ],
)  # the month cannot be 30, so the first of May is not the fifth of January
def test_stamps_with_a_date_count_from_1970(
    tmp_path: Path, stamps: list[str], began: datetime.datetime, more: str
) -> None:
    seconds = stamped(tmp_path, stamps, more and f', date_format = "{more}"')
    first = began.replace(tzinfo=datetime.UTC).timestamp()
    assert seconds == pytest.approx([first, first + 1.5], abs=1e-6)


@pytest.mark.parametrize(
    ("stamps", "more", "said"),
    [
        (["5/3/2026 9:01"], "", r"line 2, .*'5/3/2026 9:01' may be day/month or month/day. In the column map add"),
        (["10/27/2026 9:01", "27/10/2026 9:02"], "", r"line 3, .* has day and month in another order than other rows"),
        (["10/27/2026 9:01"], "DD/MM/YYYY", r"line 2, .* has day and month in another order than 'date_format'"),
        (["5/3/2026 9:01"], "D/M", r"t_s.date_format: one of MM/DD/YYYY, DD/MM/YYYY"),
        (["2026-11-22 9:01", "9:02"], "", r"line 3, .*'9:02' has no date, unlike the rows before"),
    ],
)
def test_dates_that_cannot_be_read_name_the_row(tmp_path: Path, stamps: list[str], more: str, said: str) -> None:
    with pytest.raises(FileError, match=said):
        stamped(tmp_path, stamps, more and f', date_format = "{more}"')


def test_a_clock_that_goes_back_is_named_by_its_row(tmp_path: Path) -> None:
    stamps = [f"2026-10-25 02:{minute:02d}:00" for minute in (50, 55, 1, 6)]
    text = "j,Time\n" + "".join(f"{k},{stamp}\n" for k, stamp in enumerate(stamps))
    (tmp_path / "lab.csv").write_text(text)
    columns = '[columns]\nq1_deg = { from = "j", unit = "deg" }\nt_s = { from = "Time", unit = "timestamp" }\n'
    read = prepare(tmp_path / "lab.csv", column_map=write(tmp_path / "map.toml", columns))
    (said,) = [text for text in read.warnings if "clock" in text]
    assert "goes back by 3.24e+03 s at line 4" in said


@pytest.mark.parametrize("stamp", ["11/31/2026 12:00", "12:61:00", "31.02.2026 10:00", "noon"])
def test_time_stamps_that_are_refused(tmp_path: Path, stamp: str) -> None:
    columns = '[columns]\nq1_deg = { from = "j", unit = "deg" }\nt_s = { from = "t", unit = "timestamp" }\n'
    with pytest.raises(FileError, match=r"line 2, column 't': .* is not a time stamp such as 12:00:01.5"):
        mapped(tmp_path, f"j,t\n1,{stamp}\n", columns)
    with pytest.raises(FileError, match=r"columns.q1_deg.unit: 'timestamp' cannot become 'deg'"):
        mapped(tmp_path, f"j,t\n1,{stamp}\n", columns.replace('"deg"', '"timestamp"'))


def test_a_time_stamp_under_a_number_is_named(tmp_path: Path) -> None:
    columns = '[columns]\nq1_deg = { from = "j", unit = "deg" }\nt_s = { from = "t", unit = "s" }\n'
    with pytest.raises(FileError, match=r"It is a time stamp: map it to t_s with unit = \"timestamp\""):
        mapped(tmp_path, "j,t\n1,'12:00:01.5\n", columns)


def test_numbers_kept_as_text_by_a_spreadsheet_and_a_row_of_units(tmp_path: Path) -> None:
    columns = '[file]\nunits_row = true\n[columns]\nq1_deg = { from = "Gelenk 1", unit = "deg" }\n'
    assert mapped(tmp_path, "Gelenk 1\n[deg]\n'1.5\n", columns) == [{"q1_deg": 1.5}]


BY_SESSION = NESTS.replace('[markers]\nfrom = "nest"\n', 'session = { from = "nest" }\n')


@pytest.mark.parametrize(
    ("cells", "sessions"),
    [("BAC", [5198513, 9254475, 3565863]), (["early", "", "late"], None), ("979", [9, 7, 9]), (["9", "A", "9"], None)],
)
def test_sessions_may_have_names(tmp_path: Path, cells: Sequence[str], sessions: list[int] | None) -> None:
    """A nest or a day: a name has one number in every file. Empty cells and names among numbers are refused."""
    lines = [f"{k},{cell},{k},2,3" for k, cell in enumerate(cells)]
    text = "\n".join(["A1,nest,x,y,z", *lines]) + "\n"
    if sessions is None:
        with pytest.raises(FileError, match="line 3"):
            mapped(tmp_path, text, BY_SESSION)
        return
    assert [row["session"] for row in mapped(tmp_path, text, BY_SESSION)] == sessions
    notes = prepare(tmp_path / "lab.csv", column_map=tmp_path / "map.toml").notes
    told = "session from 'nest'" + (": 5198513 is 'B', 9254475 is 'A', 3565863 is 'C'" if "A" in cells else "")
    assert told in notes
