"""Robots, their frames, meshes, repairs and instruments over HTTP, and what their nominal arm reaches."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from numpy.typing import NDArray

from kilter_core.errors import ObservationError, OptionError
from kilter_service.contract.devices import Instrument, InstrumentList, NewInstrument
from kilter_service.contract.robot_reports import (
    CircleAxis,
    Flanges,
    FoundRobot,
    Frame,
    JointRows,
    NewFrame,
    OffPoint,
    Posture,
    Postures,
    RobotCheck,
    RobotList,
    RobotReport,
)
from kilter_service.contract.robots import Mesh, MeshList, MeshUnit, RobotDocument, Target, UrdfShapes
from kilter_service.contract.today import NewRepair, Repair
from kilter_service.contract.units import MAX_JOINTS, Name, PointMm, Pose
from kilter_service.contract.wording import RobotChange, Tombstone
from kilter_service.ground.backup_folder import check_digest
from kilter_service.ground.core import core_arm, core_model, core_procedures
from kilter_service.ground.db import Database
from kilter_service.ground.limits import MAX_CIRCLE_CELLS, MAX_CIRCLE_MB, MAX_CIRCLE_ROWS, MAX_MESH_MB
from kilter_service.ground.naming import copy_fields
from kilter_service.ground.tables import reading
from kilter_service.ground.tables.assemble import observations
from kilter_service.ground.tables.columns import read_columns
from kilter_service.ground.wire import to_deg, to_metres, to_mm, to_rad
from kilter_service.robots import check as checks
from kilter_service.robots import documents, service
from kilter_service.robots.meshes import service as meshes
from kilter_service.robots.wire import DOCUMENT
from kilter_service.web.auth.access import Admin
from kilter_service.web.bodies import MESH, compute, spool_upload
from kilter_service.web.routing import (
    ConditionalRoute,
    DatabaseOfApp,
    GuardedRoute,
    PageOfList,
    SettingsOfApp,
    get_scratch,
)

if TYPE_CHECKING:
    from kilter_core.procedures import AxisFit, ReferenceFrame


mesh_router = APIRouter(prefix="/v1/robots", tags=["robots"], route_class=ConditionalRoute)
FILE = {"schema": {"type": "string", "format": "binary"}}
MESH_CONTENT = dict.fromkeys(meshes.MEDIA, FILE)


@mesh_router.get("/{robot}/meshes")
def list_meshes(robot: str, database: DatabaseOfApp) -> MeshList:
    """List the shapes of a robot's links."""
    return meshes.list_meshes(database, robot)


@mesh_router.get("/{robot}/urdf-shapes")
def of_urdf(robot: str, database: DatabaseOfApp) -> UrdfShapes:
    """List what the robot's URDF draws of the arm: files to send as meshes, and where each goes."""
    return meshes.of_urdf(database, robot)


@mesh_router.put("/{robot}/meshes/{link}", openapi_extra={"requestBody": {"required": True, "content": MESH_CONTENT}})
async def put(
    robot: str, link: str, request: Request, database: DatabaseOfApp, _: Admin, unit: MeshUnit = "mm"
) -> Mesh:
    """Give a link its shape (STL or OBJ), in the frame in which its mass is given; it is drawn only."""
    form = meshes.format_from_content_type(request.headers.get("content-type", ""))
    await run_in_threadpool(meshes.check_link, database, robot, link)
    with get_scratch(request).folder_for("mesh") as folder:
        path = folder / "body"
        sha256 = await spool_upload(request, path, MAX_MESH_MB, MESH)
        check_digest(request.headers, sha256)
        return await compute(request, meshes.put, database, robot, link, path, form, unit, sha256)


@mesh_router.get(
    "/{robot}/meshes/{link}",
    response_class=Response,
    responses={200: {"content": MESH_CONTENT, "description": "The file as it was sent"}},
)
def get_mesh(robot: str, link: str, database: DatabaseOfApp) -> Response:
    """Download the shape of a link as it was sent."""
    content, media = meshes.file(database, robot, link)
    headers = {"Content-Disposition": "attachment", "X-Content-Type-Options": "nosniff"}
    return Response(content, media_type=media, headers=headers)


@mesh_router.delete("/{robot}/meshes/{link}", status_code=204)
def remove_mesh(robot: str, link: str, database: DatabaseOfApp, _: Admin) -> None:
    """Delete the shape of a link: it is drawn as cylinders again."""
    meshes.remove(database, robot, link)


JOINT = re.compile(r"q([1-9][0-9]?)_(deg|rad|mm|m)")


FOLLOWS = re.compile(r"j([1-9][0-9]?)=j([1-9][0-9]?)")


def found_robot(
    path: Path, media: str, name: str, convention: Target, frame: str, follows: Sequence[str] = ()
) -> FoundRobot:
    """Read a table (``q1_deg`` or ``q1_mm`` ..., and ``x_mm`` ... or markers) and find the robot whose joints moved in it.

    ``follows`` are pairs "j3=j2" of joints that are read against the horizontal.

    Raises:
        ObservationError: the table cannot be read, or shows no axes. TooFewPosesError: too few rows of a joint.

    """
    names = reading.column_names(path, media)
    kinds = _kinds(names)
    columns = read_columns(names, kinds)
    table = reading.whole_table(path, media, min(MAX_CIRCLE_ROWS, MAX_CIRCLE_CELLS // len(columns)))
    rows = observations(table, columns, {})
    points = rows.markers if rows.markers is not None else rows.position
    if points is None:
        raise ObservationError("Nothing was measured in these rows: give x_mm, y_mm, z_mm, or markers m1x_mm ... .")
    slides = np.array([kind == "prismatic" for kind in kinds])
    found = core_procedures.robot_from_circles(
        rows.q,
        slides,
        points.reshape(len(rows), -1, 3),
        rows.tip,
        name=name,
        convention=convention,
        frame=frame,
        follows=_follows(follows),
    )
    axes = [_axis(k, fit) for k, fit in enumerate(found.axes)]
    return FoundRobot(robot=_document(found.document), axes=axes, rms_mm=to_mm(found.rms))


def _follows(pairs: Sequence[str]) -> dict[int, int]:
    """Follower -> leader, from 0."""
    found = [FOLLOWS.fullmatch(pair.replace(" ", "")) for pair in pairs]
    wrong = [pair for pair, match in zip(pairs, found, strict=True) if match is None]
    if wrong:
        raise OptionError(
            f"follows is {wrong[0]!r}: give the follower and its leader, for example j3=j2.", option="follows"
        )
    return {int(match[1]) - 1: int(match[2]) - 1 for match in found if match}


def _kinds(names: list[str]) -> list[str]:
    """Kind of every joint, by the unit of its reading."""
    units = {int(match[1]): match[2] for match in map(JOINT.fullmatch, names) if match}
    if sorted(units) != list(range(1, len(units) + 1)) or not units:
        raise ObservationError(
            "The joints are not there or not numbered 1, 2, 3 ...: give q1_deg, q2_deg, ..., q3_mm for a prismatic joint.",
            column=f"q{len(units) + 1}",
        )
    if len(units) > MAX_JOINTS:
        raise ObservationError(
            f"The table has {len(units)} joints, an arm has at most {MAX_JOINTS}.", column=f"q{MAX_JOINTS + 1}"
        )
    return ["prismatic" if units[k] in ("mm", "m") else "revolute" for k in sorted(units)]


def _axis(k: int, fit: AxisFit) -> CircleAxis:
    return CircleAxis(
        joint=f"j{k + 1}",
        kind="prismatic" if fit.prismatic else "revolute",
        rows=fit.rows,
        arc_deg=None if fit.prismatic else to_deg(fit.arc),
        stroke_mm=to_mm(fit.arc) if fit.prismatic else None,
        radius_mm=None if fit.prismatic else to_mm(fit.radius),
        rms_mm=to_mm(fit.rms),
        sigma_deg=to_deg(fit.sigma_rad),
        sigma_mm=to_mm(fit.sigma_m),
    )


def _document(document: dict[str, Any]) -> Any:
    return DOCUMENT.validate_python(document)


router = APIRouter(prefix="/v1/robots", tags=["robots"], route_class=ConditionalRoute)

Follows = Annotated[
    list[str] | None,
    Query(description='Joints read against the horizontal, each with its leader: "j3=j2".', max_length=MAX_JOINTS),
]
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
    return DOCUMENT.validate_python(documents.convert(document, to))


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
    return found_robot(path, media, name, to, base, follows)


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
    return flanges_at_joints(database, robot, rows)


@router.post("/{robot}/inverse")
def inverse(robot: str, wanted: Flanges, database: DatabaseOfApp) -> Postures:
    """Find all joints that bring the nominal flange to these poses, of a six-axis arm."""
    return joints_at_flanges(database, robot, wanted)


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


frame_router = APIRouter(prefix="/v1/frames", tags=["frames"], route_class=GuardedRoute)


@frame_router.post("")
def make(frame: NewFrame) -> Frame:
    """Find a frame from digitised points: known points measured again, or a plane, a line in it and an origin."""
    return find_frame(frame)


instrument_router = APIRouter(prefix="/v1/instruments", tags=["instruments"], route_class=ConditionalRoute)


@instrument_router.post(
    "", status_code=201, responses={200: {"model": Instrument, "description": "Already there, unchanged"}}
)
def add_instrument(instrument: NewInstrument, response: Response, database: DatabaseOfApp, _: Admin) -> Instrument:
    """Add an instrument with its permissible error and its certificate."""
    found, new = service.add_instrument(database, instrument)
    response.status_code = 201 if new else 200
    return found


@instrument_router.get("")
def list_instruments(database: DatabaseOfApp, page: PageOfList) -> InstrumentList:
    """List the instruments."""
    return service.list_instruments(database, page)


repair_router = APIRouter(prefix="/v1/robots", tags=["robots"], route_class=ConditionalRoute)


@repair_router.post("/{robot}/repairs", status_code=201)
def add_repair(robot: str, repair: NewRepair, database: DatabaseOfApp, actor: Admin) -> Repair:
    """Record what was done to an arm: checks, charts and comparisons begin anew with it."""
    return service.add_repair(database, robot, repair, actor)


@repair_router.delete("/{robot}/repairs/{repair}", status_code=204)
def remove_repair(robot: str, repair: str, database: DatabaseOfApp, _: Admin) -> None:
    """Delete a repair that was recorded by mistake."""
    service.remove_repair(database, robot, repair)


def find_frame(frame: NewFrame) -> Frame:
    """Find the frame.

    Raises:
        ObservationError: neither or both kinds of points, or points that make no frame.

    """
    if (frame.points is None) == (frame.features is None):
        raise ObservationError("Give points (known and measured) or features (plane, line, origin), one of the two.")
    if frame.points is not None:
        names = [point.name or str(k) for k, point in enumerate(frame.points, 1)]
        made = core_procedures.frame_of_points(
            metres([p.known_mm for p in frame.points]), metres([p.measured_mm for p in frame.points])
        )
    else:
        assert frame.features is not None
        f = frame.features
        names = [f"plane {k}" for k in range(1, len(f.plane_mm) + 1)]
        made = core_procedures.frame_of_features(metres(f.plane_mm), metres(f.line_mm), metres([f.origin_mm])[0])
    return describe_frame(made, names)


def metres(points: Sequence[PointMm]) -> NDArray[np.float64]:
    """Return points (N, 3) in m."""
    return to_metres(np.array(points, dtype=np.float64))


def describe_frame(made: ReferenceFrame, names: Sequence[str]) -> Frame:
    """Say where a frame is, and how well its points fit."""
    left = [OffPoint(name=name, left_mm=to_mm(float(off))) for name, off in zip(names, made.left, strict=True)]
    return Frame(pose=Pose.model_validate(core_arm.pose_document(made.pose)), rms_mm=to_mm(made.rms), points=left)


MOST_WITHOUT_FORM = 200  # poses of one request: some 0.05 s of processor time each


def flanges_at_joints(database: Database, name: str, rows: JointRows) -> Flanges:
    """Return the flange at each row of joints.

    Raises:
        OptionError: another number of joints than the robot has, or a prismatic joint.

    """
    arm = service.arm(database, name)
    if any(joint.kind != "revolute" for joint in arm.joints):
        raise OptionError(f"{name!r} has a prismatic joint: joints_deg are of revolute joints.", option="joints_deg")
    wrong = next((k for k, row in enumerate(rows.joints_deg) if len(row) != arm.n_joints), None)
    if wrong is not None:
        said = f"Row {wrong + 1} has {len(rows.joints_deg[wrong])} joints, {name!r} has {arm.n_joints}."
        raise OptionError(said, option="joints_deg")
    poses = (core_model.flange(arm, q) for q in to_rad(np.array(rows.joints_deg, dtype=np.float64)))
    return Flanges(flanges=[Pose.model_validate(core_arm.pose_document(T)) for T in poses])


def joints_at_flanges(database: Database, name: str, wanted: Flanges) -> Postures:
    """Return all joints of each pose of the flange.

    Raises:
        RobotError: the arm has not six revolute joints.
        OptionError: more poses than one request computes of an arm without a closed form.

    """
    axes = core_model.read_six_axes(service.arm(database, name))
    if core_model.closed_form_kind(axes) is None and len(wanted.flanges) > MOST_WITHOUT_FORM:
        raise OptionError(
            f"{name!r} has no closed form, and its joints are found for {MOST_WITHOUT_FORM} poses at a time, "
            f"not {len(wanted.flanges)}. Send them in parts.",
            option="flanges",
        )
    rows = [core_model.reaching(axes, core_arm.parse_pose(pose.model_dump())) for pose in wanted.flanges]
    return Postures(
        postures=[[copy_fields(Posture, one, joints_deg=to_deg(one.q).tolist()) for one in row] for row, _ in rows],
        certain=[certain for _, certain in rows],
    )
