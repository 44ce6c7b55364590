"""The story of a gap search: what it found, and what follows from it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Annotated, Any, Literal

from fastapi import Form, Request, Response

from kilter_service.campaigns import service as campaigns
from kilter_service.campaigns import suspicious
from kilter_service.contract.campaigns import Campaign
from kilter_service.contract.gap_details import AtJoints, Detectable, NamedEffect, Place, Refused, Untestable
from kilter_service.contract.jobs.gap import GAP, GapJob, GapOptions, GapResult
from kilter_service.contract.jobs.plan import PLAN, PlanOptions
from kilter_service.contract.jobs.registry import Job
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import plural
from kilter_service.ground.paging import Page
from kilter_service.jobs import service as jobs
from kilter_service.page.answers import redirect, router
from kilter_service.page.figures.drawn import HeatMap
from kilter_service.page.gap import effects
from kilter_service.page.shared import curves, errors_drawn
from kilter_service.page.shared.naming import (
    chance,
    format_claim,
    format_effect_at_joints,
    format_effect_name,
    parse_joint_number,
)
from kilter_service.page.words import joined_by_and, number, percent
from kilter_service.web.auth.access import Admin
from kilter_service.web.routing import DatabaseOfApp

Use = Literal["rows", "confirmation"]


def plan(database: Database, job: GapJob) -> Job:
    """Queue a plan of poses: those that tell apart what is undecided, else those that show what was named best."""
    result = job.result
    if result is None or result.version_id is None:
        raise ServiceError(f"Job {job.id} made no version to plan with.", code="option_invalid", job=job.id)
    if any(pose.information_factor is not None for pose in result.next_poses or []):
        options = PlanOptions(purpose="separate", version=result.version_id)
    else:
        asked = {"purpose": "identify", "version": result.version_id, "effects": _effects(job)}
        options = PlanOptions.model_validate(asked)
    return jobs.submit(database, PLAN.request(kind="plan", robot=job.robot, campaigns=job.campaigns, options=options))


def _effects(job: GapJob) -> list[str]:
    effects = (job.result.effects if job.result is not None else None) or []
    return list(dict.fromkeys(effect.id for effect in effects if not effect.empirical))


def search_again(database: Database, job: GapJob, campaign: str, use: Use) -> Job:
    """Queue the same search with a further campaign: as rows to search, or as a confirmation."""
    more = (
        {"campaigns": [*job.campaigns, campaign]} if use == "rows" else {"confirmation": [*job.confirmation, campaign]}
    )
    asked = {
        "kind": "gap",
        "robot": job.robot,
        "campaigns": job.campaigns,
        "validation": job.validation,
        "confirmation": job.confirmation,
        "options": job.options.model_dump(mode="json", exclude_unset=True),
        **more,
    }
    return jobs.submit(database, GAP.request.model_validate(asked))


MIMICKED = 0.1  # share of a signature that geometry leaves, below which it is said to imitate it


@dataclass(frozen=True)
class Candidate:
    """A candidate of the search and what became of it."""

    name: str
    outcome: str
    look: str
    reason: str


def candidates(result: GapResult, options: GapOptions, unit: str) -> list[Candidate]:
    """Return those named, their rivals, those refused."""
    return [*_named_candidates(result.effects or [], unit), *_refused_candidates(result, options)]


def _named_candidates(effects: Sequence[NamedEffect], unit: str) -> Iterator[Candidate]:
    for effect in effects:
        gain = _gain(effect.gain_mm, unit)
        level = (effect.verdict or "").replace("_", " ")
        look = "warn" if effect.verdict in ("provisional", "contradicted") else "good"
        yield Candidate(
            format_effect_name(effect),
            f"named, {level}",
            look,
            f"{gain}p {chance(effect.p_value)} that chance does as much",
        )
        for rival in effect.alias_set or []:
            behind = f"{number(rival.behind, 2)} points behind, " if rival.behind else "does as well, "
            reason = (
                f"{behind}its signature correlates {number(rival.correlation, 2)} with {format_effect_name(effect)}"
            )
            yield Candidate(format_effect_name(rival), "cannot be told apart", "warn", reason)


def _gain(gain: float | None, unit: str) -> str:
    """What an effect takes off the plain rms error, or that it takes off the weighed one only."""
    if gain is None:
        return ""
    if gain < 0.0:
        return f"explains the surer readings better, and adds {number(-gain)} {unit} to the plain rms error; "
    return f"takes {number(gain)} {unit} off the rms error; "


def _refused_candidates(result: GapResult, options: GapOptions) -> Iterator[Candidate]:
    effects = result.effects or []
    known: list[AtJoints] = [*effects, *(rival for effect in effects for rival in effect.alias_set or [])]
    taken: set[tuple[str, int | None]] = {(one.id, None) for one in known if not one.joints}
    taken |= {(one.id, joint) for one in known for joint in one.joints or []}
    rest = [one for one in result.smallest_detectable or [] if _key(one) not in taken]
    scores: dict[tuple[str, int | None], Refused] = {}
    for one in result.refused or []:
        scores |= {(one.id, joint): one for joint in (one.joints or (None,))}
    for key, group in groupby(sorted(rest, key=lambda d: (d.id, parse_joint_number(d.parameter or "") or 0)), key=_key):
        yield _candidate(list(group), effects, options, scores.get(key))


def _key(one: Detectable) -> tuple[str, int | None]:
    return one.id, parse_joint_number(one.parameter or "")


def _candidate(
    group: list[Detectable], effects: Sequence[NamedEffect], options: GapOptions, score: Refused | None
) -> Candidate:
    name, joint = _key(group[0])
    seen = "; ".join(
        f"{number(one.smallest_detectable, 2)}{'' if one.unit in (None, '1') else f' {one.unit}'} of {one.parameter or name}"
        for one in group
    )
    rest = f" beside {joined_by_and([format_effect_name(effect) for effect in effects])}" if effects else ""
    reason = f"{_refusal_reason(score, options, _names(effects))}{rest}; would be seen from {seen}"
    share = max((one.visibility or 0.0) for one in group)
    if share < MIMICKED:
        reason += f"; geometry imitates {percent(1 - share)} of it"
    return Candidate(format_effect_at_joints(name, [joint] if joint else []), "refused", "faint", reason)


def _names(effects: Sequence[NamedEffect]) -> int:
    """How many names those are of the number allowed: an effect at several joints is one, a shape each of its joints."""
    return len({(one.id, tuple(one.joints or ()) if one.empirical else ()) for one in effects})


def _refusal_reason(score: Refused | None, options: GapOptions, named: int) -> str:
    """Why a candidate was not named, by its score at the final fit."""
    if score is None or score.p_value is None or score.explains is None:
        return "explains nothing of its own"
    said = f"explains {number(100 * score.explains, 2)} % of what is left, p {chance(score.p_value)}"
    if score.p_value > options.alpha:
        return f"no better than chance: {said}"
    if named >= options.max_effects:
        return f"{said}, but no more effects than {options.max_effects} were asked for"
    return f"{said}, but has not the sign or size of such an effect, or does not keep it when all is fitted again"


def untestable(rows: Sequence[Untestable]) -> dict[str, list[tuple[str, str, str]]]:
    """Return what these rows cannot say, by what is missing: the effect, why, and what would help; equal reasons together."""
    found: dict[tuple[str, str, str, str], list[int]] = {}
    for row in rows:
        key = (row.missing or row.reason or "", row.id, row.reason or "", row.remedy or "")
        found.setdefault(key, []).extend(row.joints or [])
    groups: dict[str, list[tuple[str, str, str]]] = {}
    for (missing, name, reason, remedy), joints in found.items():
        groups.setdefault(missing, []).append((format_effect_at_joints(name, joints), reason, remedy))
    return groups


SURE = 0.05
OF_JOINT = re.compile(r"^(?:contrast: )?(.*) of joint (\d+)$")
WHOLE = "whole arm"
CELL = 44.0
Cells = dict[tuple[str, str], float]


def heat_map(places: Sequence[Place]) -> HeatMap | None:
    """Draw the levels that stand out, the largest of each factor; None where nothing does."""
    cells: Cells = {}
    for place in places:
        if stands_out(place):
            cell = _cell(place.factor or "")
            cells[cell] = max(cells.get(cell, 0.0), times(place))
    if not cells:
        return None
    rows = list(dict.fromkeys(row for row, _ in cells))
    joints = sorted({column for _, column in cells} - {WHOLE}, key=lambda name: int(name.split()[-1]))
    columns = [*joints, *([WHOLE] if any(column == WHOLE for _, column in cells) else [])]
    values = [[cells.get((row, column), math.nan) for column in columns] for row in rows]
    return HeatMap(
        "Where the model was wrong",
        rows,
        columns,
        values,
        low=1.0,
        high=max(2.0, *cells.values()),
        cell=CELL,
        description=_describe_largest(cells),
    )


def stands_out(place: Place) -> bool:
    """Whether noise seldom gives such an excess anywhere."""
    return place.p_value is not None and place.p_value < SURE and (place.excess or 0.0) > 0.0


def times(place: Place) -> float:
    """Return the error there in multiples of what noise leaves."""
    return math.sqrt(max(0.0, 1.0 + (place.excess or 0.0)))


def table(places: Sequence[Place]) -> tuple[list[str], list[list[str]]]:
    """Return every level of the report."""
    rows = [
        [f"{_words(p.factor or '')}: {p.level or ''}", number(times(p), 2), chance(p.p_value), str(p.visits or "–")]
        for p in places
    ]
    return ["Factor and level", "Times what noise leaves", "Chance by noise (p)", "Visits"], rows


def clearest(places: Sequence[Place]) -> str:
    """Say the place that is the least likely by noise, in words."""
    found = [place for place in places if stands_out(place)]
    if not found:
        return ""
    best = min(found, key=lambda place: (place.p_value or 0.0, -(place.excess or 0.0)))
    # A contrast of one pose under two conditions often holds several joints at once: bins tell which one.
    bins = [place for place in found if not (place.factor or "").startswith("contrast")]
    worst = max(bins, key=lambda place: place.excess or 0.0) if bins else best
    return f"{_words(worst.factor or '')}: {worst.level} ({number(times(worst), 2)} times what noise leaves)"


def _cell(factor: str) -> tuple[str, str]:
    found = OF_JOINT.match(factor)
    contrast = factor.startswith("contrast: ")
    name = found[1] if found else factor.removeprefix("contrast: ")
    return (f"same pose, two {name}s" if contrast else name), (f"joint {found[2]}" if found else WHOLE)


def _words(factor: str) -> str:
    if factor.startswith("contrast: "):
        return f"same pose under two values, {factor.removeprefix('contrast: ')}"
    return factor


def _describe_largest(cells: Cells) -> str:
    row, column = max(cells, key=lambda cell: cells[cell])
    return f"The largest: {row}, {column}, {number(cells[row, column], 2)} times what noise leaves."


def set_aside(result: GapResult) -> str:
    """Say how many visits took no part in the search."""
    return f"{' '.join(_aside(result)) or 'The search set none aside: every visit took part.'}"


def _aside(result: GapResult) -> Iterator[str]:
    for warning in result.warnings or []:
        if warning.code == "outliers" or warning.visits or warning.rows:
            yield warning.message
    held = (result.gap.held_out_set_aside if result.gap is not None else None) or 0
    if held:
        every = result.gap.validation_after_all_mm if result.gap is not None else None
        with_them = "" if every is None else f"; with them the error after is {number(every, 4)} mm"
        yield f"{plural(held, 'held-out visit')} no model of this search predicts, left out of its errors{with_them}."
    told, fit = result.predictive, None if result.adequacy is None else result.adequacy.held_out
    if told is not None and told.of_all:
        yield (
            f"Of held-out coordinates {told.inside} of {told.of} are within their 95 % intervals; with what was set aside "
            f"{told.inside_all} of {told.of_all}."
        )
    if fit is not None and fit.freedom_all:
        yield (
            f"Their chi-square is {number(fit.chi2)} for {fit.freedom} numbers; with what was set aside "
            f"{number(fit.chi2_all)} for {fit.freedom_all}."
        )


VERDICTS = {
    "closed": ("The gap is closed", "good"),
    "no_gap": ("Nothing is missing", "good"),
    "not_known": ("Not known without repeats", "warn"),
    "provisional": ("Likely explained, not yet confirmed", "warn"),
    "unexplained": ("The gap is not explained", "bad"),
}
MOST_CAMPAIGNS = 50  # newest of the robot, from which one can be taken in


def get_gap_job(database: Database, job: str) -> GapJob:
    """Return a gap search.

    Raises:
        ServiceError: no such job, or one of another kind.

    """
    found = jobs.get(database, job)
    if not GAP.is_kind_of(found):
        raise ServiceError(
            f"Job {job} is not a gap search: it is of kind {found.kind}.", code="option_invalid", job=job
        )
    return found


def result_context(database: Database, job: GapJob) -> dict[str, Any]:
    """Return what ``gap/result.html`` shows of a search that has succeeded."""
    result = job.result or GapResult()
    unit = errors_drawn.error_unit(result.gap)
    read = errors_drawn.steps_shown(result.figures, unit)
    verdict = VERDICTS.get(result.verdict or "", (result.verdict or "Searched", "faint"))
    return {
        "version": result.version_id,
        "result": result,
        "unit": unit,
        "verdict": verdict,
        "lines": (result.headline or verdict[0]).splitlines(),
        "cards": effects.cards(result, unit),
        "poses_decide": result.told_apart is None or result.told_apart.enough or not result.told_apart.instead,
        "decide": effects.describe_decision(result),
        "set_aside": set_aside(result),
        "suspicious": suspicious.of_campaigns(database, searched_campaigns(job)),
        "where": heat_map(result.where or []),
        "where_table": table(result.where or []),
        "clearest": clearest(result.where or []),
        "effects": [(format_claim(effect), effect) for effect in result.effects or []],
        "candidates": candidates(result, job.options, unit),
        "untestable": untestable(result.not_testable or []),
        "own_curves": curves.own_curves(result.effect_curves),
        "curves": curves.curves(result.figures, unit),
        "steps": None if read is None else errors_drawn.plot(read),
        "steps_said": "" if read is None else errors_drawn.describe(read),
        "rivals": effects.rivals(result),
        "alias_map": effects.heat_map(result.alias_matrix),
        "claims": [effects.claim_from_effect(effect, unit) for effect in result.effects or []],
        "newer": newer(database, job),
    }


def searched_campaigns(job: GapJob) -> list[str]:
    """Return the campaigns that a search looked at, and those it held out."""
    return [*job.campaigns, *(job.validation if isinstance(job.validation, list) else [])]


def newer(database: Database, job: GapJob) -> list[Campaign]:
    """Return campaigns of the robot that the search did not use, the newest first."""
    used = {*searched_campaigns(job), *job.confirmation}
    found = campaigns.list_campaigns(database, job.robot, Page()).campaigns
    rest = [campaign for campaign in found if campaign.id not in used]
    return sorted(rest, key=lambda campaign: campaign.created_at, reverse=True)[:MOST_CAMPAIGNS]


@router.post("/jobs/{job}/gap/plan")
def queue_plan(job: str, request: Request, database: DatabaseOfApp, _: Admin) -> Response:
    """Queue a plan of poses that make the claims surer."""
    queued = plan(database, get_gap_job(database, job))
    return redirect(request, f"/jobs/{queued.id}")


@router.post("/jobs/{job}/gap/again")
def repeat_search(
    job: str,
    request: Request,
    database: DatabaseOfApp,
    _: Admin,
    campaign: Annotated[str, Form(max_length=100)],
    use: Annotated[Use, Form()],
) -> Response:
    """Queue the search again with a further campaign."""
    queued = search_again(database, get_gap_job(database, job), campaign, use)
    return redirect(request, f"/jobs/{queued.id}")
