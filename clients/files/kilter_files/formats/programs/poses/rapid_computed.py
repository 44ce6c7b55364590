"""RAPID's Offs and RelTool: the robtarget that a move computes from another one by plain numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

from kilter_files.formats.programs.found import NUMBER, Program, line_number
from kilter_files.formats.programs.keyed import Keyed
from kilter_files.formats.programs.notations import RAPID
from kilter_files.formats.programs.one_target import PoseTarget, WrittenOut
from kilter_files.formats.programs.poses.rapid import arguments
from kilter_files.formats.programs.rigid import Rigid
from kilter_files.ground.orientation import from_euler

CALL = re.compile(r"(Offs|RelTool)\s*+\((.*)\)\s*+", re.I | re.S)
VALUE = rf"(?:{NUMBER}|[-+]?[A-Za-z]\w*)"
SHIFT = re.compile(
    rf"\s*+({VALUE})\s*+,\s*+({VALUE})\s*+,\s*+({VALUE})\s*+((?:,?\s*+\\\s*+R[xyz]\s*+:=\s*+{VALUE}\s*+){{0,3}})", re.I
)
TURN = re.compile(rf"R([xyz])\s*+:=\s*+({VALUE})", re.I)
CONSTANT = Keyed("const", rf"\bCONST\s+num\s+(\w+)\s*+:=\s*+({NUMBER})\s*+;")
NUM = Keyed("num", r"\bnum\s+(\w+)")
LOOP = Keyed("for", r"\bFOR\s+(\w+)\s+FROM\b")  # which declares its variable


class Computed:
    """Targets that moves compute, and the places of the names of those from which they do."""

    def __init__(self, program: Program, text: str, declared: Callable[[str], PoseTarget | None]) -> None:
        """Take a program, its text with comments blanked, and what finds a declared target by what a move says."""
        self._program, self._text, self._declared = program, text, declared
        several = [match[1].lower() for pattern in (NUM, LOOP) for match in pattern.finditer(text)]
        constants = {match[1].lower(): float(match[2]) for match in CONSTANT.finditer(text)}
        self._constants = {name: value for name, value in constants.items() if several.count(name) == 1}
        self.named: set[int] = set()

    def add_computed_target(self, at: int, said: str) -> PoseTarget | None:
        """Take what a move says as its goal at a place: a target, if it is computed from a declared one by numbers alone."""
        end = at + len(said)
        if self._program.text[at:end] != self._text[at:end]:  # a comment stands within
            return None
        found = self._resolve_computed_pose(at, said)
        if found is None:
            return None
        of, pose, name_at = found
        self.named.add(name_at)
        numbers = tuple(RAPID.nearest_numbers(pose, of.numbers))
        start, stop = of.whole
        ends = "".join(re.findall(r"\r\n|\r|\n", said))
        target = PoseTarget(said[:40], line_number(self._text, at), RAPID, numbers, of.spans, of.configuration)
        target.root = of.root
        target.computed = WrittenOut(of, (at, end), ends, self._text[start:stop], start)
        return self._program.add_pose(target, counted=False)

    def _resolve_computed_pose(self, at: int, said: str) -> tuple[PoseTarget, Rigid, int] | None:
        """The declared target, the pose that is computed from it, and where it is named."""
        call = CALL.fullmatch(said)
        if call is None:
            of = self._declared(said)
            return None if of is None else (of, RAPID.pose(of.numbers), at)
        place, first = next(arguments(call[2]))
        start = call.start(2)
        inner = self._resolve_computed_pose(at + start + place, first)
        comma = call[2].find(",", place + len(first))
        shift = SHIFT.fullmatch(call[2], comma + 1) if comma > 0 else None
        if inner is None or shift is None:
            return None
        by = [self._value(shift[k]) for k in (1, 2, 3)]
        turns = {axis.lower(): self._value(value) for axis, value in TURN.findall(shift[4])}
        of, pose, name_at = inner
        moved = _displace_pose(pose, by, turns, call[1].lower() == "reltool")
        return None if moved is None else (of, moved, name_at)

    def _value(self, said: str) -> float | None:
        if re.fullmatch(NUMBER, said):
            return float(said)
        value = self._constants.get(said.lstrip("+-").lower())
        return -value if value is not None and said[0] == "-" else value


def _displace_pose(pose: Rigid, by: list[float | None], turns: dict[str, float | None], in_tool: bool) -> Rigid | None:
    """A pose displaced by mm, and in its own axes then also rotated, deg, about x, the new y and the new z."""
    if None in by or None in turns.values() or (turns and not in_tool):
        return None
    x, y, z = (value or 0.0 for value in by)
    if not in_tool:
        return Rigid((pose.place[0] + x, pose.place[1] + y, pose.place[2] + z), pose.turn)
    a, b, c = (math.radians(turns.get(axis) or 0.0) for axis in "xyz")
    return pose.compose_frames(Rigid((x, y, z), from_euler((a, b, c), "XYZ")))
