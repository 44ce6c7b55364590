"""Programs whose joint targets are rewritten: every byte accounted for, damaged ones refused with their line."""

from __future__ import annotations

import math
import random
from pathlib import Path

import pytest

from kilter_files.formats.programs.reading import read_program, read_programs, targets_in_visit_order
from kilter_files.ground.errors import FileError

OTHER = {
    ".dat": ["; A1 5, {A1 1,A2 2}", "DECL INT N=3", "  $VEL.CP=0.5 ", "DECL FDAT F1={TOOL_NO 1,BASE_NO 2}"],
    ".mod": [
        "! jointtarget x := [[1,2,3,4,5,6],[0,0,0,0,0,0]];",
        "  VAR num n := 3;",
        'TPWrite "MoveAbsJ [[1";',
        "WaitTime 0.5;",
    ],
    ".script": ["# movej([0,0,0,0,0,0])", "  sleep(0.5)", "set_digital_out(1, True)", "v = [1, 2, 3]"],
    ".ls": ["   9:  !P moves ;", "  10:  WAIT   .50(sec) ;", "  11:  DO[1]=ON ;"],
}
ENDS = {".dat": "ENDDAT", ".mod": "ENDMODULE", ".script": "end", ".ls": "/END"}
HEADS = {".dat": "DEFDAT w", ".mod": "MODULE w", ".script": "def w():", ".ls": "/PROG W"}


def target(ending: str, k: int, q: list[str]) -> str:
    if ending == ".dat":
        return f"DECL E6AXIS XP{k}={{" + ",".join(f"A{i} {v}" for i, v in enumerate(q, 1)) + ",E1 7.5}"
    if ending == ".mod":
        return f"  CONST jointtarget p{k} := [[{', '.join(q)}],[9E9,9E9,9E9,9E9,9E9,9E9]];"
    if ending == ".script":
        return f"  movej([{', '.join(q)}], a=1.4, v=0.5)"
    return f"P[{k}]{{ GP1: UF : 0, UT : 1, " + ", ".join(f"J{i}= {v} deg" for i, v in enumerate(q, 1)) + "};"


def generated(rng: random.Random, ending: str) -> tuple[str, list[list[str]], list[tuple[int, ...]]]:
    lines, rows, where = [HEADS[ending]], [], []
    newline = rng.choice(["\n", "\r\n"])
    for k in range(1, rng.randint(3, 9)):
        lines += rng.sample(OTHER[ending], rng.randint(0, 3))
        reach = 3.0 if ending == ".script" else 170.0
        rows.append([f"{rng.uniform(-reach, reach):.{rng.randint(1, 6)}f}" for _ in range(6)])
        where.append((len(lines),))
        lines.append(target(ending, k, rows[-1]))
    return newline.join([*lines, ENDS[ending], ""]), rows, where


@pytest.mark.parametrize("ending", [*OTHER])
def test_only_the_numbers_of_targets_change(tmp_path: Path, ending: str) -> None:
    rng = random.Random(ending)
    path = tmp_path / f"w{ending}"
    for _ in range(50):
        text, rows, where = generated(rng, ending)
        path.write_bytes(text.encode())
        program = read_program(path)
        assert not program.left
        in_deg = math.degrees if ending == ".script" else float
        assert [[*t.joints_deg] for t in program.targets] == [[in_deg(float(v)) for v in q] for q in rows]
        assert program.rewritten([t.joints_deg for t in program.targets]) == text
        moved = [[v + rng.uniform(0.01, 1) for v in t.joints_deg] for t in program.targets]
        new = program.rewritten(moved)
        before, after = text.split("\n"), new.split("\n")
        assert len(before) == len(after)
        changed = [k for k, (old, now) in enumerate(zip(before, after, strict=True)) if old != now]
        assert changed == [k for (k,) in where]
        path.write_bytes(new.encode())
        again = read_program(path)
        tolerance = 5.1e-4 if ending == ".ls" else 6e-7
        for t, q in zip(again.targets, moved, strict=True):
            assert max(abs(a - b) for a, b in zip(t.joints_deg, q, strict=True)) < tolerance
        assert again.rewritten([t.joints_deg for t in program.targets]).count("\n") == text.count("\n")


def test_a_table_keeps_its_other_columns(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(b"name,q1_deg,t_s,q2_deg\r\na, 1.0 ,0,2\r\n\r\nb,3,1,4.25\r\n")
    program = read_program(path)
    assert [t.line for t in program.targets] == [2, 4]
    wanted = "name,q1_deg,t_s,q2_deg\r\na, 1.500000 ,0,2\r\n\r\nb,3,1,4.500000\r\n"
    assert program.rewritten([[1.5, 2.0], [3.0, 4.5]]) == wanted


@pytest.mark.parametrize(
    ("name", "text", "lines"),
    [
        ("a.src", "PTP {A1 1,A2 2}\nLIN {X 1,Y 2,Z 3}\nPTP XP9\nPTP_REL {A1 5}\n", [2, 3, 4]),
        ("a.mod", "MoveAbsJ [[1,2,3,4,5,6],[0,0,0,0,0,0]],v1,z1,t;\nMoveL Offs(p,0,0,1),v,z,t;\nMoveAbsJ q,v1,z1,t;", [2, 3]),
        ("a.script", "movej([1,2,3,0,0,0])\nmovel(p[0,0,0,0,0,0])\nmovej(x)\nservoj([1,2,3,0,0,0])\n", [2, 3, 4]),
        ("a.ls", "1:J P[1] 9% FINE;\n2:L PR[3] 9mm/sec FINE;\nP[1]{J1= 1 deg,J2= 2 deg};\nP[2]{X= 1 mm};\n", [2, 4]),
    ],
)  # fmt: skip
def test_what_is_left_is_named_with_its_line(tmp_path: Path, name: str, text: str, lines: list[int]) -> None:
    (tmp_path / name).write_text(text)
    program = read_program(tmp_path / name)
    assert [t.line for t in program.targets] == [3 if name == "a.ls" else 1]
    assert sorted({line for line, _ in program.left}) == lines


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.txt", "x", "no known dialect"),
        ("a.dat", "DEFDAT a\nDECL E6AXIS P={A1 1,A2 2}\n", "line 3: ends without ENDDAT"),
        ("a.dat", "\nDECL E6AXIS P={A1 1,A2 2", "line 2: P is not A1"),
        ("a.dat", "DECL E6AXIS P={A1 nan,A2 2}\n", "line 1: P is not A1"),
        ("a.mod", "CONST jointtarget p := [[1,2,3,4,5],[0,0,0,0,0,0]];", "line 1: p is not made of six"),
        ("a.mod", "MODULE a\n", "ends without ENDMODULE"),
        (
            "a.script",
            "\nmovej([0, nan, 0, 0, 0, 0])\n",
            "Line 2: movej goes to '[0, nan, 0, 0, 0, 0]', no list of numbers",
        ),
        ("a.ls", "P[1]{J1= nan deg};\n", "line 1: P[1] is not J1"),
        ("a.ls", "/PROG A\n", "ends without /END"),
        ("a.csv", "q1_deg,q2_deg\n1,nan\n", "line 2: q2 is empty or not a number"),
        ("a.csv", "x,y\n1,2\n", "lacks joints"),
        ("a.csv", "q1_deg,q2_deg\n1,2\n1\n", "line 3: q2 is empty"),
        (
            "a.src",
            "\nLIN {X 1,Y 2,Z 3}\n",
            "holds no targets to rewrite. Line 2: a move, a pose: without A, B, C.",
        ),
    ],
)
def test_bad_input_is_refused_with_its_place(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(FileError) as caught:
        read_program(tmp_path / name)
    assert said in caught.value.detail


def pair(folder: Path, moving: list[str], declaring: list[str]) -> Path:
    (folder / "w.dat").write_text("\n".join(["DEFDAT W", *declaring, "ENDDAT", ""]))
    (folder / "w.src").write_text("\n".join(["DEF w()", *moving, "END", ""]))
    return folder / "w.src"


DECLARED = [f"DECL E6AXIS XP{k}={{A1 {k}.0,A2 2.5,E1 0.0}}" for k in (1, 2, 3)]


def test_targets_of_two_files_come_as_the_program_moves_to_them(tmp_path: Path) -> None:
    path = pair(tmp_path, ["PTP XP3", "PTP {A1 9,A2 9}", "PTP XP1", "PTP XP3 C_PTP"], DECLARED)
    for given in (path, path.with_suffix(".dat")):
        programs = read_programs(given)
        assert programs[0].path == given
        assert [program.left for program in programs] == [[], []]
        order = [(program.path.suffix, target.joints_deg[0]) for program, target in targets_in_visit_order(programs)]
        assert order == [(".dat", 3), (".src", 9), (".dat", 1), (".dat", 2)]


KEPT_LINES = [
    "&ACCESS RVP", ";FOLD PTP P1 CONT Vel=100 % PDAT1", "DECL INT n", "INT i", "GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS DO IR()",
    "INTERRUPT ON 3", "BAS (#VEL_PTP,100)", "FDAT_ACT=FPOINT1", "$VEL.CP=0.2", "$TOOL=TOOL_DATA[1]", "XP1.E1=5.0",
    "IF XP1.A1 == 3 THEN", "ENDIF", "FOR i=1 TO 5", "again:", "GOTO again", "gripper(TRUE)", "n = n + 1",
    "SPLINE WITH $VEL.CP=0.2", "SPL XP1", "TIME_BLOCK START", "ENDSPLINE", "PTP_SPLINE", "$H_POS=XP1", "IF (XP1.A1>3) THEN",
    "TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[1]=TRUE", "WAIT SEC 0.5", "XP3={A1 7.0,A2 7.0,E1 0.0}",
]  # fmt: skip
NAMED_LINES = [
    "XP1.A1=XP1.A1+5", "xp2 = $AXIS_ACT", "XP2=XP1", "PTP XP9", "PTP_REL {A1 5}", "PTP_REL{A1 5,A2 1}",
    "LIN {X 1,Y 2,Z 3}",
    "PTP {A1 5}", "PTP {A1 Q1,A2 2}", "XP2={A2 5}", "PTP XP1 : {X 1}", "LIN XP1:XP2", "MOVE_TO(XP1)", "ok=MOVE_TO(3,XP2)",
    "ASYPTP {E1 5}", "@@@", "IF $IN[1] THEN PTP XP1", "PTP XP[i]", "TRIGGER WHEN PATH=0 DELAY=0 DO PTP XP1",
]  # fmt: skip


def test_each_line_of_two_files_is_rewritten_kept_or_named(tmp_path: Path) -> None:
    rng = random.Random(5)
    for _ in range(40):
        named = rng.sample(NAMED_LINES, 4)
        moving = [*named, *rng.sample(KEPT_LINES, 8), "PTP XP1", "PTP {A1 9,A2 9}", "PTP{A2 8,A1 8}"]
        rng.shuffle(moving)
        moves, declares = read_programs(pair(tmp_path, moving, DECLARED))
        assert {moving[line - 2] for line, _ in moves.left} == set(named)
        assert declares.left == []
        rewritten = [line for line in moving if line.startswith(("PTP {A1 9", "PTP{A2", "XP3={A1"))]
        assert sorted(moving[target.line - 2] for target in moves.targets) == sorted(rewritten)


MOVED = "Line 2 of w.src: PTP XP1: a pose that is left."


@pytest.mark.parametrize(
    ("moving", "declaring", "said"),
    [
        (["PTP XP1"], ["DECL E6AXIS XP1={A1 1,A2 x}"], "w.dat, line 2: XP1 is not A1"),
        (["PTP {A1 1,A2 2,A3 3}"], ["DECL E6AXIS XP1={A1 1,A2 2}"], "w.dat, line 2: XP1 has 2 joints, the first target 3"),
        (["PTP XP1"], ["DECL E6POS XP1={X 1,Y 2,Z 3}"], f"{MOVED} Line 2 of w.dat: XP1, a pose: without A, B, C."),
        (["PTP XP1"], ["ENDDAT", "DEFDAT other"], None),
    ],
)  # fmt: skip
def test_damage_in_either_file_is_named(tmp_path: Path, moving: list[str], declaring: list[str], said: str) -> None:
    path = pair(tmp_path, moving, declaring)
    if said is None:
        path.with_suffix(".dat").write_text("\nDEFDAT OTHER\nENDDAT\n")
        said = "w.dat, line 2: DEFDAT OTHER is not of the program beside it (w.src)"
    with pytest.raises(FileError) as caught:
        read_programs(path)
    assert said in caught.value.detail


def test_two_files_that_may_belong_to_it_are_refused(tmp_path: Path) -> None:
    path = pair(tmp_path, ["PTP XP1"], DECLARED)
    (tmp_path / "W.DAT").write_text("DEFDAT w\nENDDAT\n")
    if len([*tmp_path.glob("*")]) == 2:
        pytest.skip("this file system does not tell capitals from small letters")
    with pytest.raises(FileError, match=r"W\.DAT and w\.dat stand beside it"):
        read_programs(path)


CONF, NO_AXES, PLACE = "[0,0,0,0]", "[9E9,9E9,9E9,9E9,9E9,9E9]", "[600,0,400],[0,0,1,0]"
WHOLE = f"[{PLACE},{CONF},{NO_AXES}]"
RAPID_POSES = f"""MODULE a
CONST robtarget p1 := {WHOLE};
CONST robtarget p2 := [{PLACE},{CONF},[9E9,5,9E9,9E9,9E9,9E9]];
VAR robtarget p3 := {WHOLE};
CONST robtarget p4{{2}} := [{WHOLE},{WHOLE}];
CONST robtarget p5 := [[1,2,3],[1,1,0,0],{CONF},{NO_AXES}];
CONST robtarget p6 := {WHOLE};
PERS tooldata t1 := [TRUE,[[0,0,100],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
PERS tooldata t2 := [FALSE,[[0,0,100],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
MoveJ\\Conc, p1, v100, z10, t1;
MoveL p2, v100, z10, tool0;
MoveL p3, v100, z10, t1;
p3 := CRobT();
MoveL p4{{1}}, v100, z10, t1;
MoveL p4{{i}}, v100, z10, t1;
MoveL Offs(p1,0,0,50), v100, z10, t1;
MoveL p6, v100, z10, t2;
MoveL p1, v100, z10, tX\\WObj:=wobj0;
TriggL p5, v100, trg, z10, t1;
MoveL {WHOLE}, v100\\V:=3, fine, t1\\WObj:=wobj0;
ENDMODULE
"""
FANUC_POSE = "CONFIG : 'N U T, 0, 0, 0', Y = 0.0 mm, Z = 400.0 mm, W = 180.0 deg, P = 0.0 deg, R = 0.0 deg"
FANUC_POSES = f"""/PROG A
1:J P[1] 100% FINE    ;
2:L P[2] 100mm/sec FINE Offset,PR[1]    ;
3:C P[3]
 :  P[4] 100mm/sec FINE    ;
4:L PR[2] 100mm/sec FINE;
P[1:"home"]{{ GP1: UF : 0, UT : 0, {FANUC_POSE}, X = 600.0 mm }};
P[2]{{ GP1: UF : 0, UT : 0, {FANUC_POSE}, X = 600.0 mm }};
P[3]{{ GP1: UF : 0, UT : 1, {FANUC_POSE}, X = 600.0 mm }};
P[4]{{ GP1: UF : 0, UT : 0, {FANUC_POSE}, X = ********* mm }};
P[5]{{ GP1: UF : 0, UT : 0, {FANUC_POSE}, X = 600.0 mm, E1 = 10.0 mm }};
/END
"""
UR_POSES = """def a():
  p1 = p[0.5,0,0.4,0,3.14,0]
  p2 = p[0.5,0.1,0.4,0,3.14,0]
  p3 = p[0.5,0.1,0.4,0,3.14,0]
  q0 = [0,-1.5,1.5,-1.5,-1.5,0]
  movel(p1, a=1)
  set_tcp(p[0,0,0.1,0,0,0])
  movej(q0)
  movec(p[0.5,0.05,0.45,0,3.14,0], p2, a=1.2)
  movel(pose_trans(p1, p[0,0,0.1,0,0,0]))
  movel(p3)
  p3[2] = 5
end
"""


@pytest.mark.parametrize(
    ("name", "text", "left", "taken"),
    [
        ("a.mod", RAPID_POSES, {
            2: "tool tX is not in this program", 3: "an external axis", 4: "the program changes it",
            6: "not a unit quaternion", 7: "tool t2 stands still", 10: "left", 11: "left", 12: "left",
            17: "left", 18: "left", 19: "left",
        }, [5, 5, 16, 20]),
        ("a.ls", FANUC_POSES, {
            3: "moves beside it", 4: "left", 5: "left", 6: "no position of this file", 8: "have an offset",
            9: "UT : 1 is not in this program", 10: "not taught", 11: "an external axis",
        }, [7]),
        ("a.script", UR_POSES, {
            2: "no set_tcp is before it", 4: "the program changes it", 6: "left", 10: "its frame p1 is a target itself",
            11: "left",
        }, [3, 9]),
    ],
)  # fmt: skip
def test_poses_of_which_too_little_is_known_are_named_with_their_reason(
    tmp_path: Path, name: str, text: str, left: dict[int, str], taken: list[int]
) -> None:
    (tmp_path / name).write_text(text)
    program = read_program(tmp_path / name)
    told: dict[int, str] = {}
    for line, what in program.left:
        told[line] = f"{told.get(line, '')} {what}"
    assert told.keys() == left.keys()
    for line, said in left.items():
        assert said in told[line]
    assert sorted(pose.line for pose in program.cartesian if not pose.reason_left_unresolved()) == taken


SIX = "X {},Y 0,Z 0,A 0,B 0,C 0"
MOVE = f"LIN {{{SIX.format(500)},S 2,T 2}}"
SPLINE = f"S{MOVE}"
ONE, TWO = (f"$TOOL={{{SIX.format(k)}}}" for k in (1, 2))


@pytest.mark.parametrize(
    ("lines", "tools"),
    [
        ([ONE, MOVE, TWO, MOVE], [1, 2]),
        ([MOVE, ONE], [None]),
        ([ONE, "IF $IN[1] THEN", MOVE, "ENDIF", MOVE], [1, 1]),
        ([ONE, "IF $IN[1] THEN", TWO, MOVE, "ENDIF", MOVE], [2, "way"]),
        ([ONE, "IF $IN[1] THEN", ONE, "ENDIF", MOVE], [1]),
        ([ONE, "LOOP", MOVE, TWO, "ENDLOOP"], ["way"]),
        ([ONE, "GOTO far", TWO, "far:", MOVE], ["way"]),
        (["BAS(#TOOL,3)", MOVE, "BAS(#TOOL,0)", MOVE], [3, 0]),
        (["FDAT_ACT=FP1", "BAS(#PTP_PARAMS,100)", MOVE, "FDAT_ACT=FP2", MOVE], [3, "stands still"]),
        (["$TOOL=TOOL_DATA[3]", MOVE, "$TOOL=other", MOVE], [3, "is not known"]),
        ([ONE, "END", "DEF other()", MOVE], [None]),
        ([f"{ONE}:{{Z 9}}", MOVE], ["is not known"]),
        ([ONE, "$TOOL.Z = 5", MOVE], ["the program changes $TOOL"]),
        ([ONE, "BAS(#INITMOV,0)", MOVE, TWO, MOVE], ["INITMOV", 2]),
        (["$TOOL=TOOL_DATA[3]", MOVE, "TOOL_DATA[3].Z=7"], ["the program changes TOOL_DATA[3]"]),
        (["$TOOL=TOOL_DATA[3]", "TOOL_DATA[n]=other", MOVE, "TOOL_DATA[3] = {X 3}"], ["the program changes TOOL_DATA[3]"]),
        ([ONE, f"{SPLINE} WITH $VEL.CP=0.2, $TOOL=STOOL2(FP1),$BASE= SBASE(FP1.BASE_NO)", MOVE], [3, 1]),
        ([ONE, f"{SPLINE} WITH $TOOL=STOOL2(FX)", f"{SPLINE} WITH $TOOL=tool_of(1, 2)"], ["FX is not in", "is not known"]),
        (["SPLINE WITH $TOOL=TOOL_DATA[3]", SPLINE, "ENDSPLINE", ONE, MOVE], [3, 1]),
    ],
)  # fmt: skip
def test_the_tool_of_a_move_is_the_one_that_is_surely_set(
    tmp_path: Path, lines: list[str], tools: list[int | str | None]
) -> None:
    declared = [
        f"TOOL_DATA[3]={{{SIX.format(3)}}}",
        "DECL FDAT FP1={TOOL_NO 3,BASE_NO 0,IPO_FRAME #BASE}",
        "DECL FDAT FP2={TOOL_NO 3,BASE_NO 0,IPO_FRAME #TCP}",
    ]
    base = f"$BASE={{{SIX.format(0)}}}"
    path = pair(tmp_path, [base, *lines, "PTP {A1 1,A2 2}"], declared)
    found: list[int | str | None] = []
    for pose in read_programs(path)[0].cartesian:
        tool = pose.uses[0].tool
        said = [w for w in tools if isinstance(w, str) and isinstance(tool, str) and w in tool]
        found.append((said or [None])[0] if isinstance(tool, str) else int(tool.numbers[0]))
    assert found == tools


A, B = (f"set_tcp(p[{k},0,0.1,0,0,0])" for k in (1, 2))
AT, TO = "movej([0,-1.5,1.5,-1.5,-1.5,0])", "movel(p[0.5,0,0.4,0,3.14,0])"


@pytest.mark.parametrize(
    ("lines", "tool", "from_joints"),
    [
        ([A, AT, TO], 1, True),
        (['set_tcp(p[1,0,0.1,0,0,0], "grip")', AT, TO], 1, True),
        ([A, "set_tcp(pose_trans(flange, p[0,0,0.1,0,0,0]))", AT, TO], "is not known", True),
        ([A, "def go():", "while x:", AT, "end", "end", AT, TO], 1, True),
        (["def go():", A, AT, "end", AT, TO], "no set_tcp is before it", True),
        ([A, "def go():", B, AT, "end", "go()", AT, TO], "go() sets the tool", True),
        ([A, "def go():", AT, "end", AT, "go()", TO], 1, False),
        ([A, AT, "def go():", AT, "end", TO], 1, False),
    ],
)
def test_tool_and_last_target_of_a_program_with_subprograms(
    tmp_path: Path, lines: list[str], tool: int | str, from_joints: bool
) -> None:
    (tmp_path / "a.script").write_text("\n".join(["def a():", *lines, "end", ""]))
    use = read_program(tmp_path / "a.script").cartesian[-1].uses[0]
    if isinstance(tool, str):
        assert isinstance(use.tool, str)
        assert tool in use.tool
    else:
        assert not isinstance(use.tool, str)
        assert use.tool.numbers[0] == tool
    assert (use.near is not None) == from_joints


@pytest.mark.parametrize(
    ("between", "known"), [("", True), ("BAS(#VEL_PTP,50)", True), ("grip(1)", False), ("away( )", False)]
)
def test_a_subprogram_may_move_the_arm(tmp_path: Path, between: str, known: bool) -> None:
    lines = [
        "DEF a()",
        "PTP {A1 1,A2 2}",
        between,
        f"LIN {{{SIX.format(500)}}}",
        "END",
        "DEF away()",
        "PTP {A1 9,A2 2}",
        "END",
    ]
    (tmp_path / "a.src").write_text("\n".join(lines))
    program = read_program(tmp_path / "a.src")
    assert (program.cartesian[0].uses[0].near is not None) == known
