"""Poses that distinguish two named effects, without a search before: the planning job's purpose "separate A from B"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects import EFFECTS, Effect
from kilter_core.errors import OptionError
from kilter_core.gap.evidence.similarity.aliases import correlation
from kilter_core.gap.evidence.similarity.testability import testability
from kilter_core.gap.options import GapOptions
from kilter_core.gap.report.next_poses import Proposal, separate
from kilter_core.gap.report.told_apart import ToldApart, assess_separation
from kilter_core.gap.search.candidates import Candidate, Library
from kilter_core.gap.search.linear.linearized import LinearizedProblem, estimate_linear_parameters
from kilter_core.gap.search.prepare import Prepared, prepare_data
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
