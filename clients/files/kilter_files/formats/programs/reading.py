"""Reads a program that is to be rewritten, with the second file of it where it has two."""

from __future__ import annotations

import gc
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from kilter_files.formats.programs.dialects import DIALECTS
from kilter_files.formats.programs.found import MOST_LINES, Dialect, Program, Stated, line_number
from kilter_files.formats.programs.one_target import JointTarget, PoseTarget
from kilter_files.formats.programs.remedies import remedies
from kilter_files.ground.errors import fault, read_head

MOST_BYTES = 16 << 20
MOST_IN_LINE = 1 << 16  # characters: no controller writes as many
MOVING = re.compile(r"^[ \t]{0,99}(?:GLOBAL[ \t]{1,9})?DEF(?:FCT[ \t]{1,9}\w{1,64})?[ \t]{1,9}(\w{1,64})", re.I | re.M)
DECLARING = re.compile(r"^[ \t]{0,99}DEFDAT[ \t]{1,9}(\w{1,64})", re.I | re.M)


NOTHING_STATED = Stated()


def read_program(path: Path, stated: Stated = NOTHING_STATED) -> Program:
    """Find the targets of one file, byte for byte as Latin-1, and name the lines that stay as they are.

    ``stated`` are frames that the program uses and does not hold.

    Raises:
        FileError: an unknown dialect, no targets, damaged ones, or ones of different arms.

    """
    return _validate_programs([_parse_program(path, dialect_of_file(path), stated)])[0]


def read_programs(path: Path, stated: Stated = NOTHING_STATED) -> list[Program]:
    """Find the targets of a program: of this file, and of the one that belongs to it where that stands beside it.

    Raises:
        FileError: as ``read_program``, of either file, or they are not of one program.

    """
    dialect = dialect_of_file(path)
    other = None if dialect.pair is None else _companion_file(path, dialect.pair)
    if dialect.pair is None or other is None:
        return [read_program(path, stated)]
    moving, declaring = (path, other) if path.suffix.lower() == dialect.pair[0] else (other, path)
    declares = _parse_program(declaring, dialect, stated)
    moves = _parse_program(moving, dialect, stated, declares)
    _refuse_other_names(moves, declares)
    return _validate_programs([moves, declares] if moving == path else [declares, moves])


def targets_in_visit_order(programs: Sequence[Program]) -> list[tuple[Program, JointTarget | PoseTarget]]:
    """Return all targets: those of one file as it has them, those of two as the program first moves to them."""
    owners: list[tuple[Program, JointTarget | PoseTarget]] = []
    for program in programs:
        owners += [(program, target) for target in program.targets]
        owners += [(program, pose) for pose in program.cartesian]
    if len(programs) == 1:
        return sorted(owners, key=lambda one: one[1].start_offset)
    first: dict[int, int] = {}
    for program in programs:
        for target in program.visits:
            first.setdefault(id(target), len(first))
    return sorted(owners, key=lambda one: first.get(id(one[1]), len(first)))


def dialect_of_file(path: Path) -> Dialect:
    """Return the dialect that the ending of a file says.

    Raises:
        FileError: none of those that are known.

    """
    by_ending = {ending: dialect for dialect in DIALECTS.values() for ending in dialect.endings}
    dialect = by_ending.get(path.suffix.lower())
    if dialect is None:
        raise fault(path, f"the ending {path.suffix!r} is of no known dialect", f"Known are {', '.join(by_ending)}.")
    return dialect


def _companion_file(path: Path, pair: tuple[str, str]) -> Path | None:
    """The other file of a program; a controller does not tell capitals from small letters."""
    ending = pair[path.suffix.lower() == pair[0]]
    wanted = f"{path.stem}{ending}".casefold()
    try:
        found = sorted(one for one in path.parent.iterdir() if one.name.casefold() == wanted and one.is_file())
    except OSError:
        return None
    if len(found) > 1:
        named = " and ".join(one.name for one in found)
        raise fault(path, f"{named} stand beside it", "Leave the one that belongs to it.")
    return found[0] if found else None


def _parse_program(path: Path, dialect: Dialect, stated: Stated, beside: Program | None = None) -> Program:
    content = read_head(path, MOST_BYTES + 1)
    if len(content) > MOST_BYTES or b"\0" in content:
        raise fault(path, f"is larger than {MOST_BYTES >> 20} MB or not text of 8 bits", "Export it as plain text.")
    lengths = [*map(len, content.split(b"\n"))]
    if max(lengths) > MOST_IN_LINE:
        line = next(k for k, length in enumerate(lengths, 1) if length > MOST_IN_LINE)
        what = f"has more than {MOST_IN_LINE} characters in a line"
        raise fault(path, what, "Break the line, or export it again.", line=line)
    if len(lengths) > MOST_LINES:
        what = f"has more than {MOST_LINES} lines"
        raise fault(path, what, "Part it into several programs, and leave empty lines out.", line=MOST_LINES + 1)
    program = Program(path, content.decode("latin-1"), dialect.name, beside=beside, stated=stated)
    dialect.refuse_cut(program)
    with uncollected():
        dialect.find(program)
    program.left = sorted(set(program.left))
    return program


@contextmanager
def uncollected() -> Iterator[None]:
    """Make many things that all stay, without Python looking through them again and again for ones that do not."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def _refuse_other_names(moves: Program, declares: Program) -> None:
    names = {name.upper() for name in MOVING.findall(moves.text)}
    named = DECLARING.search(declares.text)
    if named is not None and names and named[1].upper() not in names:
        what = f"DEFDAT {named[1]} is not of the program beside it ({moves.path.name})"
        raise fault(
            declares.path, what, "Keep other programs elsewhere.", line=line_number(declares.text, named.start(1))
        )


def _validate_programs(programs: list[Program]) -> list[Program]:
    """Name the poses that the program says too little of; refuse files without targets, or with those of several arms."""
    poses = {pose: why for one in programs for pose in one.cartesian if (why := pose.reason_left_unresolved())}
    for program in programs:
        program.leave_poses(poses)
    targets = [(program, target) for program in programs for target in program.targets]
    if not targets and len(poses) == sum(len(program.cartesian) for program in programs):
        named = [(program, line, what) for program in programs for line, what in program.left]
        where = " ".join(
            f"Line {line}{_file_name_phrase(program, programs)}: {what}." for program, line, what in named[:5]
        )
        helps = remedies(what for _, _, what in named) if named else ["Store its targets as joints."]
        raise fault(programs[0].path, "holds no targets to rewrite", " ".join([where, *helps]).strip())
    count = len(targets[0][1].joints_deg) if targets else 0
    for program, target in targets:
        if len(target.joints_deg) != count:
            what = f"{target.name} has {len(target.joints_deg)} joints, the first target {count}"
            raise fault(program.path, what, "Give the targets of one arm.", line=target.line)
    return programs


def _file_name_phrase(program: Program, programs: Sequence[Program]) -> str:
    return f" of {program.path.name}" if len(programs) > 1 else ""
