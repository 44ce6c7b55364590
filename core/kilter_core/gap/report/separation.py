"""Poses that distinguish two named effects, whether they do, and how many would."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects import EFFECTS, Effect
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
from kilter_core.errors import FindingDocument, OptionError
from kilter_core.gap.effect_search import SearchOutcome
from kilter_core.gap.evidence.similarity.aliases import SAME, correlation
from kilter_core.gap.evidence.similarity.smooth import TURN
from kilter_core.gap.evidence.similarity.testability import testability
from kilter_core.gap.evidence.verdict import SURE, Judged
from kilter_core.gap.options import PLANNING, GapOptions
from kilter_core.gap.report.next_poses import Proposal, proposal_rows, separate
from kilter_core.gap.search.candidates import Candidate, Library
from kilter_core.gap.search.linear.linearized import LinearizedProblem, estimate_linear_parameters
from kilter_core.gap.search.prepare import Prepared, prepare_data
from kilter_core.gap.study import Study
from kilter_core.identify.seen_poses import seen_poses
from kilter_core.model import Calibration
from kilter_core.model.region import Region
from kilter_core.observations import Observations
from kilter_core.types import Floats, unheard

Named = tuple[str, Sequence[int] | None]  # id, joints from 0 (None: as the effect acts by itself)

IMAGINED_POSES = 60
IMAGINED_NOISE_MM = 0.05
IMAGINED_S = 3600.0
BARELY_SEEN = 3.0  # times what the data could just show: the amount of an effect that is not known yet


@dataclass(frozen=True)
class Plan:
    """Proposals, best first, for distinguishing ``labels``; ``alike`` is their correlation in what was measured.

    ``told`` says whether the proposals do it; None for an effect and the geometry.
    """

    proposals: tuple[Proposal, ...]
    labels: tuple[str, str]
    alike: float
    told: ToldApart | None


def plan_separation(
    robot: Robot,
    observations: Observations | None,
    first: Named,
    second: Named | None = None,
    count: int = 12,
    options: GapOptions | None = None,
    start: Calibration | None = None,
    region: Region | None = None,
) -> Plan:
    """Poses, loads and directions that separate two effects best, given what was measured already.

    An effect that ``start`` holds is taken as large as it is there, another as the data say or, if they say nothing, at
    three times what they could just see. Without ``second`` the first is distinguished from geometry: its amount becomes surer.
    Without ``observations`` a first campaign of random poses is imagined. New poses stay in ``region``: where the
    observations were when None. Where views alone told of the tool, each is weighed by the pixels that a view of it would have.

    Raises:
        OptionError: an effect these observations cannot have or that cannot act there, with the reason.

    """
    begin = start or Calibration.nominal(robot)
    wanted = [first] if second is None else [first, second]
    bare = _remove_effects(begin, wanted)
    options = replace(options or GapOptions(), effects=tuple(dict.fromkeys(name for name, _ in wanted)))
    if observations is None:
        options = replace(options, noise_mm=options.noise_mm or IMAGINED_NOISE_MM)
    rows = simulate_first_campaign(begin, options) if observations is None else observations
    (rows,), by_views, _ = seen_poses(begin, rows)
    prepared = prepare_data(bare, rows, options, unheard)
    chosen = [_find_candidate(prepared.library, named) for named in wanted]
    for candidate in chosen:
        _refuse_still(candidate, prepared.problem, robot)
    target, rivals = chosen[0], chosen[1:]
    proposals = separate(
        prepared.problem,
        prepared.visits.observations,
        target,
        rivals,
        (),
        _amounts(prepared, target, begin, observations),
        count,
        options.seed,
        region,
        by_views,
    )
    if not proposals:
        raise OptionError("Poses can be planned for measurements of the tool only: name campaigns with positions.")
    alike = correlation(prepared.problem.A, target.columns, rivals[0].columns) if rivals else 0.0
    told = assess_separation(proposals, target, rivals[0] if rivals else None, prepared.visits.observations, robot)
    return Plan(proposals, (target.label, rivals[0].label if rivals else "geometry"), float(alike), told)


def simulate_first_campaign(begin: Calibration, options: GapOptions) -> Observations:
    """Random poses as a first campaign would measure them: both directions, the default load or none, in one hour."""
    rng = np.random.default_rng(options.seed)
    q = Region.from_calibration(begin).draw(IMAGINED_POSES, rng)
    rows = Observations(
        q,
        direction=rng.choice([-1.0, 1.0], q.shape),
        temperature_c=20.0 + np.linspace(0.0, 1.0, len(q)),
        t=np.linspace(0.0, IMAGINED_S, len(q)),
    )
    load = begin.robot.load
    rows = replace(rows, payload_kg=np.zeros(len(q))) if load is None else rows.carrying(load.mass, load.com)
    noise = (options.noise_mm or IMAGINED_NOISE_MM) * 1e-3
    return replace(rows, position=begin.predict(rows).position + noise * rng.standard_normal((len(q), 3)))


def _remove_effects(begin: Calibration, wanted: Sequence[Named]) -> Calibration:
    """The start less the effects to plan for: what was confirmed is a question again."""
    kept: list[Effect] = []
    for effect in begin.model.effects:
        own = [joints for name, joints in wanted if name == effect.id]
        if not own:
            kept.append(effect)
            continue
        asked = {j for joints in own for j in joints or ()}
        left = tuple(j for j in effect.acting(begin.robot.n_joints) if j not in asked)
        if effect.at_joints and all(joints is not None for joints in own) and left:
            kept.append(replace(effect, joints=left))
    return begin.with_effects(kept)


def _find_candidate(library: Library, wanted: Named) -> Candidate:
    effect, joints = wanted
    own = [c for c in library.candidates if c.id == effect]
    exact = [c for c in own if joints is None or c.joints == tuple(joints)]
    if exact:
        return max(exact, key=lambda c: len(c.columns)) if joints is None else exact[0]
    why = next((f"{u.reason} Remedy: {u.remedy}." for u in library.refused if u.id == effect), "")
    if own:
        why = f"It acts at joints {sorted({j + 1 for c in own for j in c.joints or ()})}."
    where = "" if joints is None else f" at joints {[j + 1 for j in joints]}"
    raise OptionError(f"These observations cannot show {effect}{where}. {why}".strip(), option="effects", effect=effect)


def _refuse_still(candidate: Candidate, problem: LinearizedProblem, robot: Robot) -> None:
    """Refuse to plan for what moves nothing, whatever the pose: a load about a vertical first axis."""
    still = [k for k in candidate.columns if problem.scale[k] == 0.0]
    if len(still) < len(candidate.columns):
        return
    needs = EFFECTS[candidate.id].needs
    why = "what it needs is constant zero in these observations"
    if "moments" in needs:
        masses = robot.has_masses or np.any(problem.settings.source.batch.payload_kg)
        why = "no load moment acts there" if masses else "neither link masses nor a payload are known"
    raise OptionError(
        f"{candidate.label} moves nothing: {why}, so no pose can show it. Name another joint or effect. "
        f"What would show it: {candidate.effects[0].remedy}.",
        option="effects",
        effect=candidate.id,
    )


def _amounts(prepared: Prepared, target: Candidate, begin: Calibration, measured: Observations | None) -> Floats:
    """How large (d,) the effect is taken to be, SI."""
    columns = list(target.columns)
    names = [prepared.library.parameters[k].name for k in columns]
    known = dict(zip(begin.names, begin.values, strict=True))
    if all(name in known for name in names) and any(known[name] for name in names):
        return np.array([known[name] for name in names])
    smallest = testability(prepared.problem, prepared.library).smallest[columns]
    sigma = prepared.problem.settings.source.library_sigma[columns]
    barely = np.where(np.isfinite(smallest), np.minimum(BARELY_SEEN * smallest, sigma), sigma)
    if measured is None:
        return np.asarray(barely)
    values, covariance = estimate_linear_parameters(prepared.problem, columns)
    seen = np.abs(values) > 2.0 * np.sqrt(np.diag(covariance))
    return np.asarray(np.where(seen, values, barely))


def undecided_effect_pair(report: dict[str, Any]) -> tuple[Named, Named | None] | None:
    """What a search's report (its document) left open: an effect and its nearest alias, or a name to make surer."""

    def effect_and_joints(row: dict[str, Any]) -> Named:
        joints = row.get("joints")
        return row["id"], None if joints is None else tuple(j - 1 for j in joints)

    effects = [e for e in report.get("effects") or () if not e.get("empirical")]
    for effect in effects:
        rivals = [a for a in effect.get("alias_set") or () if a["correlation"] < 1.0 - 1e-4 and a["id"] in EFFECTS]
        if rivals:
            return effect_and_joints(effect), effect_and_joints(rivals[0])
    weak = [e for e in effects if e["verdict"] in ("provisional", "contradicted")]
    return (effect_and_joints(weak[0]), None) if weak else None


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

    def warnings(self) -> Iterator[FindingDocument]:
        """Warn where the poses are not enough."""
        if not self.enough:
            yield FindingDocument.make("poses_will_not_tell", self.sentence)


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
