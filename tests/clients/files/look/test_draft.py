"""`kilter measure inspect --draft`: first maps for files of invented labs, which upload once their marked places are filled."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from kilter_client import FileError, Kilter, prepare
from kilter_client.cli import run
from kilter_files.formats.unknown.table_shape import detect_table_shape
from kilter_files.look.drafts import draft, inspect
from kilter_files.look.summaries import numeric_columns
from tests.clients.answered import document
from tests.clients.files.look.labs import LABS, Measured, write_lab
from tests.clients.files.test_fuzz import EDITS, edited

Write = Callable[..., Path]
Capture = pytest.CaptureFixture[str]


def fill(text: str, name: str) -> str:
    """Do what the marks and remarks of a draft ask for."""
    text = text.replace("# [pose_id]\n# same", "[pose_id]\nsame")
    for old, new in LABS[name].filled:
        assert old in text, text
        text = text.replace(old, new)
    return text


@pytest.mark.parametrize("name", LABS)
def test_a_draft_means_what_the_lab_measured(tmp_path: Path, capsys: Capture, name: str) -> None:
    path, measured = write_lab(tmp_path, name)
    target = tmp_path / "map.toml"
    found = document(capsys, "inspect", path, "--draft", target)
    assert found["open"] == list(LABS[name].open)
    if LABS[name].open:
        with pytest.raises(FileError, match=r"the draft could not determine"):
            prepare(path, column_map=target)
    target.write_text(fill(target.read_text(encoding="utf-8"), name), encoding="utf-8")
    columns = numeric_columns(prepare(path, column_map=target))
    to_deg = {f"q{k}_rad": np.degrees(values) for k in range(1, 6) if (values := columns.get(f"q{k}_rad"))}
    q = [to_deg.get(f"q{k}_rad", columns.get(f"q{k}_deg", [])) for k in range(1, 6)]
    np.testing.assert_allclose(np.array(q).T, measured.q, atol=1e-3)
    np.testing.assert_allclose(np.array([columns[f"{a}_mm"] for a in "xyz"]).T, measured.p, atol=1e-4)
    assert len(set(columns["pose_id"])) == 12
    if name in ("kuka", "workbook", "matlab"):
        began = datetime.fromtimestamp(columns["t_s"][0], UTC)  # a workbook has dates
        assert (began.year if name == "workbook" else columns["t_s"][0]) == (2026 if name == "workbook" else 0)
        assert np.all(np.diff(columns["t_s"]) > 0)
    if name == "workbook":
        assert set(columns["payload_kg"]) == {2.5}


@pytest.mark.parametrize("name", LABS)
def test_the_draft_uploads(
    kilter: Kilter, robot: str, write_campaign: Write, tmp_path: Path, capsys: Capture, name: str
) -> None:
    table = np.genfromtxt(write_campaign(30), delimiter=",", names=True)
    q, p = (
        np.stack([table[n] for n in names], axis=1)
        for names in ([f"q{k}_deg" for k in range(1, 6)], ["x_mm", "y_mm", "z_mm"])
    )
    path, _ = write_lab(tmp_path, name, Measured(q, p))
    assert run(["inspect", str(path), "--draft", str(tmp_path / "map.toml")]) == 0
    text = (tmp_path / "map.toml").read_text(encoding="utf-8")
    (tmp_path / "map.toml").write_text(fill(text, name), encoding="utf-8")
    done = document(capsys, "upload", robot, path, "--map", tmp_path / "map.toml")
    assert done["rows"] == 30
    assert kilter.campaigns.get(done["campaign_id"])["name"] == path.name


HEAD = "j1,j2,j3,x,y,z"
ROWS = [[10 * k, -20 * k, 5 * k, 100 + k, 200 - k, 300 + 2 * k] for k in range(1, 6)]


def table(head: str, rows: list[list[Any]] = ROWS, **more: list[Any]) -> str:
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow([*head.split(","), *more])
    writer.writerows([[*row, *(values[k] for values in more.values())] for k, row in enumerate(rows)])
    return out.getvalue()


def drafted(folder: Path, text: str) -> str:
    (folder / "lab.csv").write_text(text)
    return draft(folder / "lab.csv").text


def test_the_actual_joints_go_before_the_commanded_ones(tmp_path: Path) -> None:
    head = "cmd_j1,cmd_j2,cmd_j3,act_j1,act_j2,act_j3,x_soll,y_soll,z_soll,x_ist,y_ist,z_ist"
    text = drafted(tmp_path, table(head, [[*r[:3], *r[:3], *r[3:], *r[3:]] for r in ROWS]))
    assert '"q*" = { from = "act_j*", unit = "deg" }' in text
    assert 'x_mm = { from = "x_ist", unit = "mm" }' in text
    assert "# other columns that might be the joints: cmd_j*" in text
    assert "# other columns that might be the position: @_soll" in text


def test_two_arms_in_one_file_are_left_to_the_person(tmp_path: Path) -> None:
    text = drafted(tmp_path, table("left_joint1,left_joint2,right_joint1,right_joint2,x,y", ROWS))
    assert (
        'from = "?", unit = "deg" }   # ? could not determine which of these are the arm\'s joints: left_joint*, right_joint*'
        in text
    )
    with pytest.raises(FileError, match=r"columns.q\*.from: the draft could not determine which columns these are"):
        prepare(tmp_path / "lab.csv", column_map=write(tmp_path / "m.toml", text))


def test_vectors_with_numbers_and_compound_words(tmp_path: Path) -> None:
    head = [
        *(f"actual_q_{k}" for k in range(3)),
        *(f"actual_qd_{k}" for k in range(3)),
        *(f"actual_TCP_pose_{k}" for k in range(6)),
    ]
    text = drafted(tmp_path, table(",".join(head), [[*r[:3], 1, 2, 3, *r[3:], 0.1, 0.2, 0.3] for r in ROWS]))
    assert '"q*" = { from = "actual_q_*", unit = "deg" }' in text
    assert 'z_mm = { from = "actual_TCP_pose_2", unit = "mm" }' in text
    assert "What the controller computes from its joints is not a measurement" in text
    text = drafted(
        tmp_path,
        table(
            "Achswinkel 1 in Grad,Achswinkel 2 in Grad,Achswinkel 3 in Grad,Messwert X in mm,Messwert Y in mm,Messwert Z in mm"
        ),
    )
    assert '"q*" = { from = "Achswinkel * in Grad", unit = "deg" }' in text
    assert 'x_mm = { from = "Messwert X in mm", unit = "mm" }\n' in text


def test_an_instrument_goes_before_the_controllers_own_pose(tmp_path: Path) -> None:
    text = drafted(
        tmp_path, table("A1,A2,A3,TCP_x,TCP_y,TCP_z,tracker_x,tracker_y,tracker_z", [[*r, *r[3:]] for r in ROWS])
    )
    assert 'x_mm = { from = "tracker_x", unit = "mm" }' in text
    assert "no measurement" not in text


def test_torques_speeds_and_currents_are_no_joints(tmp_path: Path) -> None:
    text = drafted(tmp_path, table("torque_j1,torque_j2,torque_j3,x,y,z"))
    assert '"q*" = { from = "?", unit = "?" }' in text
    assert "# [join]" in text


def test_markers(tmp_path: Path) -> None:
    head = ",".join(["A1", "A2", *(f"Marker {k} {a}" for k in (1, 2) for a in "XYZ")])
    text = drafted(tmp_path, table(head, [[*r[:2], *r[3:], *(v + 50 for v in r[3:])] for r in ROWS]))
    assert '"m*x_mm" = { from = "Marker * X", unit = "mm" }' in text
    found = numeric_columns(prepare(tmp_path / "lab.csv", column_map=write(tmp_path / "m.toml", text)))
    assert found["m2z_mm"] == [352, 354, 356, 358, 360]


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_a_quaternion_is_no_family_of_joints(tmp_path: Path) -> None:
    text = drafted(tmp_path, table(HEAD + ",q0,q1,q2,q3", [[*r, 1.0, 0.0, 0.0, 0.0] for r in ROWS]))
    assert 'from = ["q0", "q1", "q2", "q3"]\nquaternion = "wxyz"' in text
    assert '"q*" = { from = "j*", unit = "deg" }' in text


def test_angles_of_unknown_order_are_marked_and_refused_until_filled(tmp_path: Path) -> None:
    text = drafted(tmp_path, table(HEAD + ",rx,ry,rz", [[*r, 10.0, 20.0, 170.0] for r in ROWS]))
    assert 'euler = "?"   # ? order of the angles' in text
    column_map = write(tmp_path / "m.toml", text)
    with pytest.raises(FileError, match=r"orientation: the draft could not determine: fill in what is \"\?\""):
        prepare(tmp_path / "lab.csv", column_map=column_map)
    write(column_map, text.replace('euler = "?"', 'euler = "xyz"'))
    assert "qw" in numeric_columns(prepare(tmp_path / "lab.csv", column_map=column_map))


def test_empty_cells_states_and_times(tmp_path: Path) -> None:
    rows: list[list[Any]] = [list(row) for row in ROWS]
    rows[2][4] = ""
    states, stamps = ["ok", "lost", "ok", "ok", "ok"], [1_700_000_000_000 + k for k in range(5)]
    text = drafted(tmp_path, table(HEAD, rows, state=states, time=stamps, temp_air=[20, 20, 21, 21, 21]))
    assert 't_s = { from = "time", unit = "ms" }' in text
    assert 'temperature_c = { from = "temp_air", unit = "C" }' in text
    assert "drop_missing = true   # 1 rows or more have an empty cell" in text
    assert '# keep = [{ column = "state", equals = "ok" }]   # it holds ok, lost' in text
    done = prepare(tmp_path / "lab.csv", column_map=write(tmp_path / "m.toml", text.replace("# keep", "keep")))
    assert done.lines == (2, 5, 6)


def test_joints_of_a_points_file_come_by_the_join_that_the_draft_offers(tmp_path: Path) -> None:
    text = drafted(tmp_path, table("Point,x,y,z", [[k, *row[3:]] for k, row in enumerate(ROWS)]))
    (tmp_path / "joints.csv").write_text(table("A1,A2,A3", [row[:3] for row in ROWS]))
    lines = [line for line in text.splitlines() if not line.startswith('"q*"')]
    start = next(k for k, line in enumerate(lines) if "# [join]" in line)
    lines[start : start + 5] = [line.removeprefix("# ") for line in lines[start : start + 5]]
    found = numeric_columns(prepare(tmp_path / "lab.csv", column_map=write(tmp_path / "m.toml", "\n".join(lines))))
    assert found["q2_deg"] == [-20, -40, -60, -80, -100]


def test_small_values_leave_the_unit_open(tmp_path: Path) -> None:
    text = drafted(tmp_path, table(HEAD, [[v / 1000 for v in row] for row in ROWS]))
    assert (
        '"q*" = { from = "j*", unit = "?" }   # ? the file states no unit, and values up to 0.1 do not decide between'
        in text
    )
    with pytest.raises(FileError, match=r"columns.q\*.unit: the draft could not determine the unit"):
        prepare(tmp_path / "lab.csv", column_map=write(tmp_path / "m.toml", text))


def test_a_unit_that_the_file_states_is_never_guessed_from_the_values(tmp_path: Path) -> None:
    joints = {f"A{k} [gon]": [100.0 * k, 3.0 - 50.0 * k] for k in (1, 2, 3, 4)}
    path = write(tmp_path / "lab.csv", table("X [ft],Y [ft],Z [ft]", [[1.0, 2.0, 3.5], [2.0, 1.5, 9.5]], **joints))
    found = draft(path)
    assert '"q*" = { from = "A* [gon]", unit = "gon" }\n' in found.text
    assert found.open == ["columns.x_mm", "columns.y_mm", "columns.z_mm"]
    assert "the file states [ft], which is none of m, cm, mm" in found.text
    column_map = write(tmp_path / "map.toml", found.text.replace('unit = "?"', 'unit = "m", scale = 0.3048'))
    columns = numeric_columns(prepare(path, column_map=column_map))
    np.testing.assert_allclose([columns["x_mm"][0], columns["q2_deg"][1]], [304.8, (3.0 - 100.0) * 0.9])


@pytest.mark.parametrize("poses", [40, 1000])
def test_arrays_of_matlab_that_lie_across_are_read_by_rows(tmp_path: Path, poses: int) -> None:
    """A pose in each column: the forty poses were drafted as forty joints, and a thousand were not seen at all."""
    rng, path = np.random.default_rng(4), tmp_path / "lab.mat"
    q, p = rng.uniform(-2.0, 2.0, (6, poses)), rng.uniform(-900.0, 900.0, (3, poses))
    savemat(path, {"log": {"joint_pos": q, "tcp_meas": p}})
    found = draft(path)
    assert found.open == []
    column_map = write(tmp_path / "map.toml", found.text)
    columns = numeric_columns(prepare(path, column_map=column_map))
    joints = [np.radians(columns[f"q{k}_deg"]) for k in range(1, 7)]
    np.testing.assert_allclose(joints, q, atol=1e-9)
    np.testing.assert_allclose([columns[f"{axis}_mm"] for axis in "xyz"], p, atol=1e-9)


def test_words_for_what_was_not_measured_are_listed_as_missing(tmp_path: Path) -> None:
    """One cell ``---`` in each coordinate: the draft asked which columns the position is, and said nothing of the cells."""
    rows = [
        [10 * k, -20 * k, 5 * k, *(["---"] * 3 if k == 4 else [100 + k, 200 - k, 300 + 2 * k])] for k in range(1, 9)
    ]
    path = write(tmp_path / "lab.csv", table("J1_deg,J2_deg,J3_deg,X_mm,Y_mm,Z_mm", rows))
    found = draft(path)
    assert found.open == []
    assert 'missing = ["---"]' in found.text
    columns = numeric_columns(prepare(path, column_map=write(tmp_path / "map.toml", found.text)))
    assert columns["x_mm"] == [101, 102, 103, 105, 106, 107, 108]


def test_thousands_separators_are_named_where_a_position_is_looked_for(tmp_path: Path) -> None:
    head = ";".join([*(f"J{k}_deg" for k in range(1, 7)), "X", "Y", "Z"])
    lines = [";".join([*(f"{10 * k + j},5" for j in range(6)), *[f"1.{k:03d},25"] * 3]) for k in range(1, 9)]
    found = drafted(tmp_path, "\n".join([head, *lines]) + "\n")
    assert "X holds '1.001,25'. Write numbers without separators of thousands" in found


def test_a_draft_writes_over_nothing(tmp_path: Path, capsys: Capture) -> None:
    path, target = write(tmp_path / "lab.csv", table(HEAD)), write(tmp_path / "map.toml", "mine")
    said = document(capsys, "inspect", path, "--draft", target, code=2)["detail"]
    assert re.search(r"map.toml: is there already. Name another file, or delete it", said)
    assert target.read_text() == "mine"


def test_the_report_says_what_to_check_and_what_comes_next(tmp_path: Path, capsys: Capture) -> None:
    path = write(tmp_path / "lab file.csv", table(HEAD))
    assert run(["inspect", str(path), "--draft", str(tmp_path / "m.toml")]) == 0
    out = capsys.readouterr().out
    assert "check q*: the file states no unit; values up to 100 are degrees" in out
    assert f"Then: kilter upload ROBOT '{path}' --map {tmp_path / 'm.toml'} --dry-run" in out


def test_two_columns_of_one_name_are_refused_with_the_file(tmp_path: Path) -> None:
    path = write(tmp_path / "lab.csv", table("A1,A1,A2,x,y,z"))
    with pytest.raises(FileError, match=r"lab.csv: two columns are called 'A1'. Rename one"):
        draft(path)


@pytest.mark.parametrize("text", ["", "only words\nand more\n", "a,b\nx,y\n"])
def test_no_table_no_draft(tmp_path: Path, text: str) -> None:
    with pytest.raises(FileError, match=r"no table of numbers was found in its beginning\. Export it as CSV"):
        draft(write(tmp_path / "lab.csv", text))


def test_layouts(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes("a|b\n1|2\n3|4\n".encode("utf-16"))
    layout = detect_table_shape(tmp_path / "a.csv").layout
    assert (layout.delimiter, layout.encoding) == ("|", "utf-16")
    bare = drafted(tmp_path, "1,2,3,4\n5,6,7,8\n")
    assert "header = false" in bare
    assert '"q*" = { from = "?", unit = "?" }' in bare


def bare_table(tmp_path: Path, *blocks: np.ndarray) -> str:
    """Draft of a table without a header."""
    lines = [",".join(f"{v:.4f}" for v in row) for row in np.hstack(blocks)]
    return drafted(tmp_path, "\n".join(lines) + "\n")


def test_columns_without_a_header_within_half_a_turn_are_the_joints(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    q = rng.uniform(-1.0, 1.0, (30, 6)) * [170, 90, 120, 3, 100, 175]  # the fourth hardly moved
    mm, number = rng.uniform(-900.0, 900.0, (30, 3)), np.arange(1.0, 31.0)[:, None]
    for blocks, first in (((q, mm), 0), ((number, q, mm / 1e3), 1), ((mm, q), 3)):
        text = bare_table(tmp_path, *blocks)
        assert [f'q{k}_deg = {{ from = {first + k - 1}, unit = "deg" }}' in text for k in range(1, 7)] == [True] * 6
        assert "there is no header" in text
    for undecided in ((q, mm / 10.0), (np.radians(q), mm), (q, mm, q), (q[:, :2], mm)):
        assert '"q*" = { from = "?"' in bare_table(tmp_path, *undecided)


@pytest.mark.parametrize("name", ["german", "kuka", "lists", "workbook"])
def test_damaged_files_are_drafted_or_refused_and_nothing_else(tmp_path: Path, name: str) -> None:
    whole, _ = write_lab(tmp_path, name)
    seed = whole.read_bytes()
    path, column_map = tmp_path / f"damaged{whole.suffix}", tmp_path / "m.toml"

    @settings(max_examples=40, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
    @given(EDITS)
    def check(edits: list[tuple[str, int, bytes]]) -> None:
        path.write_bytes(edited(seed, edits))
        said = str(path)
        try:
            column_map.write_text(draft(path).text, encoding="utf-8")
            prepare(path, column_map=column_map)
        except FileError as error:
            said = error.detail
        assert str(path) in said or str(column_map) in said

    check()


@pytest.mark.parametrize("head", ["A1;A2;A3;X;Y;Z", "# lab 3\n# 2026\nA1 [deg];A2 [deg];A3 [deg];X [mm];Y [mm];Z [mm]"])
def test_inspection_sees_the_joints_that_a_draft_sees(tmp_path: Path, capsys: Capture, head: str) -> None:
    """A reader of points took such a table for a tracker's export, and left the joints out."""
    rows = [f"{k * 1.5:.3f};{k * -2.25:.3f};{k % 7:.3f};{100 + k}.5;{200 - k}.5;300.5" for k in range(20)]
    path = tmp_path / "lab.csv"
    path.write_text("\n".join([head, *rows]).replace(".", ",") + "\n")
    found = document(capsys, "inspect", path)
    assert (found["kind"], found["rows"]) == ("table", 20)
    names = [column["name"].partition(" ")[0] for column in found["columns"]]
    assert names == ["A1", "A2", "A3", "X", "Y", "Z"]
    assert (found["columns"][1]["low"], found["columns"][1]["high"]) == (-42.75, 0.0)
    said = [note for note in found["notes"] if note.startswith("check q*")]
    assert bool(said) == ("[deg]" not in head)
    points = tmp_path / "points.csv"  # points alone stay points
    points.write_text("\n".join(["X;Y;Z", *(row.split(";", 3)[3] for row in rows)]).replace(".", ",") + "\n")
    assert document(capsys, "inspect", points)["kind"] == "tracker-text"


@pytest.mark.parametrize(
    ("cell", "first", "scale"), [("m{}{}", 0, 1.0), ("T_{}_{}", 1, 1000.0), ("pose[{},{}]", 0, 1.0)]
)
def test_a_pose_matrix_is_recognised(tmp_path: Path, capsys: Capture, cell: str, first: int, scale: float) -> None:
    """Nine numbers that are a rotation in every row, and beside them the point; scipy made the rotations."""
    rng = np.random.default_rng(2)
    turned = Rotation.random(12, random_state=3)
    points = rng.uniform(-1.0, 1.0, (12, 3))
    poses = np.tile(np.eye(4), (12, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = turned.as_matrix(), scale * points
    head = [f'"{cell.format(i, j)}"' for i in range(first, first + 4) for j in range(first, first + 4)]
    joints = rng.uniform(-100.0, 100.0, (12, 2))
    lines = [",".join(f"{v:.9g}" for v in (*q, *pose.reshape(-1))) for q, pose in zip(joints, poses, strict=True)]
    path, target = tmp_path / "poses.csv", tmp_path / "map.toml"
    path.write_text("\n".join([",".join(["A1 [deg]", "A2 [deg]", *head]), *lines]) + "\n")
    found = document(capsys, "inspect", path, "--draft", target)
    assert (found["open"], found["unused"]) == ([], [])
    columns = numeric_columns(prepare(path, column_map=target))
    assert pytest.approx(1000.0 * points, abs=1e-4) == np.array([columns[f"{a}_mm"] for a in "xyz"]).T
    quaternion = np.array([columns[f"q{a}"] for a in "xyzw"]).T
    assert np.abs((quaternion * turned.as_quat()).sum(axis=1)) == pytest.approx(1.0, abs=1e-6)


def test_nine_numbered_columns_that_are_no_rotation_are_left_alone(tmp_path: Path, capsys: Capture) -> None:
    rng = np.random.default_rng(5)
    head = [f"m{i}{j}" for i in range(3) for j in range(3)]
    rows = [",".join(f"{v:.4f}" for v in row) for row in rng.uniform(-90.0, 90.0, (9, 11))]
    path = tmp_path / "numbers.csv"
    path.write_text("\n".join([",".join(["A1 [deg]", "A2 [deg]", *head]), *rows]) + "\n")
    found = document(capsys, "inspect", path, "--draft", tmp_path / "map.toml")
    assert set(head) <= set(found["unused"])
    assert "[orientation]" not in (tmp_path / "map.toml").read_text()


def test_cells_that_are_lists_in_a_file_without_a_header_are_columns(tmp_path: Path) -> None:
    """As are the two numbers of a JSON list that is no table at all; both ended the command with a Python error."""
    rows = [f'"[{k}.5, {2 * k}, 3]","[{30 * k}, 4]"' for k in range(1, 5)]
    for text, names in (
        ("\n".join(rows) + "\n", ["0[0]", "0[1]", "0[2]", "1[0]", "1[1]"]),
        ("[1, 2]", ["0[0]", "0[1]"]),
    ):
        path = tmp_path / "lists.csv"
        path.write_text(text)
        found = inspect(path)
        assert [column["name"] for column in found["columns"]] == names
        assert found["columns"][0]["low"] == (1.5 if len(names) > 2 else 1.0)
        assert all(name in draft(path).text for name in names)


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ("A1 [deg];A2 [deg];A3 [deg];X [mm];Y [mm];Z [mm]", "position X [mm] ... Z [mm]"),
        ("A1;A2;A3;X [mm];Y [mm];Z [mm]", "joints A* [deg]"),
    ],
)
def test_what_is_read_names_each_unit_once(tmp_path: Path, header: str, said: str) -> None:
    rows = [f"{10 * k}.5;{7 * k}.25;{-5 * k}.75;{300 + k}.1;{20 * k}.2;{400 - k}.3" for k in range(1, 12)]
    path = tmp_path / "lab.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    readings = draft(path).readings
    assert said in readings
    assert not re.search(r"\] \[", readings)
