"""Rows that look wrong, over HTTP."""

from __future__ import annotations

from fastapi import APIRouter

from kilter_service.campaigns.suspicious import service
from kilter_service.contract.campaigns import SuspiciousRows
from kilter_service.web.routing import ConditionalRoute
from kilter_service.web.state import DatabaseOfApp

router = APIRouter(prefix="/v1/campaigns", tags=["campaigns"], route_class=ConditionalRoute)


@router.get("/{campaign}/suspicious")
def suspicious(campaign: str, database: DatabaseOfApp) -> SuspiciousRows:
    """Name the rows of a campaign that look wrong, and who says so: the rows themselves, and every version made of them."""
    return service.of_campaign(database, campaign)
