"""Column maps: what they can say, and what they refuse."""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from kilter_client import FileError, prepare
from kilter_files import Prepared
from kilter_files.formats.reader import MAP as UPLOAD_MAP
from kilter_files.formats.registry import readers_for
from kilter_files.maps.column_map import read_map

LAB = """time;joint a;joint b;X;Y;Z;rx;ry;rz;state
0;10;90;1,0;0,5;0,25;0;0;90;ok
1;10,00001;90;1,0;0,5;0,25;0;0;90;ok
2;20;-90;1,1;0,5;0,25;0;0;90;lost
3;30;45;;0,5;0,25;0;0;90;ok
"""

MAP = """
[file]
delimiter = ";"
decimal = ","

[columns]
q1_deg = { from = "joint a", unit = "deg" }
q2_deg = { from = "joint b", unit = "deg", sign = -1, offset = 180 }
x_mm = { from = "X", unit = "m" }
y_mm = { from = "Y", unit = "m", scale = 2 }
z_mm = { from = "Z", unit = "m" }
t_s = { from = "time", unit = "min" }
payload_kg = { value = 2.5 }

[orientation]
from = ["rx", "ry", "rz"]
unit = "deg"
euler = "XYZ"

[pose_id]
same_joints_within_deg = 0.001

[rows]
drop_missing = true
keep = [{ column = "state", equals = "ok" }]
"""


def convert(folder: Path, column_map: str, data: str = LAB) -> Prepared:
    (folder / "lab.csv").write_text(data)
    (folder / "map.toml").write_text(column_map)
    return prepare(folder / "lab.csv", column_map=folder / "map.toml")


def rows(prepared: Prepared) -> list[dict[str, float]]:
    reader = csv.DictReader(io.StringIO(prepared.content.decode()))
    return [{name: float(cell) if cell else math.nan for name, cell in row.items()} for row in reader]


def test_a_lab_file_becomes_contract_columns(tmp_path: Path) -> None:
    prepared = convert(tmp_path, MAP)
    first, second = rows(prepared)
    assert first["q1_deg"] == 10
    assert first["q2_deg"] == 90
    assert (first["x_mm"], first["y_mm"], first["z_mm"]) == (1000, 1000, 250)
    assert second["t_s"] == 60
    assert first["payload_kg"] == 2.5
    assert [first[k] for k in ("qw", "qx", "qy", "qz")] == pytest.approx([0.5**0.5, 0, 0, 0.5**0.5])
    assert first["pose_id"] == second["pose_id"] == 1
    assert prepared.rows == 2
    assert prepared.lines == (2, 3)
    assert prepared.warnings == (
        "1 rows left out by the condition on 'state'",
        "1 rows left out because a value is missing",
    )
    assert "q2_deg from 'joint b' x -1 +180 [deg]" in prepared.notes
    assert prepared.content_type == "text/csv"


def test_the_same_file_gives_the_same_bytes(tmp_path: Path) -> None:
    assert convert(tmp_path, MAP).sha256 == convert(tmp_path, MAP).sha256


def test_a_missing_value_is_refused_unless_asked(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"line 5: x_mm is missing.*drop_missing"):
        convert(tmp_path, MAP.replace("drop_missing = true\n", ""))


def test_limits_keep_rows(tmp_path: Path) -> None:
    keep = 'keep = [{ column = "time", min = 1, max = 2 }]'
    prepared = convert(tmp_path, MAP.replace('keep = [{ column = "state", equals = "ok" }]', keep))
    assert prepared.lines == (3, 4)


def test_no_row_left_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="no row is left"):
        convert(tmp_path, MAP.replace('equals = "ok"', 'equals = "never"'))


def test_missing_markers_are_empty_cells(tmp_path: Path) -> None:
    column_map = """
        [file]
        missing = ["0", "lost"]
        [columns]
        q1_deg = { from = "q", unit = "deg" }
        m1x_mm = { from = "x", unit = "mm" }
        m1y_mm = { from = "y", unit = "mm" }
        m1z_mm = { from = "z", unit = "mm" }
    """
    prepared = convert(tmp_path, column_map, "q,x,y,z\n1,0,lost,\n2,1,2,3\n")
    assert prepared.content == b"q1_deg,m1x_mm,m1y_mm,m1z_mm\n1.0,,,\n2.0,1.0,2.0,3.0\n"


def test_a_quaternion_is_reordered_and_made_unit(tmp_path: Path) -> None:
    column_map = """
        [columns]
        q1_deg = { from = "q", unit = "deg" }
        [orientation]
        from = ["a", "b", "c", "d"]
        quaternion = "xyzw"
    """
    (row,) = rows(convert(tmp_path, column_map, "q,a,b,c,d\n1,0,0,-2,-2\n"))
    assert [row[k] for k in ("qw", "qx", "qy", "qz")] == pytest.approx([0.5**0.5, 0, 0, 0.5**0.5])


@pytest.mark.parametrize("order", ["rows", "columns"])
def test_a_pose_matrix_becomes_a_place_and_a_quaternion(tmp_path: Path, order: str) -> None:
    """Rotations of every kind, among them half turns, as scipy has them."""
    rng = np.random.default_rng(4)
    turns = [
        *Rotation.random(20, rng=rng),
        *(Rotation.from_rotvec(np.pi * axis) for axis in np.eye(3)),
        Rotation.identity(),
    ]
    names = [f"m{i}{k}" for i in range(3) for k in range(3)]
    listed = names if order == "rows" else [f"m{i}{k}" for k in range(3) for i in range(3)]
    column_map = f"""
        [columns]
        q1_deg = {{ from = "q", unit = "deg" }}
        x_mm = {{ from = "m03", unit = "m" }}
        y_mm = {{ from = "m13", unit = "m" }}
        z_mm = {{ from = "m23", unit = "m" }}
        [orientation]
        from = {json.dumps(listed)}
        matrix = "{order}"
    """
    lines = ["q,m03,m13,m23," + ",".join(names)]
    lines += [f"{k},0.1,0.2,0.3," + ",".join(f"{v:.6f}" for v in R.as_matrix().ravel()) for k, R in enumerate(turns)]
    found = rows(convert(tmp_path, column_map, "\n".join(lines) + "\n"))
    for row, turn in zip(found, turns, strict=True):
        given = Rotation.from_quat([row[k] for k in ("qx", "qy", "qz", "qw")])
        assert (given.inv() * turn).magnitude() < 1e-5
        assert (row["x_mm"], row["z_mm"]) == pytest.approx((100.0, 300.0))
    wrong = [lines[0], "1,0.1,0.2,0.3,1,0,0,0,1,0,0,0,-1"]  # left-handed
    with pytest.raises(FileError, match=r"line 2: .*not a rotation matrix"):
        convert(tmp_path, column_map, "\n".join(wrong) + "\n")
    with pytest.raises(FileError, match="nine columns"):
        convert(tmp_path, column_map.replace(f'"{order}"', '"cols"'), "\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[rows]", "[row]", r"row: unknown key \(did you mean 'rows'"),
        ("decimal =", "decimals =", r"file.decimals: unknown key \(did you mean 'decimal'"),
        ('from = "X"', 'form = "X"', r"columns.x_mm.form: unknown key \(did you mean 'from'"),
        ("x_mm =", "x =", "columns.x: is not a contract column"),
        ('from = "X", unit = "m"', 'from = "X"', "columns.x_mm: needs the unit the file has it in"),
        ('from = "X", unit = "m"', 'from = "X", unit = "deg"', "columns.x_mm.unit: 'deg' cannot become 'mm'"),
        ("value = 2.5", 'value = 2.5, unit = "g"', "columns.payload_kg: a constant is already in the target's unit"),
        ("value = 2.5", 'value = "2.5"', "columns.payload_kg.value: must be a number"),
        ("sign = -1", "sign = -2", "'sign' is 1 or -1"),
        ("scale = 2", "scale = 0", "'scale' is not 0"),
        ('euler = "XYZ"', 'euler = "XyZ"', "orientation: Euler angles are three columns"),
        ('from = ["rx", "ry", "rz"]', 'from = ["rx", "ry"]', "orientation: Euler angles are three columns"),
        ("same_joints_within_deg = 0.001", "same_joints_within_deg = 0", "needs same_joints_within_deg"),
        ('delimiter = ";"', 'delimiter = ","', "the two differ"),
        (', equals = "ok"', "", "needs 'column' and either"),
        ('from = "X"', 'from = "x"', "there is no column 'x'"),
        ("[columns]", "[columns", "is not a readable column map"),
        ('[file]', '[file]\nformat = "xls"', "file.format: must be one of csv, json, mat, parquet"),
        ('[file]', "[file]\nskip_rows = -1", "file.skip_rows: must be a whole number"),
    ],
)  # fmt: skip
def test_a_wrong_map_is_refused_with_its_place(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in MAP
    with pytest.raises(FileError, match=words):
        convert(tmp_path, MAP.replace(old, new))


def test_pose_id_is_given_once(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="given twice"):
        convert(tmp_path, MAP.replace("[columns]", '[columns]\npose_id = { from = "time" }'))


def test_mat_columns_count_from_0_in_brackets_and_from_1_in_parentheses(tmp_path: Path) -> None:
    log = {"q": np.array([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]), "xyz": np.arange(9.0).reshape(3, 3)}
    savemat(tmp_path / "log.mat", {"log": log, "t": np.array([[0.0], [0.1], [0.2]])})
    (tmp_path / "map.toml").write_text("""
        [columns]
        q1_rad = { from = "log.q[:,0]", unit = "rad" }
        q2_rad = { from = "log.q(:,2)", unit = "rad" }
        x_mm = { from = "log.xyz(1,:)", unit = "mm" }
        t_s = { from = "t", unit = "s" }
    """)
    prepared = prepare(tmp_path / "log.mat", column_map=tmp_path / "map.toml")
    assert prepared.content.decode().splitlines()[1:] == ["0.0,1.0,0.0,0.0", "2.0,3.0,1.0,0.1", "4.0,5.0,2.0,0.2"]


@pytest.mark.parametrize(
    ("expression", "words"),
    [
        ("q(:,0)", "outside the array"),
        ("q[:,2]", "outside the array"),
        ("q", "name one column"),
        ("p[:,0]", "needs a variable 'p'; the file has q"),
        ("q[1:2,0]", "is not a column of a .mat file"),
        ("q[0,0]", "must keep one direction whole"),
    ],
)
def test_a_wrong_mat_column_is_explained(tmp_path: Path, expression: str, words: str) -> None:
    savemat(tmp_path / "log.mat", {"q": np.zeros((3, 2))})
    (tmp_path / "map.toml").write_text(f'[columns]\nq1_rad = {{ from = "{expression}", unit = "rad" }}\n')
    with pytest.raises(FileError, match=words):
        prepare(tmp_path / "log.mat", column_map=tmp_path / "map.toml")


def test_no_mat_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "log.mat").write_text("nothing")
    (tmp_path / "map.toml").write_text('[columns]\nq1_rad = { from = "q", unit = "rad" }\n')
    with pytest.raises(FileError, match=r"not a \.mat file that scipy can read"):
        prepare(tmp_path / "log.mat", column_map=tmp_path / "map.toml")


def test_columns_of_different_length_are_refused(tmp_path: Path) -> None:
    savemat(tmp_path / "log.mat", {"q": np.zeros((3, 1)), "t": np.zeros((4, 1))})
    (tmp_path / "map.toml").write_text(
        '[columns]\nq1_rad = { from = "q", unit = "rad" }\nt_s = { from = "t", unit = "s" }\n'
    )
    with pytest.raises(FileError, match=r"different numbers of rows \(q1_rad 3, t_s 4\)"):
        prepare(tmp_path / "log.mat", column_map=tmp_path / "map.toml")


def test_a_lab_parquet_file_goes_through_a_map(tmp_path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    parquet.write_table(pa.table({"J1": [0.5, 1.0], "state": ["ok", "bad"]}), tmp_path / "log.parquet")
    (tmp_path / "map.toml").write_text(
        '[columns]\nq1_deg = { from = "J1", unit = "turn" }\n[rows]\nkeep = [{ column = "state", equals = "ok" }]\n'
    )
    prepared = prepare(tmp_path / "log.parquet", column_map=tmp_path / "map.toml")
    assert prepared.content == b"q1_deg\n180.0\n"


def test_an_unknown_ending_is_refused(tmp_path: Path) -> None:
    (tmp_path / "log.xyz").write_text("a\n1\n")
    (tmp_path / "map.toml").write_text('[columns]\nq1_deg = { from = "a", unit = "deg" }\n')
    with pytest.raises(FileError, match="Set 'format' under"):
        prepare(tmp_path / "log.xyz", column_map=tmp_path / "map.toml")
    with pytest.raises(FileError, match=r"--map columns\.toml"):
        prepare(tmp_path / "log.xyz")


def test_contract_files_go_as_they_are(tmp_path: Path) -> None:
    content = b"q1_deg,x_mm\r\n1,2\r\n"
    (tmp_path / "a.csv").write_bytes(content)
    prepared = prepare(tmp_path / "a.csv", device="leica-at960")
    assert prepared.content == content
    assert prepared.content_type == "text/csv"


def test_example_maps_are_readable() -> None:
    folder = Path(__file__).resolve().parents[4] / "clients/python/examples"
    assert {path.name for path in folder.glob("*.toml")} == {"columns.toml", "fanuc.toml", "kr300.toml", "talos.toml"}
    for path in folder.glob("*.toml"):
        read_map(path, readers_for(UPLOAD_MAP))


def test_the_full_example_does_what_it_says(tmp_path: Path) -> None:
    folder = Path(__file__).resolve().parents[4] / "clients/python/examples"
    head = "joint 1;joint 2;encoder 3;X;Y;Z;time;T;speed 1;torque 1;torque 2;rx;ry;rz;state;quality"
    text = (
        f"A lab\n17°C\n{head}\n# pause\n0,1;0,2;16384;1;2;3;500;293,15;-3;7;8;0;0;0;ok;0,9\n"
        "0,1;0,2;16384;1;-;3;600;293,15;-3;7;8;0;0;0;ok;0,9\n"
        "0,1;0,2;16384;1;2;3;700;293,15;-3;7;8;0;0;0;bad;0,9\n"
    )
    (tmp_path / "lab.csv").write_bytes(text.encode("latin-1"))
    prepared = prepare(tmp_path / "lab.csv", column_map=folder / "columns.toml")
    (row,) = rows(prepared)
    assert row["q2_deg"] == pytest.approx(90 - math.degrees(0.2))
    assert row["q3_deg"] == pytest.approx(90)
    assert (row["t_s"], row["payload_kg"], row["pose_id"], row["y_mm"]) == (0.5, 2.5, 1, 2000)
    assert row["temperature_c"] == pytest.approx(20)
    assert (row["dir1"], row["tau1_nm"], row["tau2_nm"]) == (-1, 7, 8)
    assert prepared.lines == (5,)


def test_a_direction_is_the_sign_of_a_speed_and_kept_at_rest(tmp_path: Path) -> None:
    data = "q,link a,link b,v\n1,1,0,0\n2,2,0,0.5\n3,3,0,0.01\n4,4,0,-2\n5,5,0,0\n"
    mapped = """
[columns]
q1_deg = { from = "q", unit = "deg" }
link1_deg = { from = "link a", unit = "deg" }
link2_deg = { from = "link b", unit = "deg" }
dir1 = { from = "v", still_below = 0.1 }
"""
    prepared = convert(tmp_path, mapped, data)
    assert [row["dir1"] for row in rows(prepared)] == [0, 1, 1, -1, -1]
    assert any("link2_deg is the same in every row: a dead channel" in text for text in prepared.warnings)
    with pytest.raises(FileError, match="still_below"):
        convert(tmp_path, mapped.replace('unit = "deg" }', 'unit = "deg", still_below = 1 }', 1), data)


def test_rows_keep_their_numbers_where_one_between_is_left_out(tmp_path: Path) -> None:
    head, first, second, lost, lacking = LAB.splitlines()
    every_ok = lost.replace(";lost", ";ok")
    prepared = convert(tmp_path, MAP, "\n".join([head, first, lacking, second, lost, every_ok]) + "\n")
    assert [row["row"] for row in rows(prepared)] == [1, 3, 4]  # what a condition leaves out was no visit
    whole = convert(tmp_path, MAP, "\n".join([head, first, second]) + "\n")
    assert "row" not in rows(whole)[0]
