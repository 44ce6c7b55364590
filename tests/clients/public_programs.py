"""Programs as people publish them: loops, frames, endings, comments, odd spacing, offsets, relative moves.

It knows how people write and nothing of how Kilter reads. A program is a list of rows: text, and where the arm truly goes
by it: the joints deg, with the frames that are in force there. Rows without such a truth must stay byte for byte.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .six_joint_arms import Arm, Floats, about, limits_deg, shift
from .test_filter_poses import confdata, config, quaternion, status_turn, vector, zyx

NO_AXES = "[9E9,9E9,9E9,9E9,9E9,9E9]"
NULL = np.eye(4)


class Truth(NamedTuple):
    """Where the arm goes: joints deg, base and tool (4, 4) mm; ``joints`` says that the row states joints."""

    q: Floats
    base: Floats
    tool: Floats
    joints: bool = False


class Row(NamedTuple):
    """Lines of a program that belong together, and the truth of the target in them."""

    text: str
    truth: Truth | None = None


class Writer:
    """Writes programs of one dialect, for one arm, by one seed."""

    def __init__(self, rng: np.random.Generator, preset: str, taught: Floats) -> None:
        self.rng, self.preset, self.arm, self.taught = rng, preset, Arm(preset), taught
        self.base = shift(*rng.uniform(-200, 200, 3)) @ about("ZYX", rng.uniform(-0.6, 0.6, 3))
        self.tool = shift(*rng.uniform(-80, 160, 3)) @ about("ZYX", rng.uniform(-0.7, 0.7, 3))
        self.rows: list[Row] = []

    def chance(self, share: float) -> bool:
        """True in this share of the cases."""
        return bool(self.rng.random() < share)

    def pick(self, *given: str) -> str:
        """Any of these."""
        return given[self.rng.integers(len(given))]

    def q(self) -> Floats:
        """Joints that were taught."""
        found: Floats = self.taught[self.rng.integers(len(self.taught))]
        return found

    def beside(self, q: Floats, by: float = 4.0) -> Floats:
        """Joints some degrees away, within the limits."""
        towards = np.sign(limits_deg(self.preset).mean(axis=1) - q)
        found: Floats = q + by * self.rng.uniform(0.3, 1.0, 6) * np.where(towards == 0, 1, towards)
        return found

    def pose(self, q: Floats, base: Floats | None = None, tool: Floats | None = None) -> Floats:
        """The pose of the tool in the frame of the program."""
        base, tool = self.base if base is None else base, self.tool if tool is None else tool
        found: Floats = np.linalg.inv(base) @ self.arm.flange(q) @ tool
        return found

    def add(self, text: str, q: Floats | None = None, base: Floats | None = None, joints: bool = False) -> None:
        """Write a row; with joints it holds the target that is there."""
        base = self.base if base is None else base
        self.rows.append(Row(text, None if q is None else Truth(q, base, self.tool, joints)))

    def six(self, T: Floats) -> str:
        """A pose as KRL writes it, with the spaces of somebody."""
        sep = self.pick(",", ", ", " ,")
        return sep.join(f"{n} {v:.{self.rng.integers(9, 12)}f}" for n, v in zip("XYZABC", zyx(T), strict=True))


def rapid(w: Writer, count: int) -> list[Row]:
    """A RAPID module: constants and inline targets, loops by index, ConfL and ConfJ, offsets, a rail that stands still."""
    end = w.pick(";", " ;")
    axes = w.pick(NO_AXES, "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]", "[0.0031,9E9,9E9,9E9,9E9,9E9]")
    with_ = w.pick(
        ", v100, fine, tGrip\\WObj:=wBench",
        ",v200\\V:=90,z10,tGrip \\WObj := wBench",
        " , vmax , z50 , tGrip\\WObj:=wBench",
    )
    w.add(w.pick("%%%\n  VERSION:1\n  LANGUAGE:ENGLISH\n%%%", "! made by hand; MoveL p1, v100, fine, tool0;"))
    w.add("MODULE Made")
    w.add(f"\tPERS tooldata tGrip:=[TRUE,[{quaternion(w.tool)}],[1.2,[0,0,50],[1,0,0,0],0,0,0]]{end}")
    w.add(f'\tTASK PERS wobjdata wBench:=[FALSE,TRUE,"",[{quaternion(w.base)}],[[0,0,0],[1,0,0,0]]];  ! "bench"')
    w.add("  VAR num nRow:=0;\n  CONST num nUp:=12.5;")
    off, body, q = w.chance(0.5), list[tuple[str, Floats | None]](), w.q()
    axis = ",".join(f"{v:.9f}" for v in q)
    w.add(f"  CONST jointtarget jHome:=[[{axis}],{NO_AXES}];", q, joints=True)
    names = []
    for k in range(count):
        q = w.beside(q) if off else w.q()
        stated = "[1,-2,1,7]" if off else confdata(q)
        names.append((f"p{10 * (k + 1)}", q))
        w.add(f"{w.pick('  ', '	')}CONST robtarget {names[-1][0]}:=[{quaternion(w.pose(q))},{stated},{axes}];", q)
    grid = [w.q() for _ in range(3)]
    if not off:
        w.add("  CONST robtarget row{3}:=[")
        for k, at in enumerate(grid):
            w.add(f"    [{quaternion(w.pose(at))},{confdata(at)},{axes}]{']' + end if k == 2 else ','}", at)
    w.add(f"\n  PROC {w.pick('main', 'Main')}()")
    if off:
        w.add(f"    {w.pick('ConfL', 'CONFL')}\\Off;\n    ConfJ {w.pick('', ' ')}\\Off;")
    w.add(f"    {w.pick('MoveAbsJ', 'moveabsj')} jHome{w.pick('', chr(92) + 'NoEOffs')}, v500, fine, tool0;")
    for name, at in names:
        body.append((f"    {'MoveL' if off else w.pick('MoveL', 'MoveJ', 'MOVEL')} {name}{with_}{end}", None))
        body.append(
            (
                w.pick(
                    "    SetDO doGrip,1;",
                    '    TPWrite "at; p10";',
                    "    WaitTime 0.5;",
                    "",
                    "    ! MoveL p10, v1, fine, t;",
                ),
                None,
            )
        )
        if w.chance(0.3):
            up = shift(*np.round(w.rng.uniform(-9, 9, 3), 2))
            there = w.arm.joints(w.base @ up @ w.pose(at) @ np.linalg.inv(w.tool), at)
            x, y, z = up[:3, 3]
            body.append((f"    MoveL {w.pick('Offs', 'offs')}({name},{x:g}, {y:g},{z:g}){with_}{end}", there))
        if w.chance(0.2):
            body.append((f"    MoveL Offs({name},0,0,nRow*10){with_}{end}", None))
            break
    for text, there in body:
        w.add(text, there)
    if not off:
        w.add("    FOR i FROM 1 TO 3 DO\n" + f"      MoveL row{{i}}{with_}{end}\n" + "      nRow:=nRow+1;\n    ENDFOR")
    w.add("    IF di1=1 Stop;\n  ENDPROC\nENDMODULE")
    return _unless_visited(w, names, [text for text, _ in body])


def _unless_visited(w: Writer, names: list[tuple[str, Floats]], body: list[str]) -> list[Row]:
    """Targets to which no move goes must stay as they are."""
    unused = [name for name, _ in names if not any(f" {name}," in text or f" {name} " in text for text in body)]
    return [Row(row.text) if any(f"robtarget {name}:=" in row.text for name in unused) else row for row in w.rows]


def krl(w: Writer, count: int) -> list[Row]:
    """A KRL program of one file: frames by hand or by data, S and T or the target before, arrays by index, relative moves."""
    data = w.chance(0.5)
    w.add(w.pick("&ACCESS RVP\n&REL 1\n", "") + "DEF  made ( )")
    w.add("  DECL INT I\n;FOLD INI;%{PE}\n  BAS (#INITMOV,0 )\n;ENDFOLD (INI)")
    base, tool = w.six(w.base), w.six(w.tool)
    if data:
        w.add(f"BASE_DATA[3]={{{base}}}\nTOOL_DATA[2] = {{FRAME: {tool}}}\n$BASE=BASE_DATA[3]\n$TOOL = TOOL_DATA[2]")
    else:
        w.add(f"$BASE={{{base}}}\n$TOOL={{{tool}}}")
    q = w.q()
    grid = [w.q() for _ in range(2)]
    for k, at in enumerate(grid, 1):
        w.add(f"XG[{k}]={{{w.six(w.pose(at))},{status_turn(at)}}}", at)
    w.add("FOR I=1 TO 2\n  LIN XG[I] C_DIS\nENDFOR")
    for _ in range(count):
        kind = w.rng.random()
        word = w.pick("PTP", "LIN", "SPTP", "SLIN", "ptp", "lin")
        if kind < 0.3:
            q = w.q()
            axes = w.pick(",", ", ").join(f"A{k} {v:.9f}" for k, v in enumerate(q, 1))
            w.add(f"{w.pick('', '  ')}PTP {{{axes},E1 0.0}} {w.pick('', 'C_PTP ; {A1 5}')}".rstrip(), q, joints=True)
            q = w.beside(q)
            w.add(f"{w.pick('LIN', 'SLIN')} {{{w.six(w.pose(q))}}}", q)
        elif kind < 0.7:
            q = w.q()
            w.add(
                f"{word} {{{w.six(w.pose(q))},{status_turn(q)},E1 {w.pick('0.0', '0.0021', '-0.004')}}} ;Vel=2 m/s", q
            )
        elif kind < 0.8:
            w.add(w.pick("LIN_REL {Z -50} #TOOL", "PTP_REL {A1 5}", "LIN XNONE C_DIS", "PTP $AXIS_ACT"))
        else:
            w.add(
                w.pick(
                    "WAIT SEC 0.5",
                    "$OUT[3]=TRUE",
                    ";LIN {X 1,Y 2,Z 3,A 4,B 5,C 6}",
                    "",
                    "$VEL.CP=0.2",
                    "IF $IN[1] THEN\nHALT\nENDIF",
                )
            )
    w.add("END")
    return w.rows


def fanuc(w: Writer, count: int) -> list[Row]:
    """A FANUC program: frames by registers, labels, offsets, positions as joints and as poses."""
    x = [zyx(w.base)[[0, 1, 2, 5, 4, 3]], zyx(w.tool)[[0, 1, 2, 5, 4, 3]]]
    lines: list[str] = []
    for values, name in zip(x, ("UFRAME", "UTOOL"), strict=True):
        said = [f"{v:.6f}" if v >= 0 else w.pick(f"({v:.6f})", f"{v:.6f}") for v in values]
        lines += [f"PR[9,{k}]={value}" for k, value in enumerate(said, 1)]
        lines += [f"{name}[4]=PR[9]", f"{name}_NUM=4"]
    lines += ["!made offline", "LBL[1]"]
    moves, positions = [], list[Row]()
    for k in range(1, count + 1):
        q, kind = w.q(), w.rng.random()
        offset = w.chance(0.15)
        speed, zone = w.pick("50%", "100mm/sec"), w.pick("FINE", "CNT50") + " Offset,PR[2]" * offset
        moves.append(f"{w.pick('J', 'L')} P[{k}{w.pick('', ':at it')}] {speed} {zone}   ")
        if w.chance(0.3):
            moves.append(
                w.pick(
                    "WAIT    .50(sec)",
                    "DO[1]=ON",
                    "R[1]=R[1]+1",
                    "CALL GRIP",
                    "  ! L P[1] 5mm/sec FINE",
                    "IF R[1]>3,JMP LBL[2]",
                )
            )
        if kind < 0.3:
            axes = ",\t".join(f"J{j}= {v:11.6f} deg" for j, v in enumerate(q, 1))
            text = f"P[{k}]{{\n   GP1:\n\tUF : 4, UT : 4,\n\t{axes}\n}};"
        else:
            X, Y, Z, R, P, W = zyx(w.pose(q))
            places = ",\t".join(f"{n} = {v:14.9f}  mm" for n, v in zip("XYZ", (X, Y, Z), strict=True))
            turns = ",\t".join(f"{n} = {v:14.10f} deg" for n, v in zip("WPR", (W, P, R), strict=True))
            text = f'P[{k}:"at"]{{\n   GP1:\n\tUF : 4, UT : 4,\t\tCONFIG : {config(q)},\n\t{places},\n\t{turns}\n}};'
        positions.append(Row(text, None if offset else Truth(q, w.base, w.tool, kind < 0.3)))
    lines += [*moves, "JMP LBL[1]", "LBL[2]"]
    w.add('/PROG  MADE\n/ATTR\nOWNER\t\t= MNEDITOR;\nCOMMENT\t\t= "P[1]";\n/APPL\n/MN')
    for k, line in enumerate(lines, 1):
        w.add(f"{k:4}:{line if line[:2] in ('J ', 'L ') else '  ' + line} ;")
    return [*w.rows, Row("/POS"), *positions, Row("/END")]


def urscript(w: Writer, count: int) -> list[Row]:
    """A URScript: the tool, a feature, joints and poses that follow them, loops, threads, relative moves."""
    w.add(w.pick("# made; movej([0,0,0,0,0,0])\n", "") + "def made():")
    w.add(f"  set_tcp(p[{vector(w.tool)}])\n  {w.pick('global ', '')}bench = p[{vector(w.base)}]")
    indent = "  "
    if w.chance(0.5):
        w.add("  while (True):")
        indent = "    "
    for k in range(count):
        q, kind = w.q(), w.rng.random()
        if kind < 0.2:
            w.add(
                indent
                + w.pick(
                    "sleep(0.5)", 'textmsg("movel(p[1,2,3,4,5,6])")', "set_digital_out(0, True)", "# p[0,0,0,0,0,0]", ""
                )
            )
            continue
        if kind < 0.3:
            w.add(
                indent
                + w.pick(
                    "movel(pose_add(get_actual_tcp_pose(), p[0,0,0.1,0,0,0]))",
                    "speedl([0,0,0.1,0,0,0], 0.5, 1)",
                    "movej(home)",
                )
            )
            continue
        joints = w.pick(", ", ",").join(f"{v:.10f}" for v in np.radians(q))
        w.add(f"{indent}movej({w.pick('', 'q=')}[{joints}], a=1.4{w.pick('', ', v=1.05, r=0.02')})", q, joints=True)
        near = w.beside(q)
        if kind < 0.6:
            w.add(f"{indent}movel({w.pick('', 'pose=')}p[{vector(w.pose(near, NULL))}], a=1.2, v=0.25)", near, NULL)
        elif kind < 0.8:
            w.add(f"{indent}movel(pose_trans(bench, p[{vector(w.pose(near))}]), a=1.2)", near)
        else:
            w.add(f"{indent}at_{k} = p[{vector(w.pose(near, NULL))}]", near, NULL)
            w.add(f"{indent}movel(at_{k}, a=1.2, v=0.25)")
    w.add("  end\nend" if indent == "    " else "end")
    return w.rows


WRITERS: dict[str, tuple[str, str, Callable[[Writer, int], list[Row]]]] = {
    "rapid": ("irb120", ".mod", rapid), "krl": ("kr6-r900", ".src", krl), "fanuc": ("irb120", ".ls", fanuc),
    "urscript": ("ur10e", ".script", urscript),
}  # fmt: skip
