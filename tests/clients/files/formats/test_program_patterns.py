"""Patterns that are looked for by their words, or by their tails, find what Python's own search finds."""

from __future__ import annotations

import re
from collections.abc import Iterable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilter_files.formats.programs import krl as krl_targets
from kilter_files.formats.programs import rapid, rapid_moves, rapid_uses, urscript
from kilter_files.formats.programs.krl_lines import Keyed, Tailed
from kilter_files.formats.programs.poses import krl
from kilter_files.formats.programs.poses import urscript as urscript_poses

MODULES = (rapid, rapid_moves, rapid_uses, rapid_uses, rapid_moves, rapid_moves, krl_targets, krl, krl,
           urscript, urscript_poses)  # fmt: skip
FOUND = {
    f"{module.__name__.rpartition('programs.')[2]}.{name}": one
    for module in MODULES
    for name, one in vars(module).items()
    if isinstance(one, Keyed | Tailed)
}
PIECES = st.sampled_from(
    ["", " ", "  ", "\t", "\n", "\r\n", "=", ":=", "{", "}", "[", "]", "(", ")", ",", ";", ":", ".", "\\", "$", "_", "1",
     "A", "p1", "P10[3]", "A1 5", "X 1, Y 2", "E6POS", "POS", "AXIS:", "FRAME", "frame :", "BASE_DATA[1]", "$TOOL",
     "TOOL_NO 1", "BASE_NO 2", "ORI_TYP #VAR", "CONST", "const num", "num", "FOR i FROM", "jointtarget", "RobTarget p",
     "tooldata t:=[TRUE,", "wobjdata", "PROC", "func num f(", "TRAP", "MoveL", "MoveAbsJ \\", "ArcC2", "TriggL", "SearchC",
     "IndAMove", "EGMRunJoint", "LoadId", "PDispOn", "EOffsSet", "SingArea\\LockAxis4", "ConfL\\Off", "ConfJ \\On", "movej(",
     "optimovel (", "servoj([1", "set_tcp(", "force_mode(", "end_force_mode (", "path_offset_set(", "track_conveyor_x(",
     "[[1,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]]", "µ", "É"]
)  # fmt: skip


def plain(one: Keyed | Tailed) -> re.Pattern[str]:
    return one._whole if isinstance(one, Tailed) else one._pattern


def spans(matches: Iterable[re.Match[str]]) -> list[tuple[tuple[int, int], ...]]:
    return [match.regs for match in matches]


@pytest.mark.parametrize("name", FOUND)
@settings(max_examples=150, deadline=None)
@given(pieces=st.lists(PIECES, max_size=40))
def test_all_matches_are_found_and_no_others(name: str, pieces: list[str]) -> None:
    text = "".join(pieces)
    assert spans(FOUND[name].finditer(text)) == spans(plain(FOUND[name]).finditer(text))


def test_heads_are_not_longer_than_what_is_looked_through() -> None:
    for name in ("N" * 64 + "[ 1000 , 1000 , 1000 ]", "E6POS" + " " * 9 + "N" * 64):
        text = f"x = 1\n{name}{' ' * 9}={' ' * 9}{{X 1,Y 2,Z 3,A 4,B 5,C 6}}"
        (match,) = krl.POSE.finditer(text)
        assert match.start() == 6
