"""What shows the result of each kind of job."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from pydantic import BaseModel

from kilter_core.errors import CoreError
from kilter_core.types import Floats
from kilter_service.campaigns import service as campaigns
from kilter_service.campaigns import suspicious
from kilter_service.contract.campaigns import Campaign
from kilter_service.contract.fits import CorrelatedGroup, Covariance, Influence, StageErrors
from kilter_service.contract.jobs.check import MadeVersion
from kilter_service.contract.jobs.drift import DriftCause, DriftJob, DriftResult
from kilter_service.contract.jobs.evaluate import EvaluateJob, EvaluateResult
from kilter_service.contract.jobs.gap import GAP
from kilter_service.contract.jobs.identify import IdentifyJob, IdentifyResult
from kilter_service.contract.jobs.plan import PLAN, PlanJob, PlanResult
from kilter_service.contract.jobs.registry import KINDS, Job
from kilter_service.contract.today import NextStep
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page
from kilter_service.page.chosen import joint_columns
from kilter_service.page.figures.drawn import Arrows, HeatMap, Space
from kilter_service.page.figures.plot import BLUE, RED, Plot
from kilter_service.page.gap import story
from kilter_service.page.shared import errors_drawn
from kilter_service.page.shared.errors_drawn import cumulative
from kilter_service.page.shared.naming import format_claim, in_names, of_a_mass, parameter_rows, version_name
from kilter_service.page.words import in_columns, number, percent
from kilter_service.versions import service as versions
from kilter_service.versions.drift import service as drift
from kilter_service.versions.predictions import places
from kilter_service.versions.today import service as today

MOST_NAMES = 20  # of a correlation map, and of an influence chart


def identification_context(database: Database, job: IdentifyJob) -> dict[str, Any]:
    """Return what ``jobs/identify.html`` shows."""
    result = job.result or IdentifyResult()
    held = result.metrics.validation if result.metrics else None
    judged = held or (result.metrics.train if result.metrics else None)
    where = "held-out rows" if held else "the rows that were fitted"
    figures = result.figures
    covariance = versions.get(database, result.version_id).covariance if result.version_id else None
    groups = result.correlated_groups or []
    return {
        "result": result,
        "suspicious": suspicious.of_campaigns(database, [*job.campaigns, *held_out(job)]),
        "version": result.version_id,
        "held": held is not None,
        "where": where,
        "points": judged.n if judged else None,
        "left_out": judged.left_out if judged else None,
        "stages": errors_drawn.compared_models(judged),
        "meaning": errors_drawn.MEANING,
        "bars": errors_drawn.bars(judged, where),
        "curve": cumulative(
            (figures.held_out_errors or figures.fitted_errors) if figures else None, where, errors_drawn.CURVES
        ),
        "effects": gain_of_effects(judged),
        "seen": parameter_rows(
            [row for row in result.parameters or [] if row.identifiable is not False or row.from_prior],
            places.prior_sigmas(database, result.version_id) if result.version_id else {},
        ),
        "unseen": [
            row
            for row in result.parameters or []
            if row.identifiable is False and not row.from_prior and not of_a_mass(row.name)
        ],
        "groups": groups,
        "map": correlation_map(groups, covariance),
        "influence": influence_chart(result.influence or []),
    }


def held_out(job: IdentifyJob) -> list[str]:
    """Return the campaigns that a job held out by name."""
    return job.validation if isinstance(job.validation, list) else []


def gain_of_effects(errors: StageErrors | None) -> float | None:
    """Return what the effects take off the mean error beyond the geometry, mm; None: there are none."""
    if errors is None or errors.best_rigid is None or errors.identified is None:
        return None
    return errors.best_rigid.mean_mm - errors.identified.mean_mm


def correlation_map(groups: list[CorrelatedGroup], known: Covariance | None) -> HeatMap | None:
    """Draw how the parameters that go together correlate; None: none do, or nothing is known of them."""
    wanted = list(dict.fromkeys(name for group in groups for name in group.parameters))[:MOST_NAMES]
    names, matrix = (known.names or [], known.matrix or []) if known is not None else ([], [])
    places = {name: place for place, name in enumerate(names)}
    wanted = [name for name in wanted if name in places and matrix[places[name]][places[name]] > 0]
    if len(wanted) < 2:
        return None
    at = [places[name] for name in wanted]
    values = [[matrix[a][b] / math.sqrt(matrix[a][a] * matrix[b][b]) for b in at] for a in at]
    return HeatMap(
        "Correlation of parameters that go together",
        wanted,
        wanted,
        values,
        low=-1.0,
        high=1.0,
        diverging=True,
        cell=34.0,
        description="Near 1 or -1 the data tell only a combination of the two.",
    )


def influence_chart(found: list[Influence]) -> Plot | None:
    """Draw how far each parameter moves the tool: mean, with least and largest over the poses."""
    rows = sorted((one for one in found if one.mean_mm is not None), key=lambda one: -(one.mean_mm or 0.0))[:MOST_NAMES]
    if not rows:
        return None
    unit, moved = in_columns([[one.mean_mm, one.min_mm, one.max_mm] for one in rows])
    return errors_drawn.grouped_bars(
        "Influence of the parameters on the tool",
        [one.name for one in rows],
        [("mean over the poses", "", [one.mean_mm for one in rows])],
        what="movement of the tool",
        across="parameter",
        size=(760.0, 320.0),
        table=(
            ["Parameter", "Change", "Its unit", f"Mean, {unit}", f"Least, {unit}", f"Largest, {unit}"],
            [[one.name, number(one.step), one.unit or "", *sizes] for one, sizes in zip(rows, moved, strict=True)],
        ),
        errors=[(one.min_mm or 0.0, one.max_mm or 0.0) for one in rows],
    )


LOOKS = {
    "ok": ("As its version says", "good"),
    "moved": ("Has moved", "bad"),
    "cannot_tell": ("Moved, cause unknown", "bad"),
}
MOST_BARS, MOST_RIVALS = 24, 4
LIKELY = 1e-3


def check_context(database: Database, job: DriftJob) -> dict[str, Any]:
    """Return what ``jobs/drift.html`` shows."""
    result = job.result or DriftResult()
    rows = result.rows or []
    named = result.causes[0] if result.causes else None
    last = drift.of_robot(database, job.robot).last
    steps: list[NextStep] = []
    if last is not None and last.job_id == job.id:  # of an older check something else comes next
        standing = today.of_robot(database, job.robot).standing
        steps = [] if standing is None else standing.steps
    errors = [one.error_mm for one in rows]
    after = [one.after_mm for one in rows]
    kinds = [Arrows("as measured", "bad", errors)]
    if named is not None and any(one is not None for one in after):
        kinds.append(Arrows(f"with {named.words}", "chosen", after))
    table = (["Row", "x, mm", "y, mm", "z, mm"], [[str(one.row), *(f"{v:.1f}" for v in one.at_mm)] for one in rows])
    names = [f"row {one.row}" for one in rows]
    return {
        "result": result,
        "state": LOOKS.get(result.verdict or "", ("", "faint")),
        "steps_next": steps,
        "space": Space("The poses of the check", [one.at_mm for one in rows], names, kinds, table=table)
        if rows
        else None,
        "bars": _bars(result, named) if rows else None,
        "rivals": rivals(result) if result.verdict != "ok" else [],
        "explained": bool(result.causes),
        "mean": next((one.identified for one in (result.metrics or {}).values()), None),
        "version": None,
        "checked": result.version_id,
    }


def _bars(result: DriftResult, named: DriftCause | None) -> Plot:
    rows = sorted(result.rows or [], key=lambda one: -math.hypot(*one.error_mm))[:MOST_BARS]
    before = [math.hypot(*one.error_mm) for one in rows]
    after = [math.hypot(*one.after_mm) for one in rows if one.after_mm is not None]
    both = len(after) == len(rows)
    unit, written = in_columns([[a, b] for a, b in zip(before, after if both else before, strict=True)])
    names = [f"row {one.row}" for one in rows]
    head = ["Row", f"Error, {unit}", *([f"If it is {named.words}, {unit}"] if both and named else [])]
    table = (head, [[name, *one[: len(head) - 1]] for name, one in zip(names, written, strict=True)])
    said = "The error of each pose, and what is left of it if the named cause is it."
    series: list[errors_drawn.Series] = [("as measured", RED, before)]
    if both and named:
        series.append((f"with {named.words}", BLUE, after))
    size = (620.0, 200.0)
    return errors_drawn.grouped_bars("Error of each pose", names, series, size=size, description=said, table=table)


def rivals(result: DriftResult) -> list[dict[str, Any]]:
    """Return the causes, each with its chance among all by how much worse than the best it explains the rows (BIC)."""
    known = [(one, one.bic) for one in result.looked_at or [] if one.bic is not None]
    best = min((bic for _, bic in known), default=0.0)
    weights = [math.exp(-0.5 * min(bic - best, 700.0)) for _, bic in known]
    whole = sum(weights) or 1.0
    out = []
    for (one, _), weight in zip(known, weights, strict=True):
        share = weight / whole
        said = percent(share) if share > LIKELY else "< 0.1 %" if share > 0 else "0 %"
        told = [n for n in one.numbers or [] if len(one.numbers or []) == 1 or n.unit == "mm"]  # of a frame its shift
        size = math.hypot(*(n.change for n in told)) if len(told) > 1 else sum(n.change for n in told)
        out.append(
            {
                "words": one.words or one.name,
                "chance": said,
                "change": f"{number(size, 2)} {told[0].unit}" if told else "",
                "left_mm": sum(one.left_mm) / len(one.left_mm) if one.left_mm else None,
                "refuted": bool(one.refuted),
            }
        )
    return sorted(out, key=lambda one: (one["left_mm"] is None, one["left_mm"]))[:MOST_RIVALS]


NEAR = 0.5  # degrees or mm from a joint as planned: the pose was driven to
MOST_CAMPAIGNS = Page(limit=20)
JOINT = re.compile(r"q.*_(deg|mm)")  # a column of a pose


def plan_context(database: Database, job: PlanJob) -> dict[str, Any]:
    """Return what ``jobs/plan.html`` shows."""
    result = job.result or PlanResult()
    poses = [pose.model_dump() for pose in result.poses or []]
    names = [name for name in dict.fromkeys(name for pose in poses for name in pose) if JOINT.fullmatch(name)]
    q = np.array([[pose.get(name) or 0.0 for name in names] for pose in poses]).reshape(len(poses), len(names))
    arrived = _arrived_rows(database, job, q)
    shown = [
        {
            "joints": [f"{value:.3f}" for value in q[k]],  # as the file has it: what is driven is not rounded
            "payload_kg": pose["payload_kg"],
            "change": pose["change"] or "",
            **arrived.get(k, {"state": "open", "why": "", "campaign": "", "row": 0}),
        }
        for k, pose in enumerate(poses)
    ]
    return {
        "result": result,
        "version": result.start,
        "joints": [name.replace("_", ", ", 1) for name in names],
        "poses": shown,
        "driven": json.dumps(q.round(4).tolist()),
        "arrived": sum(one["state"] != "open" for one in shown),
        "wrong": sum(one["state"] == "bad" for one in shown),
        "loads": any(one["payload_kg"] is not None for one in shown),
        "changes": any(one["change"] for one in shown),
    }


def _arrived_rows(database: Database, job: PlanJob, q: Floats) -> dict[int, dict[str, Any]]:
    """State, reason, campaign and row of each pose whose row came after the plan, by the pose's place; the newest counts."""
    found: dict[int, dict[str, Any]] = {}
    for campaign in campaigns.list_campaigns(database, job.robot, MOST_CAMPAIGNS).campaigns:
        if campaign.created_at >= job.created_at and campaign.rows and not campaign.staged:
            found |= dict(_rows_at(database, campaign, q))
    return found


def _rows_at(database: Database, campaign: Campaign, q: Floats) -> Iterator[tuple[int, dict[str, Any]]]:
    try:
        measured = np.stack(joint_columns(database, campaign), axis=1)
    except (CoreError, ValueError):  # rows that cannot be read, or that have no joints
        return
    if measured.shape[1:] != q.shape[1:]:
        return
    wrong = {one.row: one.why for one in suspicious.of_campaign(database, campaign.id).found}
    for place, wanted in enumerate(q):
        rows = np.flatnonzero(np.abs(measured - wanted).max(axis=1) <= NEAR) + 1
        if len(rows):
            bad = next((int(row) for row in rows if int(row) in wrong), None)
            row, why = (int(rows[-1]), "") if bad is None else (bad, wrong[bad])
            yield place, {"state": "good" if bad is None else "bad", "why": why, "campaign": campaign.id, "row": row}


def proposed_poses_csv(job: Job) -> str:
    """Return the poses that a plan or a search proposes as a file.

    Raises:
        ServiceError: the job proposes none.

    """
    poses = None
    if PLAN.is_kind_of(job) and job.result is not None:
        poses = job.result.csv
    elif GAP.is_kind_of(job) and job.result is not None:
        poses = job.result.next_poses_csv
    if not poses:
        raise ServiceError(
            f"Job {job.id} proposes no poses: plan some with a plan job.", code="option_invalid", job=job.id
        )
    return poses


EVALUATED = {"After": "Evaluated"}  # it may be older than the rows, or the nominal robot itself


def evaluation_context(database: Database, job: EvaluateJob) -> dict[str, Any]:
    """Return what ``jobs/evaluate.html`` shows."""
    result = job.result or EvaluateResult()
    return {
        "result": result,
        "version": result.version_id,
        "called": version_name(database, result.version_id),
        "campaigns": [
            (name, errors, errors_drawn.bars(errors, f"campaign {name}", EVALUATED))
            for name, errors in (result.metrics or {}).items()
        ],
    }


def default_context(database: Database, job: Job) -> dict[str, Any]:
    """Return what is shown of a job whose kind has no view of its own: what it says in words."""
    result = job.result
    return {
        "sentence": getattr(result, "sentence", None),
        "remedy": getattr(result, "remedy", None),
        "warnings": getattr(result, "warnings", None) or [],
        "version": getattr(result, "version_id", None),
        "facts": _plain_facts(result) if result is not None else {},
        "robot": job.robot if KINDS[job.kind].watching else "",
    }


def _plain_facts(result: BaseModel) -> dict[str, str]:
    """Return what a result without a sentence says in numbers and words, by name."""
    given = result.model_dump(mode="json", exclude_unset=True)
    if "sentence" in given or isinstance(result, MadeVersion):
        return {}
    parts = {name: value if isinstance(value, dict) else {"": value} for name, value in given.items()}
    return {
        f"{name.replace('_', ' ').capitalize()} {key}".rstrip(): str(value)
        for name, part in parts.items()
        for key, value in part.items()
        if isinstance(value, int | float | str)
    }


def rezero_context(database: Database, job: Job) -> dict[str, Any]:
    """Return what is shown of a re-zeroing: what it changed; activating it is the next step on the same page."""
    shown = default_context(database, job)
    return {**shown, "sentence": in_names(database, shown["sentence"] or "")}


def torques_context(_: Database, job: IdentifyJob) -> dict[str, Any]:
    """Return what ``gap/motion.html`` shows of a fit of a log of torques."""
    result = job.result or IdentifyResult()
    named = [(format_claim(effect), effect) for effect in result.effects or []]
    return {
        "result": result,
        "effects": named,
        "untestable": story.untestable(result.not_testable or []),
        "version": None,
    }


Shown = Callable[[Database, Any], dict[str, Any]]
PLAIN: tuple[str, Shown] = ("jobs/plain.html", default_context)
OF_TORQUES: tuple[str, Shown] = ("gap/motion.html", torques_context)
# The template of the result of a kind, and what fills it; a kind without one has :data:`PLAIN`.
RESULTS: dict[str, tuple[str, Shown]] = {
    "identify": ("jobs/identify.html", identification_context),
    "gap": ("gap/result.html", story.result_context),
    "evaluate": ("jobs/evaluate.html", evaluation_context),
    "drift": ("jobs/drift.html", check_context),
    "rezero": ("jobs/rezero.html", rezero_context),
    "plan": ("jobs/plan.html", plan_context),
}
