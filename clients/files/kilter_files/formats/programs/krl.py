"""KUKA's KRL: axis targets and poses in braces, of ``.src`` and ``.dat``; external axes stay."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from kilter_files.formats.programs.found import (
    DATA,
    EXTERNAL_AXES,
    NUMBER,
    Dialect,
    Mark,
    Program,
    blank_strings_and_comments,
    line_number,
    sign,
)
from kilter_files.formats.programs.krl_lines import (
    MOTIONS,
    Tailed,
    not_kept,
    reassigned_or_passed_variables,
    used_as_data,
)
from kilter_files.formats.programs.notations import Variable
from kilter_files.formats.programs.one_target import JointTarget, PoseTarget, Span, Spans, Use, Ways, note_use
from kilter_files.formats.programs.poses.krl import (
    COMPUTED_INDEX,
    NAME,
    POSE,
    KrlFrames,
    key,
    note_changes,
    note_external,
    parse_pose_target,
)

AXES = Tailed(
    rf"(?:\b({NAME})\s{{0,9}}=\s{{0,9}})?",
    r"\{\s{0,9}(?:(?:E6)?AXIS\s{0,9}:)?\s{0,9}(A\d\s[^{}]{0,500})(\}|\Z|\{)",
)
AXIS = re.compile(rf"\s{{0,9}}([AE])(\d)\s{{1,9}}({NUMBER})\s{{0,9}}", re.I)
SIX_AXES = re.compile(",".join(rf"\s{{0,9}}A{k}\s{{1,9}}({NUMBER})\s{{0,9}}" for k in range(1, 7)), re.I)  # as most are
CELL = re.compile(r"[^,]+")
ARM_AXIS = re.compile(r"\bA\d\s", re.I)
MOVE = re.compile(rf"^[ \t]*+({MOTIONS})(?:[ \t]+|(?=\{{))([^\r\n]+)", re.I | re.M)
GOAL = re.compile(rf"[ \t]*+(\{{[^{{}}]{{0,500}}\}}|{NAME}(?![\w.\[]))[ \t]*+(?=,|\r|\n|$|[A-Za-z])")
ANY_ELEMENT = re.compile(
    r"[ \t]*+(\w{1,64})\[[^\]\r\n]{1,60}\][ \t]*+(?=\r|\n|$|[A-Za-z])"
)  # the program computes which
WHERE_IT_STANDS = re.compile(
    r"[ \t]*+\$(?:AXIS|POS)_ACT[ \t]*+(?:C_\w{1,9}[ \t]*+){0,2}", re.I
)  # the start of most programs
COMMA = re.compile(r"[ \t]*+,")
LINE_END = re.compile(r"\n")
ENDS_BY_ANGLE = "arcs with CA end beside their targets: there the path is the controller's own"
OF_LOAD = re.compile(r"[{,][ \t]*+(?:CM|J)[ \t]*+\Z", re.I)  # centre of mass and inertia
SYSTEM = re.compile(r"\$\w{1,64}[ \t]*+(?:\[[^\]\r\n]{0,60}\])?[ \t]*+=[ \t]*+\Z")
ANGLE = re.compile(r",[ \t]*+CA[ \t]+([^\r\n;]{1,40}?)(?=[ \t]+(?:C_\w|WITH\b)|[ \t]*+\Z)", re.I)


@dataclass
class _Known:
    """What a program moves to: by name, by place where it is written into a move (None: left), and what came last.

    ``joints`` are the values that a name is given along the text, with their places; ``given`` names may have others too.
    ``moved`` are names to which a motion goes, without their index, ``arrays`` all that an array holds, by its name.
    """

    joints: dict[str, list[tuple[int, JointTarget]]]
    poses: dict[str, PoseTarget]
    given: set[str] = field(default_factory=set)
    moved: set[str] = field(default_factory=set)
    written: dict[int, JointTarget | PoseTarget | None] = field(default_factory=dict)
    last: tuple[int, JointTarget | PoseTarget] | None = None
    variables: dict[str, Variable[JointTarget]] = field(default_factory=dict)
    arrays: dict[str, _Array] = field(default_factory=dict)

    def gather(self, frames: KrlFrames) -> None:
        """Gather what is asked of names and arrays: all targets are read."""
        self.variables = {name: Variable(frames.way, values) for name, values in self.joints.items()}
        for name, values in self.joints.items():
            self.arrays.setdefault(name.partition("[")[0], _Array()).joints.extend(target for _, target in values)
        for name, pose in self.poses.items():
            self.arrays.setdefault(name.partition("[")[0], _Array()).poses.append(pose)


@dataclass
class _Array:
    """The targets of an array; ``ways`` are the moves to any of them, ``computed`` that a move is left that computes which."""

    joints: list[JointTarget] = field(default_factory=list)
    poses: list[PoseTarget] = field(default_factory=list)
    ways: Ways = field(default_factory=dict)
    visited: bool = False
    computed: bool = False


def find(program: Program) -> None:
    """Find the targets, and name the lines that may move the arm otherwise.

    Raises:
        FileError: axes of a target are missing, are other than numbers, or it is cut.

    """
    text = blank_strings_and_comments(program.text, ";")
    moves, lists = list(MOVE.finditer(text)), list(AXES.finditer(text))
    relative = [match.span() for match in moves if match[1].upper().endswith("_REL")]
    declared = program.beside
    known = _Known({}, {})
    if declared is not None:
        known.joints |= {target.name.upper(): [(-1, target)] for target in declared.targets}
        known.poses |= {pose.name.upper(): pose for pose in declared.cartesian}
    known.given = reassigned_or_passed_variables(text)
    away, inline = Spans(relative), Spans([match.span(2) for match in moves])
    count = max((len(one.joints_deg) for one in declared.targets), default=0) if declared is not None else 0
    count = max([count, *(len(ARM_AXIS.findall(match[2])) for match in lists)])
    for match in lists:
        at = match.start()
        if at in away:
            continue
        opens = match.start() if not match[1] else text.index("{", at)
        if SYSTEM.search(text, max(0, opens - 199), opens):
            program.leave(at, f"{match[0][:40]}: a variable of the system, no target")
            continue
        if not match[1] and at not in inline and not text[max(0, at - 99) : at].rstrip(" \t").endswith("="):
            program.leave(at, f"{match[0][:40]}: axes within another list")
            continue
        target = known.written[at] = _add_axis_target(program, match, count)
        if target is not None and match[1]:
            known.joints.setdefault(key(match[1]), []).append((at, target))
    frames = KrlFrames(program, text)
    _take_poses(program, text, moves, relative, frames, known)
    known.gather(frames)
    for match in moves:
        _follow(program, match, known, frames)
    _leave_data(program, text, known)
    note_changes(text, known.poses)
    note_external(program)
    inside = {found.end() for match in lists for found in LINE_END.finditer(text, *match.span())}
    program.left += not_kept(text, known.joints, known.poses, inside)


def _leave_data(program: Program, text: str, known: _Known) -> None:
    """Leave axes to which no motion goes and which the program uses otherwise: as an amount, or one by one."""
    data = used_as_data(text) - known.moved
    reasons = {
        target: DATA for name, values in known.joints.items() if name.partition("[")[0] in data for _, target in values
    }
    for one in (program, program.beside):
        if one is not None:
            one.leave_targets(reasons)


def _take_poses(
    program: Program,
    text: str,
    moves: list[re.Match[str]],
    relative: list[Span],
    frames: KrlFrames,
    known: _Known,
) -> None:
    moved = Spans([match.span(2) for match in moves])
    away = Spans(relative)
    seen: Mapping[str, PoseTarget] = dict(known.poses)
    for match in POSE.finditer(text):
        at = text.index("{", match.start())
        if at in frames.literals or OF_LOAD.search(text, max(0, at - 9), at):
            continue
        if at in away or text[max(0, at - 99) : at].rstrip(" \t").endswith(":"):
            program.poses.append(("a move", line_number(program.text, at)))
            continue
        inline = match.start() in moved
        pose = program.add_pose(parse_pose_target(program, match), counted=bool(match[1] or match[3] or inline))
        if inline:
            known.written[at] = pose
            continue
        name = pose.name.upper()
        if name in seen or name in known.poses:
            pose.problem = known.poses[name].problem = "the program changes it"
        known.poses[name] = pose


def _follow(program: Program, match: re.Match[str], known: _Known, frames: KrlFrames) -> None:
    """Take the targets of a motion as moves to them, or name its line."""
    if match[1].upper().endswith("_REL"):
        program.leave(match.start(), f"{match[1]} {match[2].strip()[:40]}: a relative move")
        program.moves += [] if match[2].lstrip()[:1] == "{" else [None]
        known.last = None
        return
    if WHERE_IT_STANDS.fullmatch(match[2]):
        known.last = None
        return
    first = GOAL.match(match[2])
    if first is None and _go_to_elements(program, match, known, frames):
        return
    goals = [first]
    comma = COMMA.match(match[2], first.end()) if first is not None and "CIRC" in match[1].upper() else None
    if comma is not None:
        goals.append(GOAL.match(match[2], comma.end()))
    for goal in goals:
        _record_motion(program, match, goal, known, frames)
    angle = ANGLE.search(match[2]) if "CIRC" in match[1].upper() else None
    if angle is not None and not _whole_turns(angle[1]):
        program.warn(ENDS_BY_ANGLE)
        known.last = None


def _whole_turns(angle: str) -> bool:
    """Whether an arc ends where it began."""
    return re.fullmatch(NUMBER, angle) is not None and float(angle) % 360.0 == 0.0


def _record_motion(
    program: Program, match: re.Match[str], goal: re.Match[str] | None, known: _Known, frames: KrlFrames
) -> None:
    target: JointTarget | PoseTarget | None = None
    if goal is not None:
        at = match.start(2) + goal.start(1)
        if goal[1][0] == "{":
            target = known.written.get(at)
        else:
            name = key(goal[1])
            known.moved.add(name.partition("[")[0])
            target = _joints_assigned_before_place(known, name, at) or known.poses.get(name)
    said = f"{match[1]} {match[2].strip()[:40]}"
    if target is None:
        where = " or of its .dat" if program.beside is not None else f": {program.path.stem}.dat is not beside it"
        if goal is None or match.start(2) + goal.start(1) not in known.written:
            program.leave(match.start(), f"{said}: not a target of this file{where}")
            known.moved |= _note_computed_index(match[2], known)
        program.moves += [] if match[2].lstrip()[:1] == "{" else [None]
    elif isinstance(target, JointTarget):
        program.moves.append(target)
    else:
        joined = known.last is not None and frames.way.has_unbranched_path(known.last[0], match.start())
        near = known.last[1] if known.last is not None and joined else None
        _use(program, match, (target,), near, frames)
    named = isinstance(target, JointTarget) and goal is not None and goal[1][0] != "{"
    sure = not named or goal is None or _is_sure(known, key(goal[1]), match.start())
    known.last = None if target is None or not sure else (match.start(), target)
    program.visits += [] if target is None else [target]


def _go_to_elements(program: Program, match: re.Match[str], known: _Known, frames: KrlFrames) -> bool:
    """Take a motion to an element that the program computes as one to each element; whether there are any."""
    array = ANY_ELEMENT.match(match[2])
    name = array[1].upper() if array is not None else ""
    found = known.arrays.get(name)
    if found is None:
        return False
    known.moved.add(name)
    program.moves += [None] if found.joints else []
    if found.poses:
        _use(program, match, found.poses, None, frames, found.ways)
    known.last = None
    program.visits += [] if found.visited else [*found.joints, *found.poses]
    found.visited = True
    return True


def _note_computed_index(said: str, known: _Known) -> set[str]:
    """Note poses of arrays to one of which a move goes that computes which; return the names of such arrays."""
    names = {match[1].upper() for match in COMPUTED_INDEX.finditer(said)}
    for found in (known.arrays[name] for name in names if name in known.arrays):
        for pose in () if found.computed else found.poses:
            pose.problem = pose.problem or "a move to it has a computed index"
        found.computed = True
    return names


def _use(
    program: Program,
    match: re.Match[str],
    poses: Sequence[PoseTarget],
    near: JointTarget | PoseTarget | None,
    frames: KrlFrames,
    ways: Ways | None = None,
) -> None:
    """Note a motion to a pose, or to one of several: ``ways`` are how others went to these."""
    straight = "PTP" not in match[1].upper()
    problem = (
        "" if not straight or frames.keeps_orientation(match.start()) else "its orientation is not kept ($ORI_TYPE)"
    )
    note_use(poses, Use(*frames.base_and_tool(match.start()), near, straight), problem, ways)
    what = f"{match[1]} {match[2].strip()[:40]}"
    program.moves_to_poses.append((line_number(program.text, match.start()), what, poses))


def _joints_assigned_before_place(known: _Known, name: str, at: int) -> JointTarget | None:
    """The joints that a name was given last before a place, by the text."""
    values = known.variables.get(name)
    return None if values is None else values.setting_in_force(at)


def _is_sure(known: _Known, name: str, at: int) -> bool:
    """Whether the arm surely stands at the joints of a name after a motion to it: no other value may be in force."""
    values = known.variables.get(name)
    if name.partition("[")[0] in known.given:
        return False
    return values is None or values.chosen(at) == values.setting_in_force(at)


def _add_axis_target(program: Program, match: re.Match[str], count: int) -> JointTarget | None:
    """Take a list of axes, in any order; one that lacks some, or computes them, is named and left: the others stay."""
    name = "".join((match[1] or "").split()) or "axis target"
    six = SIX_AXES.fullmatch(match.string, *match.span(2))
    if six is not None and count == 6 and match[3] == "}":
        numbers = [*zip(six.groups(), six.regs[1:], strict=True)]
        return program.add(name, numbers, line=line_number(program.text, match.start()))
    parts = [AXIS.fullmatch(match[2], at.start(), at.end()) for at in CELL.finditer(match[2])]
    arm = sorted((part for part in parts if part is not None and part[1].upper() == "A"), key=lambda part: part[2])
    axes = [int(part[2]) for part in arm]
    declared = program.path.suffix.lower() == ".dat"
    if match[3] != "}" or (None in parts and declared):
        what = f"{name} is not A1, A2, ... with numbers"
        raise program.refuse(match.start(), what, "Correct it, or export it again.")
    if None in parts or axes != [*range(1, count + 1)]:
        what = f"{name} computes axes" if None in parts else f"{name} lacks axes: it has {axes}"
        program.leave(match.start(), what)
        program.unknown.append((line_number(program.text, match.start()), what, "Correct it, or export it again."))
        return None
    if any(part is not None and part[1].upper() == "E" and float(part[3]) for part in parts):
        program.warn(EXTERNAL_AXES)
    at = match.start(2)
    numbers = [(part[3], (at + part.start(3), at + part.end(3))) for part in arm]
    return program.add(name, numbers, line=line_number(program.text, match.start()))


DIALECT = Dialect(
    "KRL",
    (".src", ".dat"),
    sign(r"\{[^{}]{0,40}\bA1\s+[-+\d.]|\bE6(?:AXIS|POS)\s+\w+\s*+(?:\[|=)"),
    find,
    "Store E6AXIS: $AXIS_ACT holds the joints where the arm stands",
    (r"^[ \t]*+DEFDAT\b", r"^[ \t]*+ENDDAT\b", "ENDDAT"),
    pair=(".src", ".dat"),
    mark=Mark(";{said}", re.compile(r"[ \t]*+END(?:FCT|DAT)?\b(?![ \t]*+=)", re.I)),
)
