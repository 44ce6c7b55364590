"""Which of the joints that reach a pose a program means: by the configuration that it states, or by the target before.

External axes of a pose: a rail that carries the arm, as somebody stated it, or an axis that stands at zero.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from kilter_files.formats.programs.found import NUMBER, Stated, Track
from kilter_files.formats.programs.notations import Frame, Notation
from kilter_files.formats.programs.one_target import Branch, Configuration, Span

Limits = Sequence[tuple[float, float]]
Joints = tuple[float, ...]
FAR_DEG = 150.0  # along a line no joint is believed to rotate by more
CLEARER = 2.0  # of two postures the nearer is meant where the other is farther by this factor
WITHIN_DEG = 1e-6
OUT_OF_REACH = "it is out of reach"
SINGULAR = "it is at a singularity, where joints cannot be told apart"
SEVERAL = "several joints reach it, and which it means is not stated"
NOT_CERTAIN = "joints reach it that may not be all: it is at a singularity, or near one"
NOT_STATED = "its configuration is not stated, and the target from which the arm comes is not known"
NO_SUCH = "no joints within their limits have its configuration"
DIFFERENT = "moves come to it with different joints"


@dataclass(frozen=True)
class Found:
    """The joints of the robot, deg, that a pose means."""

    joints_deg: Joints
    branch: Branch


def by_configuration(
    stated: Configuration, postures: Sequence[Mapping[str, Any]], limits: Limits, signs: Sequence[float]
) -> Found | str:
    """Return the one posture that has a stated configuration, or why there is none; without named branches, by its joints."""
    found: list[Found] = []
    for one in postures:
        branch = _branch(one)
        turns = [_turns(value, bounds) for value, bounds in zip(one["joints_deg"], limits, strict=True)]
        fitting = [[value for value in row if stated.fits_joint(k, signs[k] * value)] for k, row in enumerate(turns)]
        if stated.fits(branch) and all(fitting):
            if one["singular"]:
                return SINGULAR
            found += [Found(joints, branch) for joints in itertools.product(*fitting)]
    if len(found) > 1:
        return SEVERAL
    return found[0] if found else NO_SUCH if postures else OUT_OF_REACH


def fitting_signs(
    stated: Sequence[tuple[Configuration, Sequence[Mapping[str, Any]]]], limits: Limits, signs: Sequence[float]
) -> Sequence[float] | None:
    """Return other signs of joints by which all of these configurations fit the postures beside them: the fewest changes.

    None where no signs do, or where several do that change as few.
    """
    for count in range(1, len(signs) + 1):
        found = []
        for turned in itertools.combinations(range(len(signs)), count):
            other = [-sign if k in turned else sign for k, sign in enumerate(signs)]
            fits = (by_configuration(one, postures, limits, other) for one, postures in stated)
            found += [other] if not any(one in (NO_SUCH, OUT_OF_REACH) for one in fits) else []
        if found:
            return found[0] if len(found) == 1 else None
    return None


def select_following_posture(
    near: Found, postures: Sequence[Mapping[str, Any]], limits: Limits, *, straight: bool
) -> Found | str:
    """Return the posture that follows another, or why there is none.

    Along a line it is the one in its branch, else, and where branches have no names, the nearest.
    """
    ranked = []
    for one in postures:
        branch = _branch(one)
        joints = [
            _nearest(_turns(value, bounds), was)
            for value, bounds, was in zip(one["joints_deg"], limits, near.joints_deg, strict=True)
        ]
        far = max(abs(new - was) for new, was in zip(joints, near.joints_deg, strict=True))
        if not any(map(math.isnan, joints)) and (branch == near.branch or not straight):
            ranked.append((far, one["singular"], Found(tuple(joints), branch)))
    if not ranked:
        return "no joints within their limits follow those of the target before it" if postures else OUT_OF_REACH
    ranked.sort(key=lambda one: one[0])
    far, singular, found = ranked[0]
    if singular:
        return SINGULAR
    if straight and found.branch.named:
        return found if far < FAR_DEG else "it is too far from the target before it to tell how the arm goes there"
    return found if len(ranked) == 1 or ranked[1][0] > CLEARER * far else SEVERAL


def not_followed(follows: str) -> str:
    """Return why a pose is left that follows another which is not known; ``follows`` is as in ``Use``."""
    if not follows:
        return NOT_STATED
    switched_on = follows.partition(" ")[0]
    return (
        f"{follows}, and the target from which the arm comes is not known: write {switched_on} \\On before the move, if its "
        "confdata is right"
    )


def find_posture_with_joints(joints_deg: Sequence[float], postures: Sequence[Mapping[str, Any]]) -> Found | None:
    """Return the posture that has these joints, whole turns apart."""
    for one in postures:
        apart = [math.remainder(a - b, 360.0) for a, b in zip(joints_deg, one["joints_deg"], strict=True)]
        if max(map(abs, apart)) < 1e-5 and not one["singular"]:
            return Found(tuple(joints_deg), _branch(one))
    return None


def _nearest(turns: Sequence[float], was: float) -> float:
    return min(turns, key=lambda turn: abs(turn - was), default=math.nan)


def _branch(one: Mapping[str, Any]) -> Branch:
    return Branch(one["front"], one["elbow_up"], one["wrist"], one.get("named", True))


def _turns(value: float, bounds: tuple[float, float]) -> list[float]:
    """The angles within the limits that are whole turns from a value."""
    lower, upper = bounds
    first = math.ceil((lower - WITHIN_DEG - value) / 360.0)
    last = math.floor((upper + WITHIN_DEG - value) / 360.0)
    return [value + 360.0 * k for k in range(first, last + 1)]


CONFIG_TURNS = (0, 3, 5)  # FANUC: joints (from 0) whose full turns the three numbers of CONFIG state: J1, J4, J6
EDGE_DEG = 1e-6  # a joint nearer to the edge of a quadrant or of a full turn is on both sides of it


class StatusTurn(NamedTuple):
    """KRL: S says where wrist and elbow are, T of each joint whether it is negative; its third bit of S says no more."""

    status: int
    turn: int
    turn_text: str
    turn_span: Span

    def fits(self, branch: Branch) -> bool:
        """Say whether a branch has this status."""
        return not branch.named or (branch.front != bool(self.status & 1) and branch.elbow_up == bool(self.status & 2))

    def fits_joint(self, k: int, value_deg: float) -> bool:
        """Say whether a joint has the sign that T states."""
        return abs(value_deg) < 360.0 and _either(bool(self.turn >> k & 1), lambda q: q < 0.0, value_deg)

    def keeps(self, branch: Branch, joints_deg: Sequence[float]) -> bool:
        """Say whether wrist and elbow are still where S says; T is written anew."""
        return self.fits(branch)

    def edits_for_joints(self, joints_deg: Sequence[float]) -> Mapping[Span, str]:
        """Return T for these joints, where it is another."""
        turn = sum(1 << k for k, q in enumerate(joints_deg) if q < -0.0) | self.turn >> len(joints_deg) << len(
            joints_deg
        )
        if all(self.fits_joint(k, q) for k, q in enumerate(joints_deg)):
            return {}
        binary = "B" in self.turn_text.upper()
        return {self.turn_span: f"'B {turn:0{max(6, turn.bit_length())}b}'" if binary else str(turn)}


class ConfData(NamedTuple):
    """RAPID: the quadrants of axes 1, 4 and 6, and which of eight branches; the last stays as it is."""

    quadrants: tuple[int, int, int]
    branch: int
    spans: tuple[Span, Span, Span]

    def fits(self, branch: Branch) -> bool:
        """Say whether a branch is the stated one."""
        return not branch.named or (branch.front != bool(self.branch & 4) and branch.elbow_up != bool(self.branch & 2))

    def fits_joint(self, k: int, value_deg: float) -> bool:
        """Say whether a joint is in its quadrant, or axis 5 has its sign."""
        if k == 4:
            return _either(bool(self.branch & 1), lambda q: q < 0.0, value_deg)
        stated = dict(zip((0, 3, 5), self.quadrants, strict=True)).get(k)
        return stated is None or _either(stated, lambda q: math.floor(q / 90.0), value_deg)

    def keeps(self, branch: Branch, joints_deg: Sequence[float]) -> bool:
        """Say whether the branch is still the stated one, and axis 5 on its side; the other numbers are written anew."""
        return self.fits(branch) and _either(bool(self.branch & 1), lambda q: q < 0.0, joints_deg[4])

    def edits_for_joints(self, joints_deg: Sequence[float]) -> Mapping[Span, str]:
        """Return the quadrants for these joints that are others."""
        return {
            span: str(math.floor(joints_deg[k] / 90.0))
            for k, span in zip((0, 3, 5), self.spans, strict=True)
            if not self.fits_joint(k, joints_deg[k])
        }


class Config(NamedTuple):
    """FANUC: flip of the wrist by the sign of J5, elbow up, front, and the full turns of J1, J4 and J6."""

    flip: bool
    up: bool
    front: bool
    turns: tuple[int, int, int]
    spans: tuple[Span, Span, Span]

    def fits(self, branch: Branch) -> bool:
        """Say whether a branch is the stated one."""
        return not branch.named or (branch.front == self.front and branch.elbow_up == self.up)

    def fits_joint(self, k: int, value_deg: float) -> bool:
        """Say whether J1, J4 or J6 has its full rotations, or J5 its sign within half a rotation."""
        if k == 4:
            return abs(value_deg) <= 180.0 + EDGE_DEG and _either(self.flip, lambda q: q >= 0.0, value_deg)
        stated = dict(zip(CONFIG_TURNS, self.turns, strict=True)).get(k)
        return stated is None or _either(stated, _configuration_turns, value_deg)

    def keeps(self, branch: Branch, joints_deg: Sequence[float]) -> bool:
        """Say whether the branch is still the stated one, and axis 5 on its side; the other numbers are written anew."""
        return self.fits(branch) and _either(self.flip, lambda q: q >= 0.0, joints_deg[4])

    def edits_for_joints(self, joints_deg: Sequence[float]) -> Mapping[Span, str]:
        """Return the full turns for these joints that are others."""
        return {
            span: str(_configuration_turns(joints_deg[k]))
            for k, span in zip(CONFIG_TURNS, self.spans, strict=True)
            if not self.fits_joint(k, joints_deg[k])
        }


def _configuration_turns(value_deg: float) -> int:
    return math.floor((value_deg + 180.0) / 360.0)


def _either(stated: int, of: Callable[[float], int], value_deg: float) -> bool:
    """Whether a value, or one that differs by rounding only, is what was stated."""
    return stated in (of(value_deg - EDGE_DEG), of(value_deg + EDGE_DEG))


# mm or deg: where an arm of which errors are some mm in a metre stands this far from where it is taken to be, its
# correction is another one by some um at most. Rails that stand still read so.
AT_ZERO = 0.01
WRITTEN = re.compile(rf"\s*+([-+]?)([xyz])\s*+(?:,\s*+({NUMBER})\s*+)?", re.I)
NONE = "none"


def parse_track(said: str) -> Track | None:
    """Read ``x``, ``-y,1000`` (mm for each unit) or ``none``; None where it is none of these."""
    if said.strip().lower() == NONE:
        return Track((0.0, 0.0, 0.0))
    match = WRITTEN.fullmatch(said)
    if match is None or not float(match[3] or 1.0):
        return None
    mm = float(f"{match[1]}1") * float(match[3] or 1.0)
    x, y, z = (mm * (axis == match[2].lower()) for axis in "xyz")
    return Track((x, y, z))


def frame_on_track(stated: Stated, notation: Notation, axes: Mapping[str, float]) -> tuple[Frame | None, str]:
    """Return where the rail's zero is, seen from the arm's root on it, and why that is not known: one of them.

    Both are empty where no axis carries the arm. ``axes`` are the values of external axes by name.
    """
    if not axes:
        return None, ""
    place = [0.0, 0.0, 0.0]
    for name, value in axes.items():
        track = stated.tracks.get(name.lower())
        if track is not None:
            place = [at - along * value for at, along in zip(place, track.along, strict=True)]
        elif abs(value) > AT_ZERO:
            return None, (
                f"an external axis may move its base: state a rail and its direction, --track {name}=x, or that it moves "
                f"no frame, --track {name}={NONE}"
            )
    if not any(place):
        return None, ""
    turn = (1.0, 0.0, 0.0, 0.0) if len(notation.names) == 7 else (0.0, 0.0, 0.0)
    return Frame(notation, (*(at / notation.mm for at in place), *turn)), ""
