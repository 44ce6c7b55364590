"""Meshes over HTTP."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from fastapi.concurrency import run_in_threadpool

from kilter_service.contract.robots import Mesh, MeshList, MeshUnit, UrdfShapes
from kilter_service.ground.files.file_hash import check_digest
from kilter_service.ground.limits import MAX_MESH_MB
from kilter_service.robots.meshes import service
from kilter_service.web.auth.access import Admin
from kilter_service.web.bodies import MESH, spool_upload
from kilter_service.web.concurrency import compute
from kilter_service.web.routing import ConditionalRoute
from kilter_service.web.state import DatabaseOfApp, get_scratch

router = APIRouter(prefix="/v1/robots", tags=["robots"], route_class=ConditionalRoute)
FILE = {"schema": {"type": "string", "format": "binary"}}
CONTENT = dict.fromkeys(service.MEDIA, FILE)


@router.get("/{robot}/meshes")
def listed(robot: str, database: DatabaseOfApp) -> MeshList:
    """List the shapes of a robot's links."""
    return service.list_meshes(database, robot)


@router.get("/{robot}/urdf-shapes")
def of_urdf(robot: str, database: DatabaseOfApp) -> UrdfShapes:
    """List what the robot's URDF draws of the arm: files to send as meshes, and where each goes."""
    return service.of_urdf(database, robot)


@router.put("/{robot}/meshes/{link}", openapi_extra={"requestBody": {"required": True, "content": CONTENT}})
async def put(
    robot: str, link: str, request: Request, database: DatabaseOfApp, _: Admin, unit: MeshUnit = "mm"
) -> Mesh:
    """Give a link its shape (STL or OBJ), in the frame in which its mass is given; it is drawn only."""
    form = service.format_from_content_type(request.headers.get("content-type", ""))
    await run_in_threadpool(service.check_link, database, robot, link)
    with get_scratch(request).folder_for("mesh") as folder:
        path = folder / "body"
        sha256 = await spool_upload(request, path, MAX_MESH_MB, MESH)
        check_digest(request.headers, sha256)
        return await compute(request, service.put, database, robot, link, path, form, unit, sha256)


@router.get(
    "/{robot}/meshes/{link}",
    response_class=Response,
    responses={200: {"content": CONTENT, "description": "The file as it was sent"}},
)
def get(robot: str, link: str, database: DatabaseOfApp) -> Response:
    """Download the shape of a link as it was sent."""
    content, media = service.file(database, robot, link)
    headers = {"Content-Disposition": "attachment", "X-Content-Type-Options": "nosniff"}
    return Response(content, media_type=media, headers=headers)


@router.delete("/{robot}/meshes/{link}", status_code=204)
def remove(robot: str, link: str, database: DatabaseOfApp, _: Admin) -> None:
    """Delete the shape of a link: it is drawn as cylinders again."""
    service.remove(database, robot, link)
