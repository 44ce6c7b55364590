"""The changed lines of a filtered program: as difflib finds them, without its search."""

from __future__ import annotations

import difflib
import random
from pathlib import Path

import pytest

from kilter_client.verbs.programs import _diff
from kilter_files.formats.programs.found import Program

MARK = "  ! Kilter corrected ver_{}"


@pytest.mark.parametrize("seed", range(200))
def test_the_changed_lines_are_those_that_difflib_finds(seed: int) -> None:
    draw = random.Random(seed)
    old = [f"MoveAbsJ [{k}]" + draw.choice(["", "\r"]) for k in range(draw.randrange(1, 25))]
    share = draw.random()
    new = [f"x{line}" if draw.random() < share else line for line in old]
    if draw.random() < 0.5:
        old.insert(draw.randrange(len(old) + 1), MARK.format(1))
    if draw.random() < 0.8:
        new.insert(draw.randrange(len(new) + 1), MARK.format(2))
    expected = difflib.unified_diff(old, new, "a.mod", "corrected", lineterm="", n=1)
    program = Program(Path("a.mod"), "\n".join(old), "RAPID")
    assert _diff(program, "\n".join(new)) == "\n".join(line.rstrip("\r") for line in expected)


def test_a_program_without_line_feeds_has_one_line() -> None:
    assert _diff(Program(Path("a.mod"), "a\rb\r", "RAPID"), "a\rc\r! Kilter corrected ver_2\nend") != ""
