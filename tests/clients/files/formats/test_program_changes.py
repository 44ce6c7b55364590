"""What changes a target, its frame or its orientation in ways that are easily overlooked: such is left and named."""

from __future__ import annotations

from pathlib import Path

import pytest

from kilter_files.formats.programs.found import Stated
from kilter_files.formats.programs.reading import read_program, read_programs

NULL = (0.0,) * 6
STATED = Stated({"1": NULL, "2": NULL}, {"1": NULL})
POSE = "[[100,0,300],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
TOOL = "PERS tooldata grip:=[TRUE,[[0,0,120],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];"
BENCH = 'PERS wobjdata bench:=[FALSE,TRUE,"",[[500,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];'
JOINTS = "PERS jointtarget jOk:=[[0,0,0,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]];"
KRL_POSE = "{X 120,Y 0,Z 300,A 30,B 90,C 0,S 2,T 2}"
PLACE = "\tX = 500.000 mm,\tY = 0.000 mm,\tZ = 300.000 mm,\n\tW = 180.000 deg,\tP = 0.000 deg,\tR = 0.000 deg"
AXES = "J1 = 0.000 deg, J2 = 0.000 deg, J3 = 0.000 deg, J4 = 0.000 deg, J5 = 30.000 deg, J6 = 0.000 deg"


def left(path: Path, text: str, beside: str = "") -> dict[int, str]:
    """The lines of a program that are left, and why; with its .dat, where it has one."""
    path.write_text(text)
    if beside:
        path.with_suffix(".dat").write_text(beside)
    programs = read_programs(path, STATED)
    found = next(one for one in programs if one.path == path).left
    return {line: " / ".join(what for at, what in found if at == line) for line, _ in found}


def rapid(*statements: str) -> str:
    head = [
        "MODULE w",
        TOOL,
        BENCH,
        f"PERS robtarget p10:={POSE};",
        f"PERS robtarget p20:={POSE};",
        JOINTS,
        "PROC main()",
    ]
    moves = [f"MoveL p{k}0,v100,fine,grip\\WObj:=bench;" for k in (1, 2)]
    own = ["PROC fix(INOUT pos t)", "t.z:=5;", "ENDPROC", "PROC tell(pos t)", "TPWrite ValToStr(t);", "ENDPROC"]
    return "\n".join([*head, *statements, "MoveAbsJ jOk,v100,fine,tool0;", *moves, "ENDPROC", *own, "ENDMODULE", ""])


@pytest.mark.parametrize(
    "statement",
    [
        "Add p10.trans.z, 50;", "IF di1=1 Add p10.trans.z, 50;", "IF di1=1 THEN Incr p10.trans.x; ENDIF",
        "Decr p10 . trans.x;", "fix p10.trans;", "elsewhere p10.trans, 5;", "Clear p10.trans.y;",
    ],
)  # fmt: skip
def test_rapid_gives_a_part_of_a_target_to_what_may_change_it(tmp_path: Path, statement: str) -> None:
    found = left(tmp_path / "w.mod", rapid(statement))
    assert found == {4: "p10, a pose: the program changes it", 10: "MoveL p10: a pose that is left"}


@pytest.mark.parametrize(
    "statement",
    [
        "ok:=StrToVal(part,p10.trans.x);", "ok:=StrToVal(part, p10);", "IF StrToVal(part, p10 . trans.x) Stop;",
        "ok:=elsewhere(p10, 5);", "ok:=sight(p10);", "IF NOT sight(p10) THEN Stop; ENDIF",
    ],
)  # fmt: skip
def test_rapid_gives_a_target_to_a_function_that_may_change_it(tmp_path: Path, statement: str) -> None:
    own = "FUNC bool sight(INOUT robtarget t)\nt.trans.x:=5;\nRETURN TRUE;\nENDFUNC\nENDMODULE"
    found = left(tmp_path / "w.mod", rapid(statement).replace("ENDMODULE", own))
    assert found[4] == "p10, a pose: the program changes it"
    assert found[10] == "MoveL p10: a pose that is left"
    found = left(
        tmp_path / "w.mod", rapid(statement).replace("ENDMODULE", own).replace("PERS robtarget", "CONST robtarget")
    )
    assert 4 not in found


@pytest.mark.parametrize(
    "statement",
    ["here:=Offs(p10,0,0,5);", "d:=Distance(p10.trans,p20.trans);", "j:=CalcJointT(p10,grip);", "ok:=seen(p10);"],
)
def test_rapid_functions_that_only_reckon_leave_their_target(tmp_path: Path, statement: str) -> None:
    own = "FUNC bool seen(robtarget t)\nRETURN TRUE;\nENDFUNC\nENDMODULE"
    assert left(tmp_path / "w.mod", rapid(statement).replace("ENDMODULE", own)) == {}


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ('RET=EKI_GetReal("ch","Pos/X",P1.X)', "EKI_GetReal"), ('SREAD(STR[],STATE,OFFSET,"%f",P1 .Y)', "SREAD"),
        ("CREAD(HANDLE,STATE,MODE,TOTAL,OFFSET,FORM[],P1.A)", "CREAD"),
    ],
)  # fmt: skip
def test_krl_gives_a_part_of_a_pose_to_what_may_change_it(tmp_path: Path, statement: str, said: str) -> None:
    lines = ["DEF w()", "$BASE=$WORLD", "$TOOL=TOOL_DATA[1]", f"P1={KRL_POSE}", statement, "LIN P1"]
    lines += ["PTP {A1 0,A2 -90,A3 90,A4 0,A5 45,A6 0}", "END", ""]
    found = left(tmp_path / "w.src", "\n".join(lines))
    assert found[4] == f"P1, a pose: {said} may change it"
    assert found[5].endswith(f": {said} is given a part of a target")
    assert found.keys() == {4, 5, 6}
    kept = "\n".join(lines).replace(statement, "H=SQRT(P1.X*P1.X)+ABS(P1.Y)")
    assert left(tmp_path / "w.src", kept) == {}
    whole = "\n".join(lines).replace(statement, 'SREAD(STR[],STATE,OFFSET,"%r",P1)')
    assert "SREAD is given a target" in left(tmp_path / "w.src", whole)[5]


@pytest.mark.parametrize(
    "statement",
    [
        "Add reg1, p10.trans.z;", "IF p10.trans.z > 5 Stop;", "tell p10.trans;", 'TPWrite "z"\\Num:=p10.trans.z;',
        "reg1 := p10.trans.z;", "reg1 := Distance(p10.trans, p20.trans);", "SetAO ao1, p10.trans.z;",
        "WaitUntil reg1 > p10.trans.z;",
    ],
)  # fmt: skip
def test_rapid_only_reads_a_part_of_a_target(tmp_path: Path, statement: str) -> None:
    assert left(tmp_path / "w.mod", rapid(statement)) == {}


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("Add bench.oframe.trans.z, 10;", "the program changes work object bench"),
        ("Add grip.tframe.trans.z, 10;", "the program changes tool grip"),
    ],
)
def test_rapid_changes_a_part_of_a_frame(tmp_path: Path, statement: str, said: str) -> None:
    found = left(tmp_path / "w.mod", rapid(statement))
    assert [found[4], found[5]] == [f"p10, a pose: {said}", f"p20, a pose: {said}"]


def test_rapid_changes_a_part_of_joints(tmp_path: Path) -> None:
    assert left(tmp_path / "w.mod", rapid("Incr jOk.robax.rax_1;")) == {8: "jOk: the program changes this jointtarget"}


KEPT = "its orientation is not kept ($ORI_TYPE)"


@pytest.mark.parametrize(
    ("lines", "which"),
    [
        (("$ORI_TYPE=#CONSTANT", f"LIN {KRL_POSE}", f"PTP {KRL_POSE}", "$ORI_TYPE = #VAR", f"LIN {KRL_POSE}"), [5]),
        (("SPLINE", f"SPL {KRL_POSE} WITH $ORI_TYPE=#IGNORE", f"SPL {KRL_POSE}", "ENDSPLINE"), [5]),
        (("SPLINE WITH $ORI_TYPE=#CONSTANT", f"SPL {KRL_POSE}", "ENDSPLINE", f"SLIN {KRL_POSE}"), [5]),
        (("IF $IN[1] THEN", "$ORI_TYPE=#CONSTANT", "ENDIF", f"LIN {KRL_POSE}", f"PTP {KRL_POSE}"), [7]),
        (("LDAT_ACT=LCPDAT1", f"LIN {KRL_POSE}", "LDAT_ACT=LCPDAT2", f"LIN {KRL_POSE}"), [5]),
        (("LDAT_ACT={VEL 2.0,ORI_TYP #JOINT}", f"LIN {KRL_POSE}"), []),
    ],
)
def test_krl_moves_that_keep_another_orientation(tmp_path: Path, lines: tuple[str, ...], which: list[int]) -> None:
    frames = [f"${name}={{X 0,Y 0,Z 100,A 0,B 0,C 0}}" for name in ("BASE", "TOOL")]
    text = "\n".join(["DEF w()", *frames, *lines, "PTP {A1 0,A2 -90,A3 90,A4 0,A5 30,A6 0}", "END", ""])
    data = [f"DECL LDAT LCPDAT{k}={{VEL 2.0,ORI_TYP #{kind}}}" for k, kind in ((1, "CONSTANT"), (2, "VAR"))]
    dat = "\n".join(["DEFDAT w", *data, "DECL E6AXIS XP9={A1 0,A2 -90,A3 90,A4 0,A5 30,A6 0}", "ENDDAT", ""])
    assert left(tmp_path / "w.src", text, dat) == dict.fromkeys(which, f"a move, a pose: {KEPT}")


def fanuc(*lines: str, head: str = "") -> str:
    moves = [f"{k:4}:{line} ;" for k, line in enumerate([*lines, "L P[1] 100mm/sec FINE", "J P[2] 20% FINE"], 1)]
    pose = f"P[1]{{\n   GP1:\n\tUF : 2, UT : 1,\tCONFIG : 'N U T, 0, 0, 0',\n{PLACE}\n}};"
    joints = f"P[2]{{\n   GP1:\n\tUF : 2, UT : 1,\n\t{AXES}\n}};"
    return "\n".join(["/PROG W", *head.splitlines(), "/MN", *moves, "/POS", pose, joints, "/END", ""])


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("  $MNUFRAME[1,2]=PR[5]", "the program sets UFRAME"),
        ("  $MNUTOOL[1,1]=PR[5]", "the program sets UTOOL"),
        ("  UFRAME[2]=PR[5] ;\n  1:  UFRAME[2]=PR[6]", "the program sets UFRAME"),
        ("  $GROUP[1].$UFRAME=PR[5]", "the program sets UFRAME"),
        ("  $MNUTOOL[1,1].$Z=5", "the program sets UTOOL"),
    ],
)
def test_fanuc_sets_a_frame(tmp_path: Path, statement: str, said: str) -> None:
    found = left(tmp_path / "w.ls", fanuc(statement))
    more = statement.count("\n")
    assert found.keys() == {4 + more, 7 + more}
    assert found[7 + more].startswith(f"P[1], a pose: {said}: set it once, by a register")


FILLED = [f"  PR[9,{k}]={value} " for k, value in enumerate(("10.5", "(-20)", "130.000", "0", ".5", "-17.189"), 1)]


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (("  R[1]=5", *FILLED, "  UFRAME[2]=PR[9]", "  UFRAME_NUM=2"), ""),
        ((*FILLED, "  UFRAME[2:bench]=PR[9:by numbers]"), ""),
        ((*FILLED[:5], "  UFRAME[2]=PR[9]"), "by numbers it does not hold: state it, --base 2="),
        ((*FILLED, "  PR[9]=LPOS", "  UFRAME[2]=PR[9]"), "by numbers it does not hold"),
        ((*FILLED, "  PR[9,6]=PR[9,6]+5", "  UFRAME[2]=PR[9]"), "by numbers it does not hold"),
        ((*FILLED, "  PR[R[1],6]=5", "  UFRAME[2]=PR[9]"), "by numbers it does not hold"),
        (("  IF R[1]=1,JMP LBL[2]", *FILLED, "  UFRAME[2]=PR[9]"), "set it once"),
        (("J P[2] 20% FINE", *FILLED, "  UFRAME[2]=PR[9]"), "set it once"),
        ((*FILLED, "  UFRAME[2]=PR[9]", "  UFRAME[R[3]]=PR[9]"), "set it once"),
        ((*FILLED, "  UFRAME[7]=PR[9]"), "UF : 2 is not in this program"),
    ],
)
def test_fanuc_fills_a_register_and_sets_a_frame_by_it(tmp_path: Path, lines: tuple[str, ...], said: str) -> None:
    path = tmp_path / "w.ls"
    path.write_text(fanuc(*lines))
    program = read_program(path, Stated({}, {"1": (0.0, 0, 100, 0, 0, 0)}))
    (pose,) = program.cartesian
    assert said in pose.reason_left_unresolved()
    if not said:
        bases, _ = pose.frames()
        assert bases[0].numbers == (10.5, -20.0, 130.0, 0.0, 0.5, -17.189)


@pytest.mark.parametrize("move", ["J PAL_3[A_1] 100% FINE", "L PAL_1[BTM] 100mm/sec FINE"])
def test_fanuc_moves_to_positions_of_a_pallet_are_named(tmp_path: Path, move: str) -> None:
    assert left(tmp_path / "w.ls", fanuc("  PALLETIZING-B_3", move)) == {4: f"{move}: no position of this file"}


@pytest.mark.parametrize(("number", "tracks"), [(0, False), (1, True)])
def test_fanuc_poses_that_track_a_conveyor(tmp_path: Path, number: int, tracks: bool) -> None:
    head = f"/APPL\n  LINE_TRACK;\nLINE_TRACK_SCHEDULE_NUMBER      : {number};\nCONTINUE_TRACK_AT_PROG_END : FALSE;"
    found = left(tmp_path / "w.ls", fanuc(head=head))
    why = "it moves with what the program tracks (LINE_TRACK)"
    assert found == ({7: "L P[1]: a pose that is left", 10: f"P[1], a pose: {why}"} if tracks else {})


@pytest.mark.parametrize(
    ("lines", "named"),
    [
        (("movej([0,0,0,0,0.5,0] + [0,0,0,0,0,0.1], a=1)",), {3: "movej([0,0,0,0,0.5,0]: its joints are computed"}),
        (("movel(p[0.4,0,0.3,0,3,0] + p[0,0,0.1,0,0,0])",), {3: "movel(p[: no target of this file"}),
        (("P1 = p[0.4,0,0.3,0,3,0] + p[0,0,0.1,0,0,0]", "movel(P1)"), {4: "movel(P1: no target of this file"}),
        (("movej( [0,0,0,0,0.5,0] , a=1)", "movej(\n[0,0,0,0,0.5,0]\n)"), {}),
        (("P1 = p[0.4,0,0.3,0,3,0]  # above the bench", "movel(P1)"), {}),
    ],
)
def test_urscript_adds_to_a_target(tmp_path: Path, lines: tuple[str, ...], named: dict[int, str]) -> None:
    text = "\n".join(["def w():", "set_tcp(p[0,0,0.1,0,0,0])", *lines, "movej([0,0,0,0,0.5,0])", "end", ""])
    assert left(tmp_path / "w.script", text) == named


@pytest.mark.parametrize(
    "statement",
    [
        'RET=EKI_GetFrame("ch","Part",PART)', 'RET=EKI_GetReal("ch","Part/X",PART.X)', 'SREAD(STR[],S,O,"%r",PART)',
        'RET=EKI_GetReal("ch","Part/X",BASE_DATA[2].X)', 'RET=EKI_GetFrame("ch","Part",BASE_DATA[2])',
    ],
)  # fmt: skip
def test_krl_gives_a_frame_to_what_may_change_it(tmp_path: Path, statement: str) -> None:
    frame = "BASE_DATA[2]" if "BASE_DATA" in statement else "PART"
    lines = [
        "DEF w()", "DECL FRAME PART", "$TOOL=TOOL_DATA[1]", f"{frame}={{X 1,Y 0,Z 0,A 0,B 0,C 0}}", statement,
        f"$BASE={frame}", f"LIN {KRL_POSE}", "PTP {A1 0,A2 -90,A3 90,A4 0,A5 45,A6 0}", "END", "",
    ]  # fmt: skip
    found = left(tmp_path / "w.src", "\n".join(lines))
    assert f"the program changes {frame}" in found[7]
    assert left(tmp_path / "w.src", "\n".join(lines).replace(statement, "H=SQRT(PART.X*PART.X)")) == {}
