"""Robots over HTTP."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response

from kilter_service.contract.kinematics import Flanges, JointRows, Postures
from kilter_service.contract.references import RobotChange, Tombstone
from kilter_service.contract.robot_reports import FoundRobot, RobotCheck, RobotList, RobotReport
from kilter_service.contract.robots import RobotDocument, Target
from kilter_service.contract.units import MAX_JOINTS, Name
from kilter_service.ground.limits import MAX_CIRCLE_MB
from kilter_service.ground.tables import reading
from kilter_service.robots import check as checks
from kilter_service.robots import circles, nominal, service
from kilter_service.robots import convert as conversions
from kilter_service.robots.wire import DOCUMENT
from kilter_service.web.auth.access import Admin
from kilter_service.web.bodies import spool_upload
from kilter_service.web.concurrency import compute
from kilter_service.web.conditional import ConditionalRoute
from kilter_service.web.page_query import PageOfList
from kilter_service.web.state import DatabaseOfApp, SettingsOfApp, get_scratch

router = APIRouter(prefix="/v1/robots", tags=["robots"], route_class=ConditionalRoute)

Follows = Annotated[
    list[str] | None,
    Query(description='Joints read against the horizontal, each with its leader: "j3=j2".', max_length=MAX_JOINTS),
]
FILE = {"schema": {"type": "string", "format": "binary"}}
COLUMNS = {"schema": {"type": "object", "additionalProperties": {"type": "array"}}}
CONTENT = {reading.CSV: FILE, reading.PARQUET: FILE, reading.JSON: COLUMNS}


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
    return checks.check(document)


@router.post("/convert", response_model_exclude_none=True)
def convert(document: RobotDocument, to: Target) -> RobotDocument:
    """Write a document in another convention, without adding it: the same poses at the same joint readings."""
    return DOCUMENT.validate_python(conversions.convert(document, to))


@router.post(
    "/from-circles",
    response_model_exclude_none=True,
    openapi_extra={"requestBody": {"required": True, "content": CONTENT}},
)
async def from_circles(
    request: Request,
    settings: SettingsOfApp,
    name: Name = "found",
    to: Target = "chain",
    base: Literal["axis", "device"] = "axis",
    follows: Follows = None,
) -> FoundRobot:
    """Find a robot from points measured while one joint moved at a time (CSV, Parquet or JSON columns); none is added."""
    media = reading.media_type(request.headers.get("content-type"))
    with get_scratch(request).folder_for("circles") as folder:
        path = folder / "body"
        await spool_upload(request, path, min(settings.max_upload_mb, MAX_CIRCLE_MB))
        return await compute(request, _robot_from_circles, path, media, name, to, base, follows or [])


def _robot_from_circles(path: Path, media: str, name: str, to: Target, base: str, follows: list[str]) -> FoundRobot:
    return circles.found_robot(path, media, name, to, base, follows)


@router.get("")
def listed(database: DatabaseOfApp, page: PageOfList, retired: bool = False) -> RobotList:
    """List the robots; with `retired` also those that are out of use."""
    return service.list_robots(database, page, retired)


@router.get("/{robot}")
def get(robot: str, database: DatabaseOfApp) -> RobotReport:
    """Show a robot."""
    return service.get(database, robot)


@router.post("/{robot}/forward")
def forward(robot: str, rows: JointRows, database: DatabaseOfApp) -> Flanges:
    """Say where the nominal flange is at these joints."""
    return nominal.forward(database, robot, rows)


@router.post("/{robot}/inverse")
def inverse(robot: str, wanted: Flanges, database: DatabaseOfApp) -> Postures:
    """Find all joints that bring the nominal flange to these poses, of a six-axis arm."""
    return nominal.inverse(database, robot, wanted)


@router.patch("/{robot}")
def remark(robot: str, wanted: RobotChange, database: DatabaseOfApp, _: Admin) -> RobotReport:
    """Note something on a robot, or whether its controller corrects by itself."""
    return service.change(database, robot, wanted)


@router.post("/{robot}/retire")
def retire(robot: str, database: DatabaseOfApp, actor: Admin) -> RobotReport:
    """Take a robot out of use; the active version keeps correcting."""
    return service.retire(database, robot, actor)


@router.post("/{robot}/restore")
def restore(robot: str, database: DatabaseOfApp, _: Admin) -> RobotReport:
    """Bring a retired robot back into use."""
    return service.restore(database, robot)


@router.post("/{robot}/purge")
def purge(robot: str, database: DatabaseOfApp, actor: Admin) -> Tombstone:
    """Delete a robot on which nothing was measured, for good; its hash is kept."""
    return service.purge(database, robot, actor)


@router.delete("/{robot}", status_code=204)
def remove(robot: str, database: DatabaseOfApp, actor: Admin) -> None:
    """Delete a robot on which nothing was measured, as purge does."""
    service.purge(database, robot, actor)
