"""The one list of dialects of robot programs; a new one is one more line and a module that states it."""

from __future__ import annotations

import re
from bisect import bisect_right
from dataclasses import dataclass
from functools import lru_cache

from kilter_files.formats.programs import found as table
from kilter_files.formats.programs import krl, rapid, urscript
from kilter_files.formats.programs.found import DATA, EXTERNAL_AXES, NUMBER, Dialect, Mark, Program, line_number, sign
from kilter_files.formats.programs.notations import FANUC, Frame
from kilter_files.formats.programs.one_target import JointTarget, PoseTarget, Span, Spans, Use
from kilter_files.formats.programs.poses.postures import Config, frame_on_track

LINE = re.compile(r"^[ \t]*+\d{0,9}+[ \t]*+:\s*+(?!!|//|--)([^;\n]*)", re.M)
ELEMENT = re.compile(
    rf"PR\[\s?(\d+)\s?(?::[^\]\n]{{0,80}})?,\s?([1-6])\s?(?::[^\]\n]{{0,80}})?\]\s*+=\s*+\(?\s*+({NUMBER})\s*+\)?\s*+"
)
REGISTER = re.compile(r"PR\[\s?(\d{1,3})?")  # another statement that may change one
SET = re.compile(
    r"(?:\b|\$MN|\.\$)U(FRAME|TOOL)\s?(?:\[((?:[^\[\]\n]|\[[^\[\]\n]{0,20}\]){1,40})\]|(?<=\$UFRAME)|(?<=\$UTOOL))[.$\w]{0,20}\s?=\s?([^;\n]*)",
    re.I,
)
FROM_REGISTER = re.compile(r"PR\[\s?(\d+)\s?(?::[^\]\n]{0,80})?\]\s*+")
NUMBERED = re.compile(r"\s?(\d+)\s?(?::[^\]\n]*)?")
WAY = re.compile(r"\s*+(?:LBL|JMP|IF|ELSE|ENDIF|SELECT|FOR|ENDFOR|CALL|RUN|[JLCAS]\s+P)", re.I)
BRANCHES = re.compile(r"\b(?:JMP|CALL)\b", re.I)


@dataclass(frozen=True)
class Setting:
    """What sets UFRAME or UTOOL (``name``): of which ``number`` (empty: of any), to which ``numbers`` where these are known.

    ``first`` says that the program surely sets it before it moves, branches or calls.
    """

    name: str
    number: str
    numbers: tuple[float, ...] | None
    first: bool


@lru_cache(maxsize=4)
def parse_frame_settings(text: str) -> tuple[Setting, ...]:
    """Return what a program sets, in its order."""
    registers: dict[str, dict[int, float]] = {}
    found: list[Setting] = []
    first = True
    for line in LINE.finditer(text):
        said = line[1]
        first = first and WAY.match(said) is None and BRANCHES.search(said) is None
        element, setting = ELEMENT.fullmatch(said), SET.search(said)
        if element is not None:
            registers.setdefault(str(int(element[1])), {})[int(element[2])] = float(element[3])
        elif setting is not None:
            source = FROM_REGISTER.fullmatch(setting[3])
            values = registers.get(str(int(source[1])), {}) if source is not None and first else {}
            numbers = tuple(values[k] for k in sorted(values)) if len(values) == 6 else None
            plain = None if "$" in setting[0] else NUMBERED.fullmatch(setting[2] or "")
            number = "" if plain is None else str(int(plain[1]))
            found.append(Setting(f"U{setting[1].upper()}", number, numbers, first))
        elif (changed := REGISTER.match(said)) is not None:
            registers = {} if changed[1] is None else {k: v for k, v in registers.items() if k != str(int(changed[1]))}
    return tuple(found)


NULL = Frame(FANUC, (0.0,) * 6)
PART = re.compile(rf"\b([XYZWPR]|E\d)\s{{0,9}}=\s{{0,9}}({NUMBER})\s{{0,9}}(mm|deg)")
FRAME_NUMBER = re.compile(r"\b(UF|UT)\s?:\s{0,9}(\w{1,3})")
TURN = r"\s{0,9}(-?\d)\s{0,9}"
CONFIG = re.compile(rf"\bCONFIG\s?:\s?'\s{{0,9}}([NF])\s{{1,9}}([UD])\s{{1,9}}([TB])\s{{0,9}},{TURN},{TURN},{TURN}'")
TRACKS = re.compile(r"^[ \t]*+LINE_TRACK_SCHEDULE(?:_NUMBER)?\s*+:\s*+0*[1-9]", re.I | re.M)
OFFSET = re.compile(r"\b(?:Offset|Tool_Offset|INC|VOFFSET)\b", re.I)
NOT_TAUGHT = re.compile(r"=\s{0,9}\*{3,}")  # what a controller writes of a position that nobody taught
OTHER_FRAME = re.compile(r"\b(?:RTCP|COORD)\b", re.I)


def parse_pose_target(program: Program, number: str, at: int, span: Span) -> PoseTarget:
    """Read position ``number``, which begins at ``at``; ``span`` holds what its first motion group says."""
    text = program.text
    parts = {match[1]: match for match in PART.finditer(text, *span)}
    missing = [name for name in FANUC.names if name not in parts]
    config = CONFIG.search(text, *span)
    problem = f"without {', '.join(missing)}" if missing else "" if config else "its CONFIG is not understood"
    problem = "it is not taught (********)" if NOT_TAUGHT.search(text, *span) else problem
    axes = {name: float(match[2]) for name, match in parts.items() if name[0] == "E"}
    root, why = frame_on_track(program.stated, FANUC, axes)
    problem = problem or why
    if _tracks_line(text):
        problem = problem or "it moves with what the program tracks (LINE_TRACK)"
    whole = [parts[name] for name in FANUC.names if name in parts]
    numbers = tuple(float(match[2]) for match in whole)
    pose = PoseTarget(
        f"P[{number}]", line_number(text, at), FANUC, numbers, tuple(match.span(2) for match in whole), problem=problem
    )
    pose.whole, pose.root = span, root
    if config is not None:
        turns = (int(config[4]), int(config[5]), int(config[6]))
        spans = (config.span(4), config.span(5), config.span(6))
        pose.configuration = Config(config[1] == "F", config[2] == "U", config[3] == "T", turns, spans)
    named = {match[1]: match[2] for match in FRAME_NUMBER.finditer(text, *span)}
    base, tool = (_frame(program, which, named.get(short)) for which, short in (("base", "UF"), ("tool", "UT")))
    pose.uses.append(Use(base if isinstance(base, str) else (base,), tool))
    return pose


@lru_cache(maxsize=4)
def _tracks_line(text: str) -> bool:
    return TRACKS.search(text) is not None


@lru_cache(maxsize=4)
def _settings_by_name_and_number(text: str) -> dict[tuple[str, str], list[Setting]]:
    found: dict[tuple[str, str], list[Setting]] = {}
    for one in parse_frame_settings(text):
        found.setdefault((one.name, one.number), []).append(one)
    return found


def _frame(program: Program, which: str, number: str | None) -> Frame | str:
    """The frame of a number: the one that the program sets, else the stated one."""
    stated = program.stated.bases if which == "base" else program.stated.tools
    found = stated.get(number or "") or stated.get("")
    name = "UFRAME" if which == "base" else "UTOOL"
    by_number = _settings_by_name_and_number(program.text)
    settings = [one for said in {number or "", ""} for one in by_number.get((name, said), [])]
    if settings:
        one = settings[0]
        if len(settings) > 1 or not one.first or not one.number:
            return f"the program sets {name}: set it once, by a register filled with six numbers before any move"
        if one.numbers is None and found is None:
            return f"the program sets {name}[{number}] by numbers it does not hold: state it, --{which} {number}=X,Y,Z,W,P,R"
        found = one.numbers or found
    if found is not None:
        return Frame(FANUC, found)
    if number == "0":
        return NULL
    said = f"{'UF' if which == 'base' else 'UT'} : {number or '?'}"
    return f"{said} is not in this program: state it, --{which} {number or ''}{'=' if number else ''}X,Y,Z,W,P,R"


POSITION = re.compile(r"\bP\[\s?(\d+)\s?(?::[^\]\n]{0,80})?\]\s?\{([^}]{0,2000}+)(\};?|\Z)")
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
            program.moves_to_poses.append((line_number(text, match.start(1)), match[1], (poses[number],)))
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
    spans = [(at, ends[k] if (k := bisect_right(ends, at)) < len(ends) else len(text)) for at in starts]
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
    named: dict[tuple[int, str, bool], re.Match[str]] = {}  # the first use of each position in a line
    for match in NAMES.finditer(text):
        if (match[1] in known or match[1] in poses) and match.start() not in own:
            named.setdefault((line_number(text, match.start()), match[1], bool(match[2])), match)
    for match in named.values():
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


# in the order in which a text is tried
DIALECTS: dict[str, Dialect] = {
    dialect.name: dialect for dialect in (rapid.DIALECT, DIALECT, krl.DIALECT, urscript.DIALECT, table.DIALECT)
}
