"""What the story of a gap search shows."""

from __future__ import annotations

from typing import Any

from kilter_service.campaigns import service as campaigns
from kilter_service.campaigns.suspicious import service as suspicious
from kilter_service.contract.campaigns import Campaign
from kilter_service.contract.gap_details import GapSize
from kilter_service.contract.jobs.gap import GAP, GapJob, GapResult
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page
from kilter_service.jobs import service as jobs
from kilter_service.page.gap import answers, claim, curves, rivals, tested, where
from kilter_service.page.shared import own_curves, steps
from kilter_service.page.shared.called import format_claim

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
    unit = steps.error_unit(result.gap)
    read = steps.steps_shown(result.figures, unit)
    return {
        "version": result.version_id,
        "result": result,
        "unit": unit,
        "verdict": VERDICTS.get(result.verdict or "", (result.verdict or "", "faint")),
        "size": sizes(result.gap, unit),
        "answers": answers.answers(result),
        "set_aside": answers.set_aside(result),
        "suspicious": suspicious.of_campaigns(database, searched_campaigns(job)),
        "where": where.heat_map(result.where or []),
        "where_table": where.table(result.where or []),
        "clearest": where.clearest(result.where or []),
        "effects": [(format_claim(effect), effect) for effect in result.effects or []],
        "candidates": tested.candidates(result, job.options, unit),
        "untestable": tested.untestable(result.not_testable or []),
        "own_curves": own_curves.own_curves(result.effect_curves),
        "others_moved": own_curves.has_effect_without_curve(result),
        "curves": curves.curves(result.figures, unit),
        "steps": None if read is None else steps.plot(read),
        "steps_said": "" if read is None else steps.describe(read),
        "rivals": rivals.rivals(result),
        "alias_map": rivals.heat_map(result.alias_matrix),
        "claims": [claim.claim_from_effect(effect, unit) for effect in result.effects or []],
        "levels": claim.LEVELS,
        "newer": newer(database, job),
    }


def sizes(gap: GapSize | None, unit: str) -> dict[str, float | None]:
    """Return the errors before and after and the noise, of held-out poses, in one unit."""
    if gap is None:
        return dict.fromkeys(("before", "after", "noise"))
    values = gap.model_dump()
    names = {"before": "validation_before", "after": "validation_after", "noise": "validation_noise_rms"}
    return {name: values[f"{field}_{unit.split()[0]}"] for name, field in names.items()}


def searched_campaigns(job: GapJob) -> list[str]:
    """Return the campaigns that a search looked at, and those it held out."""
    return [*job.campaigns, *(job.validation if isinstance(job.validation, list) else [])]


def newer(database: Database, job: GapJob) -> list[Campaign]:
    """Return campaigns of the robot that the search did not use, the newest first."""
    used = {*searched_campaigns(job), *job.confirmation}
    found = campaigns.list_campaigns(database, job.robot, Page()).campaigns
    rest = [campaign for campaign in found if campaign.id not in used]
    return sorted(rest, key=lambda campaign: campaign.created_at, reverse=True)[:MOST_CAMPAIGNS]
