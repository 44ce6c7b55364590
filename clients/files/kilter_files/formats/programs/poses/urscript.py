"""URScript's poses, in place or by a variable: frame, tool, and the target before each, which says the joints."""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections.abc import Mapping
from functools import lru_cache

from kilter_files.formats.programs.found import NUMBER, Program, line_number
from kilter_files.formats.programs.krl_lines import Keyed, arguments, nested
from kilter_files.formats.programs.notations import (
    URSCRIPT,
    Flow,
    Frame,
    InForce,
    Variable,
    calls_of_own,
    calls_that_set,
)
from kilter_files.formats.programs.one_target import JointTarget, PoseTarget, Span, Spans, Use

NULL = Frame(URSCRIPT, (0.0,) * 6)
SIX = re.compile(r"p\s?\[\s*+" + r"\s*+,\s*+".join([f"({NUMBER})"] * 6) + r"\s*+\]")
INVERSE = re.compile(r"get_inverse_kin[ \t]{0,9}\(")
IN_FRAME = re.compile(r"pose_trans[ \t]{0,9}\(")
CALL = re.compile(r"\b(move[jlpc])[ \t]{0,9}\(")
SET_TCP = Keyed("set_tcp", r"\bset_tcp[ \t]{0,9}\(", 0)
CLOSED = re.compile(rf"{nested('()[]', 6)}[)\]]")
MOST_INSIDE, BEGINNING = 2000, 200  # characters
# functions that only reckon, set or tell, and words before a bracket
KNOWN = re.compile(
    r"(?:set|get|pose|is|force|socket|rtde|rpc|to|read|write|str|tool|path|wrench|point|integer|modbus)_\w{1,64}"
    r"|interpolate_pose|textmsg|popup|norm|length|dot|cross|transpose|inv|if|elif|while|and|or|not|return|def|thread|run|join"
    r"|sleep|sync|abs|a?(?:sin|cos|tan)|atan2|sqrt|pow|exp|log|floor|ceil|random|d2r|r2d|zero_ftsensor|size|enter_critical"
    r"|end_force_mode|powerdown|varmsg|request_\w{1,64}"
)
CALLED = re.compile(r"(?<![\w.])(\w{1,64}+)[ \t]{0,9}\(")
MOVES = re.compile(r"(?:optimove|move|servo|speed)[jlpc]")
DISPLACED = Keyed(
    "path_offset_ track_conveyor_", r"\b(?:path_offset_(?:set|enable)|track_conveyor_\w{1,20})[ \t]{0,9}\(", 0
)
FORCED = Keyed("force_mode end_force_mode", r"\b(end_)?force_mode[ \t]{0,9}\(", 0)
BY_FORCE = "force_mode moves the arm beside it"
OF_INVERSE = ("qnear", "maxpositionerror", "maxorientationerror", "tcp")
FIXED_ORIENTATION = re.compile(r"mode\s?=(?!\s?0\b)")
CONTROL = re.compile(
    r"^[ \t]*+(?:(if|while)\b|(end)\b|(def|thread|sec|elif|else|halt|return|break|continue|join|run|kill)\b)", re.M
)
OWN = re.compile(r"^[ \t]*+(?:def|thread|sec)[ \t]+(\w{1,64})", re.M)
OPENS = frozenset(("if", "while", "def", "thread", "sec"))
PARTS = frozenset(("def", "thread", "sec"))
CHANGED = re.compile(r"^[ \t]*+(\w{1,64})[ \t]*+\[[^\]\n]{1,40}\][ \t]*+=(?!=)", re.M)

NAMED = re.compile(r"\w{1,32}\s?=(?!=)\s?")

Places = Mapping[str, list[tuple[int, str]]]


class Poses:
    """The moves of a program to poses, one after another."""

    def __init__(self, program: Program, text: str, declared: Places) -> None:
        """Read the tools that a program sets; ``text`` has its comments blanked, ``declared`` are values by name."""
        self._program, self._text, self._declared = program, text, declared
        self._taken: dict[int, PoseTarget] = {}
        self._framed: list[tuple[PoseTarget, str]] = []
        self._changed = {match[1] for match in CHANGED.finditer(text)}
        self.displaced = DISPLACED.search(text) is not None
        starts, owners = _subprogram_boundaries(text)
        ways = (1, -1, 0)
        control = [(one.start(), next(w for k, w in enumerate(ways, 1) if one[k])) for one in CONTROL.finditer(text)]
        begun = set(starts)
        control = [(at, 0 if at in begun else way) for at, way in control]  # the end of a subprogram closes no block
        calls = [(at, 0) for at in calls_of_own(text, OWN)]
        self._tool: InForce[Frame | str] = InForce(Flow(sorted([*control, *calls]), starts, owners))
        own = {match.start(1) for match in OWN.finditer(text)}
        others = [
            (one.start(), 0) for one in calls_of_others(text) if one.start() not in own and not MOVES.fullmatch(one[1])
        ]
        self._way = Flow(sorted([*control, *calls, *others]), starts, owners)
        self._variables: dict[str, Variable[str]] = {}
        self._frames_given: dict[str, Variable[Frame] | None] = {}
        self.forced = self._forced_spans(text)
        for at, tool in sorted(self._tools(text), key=lambda one: one[0]):
            self._tool.set(at, tool)
        self.last: tuple[int, JointTarget | PoseTarget] | None = None

    def _tools(self, text: str) -> list[tuple[int, Frame | str]]:
        """The tools that the program sets, and the calls of subprograms that set another."""
        found: list[tuple[int, Frame | str]] = []
        for match in SET_TCP.finditer(text):
            _, said = next(arguments(inside(text, match.end())))
            found.append((match.start(), self._frame(said)))
        if len({tool for _, tool in found}) > 1:
            calls = calls_that_set(text, OWN, self._tool.flow.owner, [at for at, _ in found])
            found += [(at, f"{name}() sets the tool") for at, name in calls]
        return found

    def _forced_spans(self, text: str) -> Spans:
        """Parts between force_mode and its end: all of a program that ends it elsewhere, or calls a subprogram under it."""
        marks = [(match.start(), match[1] is None) for match in FORCED.finditer(text)]
        calls, owner = calls_of_own(text, OWN), self._tool.flow.owner
        ends: dict[int, list[int]] = {}
        for at, begins in marks:
            if not begins:
                ends.setdefault(owner(at), []).append(at)
        spans: list[Span] = []
        for at, begins in marks:
            if begins and not (spans and at < spans[-1][1]):
                own = ends.get(owner(at), [])
                k = bisect_right(own, at)
                if k == len(own) or bisect_right(calls, at) < bisect_left(calls, own[k]):
                    return Spans([(0, len(text))])
                spans.append((at, own[k]))
        return Spans(spans)

    def _frame(self, said: str) -> Frame | str:
        if said in self._changed:
            return f"the program changes {said[:40]}"
        places = self._declared.get(said, [])
        return _plain_frame(places[0][1] if len(places) == 1 else said) or f"set_tcp({said[:40]}) is not known"

    def is_sure(self, name: str, at: int) -> bool:
        """Say whether a variable surely has the last of its values before a place there."""
        known = self._variable(name)
        return name not in self._changed and known.chosen(at) == known.setting_in_force(at)

    def assignment_before(self, name: str, at: int) -> tuple[int, str]:
        """Return the last assignment to a variable before a place, and what it says; the last of all where none is before."""
        return self._variable(name).setting_before(at)

    def _variable(self, name: str) -> Variable[str]:
        if name not in self._variables:
            self._variables[name] = Variable(self._way, self._declared[name])
        return self._variables[name]

    def add_move_poses(self, match: re.Match[str], hint: JointTarget | None, doubt: str = "") -> bool:
        """Take the poses of a move; whether all that it goes to are such.

        ``hint`` are joints that the move states, ``doubt`` is what is not known of how it finds joints.
        """
        call = CALL.match(self._text, match.start())
        if call is None:
            return False
        said = [(call.end() + at, one) for at, one in arguments(inside(self._text, call.end()))]
        goals = [self._goal(*_strip_argument_name(at, one)) for at, one in said[: 2 if call[1] == "movec" else 1]]
        if None in goals or not goals:
            return False
        for goal in goals:
            assert goal is not None
            pose, base = goal
            near, self.last = hint or self.preceding_target(match.start()), (match.start(), pose)
            if match.start() in self.forced:
                self._program.leave(match.start(), f"{call[1]}({said[0][1][:40]}: {BY_FORCE}")
                pose.unused = f"{BY_FORCE} in all moves to it"
                continue
            pose.uses.append(Use(base, self._tool_in_effect(match.start()), near, call[1] != "movej"))
            turned = call[1] == "movec" and any(FIXED_ORIENTATION.match(one) for _, one in said)
            pose.problem = pose.problem or doubt or ("its orientation is not kept (mode)" if turned else "")
            pose.problem = pose.problem or (
                "the program displaces it (path offset, conveyor)" if self.displaced else ""
            )
            what = f"{call[1]}({said[0][1][:40]}"
            self._program.moves_to_poses.append((line_number(self._text, match.start()), what, (pose,)))
        return True

    def preceding_target(self, at: int) -> JointTarget | PoseTarget | None:
        """Return the target from which the program always comes to a place, if there is one."""
        return self.last[1] if self.last is not None and self._way.has_unbranched_path(self.last[0], at) else None

    def _tool_in_effect(self, at: int) -> Frame | str:
        known, value = self._tool.value_in_effect(at)
        if not known:
            return "its tool depends on the way that the program took"
        if value is not None:
            return value
        stated = self._program.stated.tools.get("")
        return Frame(URSCRIPT, stated) if stated else "no set_tcp is before it: state the tool, --tool x,y,z,rx,ry,rz"

    def _goal(self, at: int, said: str) -> tuple[PoseTarget, tuple[Frame, ...] | str] | None:
        """The pose that a move says, and the frames in which it is given: those of pose_trans, from the base on."""
        inverse = INVERSE.match(said)
        if inverse is not None:
            inner = next(arguments(inside(self._text, at + inverse.end())), (0, ""))
            at, said = at + inverse.end() + inner[0], inner[1]
        call = IN_FRAME.match(said)
        if call is None:
            pose = self._pose(at, said)
            return None if pose is None else (pose, (NULL,))
        parts = [*arguments(inside(self._text, at + call.end()))]
        frame = self._reference(at, parts[0][1]) if len(parts) == 2 else None
        goal = self._goal(at + call.end() + parts[1][0], parts[1][1]) if frame is not None else None
        if frame is None or goal is None:
            return None
        pose, base = goal
        self._framed.append((pose, parts[0][1]))
        if isinstance(base, str):
            return pose, base
        return pose, frame if isinstance(frame, str) else (frame, *base)

    def leave_beside_targets(self) -> None:
        """Leave the poses whose frame is a target too: its numbers are rewritten, and what is beside it moves with it."""
        used = {frame for _, frame in self._framed}
        targets = {one for one in used if any(place in self._taken for place, _ in self._declared.get(one, []))}
        for pose, frame in self._framed:
            if frame in targets:
                pose.problem = pose.problem or f"its frame {frame} is a target itself"

    def _reference(self, at: int, said: str) -> Frame | str | None:
        """The frame that pose_trans names at a place, or why it is not known; None where the program computes it."""
        if said in self._changed:
            return None
        if said not in self._declared:
            return _plain_frame(said)
        if said not in self._frames_given:
            frames = [(place, _plain_frame(written)) for place, written in self._declared[said]]
            known = [(place, frame) for place, frame in frames if frame is not None]
            self._frames_given[said] = Variable(self._tool.flow, known) if len(known) == len(frames) else None
        values = self._frames_given[said]
        if values is None:
            return None
        return values.chosen(at) or f"its frame {said} depends on the way that the program took"

    def _pose(self, at: int, said: str) -> PoseTarget | None:
        places = self._declared.get(said, []) or ([(at, said)] if said.startswith("p") else [])
        one = SIX.match(self._text, places[0][0]) if len(places) == 1 else None
        if one is None or places[0][1][one.end() - places[0][0] :].strip(" \t;"):  # as p[...] + p[...]
            return None
        found = self._taken.get(one.start())
        if found is None:
            name = said if len(said) < 40 and said in self._declared else "a pose"
            line, numbers = line_number(self._text, one.start()), tuple(map(float, one.groups()))
            found = PoseTarget(name, line, URSCRIPT, numbers, one.regs[1:])
            found.problem = "the program changes it" if said in self._changed else ""
            self._taken[one.start()] = self._program.add_pose(found, counted=False)
        return found


def _plain_frame(said: str) -> Frame | None:
    """The frame that a list of six numbers says."""
    whole = SIX.fullmatch(said)
    return Frame(URSCRIPT, tuple(map(float, whole.groups()))) if whole else None


def _subprogram_boundaries(text: str) -> tuple[list[int], list[int]]:
    """Where subprograms begin, and where what surrounds them goes on behind them; and the number of each."""
    starts: list[int] = []
    owners: list[int] = []
    opened: list[tuple[str, int]] = []
    for match in CONTROL.finditer(text):
        word = next(part for part in match.groups() if part)
        if word in OPENS:
            number = len(starts) + 1 if word in PARTS else 0
            opened.append((word, number))
        elif word != "end" or not opened or opened.pop()[0] not in PARTS:
            continue
        else:
            number = next((number for kind, number in reversed(opened) if kind in PARTS), 0)
        if word in PARTS or word == "end":
            starts.append(match.start())
            owners.append(number)
    return starts, owners


def _strip_argument_name(at: int, said: str) -> tuple[int, str]:
    """An argument and its place without its name: ``pose=``."""
    named = NAMED.match(said)
    return (at + named.end(), said[named.end() :]) if named else (at, said)


@lru_cache(maxsize=2)
def calls_of_others(text: str) -> list[re.Match[str]]:
    """Return the calls of what may move the arm, the name as group 1; heads of subprograms are among them."""
    calls = [*CALLED.finditer(text)]
    others = {name for name in {call[1] for call in calls} if not KNOWN.fullmatch(name)}
    return [call for call in calls if call[1] in others]


def inverse_arguments(text: str, at: int) -> dict[str, tuple[int, str]]:
    """Return what ``get_inverse_kin`` is given beside the pose, by name in small letters: places and values."""
    call = INVERSE.match(text, at)
    if call is None:
        return {}
    found = {}
    for k, (place, one) in enumerate([*arguments(inside(text, call.end()))][1:]):
        named = NAMED.match(one)
        name = one[: named.end()].split("=")[0].strip() if named else OF_INVERSE[min(k, 3)]
        start, value = _strip_argument_name(call.end() + place, one)
        found["".join(name.lower().split("_"))] = (start, value)
    return found


def inside(text: str, at: int) -> str:
    """Return the text from behind an opening bracket to the one that closes it; only its beginning where none is near."""
    closed = CLOSED.match(text, at, at + MOST_INSIDE)
    if closed is not None:
        return text[at : closed.end() - 1]
    return text[at : at + BEGINNING].partition("\n")[0]
