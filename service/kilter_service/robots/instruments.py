"""What can be done with instruments."""

from __future__ import annotations

from kilter_service.contract.instruments import Instrument, InstrumentList, NewInstrument
from kilter_service.ground.db import Database
from kilter_service.ground.paging import Page
from kilter_service.robots import store


def add(database: Database, new: NewInstrument) -> tuple[Instrument, bool]:
    """Store an instrument; the same one twice changes nothing. Returns it and whether it is new.

    Raises:
        ServiceError: the name is taken by another one.

    """
    with database.transaction() as session:
        added = store.add_instrument(session, new)
        return store.get_instrument(session, new.name), added


def list_instruments(database: Database, page: Page) -> InstrumentList:
    """List the instruments, by name."""
    with database.reading() as session:
        shown, cursor = page.cut(store.instruments_on_page(session, page), lambda one: (one.name,))
    return InstrumentList(instruments=shown, next=cursor)
