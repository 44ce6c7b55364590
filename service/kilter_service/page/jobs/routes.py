"""Jobs in the browser: the form of a new one, its check, and one of them."""

from __future__ import annotations

import hashlib
import hmac
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cache
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import Depends, Query, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import HTMLResponse, PlainTextResponse
from pydantic import TypeAdapter, ValidationError

from kilter_service.campaigns import service as campaigns
from kilter_service.contract.campaigns import Campaign
from kilter_service.contract.jobs.check import MadeVersion
from kilter_service.contract.jobs.kind import Folds
from kilter_service.contract.jobs.registry import KINDS, Job, JobCheck, NewJob
from kilter_service.ground.core import core_effects
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page
from kilter_service.jobs import checking
from kilter_service.jobs import service as jobs
from kilter_service.jobs.refusals import refusal, without_kind
from kilter_service.jobs.registry import get_job_kind
from kilter_service.page.answers import redirect, render, router
from kilter_service.page.jobs import results as planned
from kilter_service.page.jobs.results import OF_TORQUES, PLAIN, RESULTS
from kilter_service.page.shared import lists
from kilter_service.page.shared.lists import KINDS as TITLES
from kilter_service.page.shared.lists import page_of_jobs
from kilter_service.page.shared.naming import version_name
from kilter_service.robots import service as robots
from kilter_service.versions import service as versions
from kilter_service.web.auth.access import Admin
from kilter_service.web.routing import DatabaseOfApp

PREFIX = "option."
EFFECT = "effect."  # an effect that was ticked in the list
NUMBERS = {"number", "integer"}


@dataclass(frozen=True)
class Field:
    """A field of the form; ``form`` is `choice`, `number`, `text`, `names` or `json`."""

    name: str
    form: str
    hint: str
    default: str
    choices: tuple[str, ...] = ()
    required: bool = False


@cache
def fields(kind: str) -> tuple[list[Field], list[Field]]:
    """Return the usual options of a kind, and the others."""
    schema, first = KINDS[kind].options.model_json_schema(), KINDS[kind].usual
    made = {name: _field(name, part, schema) for name, part in schema["properties"].items()}
    return [made[name] for name in first], [field for name, field in made.items() if name not in first]


def parse_typed_values(kind: str, typed: Mapping[str, str]) -> dict[str, Any]:
    """Return the options that were typed; what was left empty has its default.

    Raises:
        ServiceError: what was typed is not what the option takes.

    """
    usual, others = fields(kind)
    texts = {field.name: typed.get(PREFIX + field.name, "").strip() for field in [*usual, *others]}
    found = {field.name: _read(field, texts[field.name]) for field in [*usual, *others] if texts[field.name]}
    ticked = [name.removeprefix(EFFECT) for name in typed if name.startswith(EFFECT)]
    if ticked and "effects" in texts:
        found["effects"] = [*found.get("effects", []), *(one for one in ticked if one not in found.get("effects", []))]
    return found


def _field(name: str, part: Mapping[str, Any], schema: Mapping[str, Any]) -> Field:
    hint, required = (
        part.get("description", "").replace("null:", "empty:").replace("`", ""),
        name in schema.get("required", []),
    )
    default = part.get("default")
    shown = "" if default in (None, [], {}, "") else json.dumps(default).strip('"')
    parts = [_resolve_reference(one, schema) for one in part.get("anyOf", [part])]
    kinds = {str(one.get("type", "")) for one in parts} - {"null"}
    choices = tuple(
        json.dumps(value).strip('"')
        for one in parts
        for value in one.get("enum", [one["const"]] if "const" in one else [])
    )
    if "boolean" in kinds:
        return Field(name, "choice", hint, shown, ("true", "false"), required)
    if choices:
        return Field(name, "choice", hint, shown, choices, required)
    form = "json"
    if kinds <= NUMBERS:
        form = "number"
    elif kinds == {"string"}:
        form = "text"
    elif kinds == {"array"}:
        form = "names"
    return Field(name, form, hint, shown, (), required)


def _resolve_reference(part: Mapping[str, Any], schema: Mapping[str, Any]) -> Mapping[str, Any]:
    target = part.get("$ref", "").rpartition("/")[2]
    found: Mapping[str, Any] = schema["$defs"][target] if target else part
    return found


def _read(field: Field, text: str) -> Any:
    if field.form == "text":
        return text
    if field.form == "choice":
        return _number_or_text(text)
    if field.form == "names" and not text.startswith("["):
        return [_number_or_text(one.strip()) for one in text.split(",") if one.strip()]
    try:
        return json.loads(text)
    except ValueError as error:
        wanted = "a number" if field.form == "number" else "JSON"
        raise ServiceError(
            f"{field.name}: {text!r} cannot be read. Write {wanted}, or leave it empty.",
            code="option_invalid",
            option=field.name,
        ) from error


def _number_or_text(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text


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
    document["options"] = parse_typed_values(kind, typed)
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


def uses_from_address(chosen: Mapping[str, Sequence[str]]) -> dict[str, str]:
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


# The seal of a passed check: Run is refused unless the check passed for exactly these inputs.
#
# The seal is a keyed hash of the job as it was checked and of its campaigns as they were then. Nothing is stored:
# Run computes it anew, so it fits no other input and no campaign that has changed since.


def compute_job_seal(database: Database, key: str, job: NewJob) -> str:
    """Return the seal of a job and its campaigns as they are now."""
    held = job.validation if isinstance(job.validation, list) else []
    used = [*job.campaigns, *held, *job.confirmation]
    state = [campaigns.get(database, campaign).model_dump(mode="json") for campaign in used]
    text = json.dumps([job.model_dump(mode="json"), state], sort_keys=True)
    return hmac.new(key.encode(), b"check of a job\n" + text.encode(), hashlib.sha256).hexdigest()


def demand(database: Database, key: str, job: NewJob, given: str) -> None:
    """Refuse a job that was not checked as it is.

    Raises:
        ServiceError: no check passed for these inputs, or a campaign has changed since.

    """
    if not hmac.compare_digest(compute_job_seal(database, key, job).encode(), given.encode()):
        raise ServiceError(
            "No check has passed for exactly these inputs, or a campaign has changed since: press Check, then Run.",
            code="option_invalid",
        )


MOST_JOBS = 50
MOST_OFFERED, MOST_SOUGHT = 8, 20  # campaigns beside those that are preset, and of a search
MOST_VERSIONS = 200  # that a field offers by name
MOST_SEARCHES = 50
CAMPAIGNS_USED = ("campaigns", "validation", "confirmation")


def new_job_context(database: Database, robot: str, kind: str, chosen: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Return what the form of a new job shows; ``chosen`` presets campaigns by use, and options by name.

    Raises:
        CoreError: no such kind of job.
        ServiceError: no such robot.

    """
    robots.get(database, robot)
    get_job_kind(kind)
    usual, others = fields(kind)
    found = campaigns.list_campaigns(database, robot, Page()).campaigns[::-1]
    uses = uses_from_address(chosen) or by_role(kind, found)
    rest = [one for one in found if one.id not in uses]
    return {
        "robot": robot,
        "kind": kind,
        "kinds": TITLES,
        "usual": usual,
        "others": others,
        "preset": {name: values[0] for name, values in chosen.items() if values and name not in CAMPAIGNS_USED},
        "campaigns": [*(one for one in found if one.id in uses), *rest[:MOST_OFFERED]],
        "more": len(rest[MOST_OFFERED:]),
        "uses": uses,
        "versions": versions.list_versions(database, robot, Page(limit=MOST_VERSIONS)).versions,
        "searches": jobs.list_searches_in_torques(database, robot, MOST_SEARCHES),
        "effects": effects_in_words() if any(one.name == "effects" for one in (*usual, *others)) else {},
        "confirms": KINDS[kind].takes_confirmation,
        "found": page_of_jobs(database, robot, Page(limit=MOST_JOBS)),
    }


def search_campaigns(database: Database, robot: str, kind: str, text: str) -> dict[str, Any]:
    """Return the campaigns of a robot in whose name, device or notes all words of a text are, newest first."""
    get_job_kind(kind)
    found = campaigns.list_campaigns(database, robot, Page()).campaigns[::-1]
    part = lists.select_page(
        found, lists.Asked(search=text), lambda one: f"{one.name} {one.device} {one.notes} {one.id}", {}
    )
    shown = part.shown[:MOST_SOUGHT]
    return {"campaigns": shown, "found": part.found, "uses": {}, "confirms": KINDS[kind].takes_confirmation}


def effects_in_words() -> dict[str, str]:
    """Return the effects that a person may add to a model, by id, with what each is."""
    return {name: effect.summary for name, effect in sorted(core_effects.EFFECTS.items()) if not effect.nuisance}


def check_and_seal(database: Database, key: str, job: NewJob) -> tuple[JobCheck, str]:
    """Return the check of a job, and its seal if it would run, else an empty one."""
    given = compute_job_seal(database, key, job)  # of the campaigns as they were before the check read them
    found = checking.check(database, job)
    return found, given if found.would_run else ""


def run(database: Database, key: str, job: NewJob, given: str) -> Job:
    """Queue a job whose check has passed.

    Raises:
        ServiceError: it was not checked as it is.

    """
    demand(database, key, job, given)
    return jobs.submit(database, job)


def load_job_view(database: Database, job_id: str) -> tuple[Job, str, dict[str, Any]]:
    """Return a job, the template of its result (empty: there is none yet), and what fills it."""
    job = jobs.get(database, job_id)
    names = {
        one.id: one.name for one in campaigns.list_campaigns(database, job.robot, Page(), with_retired=True).campaigns
    }
    if job.state != "succeeded" or job.result is None:
        return job, "", {"names": names, "version": None, "place": jobs.places(database).get(job.id)}
    of_torques = job.kind == "identify" and job.result.motion is not None
    template, shown = OF_TORQUES if of_torques else RESULTS.get(job.kind, PLAIN)
    makes_version = isinstance(job.result, MadeVersion)  # and has objections against it
    return job, template, {"names": names, "makes_version": makes_version, **shown(database, job)}


SEAL = "seal"


async def form_texts(request: Request) -> dict[str, str]:
    """Return the texts of a form."""
    return {name: value for name, value in (await request.form()).items() if isinstance(value, str)}


Typed = Annotated[dict[str, str], Depends(form_texts)]


@router.get("/robots/{robot}/jobs")
def show_form(robot: str, request: Request, database: DatabaseOfApp, kind: str = "identify") -> HTMLResponse:
    """Show the form of a new job, and the robot's jobs."""
    chosen = {name: request.query_params.getlist(name) for name in request.query_params}
    return render(request, "jobs/new.html", **new_job_context(database, robot, kind, chosen))


@router.get("/robots/{robot}/jobs/campaigns")
def find_campaigns(
    robot: str,
    request: Request,
    database: DatabaseOfApp,
    kind: Annotated[str, Query(max_length=40)] = "identify",
    sought: Annotated[str, Query(max_length=200)] = "",
) -> HTMLResponse:
    """Find campaigns for the form of a new job."""
    found = search_campaigns(database, robot, kind, sought)
    return render(request, "jobs/campaigns_part.html", **found)


@router.post("/robots/{robot}/jobs/check")
def check_job(robot: str, request: Request, database: DatabaseOfApp, texts: Typed) -> HTMLResponse:
    """Say what the job would do; if it would run, hand out the seal that Run asks for."""
    found, seal = check_and_seal(database, request.app.state.token, parse_new_job(robot, texts))
    called = version_name(database, found.version)
    return render(request, "jobs/check.html", check=found, seal=seal, robot=robot, called=called)


@router.post("/robots/{robot}/jobs")
def queue_job(robot: str, request: Request, database: DatabaseOfApp, texts: Typed, _: Admin) -> Response:
    """Queue a job whose check has passed."""
    asked = parse_new_job(robot, texts)
    queued = run(database, request.app.state.token, asked, texts.get(SEAL, ""))
    return redirect(request, f"/jobs/{queued.id}")


@router.get("/jobs/{job}")
def show_job(job: str, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show a job: how far it is, why it failed, or what came out."""
    found, template, filled = load_job_view(database, job)
    return render(
        request, "jobs/job.html", job=found, part=template, kinds=TITLES, again=query_from_job(found), **filled
    )


@router.get("/jobs/{job}/poses.csv")
def poses(job: str, database: DatabaseOfApp) -> Response:
    """Download the poses that a plan or a search proposes."""
    found = jobs.get(database, job)
    named = {"Content-Disposition": f'attachment; filename="poses-{found.id}.csv"'}
    return PlainTextResponse(planned.proposed_poses_csv(found), media_type="text/csv", headers=named)


@router.post("/jobs/{job}/cancel")
def cancel(job: str, request: Request, database: DatabaseOfApp, _: Admin) -> Response:
    """Stop a job."""
    jobs.cancel(database, job)
    return redirect(request, f"/jobs/{job}")
