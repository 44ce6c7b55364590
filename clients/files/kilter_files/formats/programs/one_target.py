"""Targets of a program: joints, or a pose with the frames and the configuration that it is given in."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from kilter_files.formats.programs.notations import Frame, Notation

Span = tuple[int, int]
UNUSED = "no move of the program goes to it, so its frames are not known"
MOST_WAYS = 20
SEVERAL = "moves go to it with different frames or tools"


class Spans:
    """Spans of a text that do not overlap, in their order: ``place in spans``."""

    def __init__(self, spans: Sequence[Span]) -> None:
        """Take them."""
        self._starts, self._ends = [start for start, _ in spans], [end for _, end in spans]

    def __contains__(self, place: int) -> bool:
        k = bisect_right(self._starts, place) - 1
        return k >= 0 and place < self._ends[k]


def replace_spans(text: str, new: Mapping[Span, str]) -> str:
    """Return a text with others at these places, which do not overlap."""
    parts, at = [], 0
    for (start, end), other in sorted(new.items()):
        parts += [text[at:start], other]
        at = end
    return "".join([*parts, text[at:]])


class JointTarget(NamedTuple):
    """A target: its joints in deg, and the places of their numbers; ``radians`` says of each how it is written.

    One without places is read and never rewritten.
    """

    name: str
    line: int
    joints_deg: tuple[float, ...]
    spans: tuple[Span, ...] = ()
    radians: tuple[bool, ...] = ()

    @property
    def start_offset(self) -> int:
        """Where it begins in the text."""
        return self.spans[0][0] if self.spans else 0


@dataclass(frozen=True)
class Branch:
    """Which of the branches of an arm a posture is: where its wrist is, and its elbow; see the route of inverse kinematics.

    Those of an arm without a closed form have no names: then only the joints say whether a posture is the stated one.
    """

    front: bool
    elbow_up: bool
    wrist: bool
    named: bool = True


class Configuration(Protocol):
    """What a target says of the posture that reaches it."""

    def fits(self, branch: Branch) -> bool:
        """Say whether a branch is the stated one."""
        ...

    def fits_joint(self, k: int, value_deg: float) -> bool:
        """Say whether joint ``k`` (from 0) of the program may have this value."""
        ...

    def keeps(self, branch: Branch, joints_deg: Sequence[float]) -> bool:
        """Say whether these joints of the program, in this branch, are still what it says, but for what is restated."""
        ...

    def edits_for_joints(self, joints_deg: Sequence[float]) -> Mapping[Span, str]:
        """Return what must be written anew for these joints of the program, by its place."""
        ...


class Use(NamedTuple):
    """A move to a target. A frame that is not known is the reason why.

    ``near`` is the target before it, where that is known; ``straight`` says that the move keeps the branch. ``follows`` says
    why the controller takes the posture next to that and not the stated one; empty: it takes the stated one.
    """

    base: tuple[Frame, ...] | str
    tool: Frame | str
    near: JointTarget | PoseTarget | None = None
    straight: bool = False
    follows: str = ""


Ways = dict[tuple[Use, str], None]


def note_use(poses: Sequence[PoseTarget], use: Use, problem: str = "", ways: Ways | None = None) -> None:
    """Note a move to a pose, or to one of several of which the program computes which.

    ``ways`` are how other moves went to any of the several: a way that is known says nothing new of them.
    """
    if ways is not None:
        if len(ways) > MOST_WAYS or (use, problem) in ways:
            return
        ways[use, problem] = None
        problem = (
            f"the program computes which of them it goes to, in {len(ways)} ways" if len(ways) > MOST_WAYS else problem
        )
    for pose in poses:
        pose.uses.append(use)
        pose.problem = pose.problem or problem


@dataclass(frozen=True)
class WrittenOut:
    """What stands for a target that a move computes from another one: the list of that one, with the numbers of this.

    ``place`` is where the move computes it, ``ends`` are the ends of lines within; ``literal`` is the list of the other
    target ``of``, which begins at ``at``.
    """

    of: PoseTarget
    place: Span
    ends: str
    literal: str
    at: int

    def edits(self, new: Mapping[Span, str]) -> dict[Span, str]:
        """Return the list with these numbers at the places of the other's, in place of the computation."""
        moved = {(start - self.at, end - self.at): number for (start, end), number in new.items()}
        return {self.place: "".join(replace_spans(self.literal, moved).split()) + self.ends}


@dataclass(eq=False, slots=True)
class PoseTarget:
    """A target given as a pose, its numbers at their places, and the moves to it.

    ``root`` is the zero of the rail that carries the arm, seen from the arm's root there.
    ``problem`` says why it cannot be rewritten. ``whole`` is the place of its list, where it has one. ``computed``: the places
    are those of another target, from which a move computes this one. ``unused`` is why it is left where no move surely
    goes to it.
    """

    name: str
    line: int
    notation: Notation
    numbers: tuple[float, ...]
    spans: tuple[Span, ...]
    configuration: Configuration | None = None
    uses: list[Use] = field(default_factory=list)
    problem: str = ""
    whole: Span = (0, 0)
    computed: WrittenOut | None = None
    unused: str = UNUSED
    root: Frame | None = None

    @property
    def start_offset(self) -> int:
        """Where it begins in the text."""
        if self.computed is not None:
            return self.computed.place[0]
        return self.spans[0][0] if self.spans else self.whole[0]

    @property
    def active_configuration(self) -> Configuration | None:
        """The configuration, where it counts in some move; see ``Use.follows``."""
        return self.configuration if not all(use.follows for use in self.uses) or not self.uses else None

    def reason_left_unresolved(self) -> str:
        """Say what of this target is not known; empty: all that the program can say."""
        problem = self.problem or ("" if self.computed is None else self.computed.of.problem)
        if problem or not self.uses:
            return problem or self.unused
        for use in self.uses:
            if isinstance(use.base, str):
                return use.base
            if isinstance(use.tool, str):
                return use.tool
        first = self.uses[0]
        return SEVERAL if any(use.base != first.base or use.tool != first.tool for use in self.uses[1:]) else ""

    def frames(self) -> tuple[tuple[Frame, ...], Frame]:
        """Return the frames from the robot's root to those the pose is given in, and the tool; of one without a reason."""
        base, tool = self.uses[0].base, self.uses[0].tool
        assert not isinstance(base, str)
        assert not isinstance(tool, str)
        return (base if self.root is None else (self.root, *base)), tool
