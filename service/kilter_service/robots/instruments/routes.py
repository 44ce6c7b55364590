"""Instruments over HTTP."""

from __future__ import annotations

from fastapi import APIRouter, Response

from kilter_service.contract.instruments import Instrument, InstrumentList, NewInstrument
from kilter_service.robots.instruments import service
from kilter_service.web.auth.access import Admin
from kilter_service.web.routing import ConditionalRoute
from kilter_service.web.state import DatabaseOfApp, PageOfList

router = APIRouter(prefix="/v1/instruments", tags=["instruments"], route_class=ConditionalRoute)


@router.post("", status_code=201, responses={200: {"model": Instrument, "description": "Already there, unchanged"}})
def add(instrument: NewInstrument, response: Response, database: DatabaseOfApp, _: Admin) -> Instrument:
    """Add an instrument with its permissible error and its certificate."""
    found, new = service.add(database, instrument)
    response.status_code = 201 if new else 200
    return found


@router.get("")
def listed(database: DatabaseOfApp, page: PageOfList) -> InstrumentList:
    """List the instruments."""
    return service.list_instruments(database, page)
