"""The audit over HTTP."""

from __future__ import annotations

from fastapi import APIRouter

from kilter_service.contract.tokens import AuditPage
from kilter_service.web.audit import service
from kilter_service.web.routing import GuardedRoute
from kilter_service.web.state import DatabaseOfApp, PageOfList

router = APIRouter(prefix="/v1", tags=["access"], route_class=GuardedRoute)


@router.get("/audit")
def listed(database: DatabaseOfApp, page: PageOfList) -> AuditPage:
    """List who changed what, from where, before and after, oldest first; at most 1000 entries at once."""
    return service.list_entries(database, page)
