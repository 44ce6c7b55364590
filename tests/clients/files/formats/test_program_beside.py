"""Where the arm does not go to what is written: sensors, external axes that stay where they were, arcs, values of the system.

Lines begin with what they are, as in ``test_program_uses``.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from kilter_files.formats.programs.found import EXTERNAL_AXES, Stated
from kilter_files.formats.programs.poses.postures import StatusTurn
from kilter_files.formats.programs.reading import read_program, read_programs
from kilter_files.ground.errors import FileError
from tests.clients.files.formats.test_program_uses import WHOLE, known

SIX, AT = "A1 0,A2 -90,A3 90,A4 0,A5 45,A6 0", "X 500,Y 0,Z 500,A 0,B 90,C 0"
FRAMES = "\n".join([f".|$BASE={{{AT}}}", f".|$TOOL={{{AT}}}"])
SENSED = f"""
.|MODULE M
.|  PERS tooldata t1:=[TRUE,[[0,0,100],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
P|  CONST robtarget p10:={WHOLE};
L|  CONST robtarget p20:={WHOLE};
L|  CONST robtarget p30:={WHOLE};
.|  PROC main()
.|    MoveL p10,v100,fine,t1;
L|    MoveL p10,v100,fine,t1 \\Corr;
L|    MoveC p10,p20,v100,fine,t1\\WObj:=wobj0\\Corr;
L|    ArcL p30,v100,seam1,weld1,z1,t1\\Track:=track1;
L|    MoveL Offs(p10,0,0,5),v100,fine,t1\\corr;
P|    IF reg1>5 MoveL Offs(p10,0,0,5),v100,fine,t1;
P|    IF (reg1>5) MoveJ\\Conc,{WHOLE},v100,fine,t1;
L|    IndAMove STN1,1\\ToAbsNum:=30,20;
L|    EGMRunJoint egm1,EGM_STOP_HOLD\\J1\\J2;
.|    SingArea\\Wrist;
.|  ENDPROC
.|ENDMODULE
"""
LOCKED = SENSED.replace("\\Wrist", "\\LockAxis4").replace(
    f"P|    IF (reg1>5) MoveJ\\Conc,{WHOLE}", f"P|    MoveJ {WHOLE}"
)
LOCKED = (
    LOCKED.replace("P|  CONST", "L|  CONST")
    .replace(".|    MoveL p10", "L|    MoveL p10")
    .replace("P|    IF", "L|    IF")
)
KEPT_AXIS = f"""
.|DEF a()
{FRAMES}
J|PTP {{{SIX},E1 100}}
P|LIN {{{AT},S 2,T 2,E1 0}}
L|LIN {{{AT},S 2,T 2,E1 100}}
L|LIN {{{AT},S 2,T 2}}
L|LIN {{{AT},S 2,T 2,E2 0}}
J|PTP {{{SIX}}}C_PTP
.|END
"""
STANDING_AXIS = KEPT_AXIS.replace("E1 100", "E1 0.0").replace("L|", "P|")
MOVED_AXIS = f"""
.|DEF a()
{FRAMES}
L|LIN {{{AT},S 2,T 2,E1 0}}
P|LIN {{{AT},S 2,T 2,E2 0}}
L|ASYPTP {{E2 5}}
.|END
"""
STATUS = f"""
.|DEF a()
{FRAMES}
P|LIN {{{AT},S 6,T 2}}
L|LIN {{{AT},S 22,T 2}}
L|LIN {{{AT},S 'B 10010',T 2}}
L|LIN {{{AT},S 8,T 2}}
L|LIN {{{AT},S 18}}
.|END
"""
ARCS = f"""
.|DEF a()
{FRAMES}
J|PTP {{{SIX}}}
P|CIRC {{{AT}}},{{{AT}}},CA 360 C_DIS
P|LIN {{{AT}}}
P|SCIRC {{{AT}}},{{{AT}}},CA 95.5 WITH $VEL.CP=0.1
.|END
"""
SYSTEM = f"""
.|DEF a()
{FRAMES}
L|$AXIS_HOME[1]={{{SIX}}}
L|$H_AXIS_TOL={{A1 2,A2 2,A3 2,A4 2,A5 2,A6 2}}
L|$AXIS_HOME[I] = {{{SIX}}}
J|HOME2={{{SIX}}}
.|DECL LOAD L1={{M 2.5,CM {{X 0,Y 0,Z 60,A 0,B 0,C 0}},J {{X 0.1,Y 0.1,Z 0.1}}}}
P|LIN {{{AT},S 2,T 2}}
L|IF RSI_ON(#RELATIVE)<>RSIOK THEN
.|ENDIF
L|RSI_MOVECORR()
.|END
"""
WRAPPED = """
.|/PROG W
.|/MN
L|   1:L P[1:over the tray] 2000mm/sec CNT100
.|    :  Offset,PR[12:shift]    ;
L|   2:C P[2]
L|    :  P[3] 500mm/sec FINE
.|    :  Tool_Offset,PR[1]    ;
.|   3:J P[3] 100% FINE ;
.|   4:  Track TAST[1] ;
L|   5:L P[4] 20cm/min CNT100 ;
.|   6:  Track End ;
.|   7:J P[5] 100% FINE ;
.|   8:  MP Offset PR[60] RPM[1] ;
L|   9:J P[5] 100% FINE ;
.|  10:  MP Offset End ;
.|/POS
{positions}
.|/END
"""
JOINTS = ", ".join(f"J{k} = {10.0 * k} deg" for k in range(1, 7))
WRAPPED = WRAPPED.format(
    positions="\n".join(
        f"{kind}|P[{k}]{{ GP1: {JOINTS}{', E1 = 5.0 mm' if k == 5 else ''} }};" for k, kind in enumerate("LLJLJ", 1)
    )
)
TOOLS = """
.|def a():
.|  tool = p[0,0,0.1,0,0,0]
.|  set_tcp(tool)
J|  movej([0,-1.57,1.57,-1.57,-1.57,0])
{0}|  movel(p[0.4,0.1,0.3,0,3.14,0])
{1}
.|  set_tcp(tool)
.|end
"""
PROGRAMS = {
    "sensed.mod": SENSED, "locked.mod": LOCKED, "kept.src": KEPT_AXIS, "standing.src": STANDING_AXIS,
    "moved.src": MOVED_AXIS, "status.src": STATUS, "arcs.src": ARCS, "system.src": SYSTEM, "wrapped.ls": WRAPPED,
    "kept.script": TOOLS.format("P", ".|"), "changed.script": TOOLS.format("L", ".|  tool[2] = 0.2"),
    "table.csv": "L|q1_deg,q2_deg,qd1_deg_s,x_mm,q7_mm,speed_mm_s,note\nJ|1,2,3,4,5,6,x_mm",
}  # fmt: skip


@pytest.mark.parametrize("name", [*PROGRAMS])
def test_what_does_not_go_to_its_target_is_named(tmp_path: Path, name: str) -> None:
    lines = [line.partition("|")[::2] for line in PROGRAMS[name].strip().split("\n")]
    (tmp_path / name).write_text("\n".join(text for _, text in lines) + "\n")
    program = read_programs(tmp_path / name, Stated())[0]
    assert [(known(program, k), text) for k, (_, text) in enumerate(lines, 1)] == lines


@pytest.mark.parametrize(
    ("name", "line", "said"),
    [
        ("sensed.mod", 4, r"the moves to it add what a sensor says \(\\Corr, \\Track\)"),
        ("locked.mod", 3, r"its orientation is not kept \(SingArea \\LockAxis4\)"),
        ("kept.src", 7, "it does not state E1, which the program moves"),
        ("status.src", 5, "absolute accuracy taught it: it would be corrected twice"),
        ("status.src", 7, "its S is 8, which has bits that are not understood"),
        ("system.src", 4, "a variable of the system, no target"),
        ("wrapped.ls", 3, "moves beside it"),
        ("changed.script", 5, "the program changes tool"),
        ("table.csv", 1, r"qd1_deg_s, x_mm, q7_mm: poses or joints in other columns than q1, q2, \.\.\."),
    ],
)
def test_the_reason_is_said(tmp_path: Path, name: str, line: int, said: str) -> None:
    (tmp_path / name).write_text("".join(f"{one.partition('|')[2]}\n" for one in PROGRAMS[name].strip().split("\n")))
    told = dict(read_program(tmp_path / name).left)[line]
    assert re.search(said, told), told


def test_what_is_to_be_known_of_the_whole_program_is_said_once(tmp_path: Path) -> None:
    warned = {
        "kept.src": [EXTERNAL_AXES],
        "standing.src": [],
        "wrapped.ls": [EXTERNAL_AXES],
        "arcs.src": ["arcs with CA end beside their targets: there the path is the controller's own"],
    }
    for name, said in warned.items():
        (tmp_path / name).write_text(
            "".join(f"{one.partition('|')[2]}\n" for one in PROGRAMS[name].strip().split("\n"))
        )
        assert read_program(tmp_path / name).warnings == said
    text = "def a():\n  movej([0,0,0,0,0,0])\n  track_conveyor_linear(p[1,0,0,0,0,0], 500.0)\nend\n"
    (tmp_path / "a.script").write_text(text)
    assert "displaces moves to joints too" in read_program(tmp_path / "a.script").warnings[0]


def test_after_an_arc_that_ends_by_its_angle_nobody_knows_where_the_arm_stands(tmp_path: Path) -> None:
    arc, then = f"CIRC {{{AT}}},{{{AT}}},CA ", f"LIN {{{AT}}}"
    for angle, known_before in (("90", False), ("ANGLE", False), ("-720.0", True)):
        frames = "\n".join(one[2:] for one in FRAMES.split("\n"))
        (tmp_path / "a.src").write_text(f"DEF a()\n{frames}\nPTP {{{SIX}}}\n{arc}{angle}\n{then}\nEND\n")
        use = read_program(tmp_path / "a.src").cartesian[-1].uses[0]
        assert (use.near is not None) == known_before


@pytest.mark.parametrize(("said", "wanted"), [("66", "65"), ("'B 1000010'", "'B 1000001'")])
def test_the_bits_of_further_axes_stay(said: str, wanted: str) -> None:
    stated = StatusTurn(2, 0b1000010, said, (0, len(said)))
    assert dict(stated.edits_for_joints([-5.0, 5.0, 5.0, 5.0, 5.0, 5.0])) == {(0, len(said)): wanted}


def test_a_table_whose_joint_stands_in_it_twice_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("q1_deg,q2_deg,q1_deg\n1,2,3\n")
    with pytest.raises(FileError, match="has the column q1_deg twice"):
        read_program(tmp_path / "a.csv")
