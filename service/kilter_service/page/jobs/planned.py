"""The result of a plan: the poses to measure in 3-D, and what became of each as its row arrives."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from kilter_core.errors import CoreError
from kilter_core.types import Floats
from kilter_service.campaigns import looking
from kilter_service.campaigns import service as campaigns
from kilter_service.campaigns.facts import campaign_cache_key, display_unit_and_factor
from kilter_service.campaigns.suspicious import service as suspicious
from kilter_service.contract.campaigns import Campaign
from kilter_service.contract.jobs.gap import GAP
from kilter_service.contract.jobs.plan import PLAN, PlanJob, PlanResult
from kilter_service.contract.jobs.registry import Job
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page
from kilter_service.ground.recent import Recent

NEAR = 0.5  # degrees or mm from a joint as planned: the pose was driven to
MOST_CAMPAIGNS = Page(limit=20)
_READ = Recent[Floats](20)  # a page that is open asks every few seconds


@dataclass(frozen=True)
class PlannedPose:
    """A pose, and its row: ``state`` is open, good or bad, ``why`` of a bad one, ``campaign`` and ``row`` where it has one."""

    joints: Sequence[str]
    payload_kg: float | None
    change: str
    state: str = "open"
    why: str = ""
    campaign: str = ""
    row: int = 0


def result_context(database: Database, job: PlanJob) -> dict[str, Any]:
    """Return what ``jobs/plan.html`` shows."""
    result = job.result or PlanResult()
    poses = [pose.model_dump() for pose in result.poses or []]
    names = list(dict.fromkeys(name for pose in poses for name in pose if _is_joint(name)))
    q = np.array([[pose.get(name) or 0.0 for name in names] for pose in poses]).reshape(len(poses), len(names))
    arrived = _arrived_rows(database, job, q)
    shown = [
        PlannedPose(
            [f"{value:.3f}" for value in q[k]],  # as the file has it: what is driven is not rounded to what is known
            pose["payload_kg"],
            pose["change"] or "",
            *arrived.get(k, ()),
        )
        for k, pose in enumerate(poses)
    ]
    return {
        "result": result,
        "version": result.start,
        "joints": [name.replace("_", ", ", 1) for name in names],
        "poses": shown,
        "driven": json.dumps(q.round(4).tolist()),
        "arrived": sum(one.state != "open" for one in shown),
        "wrong": sum(one.state == "bad" for one in shown),
        "loads": any(one.payload_kg is not None for one in shown),
        "changes": any(one.change for one in shown),
    }


def _arrived_rows(database: Database, job: PlanJob, q: Floats) -> dict[int, tuple[str, str, str, int]]:
    """State, reason, campaign and row of each pose whose row came after the plan, by the pose's place; the newest counts."""
    found: dict[int, tuple[str, str, str, int]] = {}
    for campaign in campaigns.list_campaigns(database, job.robot, MOST_CAMPAIGNS).campaigns:
        if campaign.created_at >= job.created_at and campaign.rows and not campaign.staged:
            found |= dict(_rows_at(database, campaign, q))
    return found


def _rows_at(database: Database, campaign: Campaign, q: Floats) -> Iterator[tuple[int, tuple[str, str, str, int]]]:
    try:
        measured = _READ.get(campaign_cache_key(campaign), partial(_joints, database, campaign))
    except (CoreError, ValueError):  # rows that cannot be read, or that have no joints
        return
    if measured.shape[1:] != q.shape[1:]:
        return
    wrong = {one.row: one.why for one in suspicious.of_campaign(database, campaign.id).found}
    for place, wanted in enumerate(q):
        rows = np.flatnonzero(np.abs(measured - wanted).max(axis=1) <= NEAR) + 1
        if len(rows):
            bad = next((int(row) for row in rows if int(row) in wrong), None)
            state = ("good", "") if bad is None else ("bad", wrong[bad])
            yield place, (*state, campaign.id, int(rows[-1]) if bad is None else bad)


def _joints(database: Database, campaign: Campaign) -> Floats:
    """Readings (N, n) of a campaign, deg or mm."""
    rows = looking.load_campaign_rows(database, campaign.id)
    read = sorted((one for one in rows.columns if one.quantity == "q"), key=lambda one: one.number or 0)
    columns = [rows.table.column(one.name).to_numpy() * display_unit_and_factor(one)[1] for one in read]
    return np.stack(columns, axis=1).astype(np.float64)


def _is_joint(name: str) -> bool:
    return name.startswith("q") and name.endswith(("_deg", "_mm"))


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
