"""Whether proposed poses tell two effects apart, how many would, and what does where poses do not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.physical import (
    BASE_TILT,
    JOINT_CURVE,
    JOINT_TILT,
    JOINT_TWIST,
    JOINT_ZERO,
    LINK_SAG,
    REVERSAL,
    SMOOTH_CURVE,
    STATION,
    Separator,
    joint_numbers,
)
from kilter_core.gap.budget import PLANNING
from kilter_core.gap.effect_search import SearchOutcome
from kilter_core.gap.evidence.similarity.aliases import SAME
from kilter_core.gap.evidence.similarity.smooth import TURN
from kilter_core.gap.evidence.verdict import SURE, Judged
from kilter_core.gap.report.next_poses import Proposal, proposal_rows, separate
from kilter_core.gap.search.candidates import Candidate
from kilter_core.gap.study import Study
from kilter_core.observations import Observations

TOLD_APART = 22.0  # lambda (1 - rho squared) from which a name is wrong in one of a thousand
MOST_POSES = 1000  # nobody measures more to tell two effects apart
# What a link-side encoder reads: not the twist of the link behind it, which is of the class of the gear's.
AT_ENCODER = (JOINT_TWIST, JOINT_CURVE, SMOOTH_CURVE, REVERSAL, JOINT_ZERO)
TILTING = (JOINT_TILT, BASE_TILT, LINK_SAG, STATION)  # what an inclinometer reads


@dataclass(frozen=True)
class ToldApart:
    """What all of ``poses`` do for telling the two of ``names`` apart, and what does ``instead`` where that is too little.

    ``factor`` is by how much more is known after all of them; ``needed`` how many such poses would tell, None where it
    would take more than anybody measures.
    """

    names: tuple[str, str]
    poses: int
    factor: float
    enough: bool
    needed: int | None
    instead: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """All of it in words."""
        pair = f"{self.names[0]} from {self.names[1]}"
        factor = f"the factor of information after all of them is {self.factor:.3g}"
        if self.enough:
            return f"{self.poses} poses will tell {pair} ({factor})."
        many = "no number of poses like these would" if self.needed is None else f"about {self.needed} such poses would"
        return f"{self.poses} poses will not tell {pair} ({factor}); {many}. Do this instead: {'; or '.join(self.instead)}."

    def to_document(self) -> dict[str, Any]:
        """Plain numbers and words."""
        return {
            "separates": list(self.names),
            "poses": self.poses,
            "information_factor": round(self.factor, 3),
            "enough": self.enough,
            "poses_needed": self.needed,
            "instead": list(self.instead),
            "sentence": self.sentence,
        }

    def warnings(self) -> Iterator[dict[str, Any]]:
        """Warn where the poses are not enough."""
        if not self.enough:
            yield {"code": "poses_will_not_tell", "message": self.sentence}


Proposed = tuple[list[dict[str, Any]], ToldApart | None]  # poses as documents, and whether they tell two apart


def plan_next_poses(study: Study, search: SearchOutcome, effects: Sequence[Judged]) -> Proposed:
    """For the least certain effect: poses that separate it from its nearest rival, or sharpen it."""
    found, robot, options = search.found, study.robot, study.options
    if not effects or study.budget.over(PLANNING, "poses to measure next"):
        return [], None
    open_ = ((j, next(_separable_rivals(j, robot), None)) for j in effects)
    weak = ((j, None) for j in effects if j.verdict not in SURE)
    judged, rival = next((one for one in open_ if one[1]), None) or next(weak, (None, None))
    if judged is None:
        return [], None
    target, values = judged.evidence.candidate, np.array([a.value for a in judged.evidence.amplitudes])
    others = [k for k in found.columns if k not in target.columns]
    rows, rivals = search.prepared.visits.observations, [] if rival is None else [rival]
    asked_for = (options.next_poses, options.seed, None, study.by_views)
    proposals = separate(found.problem, rows, target, rivals, others, values, *asked_for)
    names = target.label, rival.label if rival else "geometry"
    return proposal_rows(proposals, names, robot), assess_separation(proposals, target, rival, rows, robot)


def _separable_rivals(judged: Judged, robot: Robot) -> Iterator[Candidate]:
    """Rivals of an effect that some poses of this arm would tell from it."""
    for a in judged.alias_set:
        own = judged.evidence.candidate
        if a.correlation < SAME and not a.member and not are_never_separable(own, a.candidate, robot):
            yield a.candidate


def assess_separation(
    proposals: Sequence[Proposal], target: Candidate, rival: Candidate | None, rows: Observations, robot: Robot
) -> ToldApart | None:
    """What the best of the proposals does for telling ``target`` from ``rival``; None without a rival or proposals."""
    best = max((p for p in proposals if p.after), key=lambda p: p.after[-1], default=None)
    if best is None or rival is None:
        return None
    count, gained = len(best.rows), best.after[-1] - best.before
    enough = best.after[-1] >= TOLD_APART
    many = count * (TOLD_APART - best.before) / max(gained, 1e-12)
    needed = count if enough else None if many > MOST_POSES else int(np.ceil(many))
    instead = () if enough else tuple(_instead(target, rival, rows, robot))
    factor = best.after[-1] / max(best.before, 1e-12)
    return ToldApart((target.label, rival.label), count, factor, enough, needed, instead)


def are_never_separable(target: Candidate, rival: Candidate, robot: Robot) -> bool:
    """Whether no poses of this arm name one of the two: curves of a joint without the full revolution that a name needs."""
    one, other = target.effects[0], rival.effects[0]
    if one.physical_class(robot).id != other.physical_class(robot).id or target.joints != rival.joints:
        return False
    needs = Separator.TURN in one.separators(robot) and (rival.empirical or Separator.TURN in other.separators(robot))
    followed = [own for effect in target.effects for own in effect.joint_frequencies(robot.n_joints)]
    return needs and any(factor * np.ptp(robot.limits[j]) < TURN for j, factor in followed)


def _instead(target: Candidate, rival: Candidate, rows: Observations, robot: Robot) -> Iterator[str]:
    """What tells the two apart that no poses are: what only one of them would show; else what each effect asks for."""
    found = [*_by_load(target, rival, rows), *_by_turn(target, rival, rows, robot), *_by_sensor(target, rival)]
    yield from found or (f"for {c.label}, {c.effects[0].remedy}" for c in (target, rival))


def _by_load(target: Candidate, rival: Candidate, rows: Observations) -> Iterator[str]:
    """A load that only one of them follows."""
    loaded = ["moments" in c.effects[0].needs for c in (target, rival)]
    if loaded[0] == loaded[1]:
        return
    used = 1 if rows.payload_kg is None else len(np.unique(rows.payload_kg))
    follows = (target if loaded[0] else rival).label
    what = "a second known payload" if used < 2 else "a heavier known payload"
    yield f"repeat old poses with {what}, which only {follows} follows"


def _by_turn(target: Candidate, rival: Candidate, rows: Observations, robot: Robot) -> Iterator[str]:
    """A full turn of a joint whose error curve is in question, if the joint can make one."""
    turning = {j for c in (target, rival) if Separator.TURN in c.effects[0].separated_by for j in c.joints or ()}
    able = [
        j for j in sorted(turning) if robot.joints[j].kind != "prismatic" and np.ptp(robot.limits[j]) >= 2.0 * np.pi
    ]
    short = [j for j in able if np.ptp(rows.q[:, j]) < 2.0 * np.pi]
    if short:
        yield f"move {joint_numbers(short)} through a full turn, after which a true error of the joint repeats"


def _by_sensor(target: Candidate, rival: Candidate) -> Iterator[str]:
    """A sensor at the place, which one of them moves and the other does not."""
    for own, other in ((target, rival), (rival, target)):
        if _at_encoder(own) and not (_at_encoder(other) and set(own.joints or ()) & set(other.joints or ())):
            yield f"read a link-side encoder of {joint_numbers(own.joints or ())}, which sees only {own.label}"
            break
    for own, other in ((target, rival), (rival, target)):
        if own.effects[0].physical in TILTING and _place(own) < _place(other):
            where = f"behind {joint_numbers(own.joints or ())}" if own.joints else "on the base"
            yield f"read an inclinometer {where}, which tilts with {own.label} alone"
            break


def _at_encoder(candidate: Candidate) -> bool:
    return bool(candidate.joints) and candidate.effects[0].physical in AT_ENCODER


def _place(candidate: Candidate) -> float:
    """How far out on the arm it begins to act: 0 the base, then the joints; beyond all of them what rotates nothing."""
    if candidate.joints:
        return float(min(candidate.joints) + 1)
    return 0.0 if candidate.effects[0].physical in TILTING else np.inf
