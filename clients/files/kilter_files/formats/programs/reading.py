"""Reads a program that is to be rewritten, with the second file of it where it has two."""

from __future__ import annotations

import gc
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from kilter_files.formats.programs.dialects import DIALECTS
from kilter_files.formats.programs.found import MOST_LINES, Dialect, Program, Stated, line_number
from kilter_files.formats.programs.one_target import JointTarget, PoseTarget
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
    with pause_garbage_collection():
        dialect.find(program)
    program.left = sorted(set(program.left))
    return program


@contextmanager
def pause_garbage_collection() -> Iterator[None]:
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


AS_JOINTS = "Store it as joints: a controller shows them where the arm stands."
MOVE_BEFORE = "Move to joints near the pose before it, or state its configuration."
OWN_TARGET = "Declare a target of its own for each."
OWN_NAME = "Give each target a name of its own."
PLAIN_NUMBERS = "Write the target with numbers."
SET_BEFORE = "Set base and tool in the routine, before the move and outside its branches."
# what a reason says, as a text or a pattern, and what helps then; the first that fits
REMEDIES: tuple[tuple[str | re.Pattern[str], str], ...] = (
    ("is beyond its limit", "Teach these targets within reach."),
    ("is held at its limit", "Teach these targets further from the limit."),
    ("DAMPED", "Teach these targets further from the singularity."),
    (
        "out of reach",
        "Check that robot, base and tool are those of the program: kilter robot check shows the arm at zero.",
    ),
    (
        "have its configuration",
        "Compare its zero, limits and signs with the controller's: kilter robot check, --signs.",
    ),
    ("several joints reach it", AS_JOINTS),
    ("past a singularity", AS_JOINTS),
    ("singularity", AS_JOINTS),
    ("the target from which the arm comes is not known", MOVE_BEFORE),
    ("follow those of the target before it", MOVE_BEFORE),
    ("too far from the target before it", MOVE_BEFORE),
    ("moves come to it with different joints", OWN_TARGET),
    ("different frames or tools", OWN_TARGET),
    ("declared several times", OWN_NAME),
    ("is not beside it", "Copy the .dat beside the .src, and filter them together."),
    ("depends on the way", SET_BEFORE),
    ("sets its", SET_BEFORE),
    ("behind it may set", SET_BEFORE),
    ("is set after it", SET_BEFORE),
    ("changes $", SET_BEFORE),
    ("is set several times", SET_BEFORE),
    ("displaces it", AS_JOINTS),
    (
        "orientation is not kept",
        "Keep the orientation of the target in the move ($ORI_TYPE=#VAR, mode 0, SingArea \\Wrist).",
    ),
    ("stands still", AS_JOINTS),
    ("moves, or its tool", AS_JOINTS),
    ("tracks", AS_JOINTS),
    ("sensor", "Filter the program without what the sensor moves, or move to its target without the sensor too."),
    ("force_mode", "Move to it without force_mode too."),
    ("have an offset", "Move to it without the offset too."),
    ("changes it", OWN_TARGET),
    ("may change", "Declare it CONST, or give the routine a copy."),
    ("is given it", "Filter the program that moves to it, or move to it here."),
    ("no move of the program goes to it", "Filter it with the program that moves to it, or delete it."),
    ("relative move", "Move to a target that is written out."),
    ("computed", PLAIN_NUMBERS),
    ("computes", PLAIN_NUMBERS),
    ("without numbers", PLAIN_NUMBERS),
    ("is not a number", PLAIN_NUMBERS),
    (
        re.compile(r"[( ][A-Za-z]\w*(?:\[\d+\])?: no[t]? ?a? ?target of this file"),
        "Filter the file that declares the target.",
    ),
    (re.compile(r"(?:Offs|RelTool|pose_\w+)\(.*target of this file|:\{.*target of this file"), PLAIN_NUMBERS),
    ("no position of this file", "Write a position of the program into the move."),
    ("not a unit quaternion", "Correct its four numbers: their squares add up to 1."),
    ("confdata is not understood", "Give four whole numbers, the last from 0 to 7."),
    ("CONFIG is not understood", "Export the position again with its CONFIG."),
    ("not taught", "Teach it, or delete it."),
    ("its inverse needs six", ""),  # says itself what to give
    ("corrected twice", "Do not filter what such a controller corrects."),
    ("does not state E", "State the axis in each pose, or --track with none."),
)
SAYS_IT = re.compile(": (?:state it|state a rail|write |set it|filter )")
MOST = 3


def remedies(reasons: Iterable[str]) -> list[str]:
    """Return the remedies of reasons, each once, in the order of the reasons; the most frequent kinds only."""
    found = [remedy for remedy in map(remedy_for_reason, dict.fromkeys(reasons)) if remedy]
    return [*dict.fromkeys(found)][:MOST]


def remedy_for_reason(reason: str) -> str:
    """Return what helps; empty where the reason says it itself, or nothing is known."""
    if SAYS_IT.search(reason):
        return ""
    return next(
        (remedy for said, remedy in REMEDIES if (said in reason if isinstance(said, str) else said.search(reason))), ""
    )
