"""References and tombstones over HTTP."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from kilter_service.contract.references import Kind, ResolvedReference, TombstoneList
from kilter_service.kept import service
from kilter_service.web.routing import GuardedRoute
from kilter_service.web.state import DatabaseOfApp, PageOfList

router = APIRouter(prefix="/v1", tags=["references"], route_class=GuardedRoute)


@router.get("/resolve")
def resolve(
    kind: Kind,
    reference: Annotated[
        str, Query(min_length=1, max_length=200, description="An id or its beginning, a name, or `latest`.")
    ],
    database: DatabaseOfApp,
    robot: Annotated[str | None, Query(max_length=64, description="Look among those of this robot only.")] = None,
) -> ResolvedReference:
    """Find the one campaign, version or job that a beginning of its id, its name, or `latest` refers to."""
    return service.resolve(database, kind, reference, robot)


@router.get("/tombstones")
def tombstones(
    database: DatabaseOfApp,
    page: PageOfList,
    robot: Annotated[str | None, Query(max_length=64, description="Of this robot only.")] = None,
) -> TombstoneList:
    """List what was purged: its hash, who purged it, and when."""
    return service.tombstones(database, robot, page)
