"""Why a target is left, in the words of its own move, and one remedy for each reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from kilter_files.formats.programs.reading import read_program, read_programs, remedies, remedy_for_reason
from kilter_files.ground.errors import FileError

NO_AXES = "[9E9,9E9,9E9,9E9,9E9,9E9]"
WHOLE = f"[[600,0,400],[0,0,1,0],[0,0,0,0],{NO_AXES}]"
RAPID = f"""MODULE m
CONST robtarget p1:={WHOLE};
CONST robtarget p2:={WHOLE};
CONST robtarget p3:={WHOLE};
CONST robtarget p4:={WHOLE};
CONST robtarget p5:={WHOLE};
CONST robtarget p6:={WHOLE};
PROC main()
SearchL \\Stop,di1,pf,p1,v50,tool0;
MoveC p2,Offs(p6,0,0,reg1),v50,z10,tool0;
MoveL p3,v50,z10;
weld p4;
MoveL p6,v50,z10,tool0;
ENDPROC
ENDMODULE
"""


def test_a_target_whose_move_is_left_says_which_move_and_why(tmp_path: Path) -> None:
    (tmp_path / "m.mod").write_text(RAPID)
    left = dict(read_program(tmp_path / "m.mod").left)
    assert left[2] == "p1, a pose: SearchL does not surely end at it (line 9)"
    assert left[3] == "p2, a pose: MoveC goes to a target too that is not known (line 10)"
    assert left[4] == "p3, a pose: MoveL lacks arguments (line 11)"
    assert left[5] == "p4, a pose: weld is given it, and may move to it in other frames"
    assert left[6] == "p5, a pose: no move of the program goes to it, so its frames are not known"
    assert 7 not in left


def test_a_program_without_its_dat_says_that_this_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "weld.src"
    path.write_text("DEF weld( )\nSPTP XP1 WITH $TOOL=STOOL2(FP1), $BASE=SBASE(FP1.BASE_NO)\nSLIN XP2\nEND\n")
    with pytest.raises(FileError, match=r"weld.dat is not beside it") as refused:
        read_programs(path)
    assert refused.value.detail.endswith("Copy the .dat beside the .src, and filter them together.")


@pytest.mark.parametrize("ending", [".mod", ".modx", ".sys", ".sysx", ".prg"])
def test_endings_of_rapid_modules(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"m{ending}"
    path.write_bytes(f"\ufeff{RAPID}".replace("weld p4;", "! Schweißnaht — Größe").encode())  # of RobotWare 7: UTF-8
    program = read_program(path)
    assert len(program.cartesian) == 6
    assert program.rewritten([]).encode("latin-1") == path.read_bytes()


def test_urscript_has_two_endings(tmp_path: Path) -> None:
    path = tmp_path / "m.urscript"
    path.write_text("def p():\n  movej([0, -1.5, 1.5, -1.5, -1.5, 0])\nend\n")
    assert len(read_program(path).targets) == 1


def test_each_reason_has_one_remedy() -> None:
    assert remedies(["p1, a pose: it is out of reach", "p2, a pose: it is out of reach"]) == [
        remedy_for_reason("out of reach")
    ]
    assert remedy_for_reason("tool t1 is not in this program: state it, --tool t1=x,y,z,q1,q2,q3,q4") == ""
    assert remedy_for_reason("MoveJ p1: no target of this file").startswith("Filter the file that declares")
    assert remedy_for_reason("LIN XP1: not a target of this file or of its .dat").startswith(
        "Filter the file that declares"
    )
    assert remedy_for_reason("MoveL Offs(p1,0,0,reg1): no target of this file") == "Write the target with numbers."
    assert remedy_for_reason("servoj([0,0: no target of this file") == ""
    several = remedies(["it is declared several times", "LIN_REL {X 5}: a relative move"])
    assert several == ["Give each target a name of its own.", "Move to a target that is written out."]
