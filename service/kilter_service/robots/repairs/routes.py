"""Repairs over HTTP."""

from __future__ import annotations

from fastapi import APIRouter

from kilter_service.contract.drift import NewRepair, Repair
from kilter_service.robots.repairs import service
from kilter_service.web.auth.access import Admin
from kilter_service.web.routing import ConditionalRoute
from kilter_service.web.state import DatabaseOfApp

router = APIRouter(prefix="/v1/robots", tags=["robots"], route_class=ConditionalRoute)


@router.post("/{robot}/repairs", status_code=201)
def add(robot: str, repair: NewRepair, database: DatabaseOfApp, actor: Admin) -> Repair:
    """Record what was done to an arm: checks, charts and comparisons begin anew with it."""
    return service.add(database, robot, repair, actor)


@router.delete("/{robot}/repairs/{repair}", status_code=204)
def remove(robot: str, repair: str, database: DatabaseOfApp, _: Admin) -> None:
    """Delete a repair that was recorded by mistake."""
    service.remove(database, robot, repair)
