"""What programs of cells do between their moves: frames by data and by name, amounts, subprograms, variables, odd layout.

Each idiom is some lines with what they are, for the program that a generator writes; it knows nothing of how Kilter reads.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from .program_lines import Line
from .six_joint_arms import Floats, limits_deg
from .test_filter_poses import BASE, TOOL, vector

if TYPE_CHECKING:
    from .program_generator import Generator

STEP = "{A1 5,A2 0,A3 0,A4 0,A5 0,A6 0}"


def beside(one: Generator, q: Floats) -> Floats:
    """Joints a few degrees from others."""
    low, high = limits_deg(one.preset).T
    near: Floats = np.clip(q + one.rng.uniform(-4, 4, 6), low + 1, high - 1)
    return near


def krl(one: Generator, count: int, frames: list[Line]) -> list[Line]:
    """An idiom of KRL; ``frames`` set base and tool anew, ``count`` makes names its own."""
    q, name = one.q(), f"V{count}"
    pose, near = one.krl_pose(q), beside(one, q)
    axes = [",".join(f"A{k + 1} {v:.9f}" for k, v in enumerate(at)) for at in (q, near)]
    free = f"{{{one.six(one.pose(near))}{one.external()}}}"
    absolute = re.sub(r"S (\d)", lambda at: f"S {16 + int(at[1])}", pose)
    base = f"{{{one.six(BASE)}}}"
    idioms = [
        [
            Line(";FOLD PTP P7 CONT Vel=100 % PDAT7 Tool[1] Base[2];%{PE}"), Line("$BWDSTART=FALSE"), Line("PDAT_ACT=PPDAT7"),
            Line("FDAT_ACT = {TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}"), Line("BAS(#PTP_PARAMS,100)"),
            Line(f"PTP {pose} C_PTP", "pose", q), Line(";ENDFOLD"),
        ],
        [Line("FDAT_ACT={TOOL_NO 1,BASE_NO 9,IPO_FRAME #BASE}"), Line(f"LIN {pose}", "named"), *frames],
        [Line("FDAT_ACT.BASE_NO=9"), Line(f"LIN {pose}", "named"), *frames],
        [Line(f"FKEPT={base}"), Line("$BASE = FKEPT"), Line(f"SLIN {pose} C_SPL", "pose", q), *frames],
        [Line(f"FMOVED={base}"), Line("FMOVED.Z=FMOVED.Z+1"), Line("$BASE=FMOVED"), Line(f"LIN {pose}", "named"), *frames],
        [Line(f"$BASE={base}:FKEPT"), Line(f"LIN {pose}", "named"), *frames],
        [Line("SETBASE()"), Line(f"LIN {pose}", "named"), *frames],
        [Line(f"LIN {absolute}", "named")],
        [Line(f"PTP {pose.replace(one.external() or '?', '')}", "named" if one.track else "pose", q)],
        [
            Line(f"SCIRC {pose},{pose},CA 95.5", "pose", q, q), Line(f"LIN {free}", "named"), Line("RSI_MOVECORR()", "named"),
            Line(f"$AXIS_HOME[2]={{{axes[0]}}}", "named"), Line("DECL LOAD L2={M 2,CM {X 0.0,Y 0.0,Z 60.0,A 0,B 0,C 0}}"),
        ],
        [Line(f"{name}={STEP}", "named"), Line(f"PTP_REL {name}", "named")],
        [Line(f"{name}={STEP}", "named"), Line(f"IF $AXIS_ACT.A1>{name}.A1 THEN"), Line("HALT"), Line("ENDIF")],
        [Line(f"{name}={{HOME {{{axes[0]}}},NUM 3}}", "named"), Line(f"PTP {name}.HOME C_PTP", "named")],
        [Line(f"\tptp\t{{ {axes[0].lower().replace(',', ' ,  ')} }}  c_ptp ;x", "joints", q)],
        [Line(f" sLin {pose.lower().replace(',', ' , ')} c_dis", "pose", q)],
        [Line(f"{name}={pose}", "named"), Line(f"LIN {name}", "named"), Line(f"{name} = {pose}", "named")],
        [
            Line(f"{name}={{{axes[0]}}}", "joints", q), Line(f"PTP {name} C_PTP"), Line("BAS(#VEL_CP,0.2)"),
            Line(f"LIN {free}", "pose", near), Line("GRIP(1)"), Line(f"LIN {free}", "named"),
            Line(f"{name}={{{axes[1]}}}", "joints", near), Line(f"PTP {name}"), Line(f"LIN {free} C_DIS", "pose", near),
        ],
        [
            Line(f"{name}={{{axes[0]}}}", "joints", q), Line(f"{name}.A1={name}.A1+45", "named"), Line(f"PTP {name}"),
            Line(f"LIN {free} C_DIS", "named"),
        ],
    ]  # fmt: skip
    return idioms[one.rng.integers(len(idioms))]


KRL_HEAD = [Line("DECL FRAME FKEPT, FMOVED")]
KRL_TAIL = [Line("DEF SETBASE( )"), Line("$BASE=BASE_DATA[3]"), Line("END")]


def urscript(one: Generator, count: int) -> list[Line]:
    """An idiom of URScript."""
    q, name = one.q(), f"v{count}"
    (pose, near), axes = one.beside(q), f"[{', '.join(f'{v:.12f}' for v in np.radians(q))}]"
    framed, before = f"pose_trans(ref_frame, p[{vector(one.pose(near))}])", Line(f"  movej({axes})", "joints", q)
    other = beside(one, q)
    idioms = [
        [Line(f"  movej(get_inverse_kin({framed}, qnear={axes}), a=1.4, v=1.05)", "pose", near)],
        [Line(f"  movej(get_inverse_kin({pose}, {axes}), a=1.4)", "pose", near)],
        [before, Line(f"  movej(get_inverse_kin({pose}, qnear=get_actual_joint_positions()))", "pose", near)],
        [before, Line(f"  movej(get_inverse_kin({pose}, qnear=q_elsewhere))", "named")],
        [before, Line(f"  movej(get_inverse_kin({pose}, tcp=p[0, 0, 0.3, 0, 0, 0]))", "named")],
        [before, Line(f"  movel ( {pose} , a=1.2 , v = 0.1 )", "pose", near)],
        [before, Line("  rg_grip(40, 20)"), Line(f"  movel({pose}, v=0.1)", "named")],
        [before, Line("  freedrive_mode()"), Line("  end_freedrive_mode()"), Line(f"  movel({pose}, v=0.1)", "named")],
        [
            Line(f"  {name} = {axes}", "joints", q), Line(f"  movej({name}, r=0.01)"), Line(f"  movel({pose})", "pose", near),
            Line(f"  {name} = [{', '.join(f'{v:.12f}' for v in np.radians(other))}]", "joints", other),
            Line(f"  movej({name})"), Line(f"  movel({pose})", "pose", near),
            Line("  if count > 3:"), Line(f"    {name} = {axes}", "joints", q), Line("  end"), Line(f"  movej({name})"),
            Line(f"  movel({pose})", "named"),
        ],
        [
            Line(f"  {name} = p[{vector(TOOL)}]"), Line(f"  {name}[2] = 0.4"), Line(f"  set_tcp({name})"), before,
            Line(f"  movel({pose})", "named"), Line(f"  set_tcp(p[{vector(TOOL)}])"),
        ],
        [
            Line("  change()"), before, Line(f"  movel({pose})", "named"), Line(f"  set_tcp(p[{vector(TOOL)}])"), before,
            Line(f"  movel({pose})", "pose", near),
        ],
    ]  # fmt: skip
    return idioms[one.rng.integers(len(idioms))]


URSCRIPT_HEAD = [
    Line("  def other_tool():"), Line("    set_tcp(p[0, 0, 0.3, 0, 0, 0])"), Line("  end"),
    Line("  def change():"), Line("    other_tool()"), Line("  end"), Line(f"  set_tcp(p[{vector(TOOL)}])"),
]  # fmt: skip


def rapid(one: Generator, count: int) -> tuple[list[Line], list[Line]]:
    """An idiom of RAPID: what is declared for it, and what is done."""
    q, name = one.q(), f"jBy{count}"
    outside, target = "[9E9,9E9,9E9,9E9,9E9,9E9]", one.robtarget(q)
    axes = f"[{','.join(f'{v:.9f}' for v in q)}]"
    amount = Line(f"  CONST jointtarget {name} := [[2,2,2,2,2,2],{outside}];", "named")
    idioms: list[tuple[list[Line], list[Line]]] = [
        ([amount], [Line(f"  WZHomeJointDef\\Inside, space, jElsewhere, {name};", "named")]),
        ([amount], [Line(f"  MoveExtJ {name}, vrot10, fine;", "named")]),
        ([amount], [Line(f"  here.robax.rax_1 := here.robax.rax_1 + {name}.robax.rax_1;")]),
        (
            [Line(f"  CONST jointtarget {name} := [[9E9,9E9,9E9,9E9,9E9,9E9],[5,9E9,9E9,9E9,9E9,9E9]];", "named")],
            [Line(f"  MoveExtJ {name}, vrot10, fine;", "named")],
        ),
        (
            [Line(f"  LOCAL PERS jointtarget {name}:=[ {axes} , {outside} ] ;", "joints", q)],
            [Line(f"  moveabsj {name} \\NoEOffs , v100 , fine , grip ;")],
        ),
        ([], [Line(f"  MoveL {target}, v100, z10, grip\\WObj?WObj;", "named")]),
        ([], [Line(f"  MoveL {target}, v100, z10, grip\\WObj:=bench \\Corr;", "named")]),
        ([], [Line(f"  IF reg1>5 MoveL {target}, v100, z10, grip\\WObj:=bench;", "pose", q)]),
        ([], [Line("  IndRMove STN1,1\\ToRelNum:=90,20;", "named")]),
        ([], [Line(f"  MoveL {target}, v100, z10, grip\\WObj:=benches{{2}};", "named")]),
        ([], [Line(f"  MoveL {target}, v100, z10, grips{{1}}\\WObj:=bench;", "named")]),
        (
            [],
            [
                Line("  IF di1 = 1 THEN"), Line(f"    MOVEJ {target} ,v100,z10 ,grip \\WObj := bench ;", "pose", q),
                Line("  ENDIF"),
            ],
        ),
    ]  # fmt: skip
    return idioms[one.rng.integers(len(idioms))]


def fanuc(one: Generator, k: int, number: int) -> tuple[list[Line], list[Line]]:
    """An idiom of FANUC: lines from ``number`` on, and position ``k``, which is shown as joints or as a pose."""
    q, kind = one.q(), one.rng.integers(9)
    axes = ",\t".join(f"J{i} = {v:.9f} deg" for i, v in enumerate(q, 1))
    moves = [
        [f"J P[{k}] 100% FINE    ;"], [f"J P[{k}] 100% FINE Offset,PR[2]    ;"], [f"  PR[9]=P[{k}]    ;"],
        ["  Touch Offset PR[1] ;", f"J P[{k}] 100% FINE    ;", "  Touch Offset End ;"],
        [f"  //J P[{k}] 100% FINE Offset,PR[2]    ;", f"J P[{k}] 100% FINE    ;"],
        [f"J P[{k}:with, comma] 20% CNT10 ACC80 TB    .10sec,CALL GRIP    ;"],
        [f"J P[{k}] 100% FINE    ;", f"  P[{k}]=JPOS    ;"], [f"J P[{k}] 100% FINE    ", f":  Offset,PR[{k}]    ;"],
        ["  Track TAST[1] ;", f"J P[{k}] 100% FINE    ;", "  Track End ;"],
    ][kind]  # fmt: skip
    named = range(len(moves)) if kind in (1, 2) else [1] if kind in (3, 6, 8) else [0] if kind == 7 else []
    heads = ["    " if said[0] == ":" else f"  {number + i}:" for i, said in enumerate(moves)]
    lines = [Line(f"{heads[i]}{said}", "named" if i in named else "alone") for i, said in enumerate(moves)]
    left = kind in (1, 2, 3, 7, 8)
    position = [
        Line(f"P[{k}]{{", "named" if left else "alone"), Line("   GP1:"), Line("\tUF : 2, UT : 1,"),
        Line(f"\t{axes}", "alone" if left else "joints", q), Line("};"),
    ]  # fmt: skip
    return lines, position
