"""Targets that hold no numbers, and moves beside their targets: each is named, and the others are rewritten."""

from __future__ import annotations

from pathlib import Path

import pytest

from kilter_files.formats.programs.marks import read_targets
from kilter_files.formats.programs.reading import read_program, targets_in_visit_order
from kilter_files.ground.errors import FileError

STARS = "********"
PLACES = f"X = {STARS} mm, Y = {STARS} mm, Z = {STARS} mm, W = {STARS} deg, P = {STARS} deg, R = {STARS} deg"
JOINTS = ", ".join(f"J{k}= {STARS} deg" for k in range(1, 7))
TAUGHT = ", ".join(f"J{k}= {10 + k} deg" for k in range(1, 7))
SIX = "A1 10,A2 -80,A3 95,A4 20,A5 60,A6 -30"
Q = "[0.1, -1.2, 1.3, -0.4, 1.5, 0.6]"


@pytest.mark.parametrize("said", [f"CONFIG : '', {PLACES}", JOINTS, f"J1= 10 deg, {JOINTS[20:]}"])
def test_a_position_of_fanuc_that_nobody_taught_is_left(tmp_path: Path, said: str) -> None:
    path = tmp_path / "w.ls"
    positions = [f"P[1]{{ GP1: UF : 0, UT : 1, {TAUGHT}}};", f"P[2]{{ GP1: UF : 0, UT : 1, {said}}};"]
    path.write_text("\n".join(["/PROG W", "/MN", "  1:J P[1] 50% FINE ;", "/POS", *positions, "/END", ""]))
    program = read_program(path)
    assert [one.name for one in program.targets] == ["P[1]"]
    assert program.left == [(6, f"P[2], a pose: it is not taught ({STARS})")]
    assert len(targets_in_visit_order([program])) == 2
    with pytest.raises(FileError, match=r"P\[2\] is not taught"):
        read_targets(path)


@pytest.mark.parametrize("move", ["LIN {X a,Y b,Z c,A d,B e,C f}", "PTP {X px,Y 20,Z 300,A 0,B 90,C 0}"])
def test_a_pose_of_variables_in_krl_is_left(tmp_path: Path, move: str) -> None:
    path = tmp_path / "w.src"
    path.write_text(f"DEF w( )\nPTP {{{SIX}}}\n{move}\nEND\n")
    program = read_program(path)
    assert len(program.targets) == 1
    assert [line for line, _ in program.left] == [3]
    assert len(targets_in_visit_order([program])) == 2


FORCE = "  force_mode(p[0,0,0,0,0,0],[0,0,1,0,0,0],[0,0,10,0,0,0],2,[0.1,0.1,0.1,0.1,0.1,0.1])"


def moves_by_force(tmp_path: Path, *lines: str) -> list[int]:
    path = tmp_path / "w.script"
    tool = "  set_tcp(p[0, 0, 0.1, 0, 0, 0])"
    path.write_text("\n".join(["def w():", tool, f"  movej({Q})", *lines, "end", ""]))
    return sorted({line for line, what in read_program(path).left if "force_mode" in what})


def test_moves_under_force_are_left(tmp_path: Path) -> None:
    pose = "  movel(p[0.2, -0.6, 0.3, 0, 3.1, 0])"
    end = "  end_force_mode()"
    assert moves_by_force(tmp_path, FORCE, pose, end, pose) == [5]
    assert moves_by_force(tmp_path, FORCE, f"  movej({Q})", end) == [5]
    own = ["  def touch():", pose, "  end"]
    with pytest.raises(
        FileError, match="force_mode moves the arm beside it"
    ):  # never ended: it goes on in the next round
        moves_by_force(tmp_path, FORCE, pose)
    with pytest.raises(FileError, match=r"Line 5: .*force_mode moves the arm beside it"):
        moves_by_force(tmp_path, *own, FORCE, "  touch()", end)
    assert moves_by_force(tmp_path, "  force_mode_set_damping(0.5)", pose) == []


def test_a_pose_to_which_one_move_goes_without_force_is_rewritten(tmp_path: Path) -> None:
    path = tmp_path / "w.script"
    lines = ["  set_tcp(p[0, 0, 0.1, 0, 0, 0])", "  A=p[0.2, -0.6, 0.3, 0, 3.1, 0]", f"  movej({Q})", "  movel(A)"]
    path.write_text("\n".join(["def w():", *lines, FORCE, "  movel(A)", "  end_force_mode()", "end", ""]))
    program = read_program(path)
    assert program.left == [(7, "movel(A: force_mode moves the arm beside it")]
    assert program.cartesian[0].reason_left_unresolved() == ""


RAPID = """MODULE w
  CONST jointtarget j1 := [[0, 10, 20, 30, 40, 50],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PROC main()
    MoveAbsJ j1, v100, fine, tool0;
  ENDPROC
ENDMODULE
"""


@pytest.mark.parametrize("ending", [".mod", ".modx", ".sysx", ".prg", ".MODX"])
def test_modules_of_rapid_have_several_endings(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"w{ending}"
    path.write_text("! Prüfung\n" + RAPID, encoding="utf-8")
    program = read_program(path)
    assert program.rewritten([program.targets[0].joints_deg]).encode("latin-1") == path.read_bytes()


def test_programs_of_urscript_may_end_in_its_name(tmp_path: Path) -> None:
    path = tmp_path / "w.urscript"
    path.write_text(f"def w():\n  movej({Q})\nend\n")
    assert len(read_program(path).targets) == 1


def test_a_dat_that_is_not_there_is_named(tmp_path: Path) -> None:
    path = tmp_path / "weld.src"
    path.write_text("DEF weld( )\nSPTP XP1 WITH $VEL_AXIS[1] = 50\nSLIN XP2\nEND\n")
    with pytest.raises(FileError, match=r"Line 2: .*weld\.dat is not beside it") as refused:
        read_program(path)
    assert "state their frames" not in str(refused.value)
