"""What programs of cells have beside plain moves to plain targets: nothing of it may change a number in silence.

A line begins with what it is, as in ``test_program_uses``: ``J`` and ``P`` hold joints or a pose that are rewritten, ``L`` is
named, ``.`` is copied in silence. Poses here have no configuration, or one; which joints they mean is asked elsewhere.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from kilter_files.formats.programs.found import Stated
from kilter_files.formats.programs.one_target import JointTarget
from kilter_files.formats.programs.reading import read_program, read_programs
from kilter_files.ground.errors import FileError

from .test_program_uses import AXES, POSE, SIX, WHOLE, known

HOME = "A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0"
FREE = "X 600.0,Y 0.0,Z 400.0,A 0.0,B 90.0,C 0.0"
TOOL = "$TOOL={X 0,Y 0,Z 100,A 0,B 0,C 0}"
NULL = "X 0,Y 0,Z 0,A 0,B 0,C 0"
KRL = f"""
.|DEF A( )
.|DECL E6AXIS STEP, P1
.|DECL FRAME F1={{{NULL}}}
.|DECL FRAME F2, F3[2]
.|DECL FDAT FP1={{TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}}
L|STEP={{A1 5,A2 0,A3 0,A4 0,A5 0,A6 0}}
L|PTP_REL STEP
L|LIM={{A1 170,A2 0,A3 0,A4 0,A5 0,A6 0}}
.|IF $AXIS_ACT.A1>LIM.A1 THEN
.|ENDIF
L|DECL CELL S1={{HOME {{{HOME}}},NUM 3}}
L|PTP S1.HOME
L|GO({{{HOME}}})
J|XH={{{HOME}}}
.|PTP XH
.|SUM=XH.A1+XH.A2
.|F2={{X 0,Y 0,Z 50,A 0,B 0,C 0}}
.|F3[1]={{X 0,Y 0,Z 50,A 0,B 0,C 0}}
.|{TOOL}
.|$BASE=F1
L|LIN {{{SIX}}}
.|$BASE=F2
P|LIN {{{SIX}}}
.|$BASE=F3[1]
P|LIN {{{SIX}}}
.|F1.Z=F1.Z+5
.|$BASE={{{NULL}}}:F2
L|LIN {{{SIX}}}
.|BASE_DATA[4]={{{NULL}}}:F2
.|BAS(#BASE,4)
L|LIN {{{SIX}}}
.|BASE_DATA[5]={{{NULL}}}
.|BAS (#BASE , 5)
P|LIN {{{SIX}}}
.|FDAT_ACT={{TOOL_NO 1,BASE_NO 5,IPO_FRAME #BASE}}
L|LIN {{{SIX}}}
.|TOOL_DATA[1]={{X 0,Y 0,Z 100,A 0,B 0,C 0}}
.|FDAT_ACT = FP1
L|LIN {{{SIX}}}
.|{TOOL}
.|$BASE={{{NULL}}}
P|ptp {{{SIX}}} c_ptp
.|FDAT_ACT.BASE_NO=3
L|LIN {{{SIX}}}
.|{TOOL}
.|$BASE=$ROBROOT
L|LIN {{{SIX}}}
.|$BASE=$WORLD
P|LIN {{{SIX}}}
.|XQ={{{NULL}}} : F2
L|LIN XQ
.|SHIFT()
L|LIN {{{SIX}}}
.|$BASE={{{NULL}}}
P|LIN {{{SIX}}}
.|THROUGH()
L|LIN {{{SIX}}}
.|END
.|DEF SHIFT( )
.|$BASE=BASE_DATA[7]
.|END
.|DEF THROUGH( )
.|SHIFT()
.|END
"""
URSCRIPT = """
.|def prog():
.|  set_tcp(p[0,0,0.1,0,0,0])
.|  def inner():
.|    set_tcp(p[0,0,0.2,0,0,0])
.|  end
.|  def outer():
.|    inner()
.|  end
.|  set_tcp(p[0,0,0.1,0,0,0])
J|  movej  ([0.1, -1.5, 1.5, -1.5, -1.5, 0])
P|  movel  (p[.433, -.467, .522, 1.5, .5, .5])
P|  movej(get_inverse_kin(p[.43, -.46, .52, 1.5, .5, .5], [0.1, -1.5, 1.5, -1.5, -1.5, 0]))
L|  movej(get_inverse_kin(p[.43, -.46, .52, 1.5, .5, .5], qnear=q_of_another_file))
P|  movej(get_inverse_kin(p[.43, -.46, .52, 1.5, .5, .5], qnear=get_actual_joint_positions()))
L|  movej(get_inverse_kin(p[.43, -.46, .52, 1.5, .5, .5], [0.1, -1.5, 1.5, -1.5, -1.5, 0], 1e-10, 1e-10, p[0,0,0.3,0,0,0]))
L|  movej(get_inverse_kin(p[.43, -.46, .52, 1.5, .5, .5], tcp=p[0,0,0.3,0,0,0]))
P|  movej(get_inverse_kin(p[.43, -.46, .52, 1.5, .5, .5], tcp="active_tcp"))
.|  feature = p[0.1,0.2,0.3,0,0,0]
P|  movej(get_inverse_kin(pose_trans(feature, p[.3, -.2, .1, 1, 0, 0]), qnear=[0.1, -1.5, 1.5, -1.5, -1.5, 0]))
L|  movec(p[.43, -.46, .52, 1.5, .5, .5], p[.43, -.47, .52, 1.5, .5, .5], a=1.2, v=0.25, r=0, mode=1)
P|  movec(p[.43, -.46, .52, 1.5, .5, .5], p[.43, -.47, .52, 1.5, .5, .5], a=1.2, v=0.25, r=0, mode=0)
.|  outer()
L|  movel(p[.433, -.467, .522, 1.5, .5, .5])
.|end
"""
FANUC = f"""
.|/PROG  A
.|/MN
.|   1:  UFRAME_NUM=0 ;
L|   2:J P[1] 100% FINE Offset,PR[2]    ;
.|   3:J P[2] 100% FINE    ;
L|   4:J P[2] 100% FINE Tool_Offset,PR[2]    ;
L|   5:  PR[3]=P[3]    ;
L|   6:  PR[4]=P[4]    ;
.|   7:  Touch Offset PR[1] ;
L|   8:L P[5] 100mm/sec FINE    ;
.|   9:  Touch Offset End ;
.|  10:L P[6] 100mm/sec FINE    ;
.|/POS
L|P[1]{{ GP1: UF : 0, UT : 0, J1= 5.0 deg, J2= 0.0 deg, J3= 0.0 deg, J4= 0.0 deg, J5= -90.0 deg, J6= 0.0 deg }};
J|P[2]{{ GP1: UF : 0, UT : 0, J1= 5.0 deg, J2= 0.0 deg, J3= 0.0 deg, J4= 0.0 deg, J5= -90.0 deg, J6= 0.0 deg }};
L|P[3]{{ GP1: UF : 0, UT : 0, J1= 5.0 deg, J2= 0.0 deg, J3= 0.0 deg, J4= 0.0 deg, J5= -90.0 deg, J6= 0.0 deg }};
L|P[4]{{ GP1: UF : 0, UT : 0, {POSE} }};
L|P[5]{{ GP1: UF : 0, UT : 0, {POSE} }};
P|P[6]{{ GP1: UF : 0, UT : 0, {POSE} }};
.|/END
"""
FANUC_BY_NUMBER = f"""
.|/PROG  A
.|/MN
.|   1:J P[1] 100% FINE    ;
L|   2:J P[R[1]] 100% FINE Offset,PR[2]    ;
.|/POS
P|P[1]{{ GP1: UF : 0, UT : 0, {POSE} }};
L|P[2]{{ GP1: UF : 0, UT : 0, {POSE} }};
.|/END
"""
RAPID = f"""
.|MODULE M
.|  PERS tooldata t1:=[TRUE,[[0,0,100],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
.|  PERS tooldata t2:=[TRUE,[[0,0,100],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
.|  PERS wobjdata seen:=[FALSE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
.|  PERS wobjdata fixed:=[FALSE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
.|  CONST num i:=20;
L|  CONST robtarget p1:={WHOLE};
L|  CONST jointtarget jAround:=[[2,2,2,2,2,2],{AXES}];
L|  CONST jointtarget jStep:=[[5,0,0,0,0,0],{AXES}];
J|  CONST jointtarget jHome:=[[0,0,0,0,90,0],{AXES}];
L|  CONST jointtarget jTrack:=[[0,0,0,0,0,0],[500,9E9,9E9,9E9,9E9,9E9]];
L|  CONST jointtarget jOnly:=[[9E9,9E9,9E9,9E9,9E9,9E9],[500,9E9,9E9,9E9,9E9,9E9]];
.|  PROC main(\\PERS wobjdata WObj)
L|    WZHomeJointDef\\Inside,space,jHome,jAround;
.|    MoveAbsJ jHome\\NoEOffs,v100,fine,t1;
L|    MoveExtJ jTrack,vrot10,fine;
L|    MoveExtJ jOnly,vrot10,fine;
.|    here.robax.rax_1:=here.robax.rax_1+jStep.robax.rax_1;
P|    MoveL {WHOLE},v100,fine,t1\\WObj:=fixed;
L|    MoveL {WHOLE},v100,fine,t1\\WObj?WObj;
L|    MoveL {WHOLE},v100,fine,t1\\WObj:=many{{2}};
L|    MoveL {WHOLE},v100,fine,tools{{2}}\\WObj:=fixed;
.|    CamGetResult seen;
L|    MoveL {WHOLE},v100,fine,t1\\WObj:=seen;
.|    follow t1;
.|    measure t2;
L|    MoveL {WHOLE},v100,fine,t2;
.|    FOR i FROM 1 TO 3 DO
L|      MoveL Offs(p1,0,0,i),v100,fine,t1;
.|    ENDFOR
.|  ENDPROC
.|  PROC follow(PERS tooldata t)
L|    MoveL elsewhere,v100,fine,t;
.|  ENDPROC
.|  PROC measure(PERS tooldata tool)
.|    tool.tframe.trans.z:=tool.tframe.trans.z+1;
.|  ENDPROC
.|ENDMODULE
"""
PROGRAMS = {"a.src": KRL, "a.script": URSCRIPT, "a.ls": FANUC, "b.ls": FANUC_BY_NUMBER, "a.mod": RAPID}
STATED = Stated({"2": (0.0,) * 6})


@pytest.mark.parametrize("name", [*PROGRAMS])
def test_no_construct_changes_a_number_that_is_not_surely_a_target(tmp_path: Path, name: str) -> None:
    lines = [line.partition("|")[::2] for line in PROGRAMS[name].strip().split("\n")]
    (tmp_path / name).write_text("\n".join(text for _, text in lines) + "\n")
    program = read_programs(tmp_path / name)[0]
    assert [(known(program, k), text) for k, (_, text) in enumerate(lines, 1)] == lines


COMES_FROM = {
    "a.src": f"""DEF A( )
{TOOL}
$BASE={{{NULL}}}
P1={{{HOME}}}
PTP P1
LIN {{{FREE}}} ; 4
P1={{A1 9,A2 -90,A3 90,A4 0,A5 0,A6 0}}
PTP P1
BAS(#VEL_PTP,50)
LIN {{{FREE}}} ; 7
LOOP
LIN {{{FREE}}} ; -
PTP P1
GRIP(1)
LIN {{{FREE}}} ; -
P2={{{HOME}}}
IF $IN[1] THEN
P2={{A1 9,A2 -90,A3 90,A4 0,A5 0,A6 0}}
ENDIF
PTP P2
LIN {{{FREE}}} ; -
P3={{{HOME}}}
P3.A1=45
PTP P3
LIN {{{FREE}}} ; -
ENDLOOP
END
""",
    "a.script": """def a():
  set_tcp(p[0,0,0.1,0,0,0])
  q = [0.1, -1.5, 1.5, -1.5, -1.5, 0]
  movej(q)
  movel(p[.433, -.467, .522, 1.5, .5, .5]) # 3
  q = [0.2, -1.5, 1.5, -1.5, -1.5, 0]
  movej(q)
  sleep(0.5)
  movel(p[.433, -.467, .522, 1.5, .5, .5]) # 6
  while True:
    movel(p[.433, -.467, .522, 1.5, .5, .5]) # -
    movej(q)
    gripper_of_another_file(40)
    movel(p[.433, -.467, .522, 1.5, .5, .5]) # -
    w = [0.1, -1.5, 1.5, -1.5, -1.5, 0]
    if get_digital_in(1):
      w = [0.2, -1.5, 1.5, -1.5, -1.5, 0]
    end
    movej(w)
    movel(p[.433, -.467, .522, 1.5, .5, .5]) # -
    v = [0.1, -1.5, 1.5, -1.5, -1.5, 0]
    v[0] = 1.5
    movej(v)
    movel(p[.433, -.467, .522, 1.5, .5, .5]) # -
    movej([0.1, -1.5, 1.5, -1.5, -1.5, 0])
    freedrive_mode()
    movel(p[.433, -.467, .522, 1.5, .5, .5]) # -
  end
end
""",
}


@pytest.mark.parametrize("name", [*COMES_FROM])
def test_a_pose_follows_the_joints_that_are_surely_those_before_it(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(COMES_FROM[name])
    program = read_program(tmp_path / name)
    wanted = {}
    for number, line in enumerate(COMES_FROM[name].splitlines(), 1):
        said = line.rpartition(" ; " if name == "a.src" else " # ")
        wanted |= {number: said[2]} if said[1] else {}
    found = {}
    for pose in program.cartesian:
        near = pose.uses[0].near
        found[pose.line] = str(near.line) if isinstance(near, JointTarget) else "-"
    assert found == wanted


def test_no_target_is_left_alone_that_the_program_displaces(tmp_path: Path) -> None:
    lines = ["set_tcp(p[0,0,0,0,0,0])", "path_offset_enable()", "movej([0.1,-1.5,1.5,0,0,0])", "movel(p[.4,.1,.3,0,3,0])"]
    text = "\n  ".join(["def a():", *lines]) + "\nend\n"
    (tmp_path / "a.script").write_text(text)
    program = read_program(tmp_path / "a.script")
    assert [line for line, _ in program.left] == [5]


def test_frames_that_the_program_does_not_keep_are_stated(tmp_path: Path) -> None:
    moves = f"$TOOL={{{NULL}}}\n$BASE=$ROBROOT\nLIN {{{SIX}}}\n"
    (tmp_path / "a.src").write_text(moves)
    with pytest.raises(FileError, match=r"state it, --base '\$ROBROOT=X,Y,Z,A,B,C'"):
        read_program(tmp_path / "a.src")
    program = read_program(tmp_path / "a.src", Stated({"$ROBROOT": (0.0, 0.0, 500.0, 0.0, 0.0, 0.0)}))
    assert [one.frames()[0][0].numbers[2] for one in program.cartesian] == [500.0]


def test_a_table_of_a_spreadsheet_is_read_with_its_mark_of_utf_8(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(b"\xef\xbb\xbfq1_deg,q2_deg\r\n1.0,2.0\r\n")
    program = read_program(tmp_path / "a.csv")
    assert program.rewritten([[1.5, 2.0]]).encode("latin-1") == b"\xef\xbb\xbfq1_deg,q2_deg\r\n1.500000,2.0\r\n"
    (tmp_path / "a.csv").write_text("q1_deg;q2_deg\n1,0;2,0\n")
    with pytest.raises(FileError, match="semicolons"):
        read_program(tmp_path / "a.csv")
