"""Rows of instruments."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from sqlalchemy import select

from kilter_service.contract.instruments import Instrument, NewInstrument
from kilter_service.ground.db import Session
from kilter_service.ground.db.tables import InstrumentRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page


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
