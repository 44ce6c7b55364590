"""FANUC's LS: positions that are shown as joints or as poses; other motion groups stay, registers are named."""

from __future__ import annotations

import re

from kilter_files.formats.programs.found import DATA, EXTERNAL_AXES, NUMBER, Dialect, Mark, Program, line_number, sign
from kilter_files.formats.programs.one_target import JointTarget, PoseTarget, Spans
from kilter_files.formats.programs.poses.fanuc import NOT_TAUGHT, OFFSET, OTHER_FRAME, parse_pose_target

POSITION = re.compile(r"\bP\[\s?(\d+)\s?(?::[^\]\n]{0,80})?\]\s?\{([^}]{0,2000})(\};?|\Z)")
AXIS = re.compile(r"\bJ(\d)\s?=\s{0,9}([^\s,]+)\s{0,9}(deg|mm)?")
FURTHER = re.compile(rf"\b(?:E\d\s?=\s{{0,9}}({NUMBER})|J\d\s?=\s{{0,9}}({NUMBER})\s{{0,9}}mm)")
OTHER_GROUP = re.compile(r"\bGP[2-9]\s?:")
MOVE = re.compile(
    r"^[ \t]*+(?:\d{0,9}+[ \t]*+:\s*+(?=[JLCAS]\s)|:\s*+(?=P)(?![^\n]{0,99}\]\s*+=))"
    r"((?:[JLCAS]\s+)?(P|PR)\[\s*+(\d{1,9}+|[^\]]{1,80})[^\]\n]{0,80}+\])([^\n]{0,200})",
    re.M,
)
NOTHING = re.compile(r"^[ \t]*+\d{0,9}+[ \t]*+:\s*+(?:!|//|--)[^\n]*|\"[^\"\n]*\"", re.M)  # remarks, and names
NAMES = re.compile(r"(?<![A-Z\w])P\[\s?(\d+)\s?(?:,\s?\w{1,9}\s?)?(?::[^\]\n]{0,80})?\]([ \t]*+=(?!=))?")
ELSEWHERE = re.compile(
    r"^[ \t]*+\d{0,9}+[ \t]*+:\s*+([JLCAS]\s+(?!PR?\[)\w[^;\n]{0,80})", re.M
)  # as PAL_3[A_1] of a pallet
# between which what the robot touched or senses displaces every position
DISPLACING = r"^[ \t]*+\d{0,9}+[ \t]*+:\s*+(?:Touch Offset|MP Offset|Track)"
TOUCH = re.compile(rf"{DISPLACING}(?! End)\b", re.I | re.M)
TOUCH_END = re.compile(rf"{DISPLACING} End\b", re.I | re.M)
LONGEST = 600
ANY = "any"  # of a move that computes which
GROUPS = "motion groups beside GP1 are left out: what they move belongs to the base or the tool"


def find(program: Program) -> None:
    """Find the positions.

    Raises:
        FileError: one whose joints are not numbers in deg.

    """
    text = program.text
    program.least_decimals = 3
    known: dict[str, JointTarget] = {}
    poses: dict[str, PoseTarget] = {}
    for match in POSITION.finditer(text):
        other = OTHER_GROUP.search(match[2])
        program.warnings += [GROUPS] if other and GROUPS not in program.warnings else []
        span = (match.start(2), match.start(2) + other.start() if other else match.end(2))
        axes = [*AXIS.finditer(text, *span)]
        arm = [axis for axis in axes if axis[3] != "mm"]  # an axis in mm moves the arm's base, or a tool
        not_taught = NOT_TAUGHT.search(text, *span) is not None
        if not arm or not_taught:
            pose = parse_pose_target(program, match[1], match.start(), span)
            poses[match[1]] = program.add_pose(pose, counted=not not_taught)
            if not_taught:
                program.unknown.append((pose.line, f"{pose.name} is not taught", "Teach it, or delete it."))
            continue
        wrong = [part for part in arm if not re.fullmatch(NUMBER, part[2]) or part[3] != "deg"]
        if wrong or match[3][:1] != "}" or [int(part[1]) for part in arm] != [*range(1, len(arm) + 1)]:
            what = f"P[{match[1]}] is not J1, J2, ... with numbers in deg"
            raise program.refuse(match.start(), what, "Correct the position, or export it again.")
        if any(float(value[1] or value[2]) for value in FURTHER.finditer(text, match.start(2), match.end(2))):
            program.warn(EXTERNAL_AXES)
        numbers = [(part[2], part.span(2)) for part in arm]
        known[match[1]] = program.add(f"P[{match[1]}]", numbers, line=line_number(text, match.start()))
    gone = _follow(program, known, poses)
    _name_other_uses(program, known, poses, gone)
    program.notes.append("FANUC reads J3 against the horizontal: the robot needs --follows J3=J2")


def _follow(program: Program, known: dict[str, JointTarget], poses: dict[str, PoseTarget]) -> set[str]:
    """Take the moves of the program, and name those that go beside their position, or to one that it does not hold.

    Returns:
        The numbers of the positions to which a move may go.

    """
    text, moves = program.text, list(MOVE.finditer(program.text))
    beside: set[str] = set()
    plain: set[str] = set()
    touched = _touch_displaced_spans(text)
    for match in moves:
        end = text.find(";", match.start(4), match.start(4) + LONGEST)  # an instruction may go on in further lines
        said = text[match.start(4) : end] if end >= 0 else match[4]
        number = match[3] if match[2] == "P" else ""
        program.moves += [known.get(number)] if number else []
        number = ANY if match[2] == "P" and not number.isdigit() else number
        displaced = OFFSET.search(said) is not None or match.start() in touched
        (beside if displaced else plain).add(number)
        if number not in known and number not in poses:
            program.leave(match.start(1), f"{match[1]}: no position of this file")
        elif displaced:
            program.leave(match.start(1), f"{match[1]}: moves beside it")
        elif number in poses:
            program.moves_to_poses.append((line_number(text, match.start(1)), match[1], poses[number]))
        if number in poses and OTHER_FRAME.search(said):
            poses[number].problem = poses[number].problem or "a move to it has another frame (RTCP, COORD)"
    for match in ELSEWHERE.finditer(text):
        program.leave(match.start(1), f"{match[1].strip()[:40]}: no position of this file")
    rest = {*known, *poses} - beside - plain  # to which only moves go that compute which
    only_beside = beside - plain | (rest if ANY in beside and ANY not in plain else set())
    _leave(program, known, poses, only_beside, "the moves to it have an offset")
    return beside | plain | (rest if ANY in beside | plain else set())


def _touch_displaced_spans(text: str) -> Spans:
    """The parts of a program whose positions are all displaced by what the robot touched."""
    ends = [match.start() for match in TOUCH_END.finditer(text)]
    starts = [match.start() for match in TOUCH.finditer(text)]
    spans = [(at, next((end for end in ends if end > at), len(text))) for at in starts]
    return Spans([span for k, span in enumerate(spans) if k == 0 or span[1] != spans[k - 1][1]])


def _leave(
    program: Program, known: dict[str, JointTarget], poses: dict[str, PoseTarget], numbers: set[str], why: str
) -> None:
    program.leave_targets({known[number]: why for number in numbers & known.keys()})
    for number in numbers & poses.keys():
        poses[number].problem = poses[number].problem or why


def _name_other_uses(
    program: Program, known: dict[str, JointTarget], poses: dict[str, PoseTarget], gone: set[str]
) -> None:
    """Name the lines that use a position otherwise than as the goal of a move."""
    text = NOTHING.sub(lambda match: " " * len(match[0]), program.text)
    own = Spans(sorted(match.span() for pattern in (POSITION, MOVE) for match in pattern.finditer(program.text)))
    for match in NAMES.finditer(text):
        if match.start() in own or (match[1] not in known and match[1] not in poses):
            continue
        program.leave(
            match.start(), f"P[{match[1]}]: {'changed' if match[2] else 'used otherwise than as the goal of a move'}"
        )
        if match[2] and match[1] in poses:
            poses[match[1]].problem = poses[match[1]].problem or "the program changes it"
        if match[1] not in gone:
            _leave(program, known, poses, {match[1]}, DATA)


DIALECT = Dialect(
    "FANUC LS",
    (".ls",),
    sign(r"^[ \t]*+/(?:PROG|POS)\b"),
    find,
    "Show the positions as joints on the pendant (REPRE)",
    (r"^[ \t]*+/PROG\b", r"^[ \t]*+/END\b", "/END"),
    complete=True,
    # A remark holds 32 characters.
    mark=Mark("{number:>4}:  !{said} ;", re.compile(r"\s*+/POS\b", re.I), most=15),
)
