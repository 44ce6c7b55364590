"""Constructs of public programs, rewritten in small: searches, sensors, interrupts, copies, sums of poses, named arguments.

A line begins with what it is, as in ``test_program_uses``: ``J`` and ``P`` hold joints or a pose that are rewritten, ``L`` is
named, ``.`` is copied in silence.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from kilter_files.formats.programs.found import Stated
from kilter_files.formats.programs.reading import read_programs

from .test_program_uses import SIX, WHOLE, known

HEAD = """.|MODULE M1
.|  PERS tooldata t1:=[TRUE,[[0,0,100],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
.|  PERS wobjdata w1:=[FALSE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];"""
SEARCH = f"""{HEAD}
P|  CONST robtarget p10:={WHOLE};
P|  CONST robtarget p20:={WHOLE};
P|  CONST robtarget p30:={WHOLE};
L|  CONST robtarget p40:={WHOLE};
.|PROC main()
L|SearchL \\Stop,di1,pf,p10,v50,t1\\WObj:=w1;
.|MoveLDO p20,v100,fine,t1\\WObj:=w1,do1,1;
.|MoveLSync p30,v100,z10,t1\\WObj:=w1,"cb";
.|TriggL p10,v100,tr1\\T2:=tr2,z10,t1\\WObj:=w1;
L|SearchL \\Stop,di1,pf,p40,v50,t1\\WObj:=w1;
.|ENDPROC
.|ENDMODULE
"""
EGM = f"""{HEAD}
P|  CONST robtarget p10:={WHOLE};
.|LOCAL VAR egmident egm_id;
.|VAR JointTarget jt;
.|PROC main()
.|jt := CJointT();
L|MoveAbsJ jt, v200, fine, t1;
.|EGMGetId egm_id;
.|EGMActJoint egm_id \\J1:=c \\J2:=c;
L|EGMRunJoint egm_id, EGM_STOP_HOLD \\J1 \\J2;
.|MoveJ p10,v100,fine,t1\\WObj:=w1;
.|ENDPROC
.|ENDMODULE
"""
BY_VALUE = f"""{HEAD}
L|  CONST robtarget p10:={WHOLE};
P|  CONST robtarget p20:={WHOLE};
P|  CONST robtarget p30:={WHOLE};
.|PROC main()
L|mv p10,p20;
.|MoveJ p30,v100,fine,t1\\WObj:=w1;
.|reg1:=p30.trans.z;
.|IF p20.trans.x>10 THEN
.|MoveJ p20,v100,fine,t1\\WObj:=w1;
.|ENDIF
.|ENDPROC
.|PROC mv(robtarget a,robtarget b)
.|IF a.trans.x=p10.trans.x THEN
L|MoveLDO Offs(a,0,0,20*n+3),v100,fine,t1\\WObj:=w1,do1,1;
.|ENDIF
.|ENDPROC
.|ENDMODULE
"""
KRL_HEAD = """.|&ACCESS RVP
.|&REL 4
.|DEF w( )
.|;FOLD INI;%{PE}
.|    GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
.|    INTERRUPT ON 3
.|    BAS (#INITMOV,0 )
.|;ENDFOLD (INI)"""
FORM = """.|$BWDSTART=FALSE
.|PDAT_ACT=PPDAT{k}
.|FDAT_ACT=FP{k}
.|BAS(#{p},100)
.|{m} XP{k} C_DIS"""
MOVES = "\n".join([
    FORM.format(k=1, p="PTP_PARAMS", m="PTP"), ".|TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[1]=TRUE",
    FORM.format(k=2, p="CP_PARAMS", m="LIN"),
])  # fmt: skip
COPY = f"""{KRL_HEAD}
{MOVES}
.|XP3=XP2
.|XP3.Z=XP3.Z+50
L|LIN XP3
.|END
"""
INTERRUPT = f"""{KRL_HEAD}
{MOVES}
.|INTERRUPT DECL 10 WHEN $IN[1]==TRUE DO stopit()
.|INTERRUPT ON 10
{FORM.format(k=3, p="CP_PARAMS", m="LIN")}
.|WAIT SEC 0
.|INTERRUPT OFF 10
L|PTP $POS_INT
L|LIN $AXIS_INT
.|END
"""
SUMS = f"""{KRL_HEAD}
{MOVES}
L|LIN_REL {{Z -50}} #TOOL
L|LIN XP2:{{X 0,Y 0,Z 50,A 0,B 0,C 0}}
.|END
"""
DATA = "DEFDAT w PUBLIC\n" + "".join(
    f"DECL E6POS XP{k}={{{SIX},E1 0.0}}\nDECL FDAT FP{k}={{TOOL_NO 1,BASE_NO 0,IPO_FRAME #BASE}}\n"
    f"DECL PDAT PPDAT{k}={{VEL 100.0,ACC 100.0,APO_DIST 100.0,APO_MODE #CDIS}}\n"
    for k in (1, 2, 3)
)
ARGUMENTS = """.|def p1():
.|  set_tcp(p[0, 0, .12, .2, 0, 0])
J|  movej(q=[-1.59, -1.71, -2.2, -0.8, 1.59, -0.03], a=1)
P|  movel(pose=p[-.186, -.608, .308, .002, 3.1, -.27], a=0.5, v=0.1, t=0, r=0)
P|  movep(p[.195, -.769, .355, .28, -2.96, .4], a=0.5, v=0.1, r=0.01)
L|  servoj([-1.6, -1.54, -2.04, -1.15, 1.59, -0.03], t=0.008, lookahead_time=0.1, gain=300)
L|  speedl([0,0,0.1,0,0,0], 0.5, 1)
.|end
"""
TILT = """.|def job_a():
.|  global table_a = p[-0.42, 0.20, 0.11, 0.01, 0.0, -1.40]
.|  set_tcp(p[0, 0, .12, .2, 0, 0])
.|  local lean = d2r(30.0)
.|  local down = p[0, 0, 0, 2.3, -2.1, 0]
.|  local off = p[0, 0, 0, 0, lean, 0]
.|  local leaned = pose_trans(down, off)
.|  local ra = leaned[3]; local rb = leaned[4]; local rc = leaned[5]
J|  movej([-1.05, -1.75, -1.75, -1.22, 1.4, 0.35], a=1.0, v=0.05)
L|  movej(pose_trans(table_a, p[0, 0, 0.02, ra, rb, rc]), a=1.0, v=0.05)
.|  local i = 0
.|  while (i < 5):
.|    local xs = 0.01 * i
.|    local pa = pose_trans(table_a, p[xs, 0, 0.01, ra, rb, rc])
L|    movel(pa, a=0.3, v=0.016)
.|    i = i + 1
.|  end
P|  movel(pose_trans(table_a, p[0, 0, 0.1, 2.3, -2.1, 0]), a=0.5, v=0.05)
.|end
.|job_a()
"""
PROGRAMS = {
    "search.mod": SEARCH, "egm.mod": EGM, "by_value.mod": BY_VALUE, "copy.src": COPY, "interrupt.src": INTERRUPT,
    "sums.src": SUMS, "arguments.script": ARGUMENTS, "tilt.script": TILT,
}  # fmt: skip
LEFT_OF_DATA = {"copy.src": ["XP3"], "sums.src": ["XP3"], "interrupt.src": []}


@pytest.mark.parametrize("name", [*PROGRAMS])
def test_each_line_of_a_public_construct_is_rewritten_named_or_alone(tmp_path: Path, name: str) -> None:
    lines = [line.partition("|")[::2] for line in PROGRAMS[name].strip().split("\n")]
    (tmp_path / name).write_text("\n".join(text for _, text in lines) + "\n")
    if name.endswith(".src"):
        (tmp_path / name).with_suffix(".dat").write_text(f"{DATA}ENDDAT\n")
    programs = read_programs(tmp_path / name, Stated({}, {"1": (0.0, 0.0, 120.0, 22.9, 0.0, 0.0)}))
    assert [(known(programs[0], k), text) for k, (_, text) in enumerate(lines, 1)] == lines
    if name in LEFT_OF_DATA:
        poses = programs[1].cartesian
        assert [pose.name for pose in poses if pose.reason_left_unresolved()] == LEFT_OF_DATA[name]
        assert len(poses) == 3
