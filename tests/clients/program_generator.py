"""Robot programs of many lines, each of which is known to be a target, to be named, or to be left alone.

It knows how people write programs and nothing of how Kilter reads them. A program is a list of lines and of what each is:
``"joints"`` and ``"pose"`` with the joints at which it was taught, ``"computed"`` likewise where a move computes the pose
from another, ``"named"``, or ``"alone"``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from . import program_idioms as idioms
from .program_lines import Line
from .six_joint_arms import Arm, Floats, about, shift
from .test_filter_poses import BASE, TOOL, confdata, config, numbers, quaternion, status_turn, vector, zyx


class Generator:
    """Writes programs for one arm."""

    def __init__(self, rng: np.random.Generator, preset: str, taught: Floats) -> None:
        self.rng, self.preset, self.arm, self.taught = rng, preset, Arm(preset), taught
        self.track = bool(rng.random() < 0.3)  # of KRL: an external axis moves, so every pose says where it is

    def q(self) -> Floats:
        """Joints that were taught."""
        found: Floats = self.taught[self.rng.integers(len(self.taught))]
        return found

    def pose(self, q: Floats, base: Floats = BASE) -> Floats:
        """The pose of the tool there, in the frame of the program."""
        found: Floats = np.linalg.inv(base) @ self.arm.flange(q) @ TOOL
        return found

    def one_of(self, lines: Sequence[Line]) -> Line:
        """Any of these."""
        return lines[self.rng.integers(len(lines))]

    def krl(self, count: int) -> list[Line]:
        """A KRL program: external axes, S and T, frames by hand, logic, relative moves, splines."""
        frames = [f"{{{self.six(T)}}}" for T in (BASE, TOOL)]
        set_by = self.rng.integers(3)
        base, tool = (
            (f"$BASE={frames[0]}", f"$TOOL={frames[1]}"), ("$BASE=BASE_DATA[2]", "$TOOL = TOOL_DATA[1]"),
            ("BAS(#BASE,2)", "BAS (#TOOL,1 )"),
        )[set_by]  # fmt: skip
        lines = [Line("DEF w()"), *idioms.KRL_HEAD, Line("INI", "named"), Line(base), Line(tool)]
        lines += [Line("ASYPTP {E1 12.5}", "named")] if self.track else []
        alone = [
            Line("; PTP {A1 10,A2 20,A3 30,A4 0,A5 0,A6 0} was here"), Line("$VEL.CP=0.25"), Line("WAIT SEC 0.5"),
            Line("$OUT[3]=TRUE"), Line("$VEL_AXIS[1]=50"), Line(""), Line("WAIT FOR $IN[4]"), Line("  "), Line("$APO.CDIS=5.5"),
            Line("PTP $AXIS_ACT ; BCO"), Line("ptp $pos_act"),
        ]  # fmt: skip
        named = [
            Line(text, "named")
            for text in (
                "LIN_REL {X 10,Z -5}",
                "PTP_REL {A1 5}",
                "PTP XHOME",
                "LIN NOWHERE C_DIS",
                "PTP {A3 45}",
                "PTP {A1 Q,A2 0}",
                "LIN NOWHERE : {X 1,Y 0,Z 0,A 0,B 0,C 0}",
                "LIN $POS_ACT : {X 1,Y 0,Z 0,A 0,B 0,C 0}",
                "PTP XELSE[I,1]",
            )
        ]
        for _ in range(count):
            q, kind = self.q(), self.rng.random()
            if kind < 0.3:
                written = self.rng.permutation(6) if self.rng.random() < 0.3 else range(6)
                axes = ",".join(f"A{k + 1} {q[k]:.9f}" for k in written)
                more = f",E1 {12.5 * self.track},E2 0.0" if self.rng.random() < 0.4 else ""
                lines.append(Line(f"PTP {{{axes}{more}}} C_PTP ; {{A1 9}}", "joints", q))
            elif kind < 0.5:
                word = ("PTP", "LIN", "SPTP", "SLIN")[self.rng.integers(4)]
                lines.append(Line(f"  {word} {self.krl_pose(q)} C_DIS", "pose", q))
            elif kind < 0.6:
                lines += self.krl_arc(q, self.q())
            elif kind < 0.65:
                lines += self.krl_spline(q)
            elif kind < 0.8:
                lines += idioms.krl(self, len(lines), [Line(base), Line(tool)])
            elif kind < 0.83:
                name = f"XP[{len(lines)},{(' 2', '2')[self.rng.integers(2)]}]"
                lines += [Line(f"{name}={self.krl_pose(q)}", "pose", q), Line(f"LIN {name.replace(' ', '')} C_DIS")]
            else:
                lines.append(self.one_of(alone if kind < 0.92 else named))
        return [*lines, Line("END"), *idioms.KRL_TAIL]

    def six(self, T: Floats) -> str:
        """A pose as KRL writes it."""
        return ",".join(f"{n} {v:.9f}" for n, v in zip("XYZABC", zyx(T), strict=True))

    def krl_pose(self, q: Floats) -> str:
        """A pose with S and T."""
        return f"{{{self.six(self.pose(q))},{status_turn(q)}{self.external()}}}"

    def external(self) -> str:
        """The external axes of a pose."""
        return ",E1 0.0,E2 0.0" if self.track else ""

    def krl_arc(self, q: Floats, via: Floats) -> list[Line]:
        """An arc: its via point is a target too."""
        word, comma = ("CIRC", "SCIRC")[self.rng.integers(2)], (",", ", ", " , ")[self.rng.integers(3)]
        more = ("", ",CA 180.0", " C_DIS")[self.rng.integers(3)]
        return [Line(f"{word} {self.krl_pose(via)}{comma}{self.krl_pose(q)}{more}", "pose", q, via)]

    def krl_spline(self, q: Floats) -> list[Line]:
        """A block of splines, and motions that choose frames for themselves."""
        pose = self.krl_pose(q)
        return [
            Line("SPLINE WITH $VEL.CP=0.2"), Line(f"  SPL {pose}", "pose", q), Line(f"  SLIN {pose}", "pose", q),
            Line("  TIME_BLOCK START"), Line("ENDSPLINE"), Line(f"SLIN {pose} WITH $BASE=BASE_DATA[9], $VEL.CP=0.1", "named"),
            Line(f"SPTP {pose} WITH $VEL_AXIS[1]=SVEL_JOINT(50.0), $TOOL=TOOL_DATA[1], $BASE=BASE_DATA[2]", "pose", q),
        ]  # fmt: skip

    def rapid(self, count: int) -> list[Line]:
        """A RAPID module: targets in moves and in arrays, work objects, external axes, offsets, circles, logic."""
        head = [
            Line("MODULE w"), Line(f"  PERS tooldata grip := [TRUE,[{quaternion(TOOL)}],[1,[0,0,1],[1,0,0,0],0,0,0]];"),
            Line(f'  PERS wobjdata bench := [FALSE,TRUE,"",[{quaternion(BASE)}],[[0,0,0],[1,0,0,0]]];'),
            Line("  CONST num nUp := 7.25;"),
        ]  # fmt: skip
        lines = [Line("PROC main()")]
        alone = [
            Line("  ! MoveAbsJ [[1,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]], v100, z10, grip;"), Line("  SetDO doGrip, 1;"),
            Line("  WaitTime 0.5;"), Line('  TPWrite "p1 [[1,2,3],[1,0,0,0]]";'), Line("  AccSet 50, 100;"), Line(""),
            Line("  reg1 := reg1 + 1;"),
        ]  # fmt: skip
        outside = "[9E9,9E9,9E9,9E9,9E9,9E9]"
        named = [
            Line(text, "named")
            for text in (
                "  MoveL Offs(pHome, 0, 0, 50), v100, z10, grip\\WObj:=bench;",
                "  MoveL RelTool(pHome, 0, 0, -10), v50, fine, grip\\WObj:=bench;",
                "  MoveL Offs(pGrid{1,1}, 0, 0, reg1), v100, z10, grip\\WObj:=bench;",
                "  MoveL Offs(pGrid{1,1}, 0, 0, 2*nUp), v100, z10, grip\\WObj:=bench;",
                "  MoveJ pElsewhere, v200, z50, grip\\WObj:=bench;",
                f"  DispL [[600,0,400],[0,0,1,0],[0,0,0,0],{outside}], v50, bead1, z10, grip\\WObj:=bench;",
            )
        ]
        for _ in range(count):
            q, kind = self.q(), self.rng.random()
            if kind < 0.3:
                axes = ",".join(f"{v:.9f}" for v in q)
                lines.append(Line(f"  MoveAbsJ [[{axes}],{outside}], v200, z50, grip;", "joints", q))
            elif kind < 0.6:
                word, more = (("MoveL", "\\V:=80"), ("MoveJ", ""))[self.rng.integers(2)]
                target, arc = self.robtarget(q), self.rng.random() < 0.3
                via = self.q() if arc else None
                goals = target if via is None else f"{self.robtarget(via)}, {target}"
                weld = ", seam1, weld1" if self.rng.random() < 0.3 else ""
                word = word.replace("Move", "Arc").replace("ArcJ", "ArcLStart") if weld else word
                word = word[:-1] + "C" if arc and word[-1] in "LJ" else "ArcCEnd" if arc else word
                line = f"  {word} {goals}, v100{more}{weld}, z10, grip\\WObj:=bench;"
                lines.append(Line(line, "pose", q, via))
            elif kind < 0.68:
                data, moves = idioms.rapid(self, len(lines))
                head += data
                lines += moves
            elif kind < 0.8:
                data, moves = self.rapid_offset(q, len(head))
                head += data
                lines += moves
            else:
                lines.append(self.one_of(alone if kind < 0.9 else named))
        grid, moves = self.rapid_grid()
        return [*head, *grid, *lines, *moves, Line("ENDPROC"), Line("ENDMODULE")]

    def rapid_grid(self) -> tuple[list[Line], list[Line]]:
        """An array of two dimensions, declared over several lines, and moves to its elements by constants."""
        q = [self.q() for _ in range(6)]
        around = ("[{},", "{},", "{}],", "[{},", "{},", "{}]")
        rows = [Line(f"    {form.format(self.robtarget(at))}", "pose", at) for form, at in zip(around, q, strict=True)]
        comma = (",", ", ", " , ")[self.rng.integers(3)]
        order = self.rng.permutation([f"pGrid{{{k // 3 + 1}{comma}{k % 3 + 1}}}" for k in range(6)])
        moves = [Line(f"  MoveJ {name}, v200, z50, grip\\WObj:=bench;") for name in order]
        return [Line("  CONST robtarget pGrid{2,3} := ["), *rows, Line("  ];")], moves

    def rapid_offset(self, q: Floats, number: int) -> tuple[list[Line], list[Line]]:
        """A target beside a declared one by plain numbers, in the work object or in the tool; the other need not be one."""
        x, y, z = (float(v) for v in self.rng.uniform(-20, 20, 3).round(2))
        name, kind = f"pBy{number}", self.rng.integers(4)
        if kind < 2:  # in the work object
            pose = shift(-x, -y, -z) @ self.pose(q)
            said = (f"Offs({name},{x},{y},{z})", f"offs ( {name} , {x:+} , {y} ,{z} )")[kind]
        elif kind == 2:  # along the tool, by a constant
            pose = self.pose(q) @ shift(0, 0, 7.25)
            said = f"RelTool({name}, 0, 0, -nUp)"
        else:  # in the tool, and rotated: about x, then about the new y, then about the new z
            a, b, c = (float(v) for v in self.rng.uniform(-30, 30, 3).round(1))
            turned = shift(x, y, z) @ about("XYZ", np.radians([a, b, c]))
            pose = self.pose(q) @ np.linalg.inv(turned)
            said = f"RelTool({name},{x},{y},{z} \\Rx:={a} \\Ry:={b}\\Rz:={c})"
        declared = f"[{quaternion(pose)},{confdata(q)},[9E9,9E9,9E9,9E9,9E9,9E9]]"
        kept = ("CONST", "PERS", "VAR")[self.rng.integers(3)]
        move = f"  MoveL {said}, v100, z10, grip\\WObj:=bench;"
        return [Line(f"  {kept} robtarget {name}:={declared};")], [Line(move, "computed", q)]

    def robtarget(self, q: Floats) -> str:
        """A robtarget written into a move."""
        return f"[{quaternion(self.pose(q))},{confdata(q)},[9E9,9E9,9E9,9E9,9E9,9E9]]"

    def urscript(self, count: int) -> list[Line]:
        """A URScript: joints, poses behind them, arithmetic on poses, moves that are computed, logic."""
        frame = Line(f"  ref_frame = p[{vector(BASE)}]")
        lines = [Line("def w():"), *idioms.URSCRIPT_HEAD, frame, *self.subprogram()]
        alone = [
            Line("  # movej([0, 0, 0, 0, 0, 0])"), Line("  set_digital_out(3, True)"), Line("  sleep(0.5)"), Line(""),
            Line('  textmsg("movel(p[1,2,3,0,0,0])")'), Line("  set_payload(1.2)"), Line("  count = count + 1"),
        ]  # fmt: skip
        named = [
            Line(text, "named")
            for text in (
                "  movel(pose_trans(get_actual_tcp_pose(), p[0, 0, 0.05, 0, 0, 0]), a=1.2, v=0.1)",
                "  movel(pose_trans(p_taught, p[0, 0, 0.05, 0, 0, 0]), a=1.2, v=0.1)",
                "  movej(get_inverse_kin(p_taught), a=1.4)",
                "  movel(pose_add(p_taught, p[0, 0, 0.1, 0, 0, 0]))",
                "  movej([0.1, q_taught, 0, 0, 0, 0])",
                "  paint(p[0.4, 0.1, 0.3, 0, 3.1, 0], 0.02)",
            )
        ]
        for _ in range(count):
            q, kind = self.q(), self.rng.random()
            if kind < 0.6:
                axes = ", ".join(f"{v:.12f}" for v in np.radians(q))
                word = ("movej(", "movej(", "movej(q=", "movel(")[self.rng.integers(4)]
                lines.append(Line(f"  {word}[{axes}], a=1.4, v=1.05)", "joints", q))
                if kind < 0.3:
                    lines += self.behind(q)
            elif kind < 0.75:
                lines += idioms.urscript(self, len(lines))
            else:
                lines.append(self.one_of(alone if kind < 0.88 else named))
        return [*lines, Line("end")]

    def beside(self, q: Floats) -> tuple[str, Floats]:
        """A pose a few degrees from these joints, and its joints."""
        near = q + self.rng.uniform(-4, 4, 6)
        return f"p[{vector(self.pose(near, np.eye(4)))}]", near

    def subprogram(self) -> list[Line]:
        """A subprogram inside the program: no tool is set in it, so its pose is named."""
        q = self.q()
        axes, pose = ", ".join(f"{v:.12f}" for v in np.radians(q)), self.beside(q)[0]
        return [
            Line("  def away():"), Line(f"    movej([{axes}])", "joints", q), Line(f"    movel({pose}, v=0.1)", "named"),
            Line("  end"),
        ]  # fmt: skip

    def behind(self, q: Floats) -> list[Line]:
        """Moves from these joints to poses: along a line or arc, in a loop, and after the subprogram moved the arm."""
        (pose, near), (other, on), kind = self.beside(q), self.beside(q), self.rng.random()
        line = Line(f"  movel({pose}, a=1.2, v=0.2, r=0.01)", "pose", near)
        if kind < 0.2:  # as offline systems write it
            framed = f"p[{vector(self.pose(near))}]"
            return [Line(f"  movel(pose_trans(ref_frame, {framed}), 1.2, 0.2, 0, 0.000)", "pose", near)]
        if kind < 0.4:
            return [line]
        if kind < 0.6:
            return [Line(f"  movec({other}, {pose}, a=1.2, v=0.2)", "pose", near, on)]
        if kind < 0.8:
            return [Line("  away()"), Line(line.text, "named")]
        axes = ", ".join(f"{v:.12f}" for v in np.radians(q))
        return [
            Line("  while count < 3:"), Line(f"    movel({other})", "named"), Line(f"    movej([{axes}])", "joints", q),
            line, Line("    count = count + 1"), Line("  end"), Line(f"  movel({other}, v=0.1)", "named"),
        ]  # fmt: skip

    def fanuc(self, count: int) -> list[Line]:
        """A FANUC program in the controller's ASCII form: positions in frame 2 with tool 1, logic, registers."""
        moves, positions = [], []
        numbered = self.rng.random() < 0.7  # offline systems leave the numbers out
        alone = [
            "  CALL GRIP    ;", "  WAIT   0.50(sec) ;", "  DO[3]=ON ;", "  !P[1] was taught by hand ;", "  R[1]=R[1]+1    ;",
            "  IF R[1]>5,JMP LBL[1] ;",
        ]  # fmt: skip
        named = ["J PR[1] 100% FINE    ;", "L P[1] 100mm/sec FINE Offset,PR[2]    ;"]
        for k in range(1, count + 1):
            q = self.q()
            kind = self.rng.random()
            if self.rng.random() < 0.25:
                more, position = idioms.fanuc(self, k, len(moves) + 1)
                moves += more
                positions += position
                continue
            beside, arc = 0.5 < kind < 0.7, kind > 0.85
            if beside:
                more = ("Offset,PR[2]", "Tool_Offset,PR[3]", "INC")[self.rng.integers(3)]
                moves.append(Line(f"  {len(moves) + 1}:L P[{k}] 100mm/sec FINE {more}    ;", "named"))
            elif arc:
                moves += [Line(f"  {len(moves) + 1}:C P[{k}]    "), Line(f"    :  P[{k}] 100mm/sec CNT50    ;")]
            else:
                approach = Line(f"  {len(moves) + 1}:L P[{k}] 100mm/sec CNT50 Tool_Offset,PR[3:up]    ;", "named")
                moves += [approach] if kind < 0.1 else []
                moves.append(Line(f"  {len(moves) + 1}:L P[{k}] 100mm/sec FINE    ;"))
            x, y, z, r, p, w = zyx(self.pose(q))
            places = ", ".join(f"{n} = {v:.9f} mm" for n, v in zip("XYZ", (x, y, z), strict=True))
            turns = ", ".join(f"{n} = {v:.10f} deg" for n, v in zip("WPR", (w, p, r), strict=True))
            positions += [
                Line(f"P[{k}]{{", "named" if beside else "alone"), Line("   GP1:"),
                Line(f"\tUF : 2, UT : 1,\tCONFIG : {config(q)},"),
                Line(f"\t{places},", "alone" if beside else "pose", q),
                Line(f"\t{turns}", "alone" if beside else "turns", q), Line("};"),
            ]  # fmt: skip
            if kind < 0.5:
                moves.append(Line(f"  {len(moves) + 1}:{alone[self.rng.integers(len(alone))]}"))
        moves.append(Line(f"  {len(moves) + 1}:{named[0]}", "named"))
        moves = moves if numbered else [line._replace(text=re.sub(r"^ *\d+:", ":", line.text)) for line in moves]
        return [Line("/PROG W"), Line("/MN"), *moves, Line("/POS"), *positions, Line("/END")]


OPTIONS = {
    "krl": ["--base", f"2={numbers(BASE)}", "--tool", f"1={numbers(TOOL)}"],
    "fanuc": ["--fanuc-j3", "same", "--base", f"2={numbers(BASE, True)}", "--tool", f"1={numbers(TOOL, True)}"],
}
