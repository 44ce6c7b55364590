"""Decisions about a tolerance over HTTP."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query

from kilter_service.contract.acceptance import Acceptance
from kilter_service.contract.units import MAX_NAMED, Name
from kilter_service.versions.acceptance import service
from kilter_service.versions.acceptance.service import Wish
from kilter_service.web.routing import ConditionalRoute
from kilter_service.web.state import DatabaseOfApp

router = APIRouter(prefix="/v1/robots", tags=["robots"], route_class=ConditionalRoute)
LARGEST_MM = 1000.0
Refit = Literal["none", "base", "base,tool"]
REFITS: dict[str, tuple[str, ...]] = {"none": (), "base": ("base",), "base,tool": ("base", "tool")}
ToleranceMm = Annotated[
    float,
    Query(
        gt=0,
        le=LARGEST_MM,
        description="Tolerance of the position of the tool, mm.",
        json_schema_extra={"x-unit": "mm"},
    ),
]
Campaigns = Annotated[
    list[str] | None,
    Query(description="Ids of campaigns; none: those of today's number, else all.", max_length=MAX_NAMED),
]


@router.get("/{robot}/acceptance")
def acceptance(
    robot: str,
    database: DatabaseOfApp,
    tolerance_mm: ToleranceMm,
    version: Annotated[str | None, Query(description="The version; none: the active one.", max_length=64)] = None,
    campaign: Campaigns = None,
    refit: Annotated[
        Refit | None,
        Query(description="Frames to fit to the rows of each campaign; none given: as today's number does."),
    ] = None,
    instrument: Annotated[Name | None, Query(description="Instrument of campaigns that name none.")] = None,
) -> Acceptance:
    """Decide by ISO 14253-1 whether a robot keeps a tolerance, on rows that its version was not fitted to."""
    wish = Wish(tolerance_mm, version, campaign or (), None if refit is None else REFITS[refit], instrument)
    return service.of_robot(database, robot, wish)
