"""Read a program of any of the dialects that can be rewritten; the one list of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from kilter_files.formats.programs import fanuc, krl, rapid, table, urscript
from kilter_files.formats.programs.found import Program
from kilter_files.ground.faults import fault, head_of

MOST_BYTES = 16 << 20

# ending of the file -> dialect
ENDINGS: Mapping[str, str] = {
    ".src": "KRL", ".dat": "KRL", ".mod": "RAPID", ".script": "URScript", ".ls": "FANUC LS", ".csv": "CSV",
}  # fmt: skip
FINDERS: Mapping[str, Callable[[Program], None]] = {
    "KRL": krl.find, "RAPID": rapid.find, "URScript": urscript.find, "FANUC LS": fanuc.find, "CSV": table.find,
}  # fmt: skip


def read_program(path: Path) -> Program:
    """Find the joint targets of a program, and name the targets that stay as they are.

    Raises:
        FileError: an unknown dialect, no joint targets, damaged ones, or ones of different arms.

    """
    dialect = ENDINGS.get(path.suffix.lower())
    if dialect is None:
        raise fault(path, f"the ending {path.suffix!r} is of no known dialect", f"Known are {', '.join(ENDINGS)}.")
    content = head_of(path, MOST_BYTES + 1)
    if len(content) > MOST_BYTES or b"\0" in content:
        raise fault(path, f"is larger than {MOST_BYTES >> 20} MB or not text of 8 bits", "Export it as plain text.")
    program = Program(path, content.decode("latin-1"), dialect)
    FINDERS[dialect](program)
    program.left = sorted(set(program.left))
    if not program.targets:
        where = "".join(f" Line {line}: {what}." for line, what in program.left[:5])
        raise fault(path, "holds no joint targets", f"Store its targets as joints.{where}")
    count = len(program.targets[0].joints_deg)
    for target in program.targets:
        if len(target.joints_deg) != count:
            what = f"{target.name} has {len(target.joints_deg)} joints, the first target {count}"
            raise fault(path, what, "Give the targets of one arm.", line=target.line)
    return program
