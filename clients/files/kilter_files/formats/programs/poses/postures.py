"""Which of the joints that reach a pose a program means: by the configuration that it states, or by the target before."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from kilter_files.formats.programs.one_target import Branch, Configuration

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
