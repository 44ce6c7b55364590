"""What was typed into the form of a new job, as the job that the HTTP interface takes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any
from urllib.parse import urlencode

from fastapi.exceptions import RequestValidationError
from pydantic import TypeAdapter, ValidationError

from kilter_service.contract.campaigns import Campaign
from kilter_service.contract.jobs.job import Folds
from kilter_service.contract.jobs.registry import KINDS, Job, NewJob
from kilter_service.ground.errors import ServiceError
from kilter_service.jobs.refusals import refusal, without_kind
from kilter_service.jobs.registry import get_job_kind
from kilter_service.page.jobs import options

NEW_JOB: TypeAdapter[NewJob] = TypeAdapter(NewJob)
USE = "use."
FEWEST_ROWS = 10  # of a campaign that is preset, where there are larger ones
APART = timedelta(days=7)  # between the set-ups of an instrument
MOST_PRESET = 12  # campaigns of a role
USES = {"train": "campaigns", "validation": "validation", "confirmation": "confirmation"}


def parse_new_job(robot: str, typed: Mapping[str, str]) -> NewJob:
    """Return the job that was asked for.

    Raises:
        ServiceError: an option or the hold-out is not what it must be.
        RequestValidationError: the job does not fit the contract.

    """
    kind = typed.get("kind", "")
    get_job_kind(kind)  # refuses one that does not exist
    document: dict[str, Any] = {"kind": kind, "robot": robot, "name": typed.get("name", "").strip()}
    document |= _parse_campaign_uses(typed)
    document["options"] = options.parse_typed_values(kind, typed)
    try:
        return NEW_JOB.validate_json(json.dumps(document))
    except ValidationError as error:
        found = [{**one, "loc": ("body", *one["loc"])} for one in error.errors()]
        refused = refusal(found, document)
        if refused is not None:
            raise refused from error
        raise RequestValidationError(without_kind(found, document)) from error


def _parse_campaign_uses(typed: Mapping[str, str]) -> dict[str, Any]:
    named: dict[str, list[str]] = {name: [] for name in USES.values()}
    for field, use in typed.items():
        if field.startswith(USE) and use in USES:
            named[USES[use]].append(field.removeprefix(USE))
    part = _parse_hold_out(typed)
    if named["validation"] and part is not None:
        raise ServiceError(
            "Campaigns are held out and so is a part of the poses: choose one of the two.",
            code="option_invalid",
            option="validation",
        )
    return {**named, "validation": named["validation"] or part}


def _parse_hold_out(typed: Mapping[str, str]) -> dict[str, Any] | float | None:
    how, text = typed.get("held_out", ""), typed.get("held_out_value", "").strip()
    if not how:
        return None
    try:
        return {"folds": int(text)} if how == "folds" else float(text)
    except ValueError as error:
        wanted = "a whole number of folds, such as 5" if how == "folds" else "a fraction from 0 to 1, such as 0.25"
        raise ServiceError(
            f"{text!r} is held out, which cannot be read: write {wanted}.", code="option_invalid", option="validation"
        ) from error


def uses(chosen: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Return what each campaign is preset for, by its id: an address may name campaigns by their use."""
    return {campaign: use for use, field in USES.items() for campaign in chosen.get(field, ())}


def by_role(kind: str, campaigns: Sequence[Campaign]) -> dict[str, str]:
    """Return what each campaign is preset for by what it is meant for, where the address names none.

    Of each role those of the newest set-up: back from the newest until nothing was measured for a week.
    """
    out: dict[str, str] = {}
    for role, use in KINDS[kind].uses.items():
        whole = [one for one in campaigns if one.role == role and one.rows and not one.staged]
        few = KINDS[kind].most_campaigns == 1  # a check has few rows
        enough = [one for one in whole if few or one.rows >= FEWEST_ROWS] or whole
        out |= {one.id: use for one in _newest(enough)[: KINDS[kind].most_campaigns]}
    if not out:  # no form opens that could only be refused
        rest = [one for one in campaigns if one.rows and not one.staged]
        out = {one.id: "train" for one in sorted(rest, key=_measurement_time)[-1:]}
    return out


def _newest(campaigns: Sequence[Campaign]) -> list[Campaign]:
    """Campaigns that were measured together with the newest, at most so many as are preset."""
    ordered = sorted(campaigns, key=_measurement_time, reverse=True)
    apart = (
        k for k in range(1, len(ordered)) if _measurement_time(ordered[k - 1]) - _measurement_time(ordered[k]) > APART
    )
    return ordered[: min(next(apart, len(ordered)), MOST_PRESET)]


def _measurement_time(campaign: Campaign) -> datetime:
    return campaign.measured_at or campaign.created_at


def query_from_job(job: Job) -> str:
    """Return the query of the address that fills the form as a job was asked for."""
    held = job.validation
    asked: list[tuple[str, Any]] = [("kind", job.kind), *(("campaigns", one) for one in job.campaigns)]
    if isinstance(held, list):
        asked += [("validation", one) for one in held]
    elif held is not None:
        how, much = ("folds", held.folds) if isinstance(held, Folds) else ("fraction", held)
        asked += [("held_out", how), ("held_out_value", much)]
    asked += [("confirmation", one) for one in job.confirmation]
    given = job.options.model_dump(mode="json", exclude_unset=True)
    return urlencode(asked + [(name, _written(value)) for name, value in given.items() if value is not None])


def _written(value: Any) -> str:
    """Write an option as its field takes it."""
    if isinstance(value, list) and all(isinstance(one, str) for one in value):
        return ", ".join(value)
    return value if isinstance(value, str) else json.dumps(value)
