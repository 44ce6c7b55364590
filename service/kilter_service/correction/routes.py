"""Correction of whole trajectories over HTTP.

The torques that a path needs, over HTTP: by what a search in torques of the robot found.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import StreamingResponse
from pydantic import Field

from kilter_core.errors import OptionError
from kilter_service.correction import service
from kilter_service.correction.service import Carried, cells, read_trajectory
from kilter_service.ground import store as ground_store
from kilter_service.ground.core import core_motion
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.tables import reading
from kilter_service.ground.tables.assemble import observations
from kilter_service.ground.tables.writing import write_table
from kilter_service.robots import store as robots
from kilter_service.versions import store as versions
from kilter_service.web.bodies import compute, spool_upload
from kilter_service.web.routing import DatabaseOfApp, GuardedRoute, SettingsOfApp, get_scratch

router = APIRouter(prefix="/v1/robots", tags=["correction"], route_class=GuardedRoute)

FILE = {"schema": {"type": "string", "format": "binary"}}
NOT_CORRECTED = "Kilter-Not-Corrected"
YAML = "application/yaml"
PIECE_BYTES = 1 << 20
NOTES = "Kilter-Notes"
U95 = "Kilter-U95"
Payload = Annotated[
    float | None,
    Query(
        ge=0.0,
        allow_inf_nan=False,
        description="Mass on the tool along the whole path, kg; columns may say it instead.",
    ),
]
Centre = Annotated[
    str | None,
    Query(
        pattern=r"^[^,]+,[^,]+,[^,]+$",
        max_length=200,
        description="Centre of that mass in the tool frame, mm, as `x,y,z`; left out: the tool point.",
    ),
]
Task = Annotated[
    Literal["position", "pose"] | None,
    Query(description="What is held: the position first, as by default, or the whole pose alike."),
]
Strictly = Annotated[
    bool,
    Query(
        description="Refuse the whole trajectory, naming the rows, unless each is corrected to within what is stated."
    ),
]
AtLimit = Annotated[
    Literal["saturate", "refuse"] | None,
    Query(
        description="Where the correction exceeds the version's limits: hold it there, as by default, or refuse the row."
    ),
]
Hold = Annotated[
    list[Annotated[int, Field(ge=1, le=64)]] | None,
    Query(
        max_length=64,
        description="Joint, from 1, that the correction leaves as it is: a rail, or a positioner. Once for each joint; "
        "default: those of the version's limits.",
    ),
]
COLUMNS = {"schema": {"type": "object", "additionalProperties": {"type": "array"}}}
ANSWER = "The trajectory corrected, with dx_mm, dy_mm, dz_mm, left_mm, u95_x_mm, flags, status"
CONTENT = {reading.CSV: FILE, reading.PARQUET: FILE, reading.JSON: COLUMNS}


@router.post(
    "/{robot}/correct",
    response_class=Response,
    openapi_extra={"requestBody": {"required": True, "content": CONTENT}},
    responses={200: {"content": CONTENT | {YAML: FILE}, "description": ANSWER}},
)
async def correct(
    robot: str,
    request: Request,
    database: DatabaseOfApp,
    settings: SettingsOfApp,
    version: str | None = None,
    format: Literal["ros2-yaml"] | None = None,  # noqa: A002 (the name of the export's parameter)
    task: Task = None,
    strict: Strictly = False,
    at_limit: AtLimit = None,
    hold: Hold = None,
    payload_kg: Payload = None,
    payload_com_mm: Centre = None,
) -> Response:
    """Correct a trajectory (CSV, Parquet or JSON columns) with the active version, or with the one named.

    The numbers are those of the stream. The answer has the format that was sent; ``format=ros2-yaml`` asks for a ROS 2
    JointTrajectory instead. `status` is `OK` where what the correction leaves (`left_mm`) is within what is stated, else
    `DAMPED` or `LIMITED`, or `UNSURE` where the version is less sure than it says; refused rows have no numbers.
    ``strict`` refuses the whole trajectory unless every row is `OK`.
    Effects of the version that a correction leaves out are named in ``Kilter-Not-Corrected``.
    Where neither the path nor ``payload_kg`` states a load, the robot's default load is taken; ``Kilter-Notes`` says so, or
    that effects which follow the load were corrected without one, that the controller corrects by itself too, or why the
    version is unsure. ``Kilter-U95`` says what ``u95`` is of: poses or a path, relative to the instrument.
    """
    media = reading.media_type(request.headers.get("content-type"))
    with get_scratch(request).folder_for("correct") as folder:
        path = folder / "body"
        await spool_upload(request, path, settings.max_upload_mb)
        carried = Carried(payload_kg, read_point(payload_com_mm))
        wanted = service.Wanted(version, format, task, strict, at_limit, None if hold is None else tuple(hold))
        file, left_out, notes, u95 = await compute(
            request, _correct_to_temp_file, database, robot, path, media, wanted, settings.temperature_c, carried
        )
    headers = {"Content-Length": str(file.seek(0, 2))} | ({NOT_CORRECTED: ", ".join(left_out)} if left_out else {})
    headers |= {U95: u95} | ({NOTES: " | ".join(notes)} if notes else {})
    return StreamingResponse(_pieces(file), media_type=media if format is None else YAML, headers=headers)


def read_point(text: str | None) -> tuple[float, float, float] | None:
    """Read a point.

    Raises:
        OptionError: it is not three finite numbers.

    """
    if text is None:
        return None
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not all(map(math.isfinite, (x, y, z))):
        raise OptionError(f"payload_com_mm is {text!r}: give three numbers, as 0,0,60.", option="payload_com_mm")
    return x, y, z


def _correct_to_temp_file(
    database: Database, robot: str, path: Path, *rest: Any
) -> tuple[IO[bytes], tuple[str, ...], tuple[str, ...], str]:
    """Correct into a file without a name: a client that reads slowly holds no memory, and leaves nothing when it goes."""
    answer = service.correct(database, robot, path, *rest)
    file = tempfile.TemporaryFile(prefix="kilter-corrected-")  # noqa: SIM115 (the answer is sent after this)
    file.write(answer.content)
    return file, answer.not_corrected, answer.notes, answer.u95


def _pieces(file: IO[bytes]) -> Iterator[bytes]:
    with file:
        file.seek(0)
        while piece := file.read(PIECE_BYTES):
            yield piece


torque_router = APIRouter(prefix="/v1/robots", tags=["correction"], route_class=GuardedRoute)

TORQUE_ANSWER = "The path with tau1_nm ... (tau1_n of a prismatic joint), the torques that its motion needs"
Search = Annotated[str | None, Query(description="Id of the search in torques that it is by.", max_length=64)]
Version = Annotated[
    str | None,
    Query(
        description="Id of the version whose torques it is by; default: the active one, else the newest search in torques.",
        max_length=64,
    ),
]


@torque_router.post(
    "/{robot}/torques",
    response_class=Response,
    openapi_extra={"requestBody": {"required": True, "content": CONTENT}},
    responses={200: {"content": CONTENT, "description": TORQUE_ANSWER}},
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
        else ground_store.version_id(session, version)
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
    job, name, model = ground_store.get_search_in_torques(session, robot_id, search)
    return f"search {name or job}", model
