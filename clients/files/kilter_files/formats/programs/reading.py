"""Reads a program that is to be rewritten."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.programs.dialects import DIALECTS
from kilter_files.formats.programs.found import Program
from kilter_files.ground.faults import fault, head_of

MOST_BYTES = 16 << 20


def read_program(path: Path) -> Program:
    """Find the joint targets of a program, byte for byte as Latin-1, and name the targets that stay as they are.

    Raises:
        FileError: an unknown dialect, no joint targets, damaged ones, or ones of different arms.

    """
    by_ending = {ending: dialect for dialect in DIALECTS.values() for ending in dialect.endings}
    dialect = by_ending.get(path.suffix.lower())
    if dialect is None:
        raise fault(path, f"the ending {path.suffix!r} is of no known dialect", f"Known are {', '.join(by_ending)}.")
    content = head_of(path, MOST_BYTES + 1)
    if len(content) > MOST_BYTES or b"\0" in content:
        raise fault(path, f"is larger than {MOST_BYTES >> 20} MB or not text of 8 bits", "Export it as plain text.")
    program = Program(path, content.decode("latin-1"), dialect.name)
    dialect.refuse_cut(program)
    dialect.find(program)
    program.left = sorted(set(program.left))
    if not program.targets:
        where = "".join(f" Line {line}: {what}." for line, what in program.left[:5])
        raise fault(path, "holds no joint targets", f"Store its targets as joints.{where}")
    refuse_other_arms(program)
    return program


def refuse_other_arms(program: Program) -> None:
    """Refuse targets with different numbers of joints.

    Raises:
        FileError: there are some.

    """
    count = len(program.targets[0].joints_deg)
    for target in program.targets:
        if len(target.joints_deg) != count:
            what = f"{target.name} has {len(target.joints_deg)} joints, the first target {count}"
            raise fault(program.path, what, "Give the targets of one arm.", line=target.line)
