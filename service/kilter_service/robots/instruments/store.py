"""Rows of instruments."""

from __future__ import annotations

from collections.abc import Collection
from datetime import datetime
from typing import Any

from sqlalchemy import select

from kilter_service.contract.instruments import Instrument, NewInstrument
from kilter_service.contract.remarks import Remark
from kilter_service.ground.core import core_evaluate
from kilter_service.ground.db import Session
from kilter_service.ground.db.tables import InstrumentRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page
from kilter_service.ground.wire import from_um


def add(session: Session, new: NewInstrument) -> bool:
    """Store an instrument; the same one twice changes nothing. Returns whether it is new.

    Raises:
        ServiceError: the name is taken by another one.

    """
    found = session.get(InstrumentRow, new.name)
    if found is None:
        session.add(InstrumentRow(**new.model_dump(mode="json")))
        session.flush()
        return True
    if NewInstrument(**_fields(found)) != new:
        raise ServiceError(
            f"There is already another instrument {new.name!r}, or the same with another certificate: what was measured with "
            f"it keeps that. Add this one under another name, as {new.name}-2.",
            code="instrument_exists",
            instrument=new.name,
        )
    return False


def get(session: Session, name: str) -> Instrument:
    """Return the instrument of a name.

    Raises:
        ServiceError: there is none.

    """
    found = of_names(session, [name]).get(name)
    if found is None:
        names = session.execute(select(InstrumentRow.name).order_by(InstrumentRow.name)).scalars().all()
        known = (
            f"There are: {', '.join(names)}."
            if names
            else "There is none yet: add it with `kilter measure instrument add`."
        )
        raise ServiceError(f"There is no instrument {name!r}. {known}", code="instrument_not_found", instrument=name)
    return found


def of_names(session: Session, names: Collection[str]) -> dict[str, Instrument]:
    """Return the instruments of these names that there are."""
    if not names:
        return {}
    rows = session.execute(select(InstrumentRow).where(InstrumentRow.name.in_(names))).scalars()
    return {row.name: _instrument(row) for row in rows}


def instruments_on_page(session: Session, page: Page) -> list[Instrument]:
    """Return instruments by name, one more than the page shows."""
    query = select(InstrumentRow).order_by(InstrumentRow.name).limit(page.fetch_limit)
    if page.name is not None:
        query = query.where(InstrumentRow.name > page.name)
    return [_instrument(row) for row in session.execute(query).scalars()]


def _fields(row: InstrumentRow) -> dict[str, Any]:
    return {name: getattr(row, name) for name in NewInstrument.model_fields}


def _instrument(row: InstrumentRow) -> Instrument:
    return Instrument(**_fields(row), created_at=row.created_at)


def remarks(instrument: Instrument | None, measured_at: datetime | None, stored_at: datetime) -> list[Remark]:
    """Say what a certificate has against a campaign; where nobody stated when it was measured, the day it was stored counts."""
    if instrument is None:
        return []
    day = (measured_at or stored_at).date()
    when = f"the campaign was measured on {day}" if measured_at else f"the campaign was stored on {day}"
    name, until, since = instrument.name, instrument.valid_until, instrument.certified_on
    if until is not None and day > until:
        message = (
            f"The certificate of instrument {name} held until {until}, and {when}: its permissible error is not shown for that "
            "day. Have it calibrated, add it with the new certificate under another name, and measure again."
        )
        return [Remark(code="instrument_expired", message=message)]
    if since is not None and day < since:
        message = (
            f"The certificate of instrument {name} is of {since}, and {when}, before it: name the instrument with the "
            "certificate that held then."
        )
        return [Remark(code="instrument_not_yet_certified", message=message)]
    return []


def permissible(instrument: Instrument | None) -> Any:
    """Return an instrument's permissible error as core has it; None without one."""
    if instrument is None:
        return None
    return core_evaluate.PermissibleError(from_um(instrument.mpe_um), from_um(instrument.mpe_um_per_m))
