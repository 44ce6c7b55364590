"""The result of a plan: the poses to measure, with what to change before them."""

from __future__ import annotations

from typing import Any

from kilter_service.contract.jobs.gap import GAP
from kilter_service.contract.jobs.plan import PLAN, PlanJob, PlanResult
from kilter_service.contract.jobs.registry import Job
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.page.words import NONE, number

MOST_POSES = 100  # shown; the file has all


def result_context(_: Database, job: PlanJob) -> dict[str, Any]:
    """Return what ``jobs/plan.html`` shows."""
    result = job.result or PlanResult()
    poses = [pose.model_dump() for pose in (result.poses or [])[:MOST_POSES]]
    joints = list(dict.fromkeys(name for pose in poses for name in pose if _is_joint(name)))
    head = ["Pose", *(name.replace("_", ", ", 1) for name in joints), "Load, kg", "Change before it"]
    rows = [
        [
            str(place),
            *(_angle(pose.get(name)) for name in joints),
            number(pose["payload_kg"]),
            pose["change"] or NONE,
        ]
        for place, pose in enumerate(poses, 1)
    ]
    return {
        "result": result,
        "version": result.start,
        "table": (head, rows),
        "left_out": max(0, (result.count or 0) - len(rows)),
    }


def _angle(value: float | None) -> str:
    """Write a joint to a thousandth, as the file has it: what is driven is not rounded to what is known."""
    return NONE if value is None else f"{value:.3f}"


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
