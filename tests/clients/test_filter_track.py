"""An arm on a rail: what an external axis carries along is where the program says, in the frame of the rail's zero."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from kilter_client import Kilter
from kilter_client.cli import run

from .answered import document
from .six_joint_arms import Arm, Floats, shift
from .test_filter_poses import (
    BASE,
    ERRORS,
    TOOL,
    WITHIN_MM,
    calibrated,
    confdata,
    krl_back,
    lines_left,
    quaternion,
    rapid_back,
    status_turn,
    taught,
    zyx,
)


def robot(kilter: Kilter, preset: str, folder: Path) -> str:
    if f"poses-{preset}" not in {one["name"] for one in kilter.robots.list()}:
        calibrated(kilter, preset, folder / "measured.csv")
    return f"poses-{preset}"


def rapid(q: Floats, rail: Floats, along: Floats) -> str:
    lines = [
        "MODULE w",
        f"  PERS tooldata grip := [TRUE,[{quaternion(TOOL)}],[1,[0,0,1],[1,0,0,0],0,0,0]];",
        f'  PERS wobjdata bench := [FALSE,TRUE,"",[{quaternion(BASE)}],[[0,0,0],[1,0,0,0]]];',
    ]
    for k, (at, value) in enumerate(zip(q, rail, strict=True)):
        pose = np.linalg.inv(BASE) @ shift(*(value * along)) @ Arm("irb120").flange(at) @ TOOL
        axes = f"[{value:.6f},9E9,9E9,9E9,9E9,9E9]"
        lines.append(f"  CONST robtarget p{k} := [{quaternion(pose)},{confdata(at)},{axes}];")
    moves = [f"  MoveJ p{k}, v100, z10, grip\\WObj:=bench;" for k in range(len(q))]
    return "\n".join([*lines, "PROC main()", *moves, "ENDPROC", "ENDMODULE", ""])


def off_mm(preset: str, q: Floats, root: Floats, pose: Floats) -> float:
    """How far the real arm, which stands at ``root``, is from the taught point."""
    ideal, real = Arm(preset), Arm(preset, ERRORS)
    command = ideal.joints(np.linalg.inv(root) @ BASE @ pose @ np.linalg.inv(TOOL), q)
    return float(np.linalg.norm((real.flange(command) @ TOOL - ideal.flange(q) @ TOOL)[:3, 3]))


def test_poses_on_a_rail_that_is_stated_are_corrected(
    kilter: Kilter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name, q = robot(kilter, "irb120", tmp_path), taught("irb120", 5, seed=41)
    rail, along = np.array([0.0, 900.0, -250.5, 4000.0, 12.25]), np.array([0.0, -1.0, 0.0])
    path, output = tmp_path / "w.mod", tmp_path / "out.mod"
    path.write_text(rapid(q, rail, along))
    told = document(capsys, "filter", path, "--robot", name, "-o", output)
    assert "state a rail and its direction, --track eax_a=x" in lines_left(told)[5]
    assert [line for line in lines_left(told) if line < 9] == [5, 6, 7, 8]
    told = document(capsys, "filter", path, "--robot", name, "-o", output, "--track", "eax_a=-y")
    assert told["left"] == []
    for at, value, (pose, _) in zip(q, rail, rapid_back(output.read_text()), strict=True):
        assert off_mm("irb120", at, shift(*(value * along)), pose) < WITHIN_MM


def test_an_axis_in_metres_and_one_that_moves_no_frame(
    kilter: Kilter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name, q = robot(kilter, "kr6-r900", tmp_path), taught("kr6-r900", 4, seed=43)
    rail = np.array([1.5, -0.25, 0.0, 3.0])
    frames = [f"${which}={{{six(T)}}}" for which, T in (("BASE", BASE), ("TOOL", TOOL))]
    moves = []
    for at, value in zip(q, rail, strict=True):
        pose = np.linalg.inv(BASE) @ shift(1000 * value, 0, 0) @ Arm("kr6-r900").flange(at) @ TOOL
        moves.append(f"PTP {{{six(pose)},{status_turn(at)},E1 {value:.6f},E2 33.5}}")
    path, output = tmp_path / "w.src", tmp_path / "out.src"
    path.write_text("\n".join(["DEF w()", *frames, *moves, "END", ""]))
    tracks = ["--track", "E1=x,1000", "--track", "E2=none"]
    told = document(capsys, "filter", path, "--robot", name, "-o", output, *tracks)
    assert told["left"] == []
    for at, value, (pose, _) in zip(q, rail, krl_back(output.read_text()), strict=True):
        assert off_mm("kr6-r900", at, shift(1000 * value, 0, 0), pose) < WITHIN_MM
    assert run(["filter", str(path), "--robot", name, "--diff", "--track", "E1=along"]) == 2
    assert "--track E1=along: give a direction" in capsys.readouterr().err


def six(T: Floats) -> str:
    return ",".join(f"{n} {v:.9f}" for n, v in zip("XYZABC", zyx(T), strict=True))


def test_a_rail_that_stands_still_needs_no_statement(
    kilter: Kilter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its reading is some um from zero, as a controller stores it: then the correction is the same to the last digit shown."""
    name, q = robot(kilter, "irb120", tmp_path), taught("irb120", 3, seed=47)
    path, output = tmp_path / "w.mod", tmp_path / "out.mod"
    rail = np.full(3, -0.0064)
    path.write_text(rapid(q, rail, np.array([0.0, 1.0, 0.0])))
    assert document(capsys, "filter", path, "--robot", name, "-o", output)["left"] == []
    assert len(re.findall(r"\[-0\.006400,9E9", output.read_text())) == 3
    for at, (pose, _) in zip(q, rapid_back(output.read_text()), strict=True):
        assert off_mm("irb120", at, shift(0, -0.0064, 0), pose) < 1e-4
