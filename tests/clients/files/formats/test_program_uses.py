"""What people write in programs beside moves to targets: each line is rewritten, named, or known to leave targets alone.

A line begins with what it is: ``J`` and ``P`` hold joints or a pose that are rewritten, ``L`` is named, ``B`` both, ``.`` is
copied in silence.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from kilter_files.formats.programs.found import Program
from kilter_files.formats.programs.marks import read_targets
from kilter_files.formats.programs.reading import read_programs
from kilter_files.ground.errors import FileError

AXES = "[9E9,9E9,9E9,9E9,9E9,9E9]"
WHOLE = f"[[600,0,400],[0,0,1,0],[0,0,0,0],{AXES}]"
RAPID = f"""
.|MODULE M
.|  PERS tooldata t1:=[TRUE,[[0,0,100],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
.|  PERS tooldata t2:=[TRUE,[[0,0,100],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
L|  CONST robtarget p10:={WHOLE};
P|  CONST robtarget p20:={WHOLE};
.|  CONST robtarget p90:={WHOLE};
.|  CONST robtarget p{{2,2}}:=[[
P|    {WHOLE},
L|    {WHOLE}],[
.|    {WHOLE},
L|    {WHOLE}]];
.|  CONST num up:=20;
J|  CONST jointtarget j6{{count}}:=[[[0,0,0,0,90,0],{AXES}],[[0,0,0,0,90,0],{AXES}]];
.|  VAR num far:=20;
J|  CONST jointtarget j5{{1,2}}:=[[[[0,0,0,0,90,0],{AXES}],[[0,0,0,0,90,0],{AXES}]]];
L|  VAR robtarget p30:={WHOLE};
L|  PERS robtarget p40:={WHOLE};
P|  PERS robtarget p50:={WHOLE};
L|  PERS robtarget p60:={WHOLE};
L|  CONST robtarget p70:={WHOLE};
L|  CONST robtarget p80:={WHOLE};
J|  PERS jointtarget j1:=[[0,0,0,0,90,0],{AXES}];
J|  PERS jointtarget j2:=[[0,0,0,0,90,0],{AXES}];
J|  PERS jointtarget j3:=[[0,0,0,0,90,0],{AXES}];
L|  VAR jointtarget j4:=jElsewhere;
.|  PROC main()
L|    MoveJ p10,v1000,z50,t1;
L|    MoveL Offs(p10,0,0,50),v100,fine,t1;
P|    MoveL RelTool(p20,0,0,50\\Rz:=20),v100,fine,t1;
L|    MoveL RelTool(p20,0,0,reg1),v100,fine,t1;
P|    MoveL Offs(Offs(p20,0,0,50),-10,0,+5.5),v100,fine,t1;
P|    MoveL offs(p90, 0, 0, -up), v100, fine, t1;
P|    MoveC Offs(p90,0,0,1), Offs(p{{2, 1}},0,0,1), v100, fine, t1;
L|    MoveL Offs(p90,0,0,far),v100,fine,t1;
L|    MoveL Offs(p90,0,0,1\\Rz:=20),v100,fine,t1;
L|    MoveL Offs(p90,0,0),v100,fine,t1;
L|    MoveL Offs(p{{3,1}},0,0,1),v100,fine,t1;
.|    MoveL p{{1 , 1}},v100,fine,t1;
.|    MoveAbsJ j5{{1,2}},v100,fine,t1;
.|    MoveAbsJ j6{{reg1}},v100,fine,t1;
.|    ArcLStart p20,v100,seam1,weld1\\Weave:=weave1,fine,t1\\SeamName:="a";
P|    ArcL {WHOLE}\\ID:=10,v100,seam1,weld1,fine,t1;
L|    PaintL {WHOLE},v100,fine,t1;
L|    MoveL p30,v100,fine,t1; IF TRUE THEN p30.trans.z:=5; ENDIF
L|    SearchL\\Stop,di1,p40,p20,v100,t1;
L|    MoveL p40,v100,fine,t1;
.|    MoveL p50,v100,fine,t1;
L|    weld p50,p20;
L|    MoveL p60,v100,fine,t1;
L|    teach p60;
L|    MoveL p70,v100,fine,t1;
L|    MoveL p80,v100,fine,t2;
.|    MoveAbsJ\\Conc,j1\\NoEOffs,v100,fine,t1;
L|    j1.robax.rax_1:=5;
.|    j3.extax.eax_a:=5;
L|    j2:=CJointT();
L|    MoveAbsJ j4,v100,fine,t1;
J|    MoveAbsJ [[0,0,0,0,90,0],{AXES}],v100,fine,t1;
.|    IF p20.trans.z>5 THEN
.|      here:=p20;
.|    ENDIF
L|    IF reg1=1 goThere p20;
.|    PrintPose \\At:=p20.trans;
.|  ENDPROC
.|  PROC weld(robtarget a, robtarget b)
L|    MoveL a,v100,fine,t1;
.|  ENDPROC
.|  PROC teach(INOUT robtarget a)
.|    a:=CRobT();
.|  ENDPROC
L|  PROC again(robtarget p70)
.|    VAR tooldata t2:=[TRUE,[[0,0,200],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
L|    CONST robtarget p10:={WHOLE};
.|  ENDPROC
.|ENDMODULE
"""
URSCRIPT = """
.|def prog():
.|  set_tcp(p[0,0,0.1,0,0,0])
.|  def go(q, v):
L|    movej(q, v=v)
.|  end
P|  global way_p=p[.433, -.467, .522, 1.5003, .5214, .5309]
J|  global way_q=[1.99, -1.66, 1.93, -0.27, 1.32, 0.0036]
J|  global home=[0.1, -1.5, 1.5, -1.5, -1.5, 0]
.|  feature=p[0.1,0.2,0.3,0,0,0]
.|  moved=p[0.1,0.2,0.3,0,0,0]
.|  moved[2]=0.5
.|  part=p[0.1,0.2,0.3,0,0,0]
P|  movel(pose_trans(part, p[0.1,0,0,0,0,0]))
.|  part=p[0.1,0.2,0.4,0,0,0]
P|  movel(pose_trans(part, p[0.1,0,0,0,0,0]))
.|  if True:
.|    seat=p[0.1,0.2,0.4,0,0,0]
.|  end
.|  seat=p[0.1,0.2,0.5,0,0,0]
P|  movel(pose_trans(seat, p[0.1,0,0,0,0,0]))
.|  if True:
.|    seat=p[0.1,0.2,0.4,0,0,0]
.|  end
L|  movel(pose_trans(seat, p[0.1,0,0,0,0,0]))
.|  movej(get_inverse_kin(way_p, qnear=way_q), a=1.39, v=1.04)
.|  movej(way_q, r=0.01)
P|  movel(pose_trans(feature, p[0.1,0,0,0,0,0]), a=1.2, v=0.25, t=0, r=0.01)
P|  movel(pose_trans(p[0.1,0.2,0.3,0,0,0], pose_trans(feature, p[0.1,0,0,0,0,0])))
L|  movel(pose_trans(elsewhere, p[0.1,0,0,0,0,0]))
L|  movel(pose_trans(moved, p[0.1,0,0,0,0,0]))
L|  movel(pose_trans(feature, feature, p[0.1,0,0,0,0,0]))
J|  movel([0.1, -1.5, 1.5, -1.5, -1.5, 0], a=1)
.|  movel(home)
.|  movej(home)
L|  home[0]=home[0]+0.1
L|  movej([d2r(10), -1.5, base+1, -1.5, -1.5, 0])
J|  movej([d2r(10), -1.5, d2r(90), -1.5, -1.5, 0])
L|  go(home, 1)
L|  go([0.1, -1.5, 1.5, -1.5, -1.5, 0], 1)
L|  spray(way_p, 3)
L|  mc_add_linear(p[.433, -.467, .522, 1.5003, .5214, .5309], 0.01)
.|  set_payload(1.2, [0,0,0.1])
.|  force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,10,0,0,0], 2, [0.1,0.1,0.1,0.1,0.1,0.1])
.|  end_force_mode()
J|  movej(q=[0.1, -1.5, 1.5, -1.5, -1.5, 0], a=1)
P|  movel(pose=p[.433, -.467, .522, 1.5003, .5214, .5309])
L|  optimovej([0.1, -1.5, 1.5, -1.5, -1.5, 0])
.|  if (pose_dist(way_p, feature) < 0.1):
.|    textmsg("movel", way_p)
.|  end
.|end
"""
POSE = "CONFIG : 'N U T, 0, 0, 0', X = 600.0 mm, Y = 0.0 mm, Z = 400.0 mm, W = 180.0 deg, P = 0.0 deg, R = 0.0 deg"
FANUC = f"""
.|/PROG  A
.|/MN
.|   1:  PR[90:lpos]=LPOS    ;
.|   2:L P[1:abc] R[171:SPEED]mm/sec CNT100    ;
L|   3:L P[2] 100mm/sec FINE RTCP    ;
L|   3:L P[1:abc] 100mm/sec FINE Tool_Offset,PR[2:up]    ;
L|   3:L P[6] 100mm/sec FINE Offset,PR[2]    ;
.|:J P[1] 100% CNT50;
L|:J P[7] 100% CNT50;
.|:  !PR[1]=P[1] ;
L|:  PR[1]=P[1] ;
.|:C P[1]
.|:  P[1] 100mm/sec FINE;
L|   4:L P[R[3]] 100mm/sec FINE    ;
.|   5:  !PR[1]=P[1] ;
.|   6://L P[2] 100mm/sec FINE    ;
L|   7:  PR[1]=P[1]    ;
L|   8:  IF R[1]=1,CALL SUB(P[1]) ;
L|   9:L P[3] 100mm/sec FINE COORD    ;
L|  10:  P[4]=PR[1]    ;
L|  11:L P[4] 100mm/sec FINE    ;
L|  12:  P[5]=JPOS    ;
.|/POS
P|P[1:"abc"]{{ GP1: UF : 0, UT : 0, {POSE} }};
L|P[2]{{ GP1: UF : 0, UT : 0, {POSE} }};
L|P[3]{{ GP1: UF : 0, UT : 0, {POSE} }};
L|P[6]{{ GP1: UF : 0, UT : 0, {POSE} }};
L|P[4]{{ GP1: UF : 0, UT : 0, {POSE} }};
J|P[5]{{ GP1: UF : 0, UT : 0, J1= 5.0 deg, J2= 0.0 deg, J3= 0.0 deg, J4= 0.0 deg, J5= -90.0 deg, J6= 0.0 deg }};
.|/END
"""
SIX = "X 600.0,Y 0.0,Z 400.0,A 0.0,B 90.0,C 0.0,S 2,T 2"
KRL = f"""
.|&ACCESS RVP
.|&COMMENT Modul (src/dat) with INI line and PTP HOME at start and end of Program
.|DEF A( )
.|;FOLD INI;%{{PE}}
.|  BAS (#INITMOV,0 )
.|;ENDFOLD (INI)
.|DECL E6POS there
.|$BASE={{X 0,Y 0,Z 0,A 0,B 0,C 0}}
.|$TOOL={{X 0,Y 0,Z 100,A 0,B 0,C 0}}
P|XP1={{{SIX},E1 0.0}}
P|XG[1, 2]={{{SIX},E1 0.0}}
L|XG[2,2]={{{SIX},E1 0.0}}
P|XI[1]={{{SIX},E1 0.0}}
J|XK[1,1]={{A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}}
.|PTP $AXIS_ACT
.|LIN XG[ 1,2 ] C_DIS
L|LIN XG[1,3]
.|LIN XI[1]
.|LIN XI[k]
.|PTP XK[1,1]
J|XJ={{A3 90,A2 -90,A1 0,A4 0,A5 0,A6 0,E1 0}}
L|PTP {{A1 10}}
L|PTP {{A1 Q1,A2 -90,A3 90,A4 0,A5 0,A6 0}}
J|PTP {{AXIS: A6 0,A2 -90,A3 90,A4 0,A5 0,A1 5}} ; {{A1 10}}
L|LIN XP1 : {{X 0,Y 0,Z 50,A 0,B 0,C 0}}
L|LIN {{X 10}}
.|PTP XP1 C_PTP C_DIS
.|SPLINE WITH $VEL={{CP 0.2,ORI1 10,ORI2 10}}, $TOOL=TOOL_DATA[3]
.|ENDSPLINE
.|SPLINE
.| SPL XP1
P| SPL {{{SIX}}} WITH $VEL.CP=0.1
.| TIME_BLOCK START
.| SCIRC XP1, XP1, CA 180
.|ENDSPLINE
L|MOVE_TO(XP1)
L|ok=MOVE_TO(XJ,3)
.|IF (XP1.X>3) THEN
.|ENDIF
.|there=XP1:{{X 10,Y 0,Z 0,A 0,B 0,C 0}}
L|LIN there C_DIS
.|$H_POS=XJ
.|END
"""
PROGRAMS = {"a.mod": RAPID, "a.script": URSCRIPT, "a.ls": FANUC, "a.src": KRL}


def known(program: Program, line: int) -> str:
    """What is made of a line."""
    found = {"J" for target in program.targets if target.line == line}
    found |= {"P" for pose in program.cartesian if pose.line == line and not pose.reason_left_unresolved()}
    found |= {"L" for number, _ in program.left if number == line}
    return found.pop() if len(found) == 1 else "B" if found else "."


@pytest.mark.parametrize("name", [*PROGRAMS])
def test_each_line_that_people_write_is_rewritten_named_or_left_alone(tmp_path: Path, name: str) -> None:
    lines = [line.partition("|")[::2] for line in PROGRAMS[name].strip().split("\n")]
    (tmp_path / name).write_text("\n".join(text for _, text in lines) + "\n")
    program = read_programs(tmp_path / name)[0]
    assert [(known(program, k), text) for k, (_, text) in enumerate(lines, 1)] == lines


def test_a_list_of_joints_is_not_whole_where_some_are_computed(tmp_path: Path) -> None:
    for name, text in (
        ("a.mod", f"VAR jointtarget j:=jHome;\nMoveAbsJ [[0,0,0,0,90,0],{AXES}],v1,z1,t;\n"),
        ("a.script", "movej([0,0,0,0,0,a])\nmovej([0,0,0,0,0,0])\n"),
        ("a.src", "PTP {A1 10}\nPTP {A1 0,A2 0}\n"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(FileError, match="line 1: "):
            read_targets(tmp_path / name)


def test_a_target_is_taken_once_however_often_the_program_moves_to_it(tmp_path: Path) -> None:
    (tmp_path / "a.script").write_text("home=[0,-1.5,1.5,0,0,0]\nmovej(home)\nmovel(home)\nmovej(home)\n")
    assert len(read_programs(tmp_path / "a.script")[0].targets) == 1
