"""The torques that a path needs, over HTTP: by what a search in torques of the robot found."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from kilter_service.correction import service
from kilter_service.correction.routes import CONTENT, NOTES, Centre, Payload, read_point
from kilter_service.correction.service import cells, read_trajectory
from kilter_service.ground.core import core_motion
from kilter_service.ground.db import Database, Session
from kilter_service.ground.ended_jobs import store as ended_jobs
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.references import store as references
from kilter_service.ground.tables import reading
from kilter_service.ground.tables.assemble import observations
from kilter_service.ground.tables.writing import write_table
from kilter_service.robots import store as robots
from kilter_service.versions import store as versions
from kilter_service.web.bodies import spool_upload
from kilter_service.web.concurrency import compute
from kilter_service.web.routing import GuardedRoute
from kilter_service.web.state import DatabaseOfApp, SettingsOfApp, get_scratch

router = APIRouter(prefix="/v1/robots", tags=["correction"], route_class=GuardedRoute)

ANSWER = "The path with tau1_nm ... (tau1_n of a prismatic joint), the torques that its motion needs"
Search = Annotated[str | None, Query(description="Id of the search in torques that it is by.", max_length=64)]
Version = Annotated[
    str | None,
    Query(
        description="Id of the version whose torques it is by; default: the active one, else the newest search in torques.",
        max_length=64,
    ),
]


@router.post(
    "/{robot}/torques",
    response_class=Response,
    openapi_extra={"requestBody": {"required": True, "content": CONTENT}},
    responses={200: {"content": CONTENT, "description": ANSWER}},
)
async def torques(
    robot: str,
    request: Request,
    database: DatabaseOfApp,
    settings: SettingsOfApp,
    search: Search = None,
    version: Version = None,
    payload_kg: Payload = None,
    payload_com_mm: Centre = None,
) -> Response:
    """Add to a path (CSV, Parquet or JSON columns, with ``t_s``) the torques of gravity, inertia and friction along it.

    They are those that the log of a search in torques measured: of currents that a gain made torques, in these. Joints of
    which that log says nothing get no column; ``Kilter-Notes`` names them, and the search.
    """
    media = reading.media_type(request.headers.get("content-type"))
    with get_scratch(request).folder_for("torques") as folder:
        path = folder / "body"
        await spool_upload(request, path, settings.max_upload_mb)
        carried = service.Carried(payload_kg, read_point(payload_com_mm))
        content, notes = await compute(request, add_torques, database, robot, path, media, search, version, carried)
    return Response(content, media_type=media, headers={NOTES: " | ".join(notes)})


def add_torques(
    database: Database,
    robot: str,
    path: Path,
    media: str,
    search: str | None,
    version: str | None,
    carried: service.Carried,
) -> tuple[bytes, tuple[str, ...]]:
    """Return a path with its torques in the format it came in, and what to know of them.

    Raises:
        ObservationError: the file is not a path of this robot, or states no time.
        OptionError: the load is stated twice, or half.
        ServiceError: no such robot, version or search, or none that tells torques.

    """
    with database.reading() as session:
        stored = robots.get(session, robot)
        source, document = _find_model(session, stored.id, search, version)
        arm = stored.robot()
    table, columns = read_trajectory(path, media, [joint.kind for joint in arm.joints])
    rows = service.under(observations(table, columns, {}), carried, arm)
    model = core_motion.TorqueModel.from_document(arm, document)
    tau = model.torques(core_motion.path_of_rows(rows))
    for j in model.joints:
        unit = "nm" if arm.joints[j].kind == "revolute" else "n"
        table = table.append_column(f"tau{j + 1}_{unit}", cells(tau[:, j]))
    missing = [str(j + 1) for j in range(arm.n_joints) if j not in model.joints]
    notes = [f"Torques are by {source}."]
    if missing:
        notes.append(f"That log says nothing of joints {', '.join(missing)}: they have no torque here.")
    return write_table(table, media), tuple(notes)


def _find_model(session: Session, robot_id: int, search: str | None, version: str | None) -> tuple[str, dict[str, Any]]:
    """Return what tells the torques of a robot, and its name."""
    active = versions.active_entry(session, robot_id) if search is None and version is None else None
    chosen = (
        active.version_id
        if active is not None
        else None
        if version is None
        else references.version_id(session, version)
    )
    if chosen is not None:
        named, model = versions.get(session, chosen), versions.torques(session, chosen)
        if named.robot_id != robot_id:
            raise ServiceError(f"Version {chosen} is of robot {named.robot!r}.", code="option_invalid", version=chosen)
        if model is not None:
            return f"version {named.name or f'v{named.number}'}", model
    if version is not None:
        raise ServiceError(
            f"Version {version} holds no torques: search or fit a log from it (kilter identify ROBOT -c LOG --start VERSION).",
            code="no_torque_model",
        )
    job, name, model = ended_jobs.get_search_in_torques(session, robot_id, search)
    return f"search {name or job}", model
