"""`kilter upload --dry-run`: ranges in mm and deg, poses, repeats, loads, directions, and what would be refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from pyarrow import parquet

from kilter_client import Kilter
from kilter_client.cli import run
from tests.clients.answered import document

Write = Callable[..., Path]
Capture = pytest.CaptureFixture[str]

ROWS: dict[str, list[float]] = {
    "q1_rad": [0.5, 0.5, 1.0, 0.5, -0.25],
    "q2_m": [0.1, 0.1, 0.2, 0.1, 0.3],
    "x_m": [1.0, 1.0, 1.5, 1.0, 0.25],
    "y_m": [0.0, 0.0, 0.0, 0.0, 0.0],
    "z_mm": [7.0, 7.0, 7.0, 7.0, 8.0],
    "dir1": [1, 1, -1, -1, 0],
    "payload_kg": [0, 0, 2.5, 0, 0],
}


def csv_of(columns: dict[str, list[Any]]) -> str:
    lines = [",".join("" if v is None else repr(v) for v in row) for row in zip(*columns.values(), strict=True)]
    return "\n".join([",".join(columns), *lines]) + "\n"


@pytest.mark.parametrize("kind", ["csv", "json", "parquet"])
def test_ranges_poses_loads_and_directions(no_settings: None, tmp_path: Path, capsys: Capture, kind: str) -> None:
    path = tmp_path / f"rows.{kind}"
    if kind == "parquet":
        parquet.write_table(pa.table(ROWS), path)
    else:
        path.write_text(json.dumps(ROWS) if kind == "json" else csv_of(ROWS))
    found = document(capsys, "upload", "nobody", path, "--dry-run")
    ranges = {c["name"]: c for c in found["ranges"]}
    assert ranges["q1_rad"]["unit"] == "deg"
    assert (ranges["q1_rad"]["low"], ranges["q1_rad"]["high"]) == pytest.approx((-14.3239, 57.2958), abs=1e-4)
    assert (ranges["q2_m"]["unit"], ranges["q2_m"]["low"], ranges["q2_m"]["high"]) == ("mm", 100, 300)
    assert (ranges["x_m"]["unit"], ranges["x_m"]["high"]) == ("mm", 1500)
    # the pose at 0.5 rad is visited twice: rows 1 and 2 without motion between them are one visit
    assert found["poses"] == {
        "count": 3, "by": "equal joints", "rows_per_pose": [1, 3], "visits_per_pose": [1, 2], "repeated": 1,
    }  # fmt: skip
    assert found["loads"] == {"payload_kg": [0, 2.5]}
    assert found["directions"] == {"dir1": {"-1": 2, "0": 1, "1": 2}}
    assert found["rows"] == 5
    assert "not_checked" in found


def test_the_text_for_people(no_settings: None, tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "rows.csv"
    path.write_text(csv_of(ROWS))
    assert run(["upload", "nobody", str(path), "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "poses: 3 by equal joints, 1 to 2 visits per pose (1 to 3 rows), 1 of them repeated" in out
    assert "loads: payload 0, 2.5 kg" in out
    assert "directions: dir1 2 down, 1 unknown, 2 up" in out
    assert "not checked: joints and their limits" in out
    assert out.rstrip().endswith("Nothing was stored.")
    plain = {name: values for name, values in ROWS.items() if name not in ("dir1", "payload_kg")}
    path.write_text(csv_of(plain))
    assert run(["upload", "nobody", str(path), "--dry-run", "--payload-kg", "4"]) == 0
    out = capsys.readouterr().out
    assert "loads: payload 4 kg (whole campaign)" in out
    assert "directions: not given" in out


def test_pose_numbers_go_before_equal_joints(no_settings: None, tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "rows.csv"
    path.write_text(csv_of(ROWS | {"pose_id": [1, 2, 3, 4, 5]}))
    poses = document(capsys, "upload", "nobody", path, "--dry-run")["poses"]
    assert (poses["count"], poses["by"], poses["visits_per_pose"]) == (5, "pose_id", [1, 1])


def test_what_would_be_refused_is_what_the_server_refuses(
    kilter: Kilter, robot: str, write_campaign: Write, tmp_path: Path, capsys: Capture
) -> None:
    path = write_campaign(30)
    found = document(capsys, "upload", robot, path, "--dry-run")
    assert (found["refused"], found["not_checked"]) == ([], "")
    lines = path.read_text().splitlines()
    for row in (4, 9):
        cells = lines[row].split(",")
        lines[row] = ",".join([cells[0], "300.5", *cells[2:]])
    path.write_text("\n".join(lines) + "\n")
    (tmp_path / "map.toml").write_text("[columns]\n" + "".join(
        f'{name} = {{ from = "{name}", unit = "{name.rpartition("_")[2]}" }}\n' for name in lines[0].split(",")
    ))  # fmt: skip
    found = document(capsys, "upload", robot, path, "--map", tmp_path / "map.toml", "--dry-run", code=1)
    (said,) = found["refused"]
    assert said.startswith("q2_deg is outside the limits ")
    assert "in 2 rows (line 5, 10), by up to " in said
    assert kilter.campaigns.list(robot) == []
    problem = document(capsys, "upload", robot, path, "--map", tmp_path / "map.toml", code=1)
    assert problem["context"]["lines"] == [5, 10]
    assert f"That is line 5, 10 of {path}." in problem["detail"]
    assert kilter.campaigns.list(robot) == []


def test_a_unit_that_explains_readings_outside_the_limits_is_named(
    kilter: Kilter, robot: str, write_campaign: Write, capsys: Capture
) -> None:
    path = write_campaign(30)
    path.write_text(path.read_text().replace("_deg", "_rad"))
    (said,) = document(capsys, "upload", robot, path, "--dry-run", code=1)["refused"]
    assert "Joints look like degrees declared as radians" in said
    problem = document(capsys, "upload", robot, path, code=1)
    assert (problem["code"], said in problem["detail"]) == ("foreign_observations", True)
    path.write_text(path.read_text().replace("_rad", "_deg"))  # the remedy
    assert document(capsys, "upload", robot, path, "--dry-run")["refused"] == []


@pytest.mark.parametrize("beyond", [9.9, 10.1])
def test_the_tolerance_of_the_limits_is_the_servers(
    kilter: Kilter, robot: str, write_campaign: Write, capsys: Capture, beyond: float
) -> None:
    joint = kilter.robots.get(robot)["joints"][0]
    path = write_campaign(20)
    lines = path.read_text().splitlines()
    lines[3] = ",".join([repr(joint["limits_deg"][1] + beyond), *lines[3].split(",")[1:]])
    path.write_text("\n".join(lines) + "\n")
    code = 0 if beyond < 10 else 1
    assert bool(document(capsys, "upload", robot, path, "--dry-run", code=code)["refused"]) == (beyond > 10)
    document(capsys, "upload", robot, path, code=code)


def test_rows_that_rules_leave_out_and_joints_that_do_not_fit(robot: str, tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "lab.csv").write_text("a,x,y,z,ok\n1,200,0,300,yes\n2,210,0,300,no\n3,,0,300,yes\n4,220,0,300,yes\n")
    (tmp_path / "map.toml").write_text("""
        [columns]
        q1_deg = { from = "a", unit = "deg" }
        x_mm = { from = "x", unit = "mm" }
        y_mm = { from = "y", unit = "mm" }
        z_mm = { from = "z", unit = "mm" }
        [rows]
        drop_missing = true
        keep = [{ column = "ok", equals = "yes" }]
    """)
    found = document(capsys, "upload", robot, tmp_path / "lab.csv", "--map", tmp_path / "map.toml", "--dry-run", code=1)
    assert found["left_out"] == [
        "1 rows left out by the condition on 'ok'",
        "1 rows left out because a value is missing",
    ]
    assert found["refused"] == ["the file has joints 1, the robot 5"]
    (tmp_path / "gap.csv").write_text("q1_deg,x_mm,y_mm,z_mm\n1,2,3,\n")
    found = document(capsys, "upload", robot, tmp_path / "gap.csv", "--dry-run", code=1)
    assert "z_mm is empty or not a number in 1 rows (row 1)" in found["refused"]


def test_the_second_file_of_a_map_is_named_on_the_command_line(
    no_settings: None, tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / "points.csv").write_text("x,y,z\n1,2,3\n4,5,6\n")
    (tmp_path / "robot log.csv").write_text("A1;A2\n10;20\n30;40\n")
    points = "".join(f'{a}_mm = {{ from = "{a}", unit = "mm" }}\n' for a in "xyz")
    join = '[join]\nby = "row"\n[join.file]\ndelimiter = ";"\n[join.columns]\nq* = { from = "A*", unit = "deg" }\n'
    (tmp_path / "map.toml").write_text(f"[columns]\n{points}{join}")
    arguments = ("upload", "nobody", tmp_path / "points.csv", "--joints", tmp_path / "robot log.csv", "--dry-run")
    found = document(capsys, *arguments, "--map", tmp_path / "map.toml")
    assert [c["high"] for c in found["ranges"]] == [4, 5, 6, 30, 40]
    assert any("of robot log.csv by row" in text for text in found["notes"])
    said = document(capsys, *arguments, code=2)["detail"]
    assert "a second file (--joints) goes with a preset (--preset: a text export of points)" in said


def test_a_dry_run_says_that_columns_are_separated_otherwise(robot: str, tmp_path: Path, capsys: Capture) -> None:
    """It said *the file has joints none*, of a German spreadsheet's export of contract columns."""
    path = tmp_path / "rows.csv"
    path.write_text("q1_deg;q2_deg;x_mm;y_mm;z_mm\n1,5;2,0;100,25;200,5;300,0\n")
    assert run(["upload", robot, str(path), "--dry-run"]) == 1
    out = " ".join(capsys.readouterr().out.split())
    assert (
        "would be refused: its columns are separated by ';' or tabs: kilter measure inspect FILE --draft columns.toml"
        in out
    )
    assert "joints none" not in out
