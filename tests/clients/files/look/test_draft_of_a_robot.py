"""Drafts of a known robot: its joints are found by their names and kinds; what nobody can tell stays open."""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kilter_client import Kilter
from kilter_files.look.drafts import Draft, draft
from tests.clients.answered import document

A = [f"A{k}" for k in range(1, 8)]
AT = {"X": 700.0, "Y": -200.0, "Z": 900.0}


def drafted(folder: Path, head: Sequence[str], robot: Sequence[str] = ()) -> tuple[dict[str, Any], Draft]:
    """The columns of the map for a table of these names, and the draft."""
    rng = np.random.default_rng(3)
    with (folder / "lab.csv").open("w", newline="", encoding="utf-8") as stream:
        out = csv.writer(stream)
        out.writerow([*head, *AT])
        for k in range(20):
            out.writerow([*rng.uniform(-90, 90, len(head)).round(3), *(v + 10 * k for v in AT.values())])
    found = draft(folder / "lab.csv", robot)
    return tomllib.loads(found.text)["columns"], found


@pytest.mark.parametrize(
    ("head", "robot"),
    [
        (["wr_r", "base_yaw", "upper_arm"], ["base_yaw", "upper_arm", "wr_r"]),
        (["pos.elbow [deg]", "vel.elbow", "pos.hip [deg]", "effort.hip", "cmd.hip"], ["hip", "elbow"]),
        (["left_arm_1_pos", "left_arm_10_pos", "left_arm_2_pos"], ["left_arm_1", "left_arm_2", "left_arm_10"]),
    ],
)
def test_columns_are_found_by_the_names_of_the_joints(tmp_path: Path, head: list[str], robot: list[str]) -> None:
    columns, found = drafted(tmp_path, head, robot)
    taken = [columns[f"q{k}_deg"]["from"] for k in range(1, len(robot) + 1)]
    for name, joint in zip(taken, robot, strict=True):
        assert joint in name
        assert not name.startswith(("vel", "effort", "cmd"))
    assert not found.open


@pytest.mark.parametrize("first", [True, False])
def test_a_rail_is_where_the_robot_has_its_sliding_joint(tmp_path: Path, first: bool) -> None:
    robot = [f"joint_a{k}" for k in range(1, 8)]
    robot.insert(0 if first else 7, "track_joint:m")
    columns, found = drafted(tmp_path, [*A, "E1"], robot)
    expected = {f"q{k + first}_deg": name for k, name in enumerate(A, 1)} | {"q1_mm" if first else "q8_mm": "E1"}
    assert {key: columns[key]["from"] for key in expected} == expected
    assert not found.open


@pytest.mark.parametrize("beside", ["E1", "rail", "eax_a", "ext axis 1"])
def test_nobody_is_told_that_a_draft_with_a_moving_rail_is_whole(tmp_path: Path, beside: str) -> None:
    columns, found = drafted(tmp_path, [*A, beside])
    assert columns["q*"]["from"] == "?"
    assert found.open == ["columns.q*"]
    assert f"{beside} may be joints of the robot too" in found.text


def test_a_robot_of_other_joints_is_not_guessed(tmp_path: Path) -> None:
    columns, found = drafted(tmp_path, [*A[:6], "E1"], ["a", "b", "c"])
    assert columns["q*"]["from"] == "?"
    assert "the robot has 3 joints (a, b, c): write one line for each" in found.text


@pytest.mark.parametrize("name", ["T air [degC]", "T air (°C)", "T_air_degC", "T air", "T_amb", "Temp base"])
def test_a_temperature_is_no_time(tmp_path: Path, name: str) -> None:
    path = tmp_path / "lab.csv"
    rows = [f"{10 * k},{-20 * k},{5 * k},{100 + k},{200 - k},{300 + k},{20 + k / 10}" for k in range(1, 9)]
    path.write_text("\n".join([f"j1,j2,j3,x,y,z,{name}", *rows]) + "\n", encoding="utf-8")
    columns = tomllib.loads(draft(path).text)["columns"]
    assert "t_s" not in columns
    assert (columns["temperature_c"]["from"], columns["temperature_c"]["unit"]) == (name, "C")


def test_the_command_asks_the_server_for_the_joints(
    kilter: Kilter, robot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = [joint["name"] for joint in kilter.robots.get(robot)["joints"]]
    path = tmp_path / "lab.csv"
    head = [*reversed(names), "X", "Y", "Z"]
    rows = [[30.0 + 7 * k + c for c in range(len(names))] + [700.0, 100.0 + k, 300.0] for k in range(6)]
    path.write_text("\n".join([",".join(head), *(",".join(map(str, row)) for row in rows)]) + "\n")
    done = document(capsys, "inspect", path, "--draft", tmp_path / "map.toml", "--robot", robot)
    assert done["open"] == []
    columns = tomllib.loads((tmp_path / "map.toml").read_text())["columns"]
    assert [columns[f"q{k}_deg"]["from"] for k in range(1, len(names) + 1)] == names
