"""The moves of a RAPID program, one after another: their targets, frames, and the target before each."""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Sequence

from kilter_files.formats.programs.found import EXTERNAL_AXES, NUMBER, Program, line_number
from kilter_files.formats.programs.krl_lines import Keyed, arguments
from kilter_files.formats.programs.notations import RAPID, Flow, InForce, Place, Rigid, find_callers
from kilter_files.formats.programs.one_target import JointTarget, PoseTarget, Use, Ways, WrittenOut, note_use
from kilter_files.formats.programs.rapid_uses import TARGET, UNUSED_AXIS, RapidFrames, parse_pose_target
from kilter_files.ground.units import from_euler

SWITCHED = Keyed("conf", r"\bConf([JL])\s*+\\\s*+(On|Off)\b")
ROUTINE = Keyed("proc func trap", r"\b(?:PROC|FUNC\s+\w{1,64}|TRAP)\s+(\w{1,64})")
STARTS = re.compile(r"^[ \t]*+(?:LOCAL\s+)?(?:PROC|FUNC|TRAP|ERROR|UNDO|BACKWARD|END(?:PROC|FUNC|TRAP))\b", re.I | re.M)
STATEMENT = re.compile(r"(?:[;\n]|(?<=\w):(?!=))[^\S\n]*+([A-Za-z]\w{0,63})")  # of empty lines the last is enough
OPENED = Keyed("then else do", r"\b(?:THEN|ELSE|DO)\b\s*+([A-Za-z]\w{0,63})")
NAME = re.compile(r"[A-Za-z]\w*")
FIRST = re.compile(r"\s*+([A-Za-z]\w{0,63})")
WAYS = {
    **dict.fromkeys(("IF", "WHILE", "FOR", "TEST"), 1),
    **dict.fromkeys(("ENDIF", "ENDWHILE", "ENDFOR", "ENDTEST"), -1),
    **dict.fromkeys(("ELSE", "ELSEIF", "CASE", "DEFAULT", "RETURN", "RAISE", "RETRY", "TRYNEXT", "EXITCYCLE"), 0),
    "GOTO": None,
}
LABEL = re.compile(r"^[ \t]*+(?!(?:CASE|DEFAULT)\b)[A-Za-z]\w{0,63}[ \t]*+:(?!=)", re.I | re.M)
# instructions, and words that begin a statement, after which the arm stands where it stood
STAYS = re.compile(
    r"(?:END)?(?:MODULE|RECORD|PROC|FUNC|TRAP)|LOCAL|TASK|VAR|PERS|CONST|ALIAS|ERROR|UNDO|BACKWARD|THEN|DO|TO|STEP|FROM"
    r"|AND|OR|XOR|NOT|DIV|MOD|TRUE|FALSE|CONNECT|WITH|NOSTEPIN|SYSMODULE|Conf[JL]|AccSet|VelSet|(?:Set|Pulse|Invert)[ADG]O"
    r"|Set|Reset|Wait(?:Time|DI|DO|GI|GO|AI|AO|Until|Rob|TestAndSet)|TP(?:Write|Erase|Read\w+|Show)|UIMsgBox|Incr|Decr|Add"
    r"|Clear|Clk(?:Start|Stop|Reset)|Err(?:Write|Log|Raise)|Open|Close|Write(?:Bin|StrBin)?|Rewind|SingArea|PathAccLim"
    r"|WorldAccLim|Soft(?:Act|Deact)|CirPathMode|CornerPathWarning|Trigg(?:IO|Equip|Int|Speed|CheckIO|RampAO)"
    r"|I(?:Enable|Disable|Watch|Sleep|Delete|Signal[DAG][IO]|Timer)|Socket(?:Create|Connect|Close|Send|Receive)|GripLoad|Stop"
    r"|Break|BookErrNo|SetSysData|MotionSup|Corr(?:Con|Write|Clear|Discon)|(?:Act|Deact)Unit"
    r"|EGM(?:GetId|Reset|Setup\w+|Act\w+|Stop)"
    r"|Move(?:Abs)?[JLC]?\w*|Arc[LC]\w*|Trigg[LJC]|Search[LC]",  # moves say themselves where they go
    re.I,
)
ASSIGNED = re.compile(r"\s*+(?:[.{][^;:]{0,200})?:=")
THEN = Keyed("then", r"\bTHEN\b")
LONGEST = 500  # characters of a short IF
UNKNOWN = "UNKNOWN"


class RapidFlow:
    """Ask what is known of a place; ``text`` has its comments blanked."""

    def __init__(self, text: str) -> None:
        """Find branches, routines, calls and settings."""
        self._ever_off = {match[1].upper() for match in SWITCHED.finditer(text) if match[2].upper() == "OFF"}
        starts = [match.start() for match in STARTS.finditer(text)]
        routines = {match[1].upper() for match in ROUTINE.finditer(text)} if self._ever_off else set[str]()
        control, calls = _control(text, routines)
        self._way = Flow(sorted([*control, *((at, 0) for at, _ in calls)], key=lambda one: one[0]), starts)
        self._switched: dict[str, InForce[str]] = {}
        flow = Flow(control, starts)
        for kind in self._ever_off:
            settings: list[tuple[int, str]] = [
                (match.start(), match[2].upper()) for match in SWITCHED.finditer(text) if match[1].upper() == kind
            ]
            settings += [(at, UNKNOWN) for at in starts]  # a routine begins with what its caller left
            settings += _set_by_calls(text, _in_force(flow, settings), calls)
            self._switched[kind] = _in_force(flow, settings)

    def has_unbranched_path(self, first: int, second: int) -> bool:
        """Say whether the program always comes from one place to the other."""
        return self._way.has_unbranched_path(first, second)

    def off(self, kind: str, at: int) -> tuple[bool, ...]:
        """Return whether ConfL or ConfJ (``kind``) is off at a place: one answer, or both where the text does not say."""
        if kind not in self._ever_off:
            return (False,)
        known, value = self._switched[kind].value_in_effect(at)
        return (value == "OFF",) if known and value in ("ON", "OFF") else (False, True)


def _in_force(flow: Flow, settings: Sequence[tuple[int, str]]) -> InForce[str]:
    return InForce(flow, sorted(settings, key=lambda one: one[0]))


def _set_by_calls(text: str, own: InForce[str], calls: Sequence[tuple[int, str]]) -> list[tuple[int, str]]:
    """What calls set: the value with which a routine ends that calls no other one that sets it, else one not known."""
    owner, starts = own.flow.owner, own.flow.starts
    names = {owner(match.end()): match[1].upper() for match in ROUTINE.finditer(text)}
    ends = {name: (starts[number] - 1 if number < len(starts) else len(text)) for number, name in names.items()}
    plain = {names.get(owner(at), "") for at, value in own.settings if value != UNKNOWN}
    setting = plain | find_callers(((names.get(owner(at), ""), name) for at, name in calls), plain)
    plain -= {names.get(owner(at), "") for at, name in calls if name in setting}
    found: list[tuple[int, str]] = []
    for at, name in calls:
        if name in setting:
            known, value = own.value_in_effect(ends[name]) if name in plain and name in ends else (False, UNKNOWN)
            found.append((at, value if known and value else UNKNOWN))
    return found


def _control(text: str, routines: Collection[str]) -> tuple[list[Place], list[tuple[int, str]]]:
    """The places at which a program branches, and the calls that may move the arm; of a short IF, those of these routines."""
    control: list[Place] = [(match.start(), None) for match in LABEL.finditer(text)]
    calls: list[tuple[int, str]] = []
    then, read = [match.start() for match in THEN.finditer(text)], 0
    first = FIRST.match(text)
    begun = [*([first] if first is not None else []), *STATEMENT.finditer(text)]
    statements = dict(sorted((match.start(1), match[1].upper()) for match in (*begun, *OPENED.finditer(text))))
    for at, word in statements.items():
        if word in WAYS:
            statement = text[at : at + LONGEST].partition(";")[0]
            end = at + len(statement)
            short = word == "IF" and bisect_left(then, at) == bisect_left(then, end)  # on one line, without ENDIF
            control += [(at, 0), (end, 0)] if short else [(at, WAYS[word])]
            if short and routines:
                words = map(str.upper, NAME.findall(text, max(at, read), end))  # of an IF in an IF those that are new
                calls += [(at, one) for one in words if one in routines]
                read = max(read, end)
        elif STAYS.fullmatch(word) is None and ASSIGNED.match(text, at + len(word)) is None:
            calls.append((at, word))
    return sorted(control, key=lambda one: one[0]), calls


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
    """Targets that moves compute."""

    def __init__(
        self, program: Program, text: str, declared: Callable[[str], PoseTarget | None], named: set[int]
    ) -> None:
        """Take a program, its text with comments blanked, and what finds a declared target by what a move says.

        ``named`` are the places of the names of targets from which others are computed.
        """
        self._program, self._text, self._declared = program, text, declared
        times = Counter(match[1].lower() for pattern in (NUM, LOOP) for match in pattern.finditer(text))
        constants = {match[1].lower(): float(match[2]) for match in CONSTANT.finditer(text)}
        self._constants = {name: value for name, value in constants.items() if times[name] == 1}
        self._named = named

    def add_computed_target(self, at: int, said: str) -> PoseTarget | None:
        """Take what a move says as its goal at a place: a target, if it is computed from a declared one by numbers alone."""
        end = at + len(said)
        if self._program.text[at:end] != self._text[at:end]:  # a comment stands within
            return None
        found = self._resolve_computed_pose(at, said)
        if found is None:
            return None
        of, pose, name_at = found
        self._named.add(name_at)
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


SIX = r"\[\s*+" + r"\s*+,\s*+".join([f"({NUMBER})"] * 6) + r"\s*+\]"
PAIR = re.compile(rf"\[\s*+{SIX}\s*+,\s*+{SIX}\s*+\]")
MOVE = Keyed(
    "move arc trigg search",
    r"\b(Move\w{1,20}|Arc[LC]\d?(?:Start|End)?|Trigg[LJC]|Search[LC])(?=[\s\\])\s*+([^;]{0,2000}+)(;|\Z)",
)
TO_POSES = re.compile(r"(?:Move|Trigg|Arc)([JLC])(?:DO|AO|GO|Sync|\d?(?:Start|End))?\d?", re.I)
TO_TOOL = {"M": 2, "T": 3, "A": 4}  # arguments between goals and tool: speed and zone, a trigger, seam and weld
NAME = re.compile(r"\w+")
ID = re.compile(r"\\\s*+ID\s*+:=.*")
SENSED = re.compile(r"\\\s*+(?:Corr\b|Track\s*+:=)", re.I)
INDEX = r"\{\s*+\d+\s*+(?:,\s*+\d+\s*+){0,2}\}"
WRITTEN = re.compile(rf"\w+(?:\s*+{INDEX})?|\[.*\]", re.S)
ANY_ELEMENT = re.compile(r"(\w+)\s*+\{[^{}]{1,80}\}", re.S)  # the program computes which
WITH = re.compile(r"(\w+)\s*+((?:\\[^\\]{1,80})*)")
WORK_OBJECT = re.compile(r"\\\s*+WObj\b\s*+(?::=\s*+(\w+)\s*+(?=\\|$))?", re.I)
GOAL = re.compile(rf"(\w+)\s*+({INDEX}|\{{[^}}]{{0,80}}\}})?\s*+(?:\\.*)?", re.S)

# by the name of the variable, and there by that of the element, both in small letters
Known = dict[str, dict[str, JointTarget]]
Poses = dict[str, dict[str, PoseTarget]]


class RapidMoves:
    """Takes moves in the order of the text; ``text`` has its comments blanked.

    ``understood`` are places of goals that are known, ``moved`` the joint targets to which a move goes, ``set_anew`` names that
    the program changes, all in small letters.
    """

    def __init__(self, program: Program, text: str, known: Known, poses: Poses, set_anew: set[str]) -> None:
        """Take the targets that the program declares."""
        self._program, self._text, self._known, self._poses, self._set_anew = program, text, known, poses, set_anew
        self._arrays = {name: [*several.values()] for name, several in poses.items()}
        self._ways: dict[int, Ways] = {}  # to any target of an array
        self._said = set[int]()
        self._frames = RapidFrames(text, program.stated)
        self._flow = RapidFlow(text)
        self._last: tuple[int, JointTarget | PoseTarget] | None = None
        self.understood: set[int] = set()
        self._computed = Computed(program, text, self._declared_target, self.understood)
        self.moved: set[str] = set()

    def add_move(self, match: re.Match[str]) -> bool:
        """Take a move, or name its line; whether its targets are known."""
        said = [(match.start(2) + at, one) for at, one in arguments(match[2]) if not one.startswith("\\")]
        taken = self._to_poses(match, said) or self._to_joints(match, said)
        if not taken:
            self._last = None
        return taken

    def _to_poses(self, match: re.Match[str], said: Sequence[tuple[int, str]]) -> bool:
        """Take the robtargets of a move as moves to them."""
        way = TO_POSES.fullmatch(match[1])
        if way is None:
            self._say_unused(match, said, f"{match[1]} does not surely end at it")
            return False
        count = 2 if way[1].upper() == "C" else 1
        with_tool = count + TO_TOOL[match[1][0].upper()]
        goals = [self._goals(match[1], at, one) for at, one in said[:count]]
        what = f"{match[1]} {said[0][1][:40]}" if said else match[1]
        if len(said) <= with_tool or not all(goals):
            lacks = "lacks arguments" if len(said) <= with_tool else "goes to a target too that is not known"
            self._say_unused(match, said, f"{match[1]} {lacks}")
            return False
        held = WITH.fullmatch(said[with_tool][1])
        self.understood.update(at for at, _ in said[:count])
        if SENSED.search(match[2]):
            self._program.leave(match.start(), f"{what}: a sensor moves it beside its target")
            for several in goals:
                self._set_unused(several, "the moves to it add what a sensor says (\\Corr, \\Track)")
            self._last = None
            return True
        line = line_number(self._text, match.start())
        for several in goals:
            ways = self._ways.setdefault(id(several), {}) if len(several) > 1 else None
            for use in self._uses(match.start(), held, way[1].upper()):
                one = use if ways is None or use.follows else use._replace(near=None)  # else its configuration counts
                note_use(several, one, "", ways)
            self._program.moves_to_poses.append((line, what, several))
            self._last = (match.start(), several[0]) if ways is None else None
        return True

    def _uses(self, at: int, held: re.Match[str] | None, way: str) -> list[Use]:
        """A move to a target; one for each way in which the controller may choose the posture there."""
        work = WORK_OBJECT.search(held[2]) if held else None
        unclear = work is not None and not work[1]
        base = "its work object is not understood" if unclear else self._frames.base(work[1] if work else "wobj0")
        tool = self._frames.tool(held[1]) if held else "its tool is not understood"
        joined = self._last is not None and self._flow.has_unbranched_path(self._last[0], at)
        near = self._last[1] if self._last is not None and joined else None
        kind = "J" if way == "J" else "L"
        possible = self._flow.off(kind, at)
        is_off = f"Conf{kind} \\Off {'may be' if len(possible) > 1 else 'is'} in force"
        return [Use(base, tool, near, way != "J", is_off if off else "") for off in possible]

    def _say_unused(self, match: re.Match[str], said: Sequence[tuple[int, str]], why: str) -> None:
        """Note of the targets of a move that is left why it is: nothing else may tell what becomes of them."""
        for _, one in said if self._arrays else ():
            name = NAME.match(one)
            several = self._arrays.get(name[0].lower()) if name else None
            if several is not None:
                self._set_unused(several, f"{why} (line {line_number(self._text, match.start())})")

    def _set_unused(self, several: Sequence[PoseTarget], why: str) -> None:
        """Say why poses are left to which no move surely goes; of an array the first move says it."""
        if len(several) < 2 or id(several) not in self._said:
            self._said.add(id(several))
            for pose in several:
                pose.unused = why

    def _goals(self, move: str, at: int, said: str) -> list[PoseTarget]:
        """The target that a move says, all elements of an array of which it computes the index, or none."""
        said = ID.sub("", said).strip()
        if CALL.fullmatch(said):
            computed = self._computed.add_computed_target(at, said)
            return [] if computed is None else [computed]
        if said[:1] == "[":
            written = TARGET.match(self._text, at)
            return (
                [self._program.add_pose(parse_pose_target(self._program, move, written), counted=False)]
                if written
                else []
            )
        if not WRITTEN.fullmatch(said):
            element = ANY_ELEMENT.fullmatch(said)
            return self._arrays.get(element[1].lower(), []) if element is not None else []
        found = self._declared_target(said)
        return [] if found is None else [found]

    def _declared_target(self, said: str) -> PoseTarget | None:
        """The declared robtarget of this name, or element of an array."""
        said = "".join(said.lower().split())
        return self._poses.get(said.partition("{")[0], {}).get(said)

    def _to_joints(self, match: re.Match[str], arguments_said: Sequence[tuple[int, str]]) -> bool:
        """Take the joints of a move, or name its line."""
        program, joints = self._program, match[1].lower() == "moveabsj"
        at, said = arguments_said[0] if arguments_said else (match.start(2), "")
        written = PAIR.match(self._text, at) if joints else None
        goal = GOAL.fullmatch(said)
        targets = self._known.get(goal[1].lower(), {}) if joints and goal is not None else {}
        target = None
        if written is not None:
            target = take_joints(program, match[1], written)
        elif goal is not None and targets:
            self.moved.add(goal[1].lower())
            target = targets.get("".join(f"{goal[1]}{goal[2] or ''}".lower().split()))
        else:
            program.leave(match.start(), f"{match[1]} {said[:40]}: no target of this file")
            program.moves += [None] if joints else []
            return False
        program.moves.append(target)
        sure = target is not None and (written is not None or (goal and goal[1].lower()) not in self._set_anew)
        self._last = (match.start(), target) if target is not None and sure else None
        self.understood.add(at)
        return True


def take_joints(program: Program, name: str, pair: re.Match[str]) -> JointTarget:
    """Take six joints and six external axes."""
    if any(value != 0 and abs(value) < UNUSED_AXIS for value in map(float, pair.groups()[6:])):
        program.warn(EXTERNAL_AXES)
    numbers = [*zip(pair.groups()[:6], pair.regs[1:7], strict=True)]
    return program.add(name, numbers, line=line_number(program.text, pair.start()))
