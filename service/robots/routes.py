"""Robots over HTTP."""

from __future__ import annotations

from fastapi import APIRouter, Response

from service.auth.access import Admin
from service.robots import service
from service.robots.check_schemas import RobotCheck
from service.robots.schemas import RobotDocument, RobotList, RobotReport, Target
from service.state import DatabaseOfApp

router = APIRouter(prefix="/v1/robots", tags=["robots"])


@router.post("", status_code=201, responses={200: {"model": RobotReport, "description": "Already there, unchanged"}})
def add(document: RobotDocument, response: Response, database: DatabaseOfApp, _: Admin) -> RobotReport:
    """Add a robot."""
    report, new = service.add(database, document)
    response.status_code = 201 if new else 200
    response.headers["Location"] = f"/v1/robots/{report.name}"
    return report


@router.post("/check")
def check(document: RobotDocument) -> RobotCheck:
    """Say what a document comes to, without adding it: axes, the arm at zero, reach, and what looks wrong."""
    from service.robots.check import check as report  # imports numpy and scipy: not at the start of the API process

    return report(document)


@router.post("/convert", response_model_exclude_none=True)
def convert(document: RobotDocument, to: Target) -> RobotDocument:
    """Write a document in another convention, without adding it: the same poses at the same joint readings."""
    from service.robots.convert import convert as converted  # imports numpy and scipy: not at the start of the process

    return service.DOCUMENT.validate_python(converted(document, to))


@router.get("")
def listed(database: DatabaseOfApp) -> RobotList:
    """List the robots."""
    return service.listed(database)


@router.get("/{robot}")
def get(robot: str, database: DatabaseOfApp) -> RobotReport:
    """Show a robot."""
    return service.get(database, robot)


@router.delete("/{robot}", status_code=204)
def remove(robot: str, database: DatabaseOfApp, _: Admin) -> None:
    """Delete a robot nothing was measured on."""
    service.remove(database, robot)
