"""URScript's poses, in place or by a variable: frame, tool, and the target before each, which says the joints."""

from __future__ import annotations

import re
from collections.abc import Mapping

from kilter_files.formats.programs.found import NUMBER, Program, line_at
from kilter_files.formats.programs.notations import URSCRIPT, Frame
from kilter_files.formats.programs.one_target import JointTarget, PoseTarget, Span, Use
from kilter_files.formats.programs.poses.in_force import InForce, calls_of_own
from kilter_files.formats.programs.poses.rapid import arguments

NULL = Frame(URSCRIPT, (0.0,) * 6)
SIX = re.compile(r"p\s?\[\s*" + r"\s*,\s*".join([f"({NUMBER})"] * 6) + r"\s*\]")
INVERSE = re.compile(r"get_inverse_kin\s?\(")
IN_FRAME = re.compile(r"pose_trans\s?\(")
CALL = re.compile(r"\b(move[jlpc])\s?\(")
SET_TCP = re.compile(r"\bset_tcp\s?\(")
CONTROL = re.compile(
    r"^[ \t]*(?:(if|while)\b|(end)\b|(def|thread|sec|elif|else|halt|return|break|continue|join|run|kill)\b)", re.M
)
OWN = re.compile(r"^[ \t]*(?:def|thread|sec)[ \t]+(\w{1,64})", re.M)
OPENS = frozenset(("if", "while", "def", "thread", "sec"))
PARTS = frozenset(("def", "thread", "sec"))
CHANGED = re.compile(r"^[ \t]*(\w{1,64})[ \t]*\[[^\]\n]{1,40}\][ \t]*=(?!=)", re.M)

NAMED = re.compile(r"\w{1,16}\s?=(?!=)\s?")

Places = Mapping[str, list[tuple[int, str]]]


class Poses:
    """The moves of a program to poses, one after another."""

    def __init__(self, program: Program, text: str, declared: Places) -> None:
        """Read the tools that a program sets; ``text`` has its comments blanked, ``declared`` are values by name."""
        self._program, self._text, self._declared = program, text, declared
        self._taken: dict[int, PoseTarget] = {}
        self._framed: list[tuple[PoseTarget, str]] = []
        self._changed = {match[1] for match in CHANGED.finditer(text)}
        ways = (1, -1, 0)
        control = [(one.start(), next(w for k, w in enumerate(ways, 1) if one[k])) for one in CONTROL.finditer(text)]
        calls = [(at, 0) for at in calls_of_own(text, OWN)]
        starts, owners = _parts(text)
        self._tool = InForce(sorted([*control, *calls]), starts, owners)
        for at, tool in sorted(self._tools(text, dict(zip(starts, owners, strict=True))), key=lambda one: one[0]):
            self._tool.set(at, tool)
        self.last: tuple[int, JointTarget | PoseTarget] | None = None

    def _tools(self, text: str, parts: Mapping[int, int]) -> list[tuple[int, Frame | str]]:
        """The tools that the program sets, and the calls of subprograms that set another."""
        found: list[tuple[int, Frame | str]] = []
        for match in SET_TCP.finditer(text):
            _, said = next(arguments(inside(text, match.end())))
            found.append((match.start(), self._frame(said)))
        if len({tool for _, tool in found}) > 1:
            heads = {match.start(): match for match in OWN.finditer(text)}
            setting = {max((at for at in parts if at < place), default=-1) for place, _ in found}
            own = {heads[at][1] for at in setting if at in heads}
            for at in calls_of_own(text, OWN):
                name = re.match(r"\w+", text[at : at + 64])
                if name and name[0] in own:
                    found.append((at, f"{name[0]}() sets the tool"))
        return found

    def _frame(self, said: str) -> Frame | str:
        places = self._declared.get(said, [])
        whole = SIX.fullmatch(places[0][1] if len(places) == 1 else said)
        return Frame(URSCRIPT, tuple(map(float, whole.groups()))) if whole else f"set_tcp({said[:40]}) is not known"

    def take(self, match: re.Match[str], hint: JointTarget | None) -> bool:
        """Take the poses of a move; whether all that it goes to are such. ``hint`` are joints that the move states."""
        call = CALL.match(self._text, match.start())
        if call is None:
            return False
        said = [(call.end() + at, one) for at, one in arguments(inside(self._text, call.end()))]
        goals = [self._goal(*_unnamed(at, one)) for at, one in said[: 2 if call[1] == "movec" else 1]]
        if None in goals or not goals:
            return False
        for goal in goals:
            assert goal is not None
            pose, base = goal
            near = hint or self.before(match.start())
            pose.uses.append(Use(base, self._held(match.start()), near, call[1] != "movej"))
            what = f"{call[1]}({said[0][1][:40]}"
            self._program.moves_to_poses.append((line_at(self._text, match.start()), what, pose))
            self.last = (match.start(), pose)
        return True

    def before(self, at: int) -> JointTarget | PoseTarget | None:
        """Return the target from which the program always comes to a place, if there is one."""
        return self.last[1] if self.last is not None and self._tool.joined(self.last[0], at) else None

    def _held(self, at: int) -> Frame | str:
        known, value = self._tool.at(at)
        if not known:
            return "its tool depends on the way that the program took"
        if isinstance(value, Frame | str):
            return value
        stated = self._program.stated.tools.get("")
        return Frame(URSCRIPT, stated) if stated else "no set_tcp is before it: state the tool, --tool x,y,z,rx,ry,rz"

    def _goal(self, at: int, said: str) -> tuple[PoseTarget, tuple[Frame, ...] | str] | None:
        """The pose that a move says, and the frames in which it is given: those of pose_trans, from the base on."""
        inverse = INVERSE.match(said)
        if inverse is not None:
            inner = next(arguments(inside(said, inverse.end())), (0, ""))
            at, said = at + inverse.end() + inner[0], inner[1]
        call = IN_FRAME.match(said)
        if call is None:
            pose = self._pose(at, said)
            return None if pose is None else (pose, (NULL,))
        parts = [*arguments(inside(said, call.end()))]
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
        for pose, frame in self._framed:
            if any(place in self._taken for place, _ in self._declared.get(frame, [])):
                pose.problem = pose.problem or f"its frame {frame} is a target itself"

    def _reference(self, at: int, said: str) -> Frame | str | None:
        """The frame that pose_trans names at a place, or why it is not known; None where the program computes it."""
        places = self._declared.get(said, []) or [(at, said)]
        values = [(place, SIX.fullmatch(written)) for place, written in places]
        if any(whole is None for _, whole in values) or said in self._changed:
            return None
        frames = [(place, Frame(URSCRIPT, tuple(map(float, whole.groups())))) for place, whole in values if whole]
        if len({frame for _, frame in frames}) == 1:
            return frames[0][1]
        force = InForce(self._tool.control, self._tool.starts, self._tool.owners)
        for place, frame in frames:
            force.set(place, frame)
        known, found = force.at(at)
        alone = len({force.owner(place) for place in (at, *(place for place, _ in frames))}) == 1
        if known and alone and isinstance(found, Frame):
            return found
        return f"its frame {said} depends on the way that the program took"

    def _pose(self, at: int, said: str) -> PoseTarget | None:
        places = self._declared.get(said, []) or ([(at, said)] if said.startswith("p") else [])
        whole = [SIX.match(self._text, place) for place, _ in places]
        if not whole or any(one is None for one in whole) or (len(whole) > 1):
            return None
        one = whole[0]
        assert one is not None
        found = self._taken.get(one.start())
        if found is None:
            name = said if len(said) < 40 and said in self._declared else "a pose"
            spans: tuple[Span, ...] = tuple(one.span(k) for k in range(1, 7))
            found = PoseTarget(name, line_at(self._text, one.start()), URSCRIPT, tuple(map(float, one.groups())), spans)
            found.problem = "the program changes it" if said in self._changed else ""
            self._taken[one.start()] = self._program.add_pose(found, counted=False)
        return found


def _parts(text: str) -> tuple[list[int], list[int]]:
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


def _unnamed(at: int, said: str) -> tuple[int, str]:
    """An argument and its place without its name: ``pose=``."""
    named = NAMED.match(said)
    return (at + named.end(), said[named.end() :]) if named else (at, said)


def inside(text: str, at: int) -> str:
    """Return the text from behind an opening bracket to the one that closes it."""
    depth = 1
    for end in range(at, min(len(text), at + 2000)):
        depth += (text[end] in "([") - (text[end] in ")]")
        if depth == 0:
            return text[at:end]
    return ""
