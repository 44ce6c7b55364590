"""A database that cannot be reached: one error for the API, which answers 503, and for workers, which wait."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.exc import DBAPIError

from kilter_service.db.failures import AWAY_CODE, in_words
from kilter_service.errors import ServiceError


class DatabaseAwayError(ServiceError):
    """The database does not answer now; what was asked of it was not stored, or it cannot be told."""

    default_code = AWAY_CODE


@contextmanager
def outages() -> Iterator[None]:
    """Raise ``DatabaseAwayError`` where the driver says that its server is gone; other errors pass."""
    try:
        yield
    except DBAPIError as error:
        known = in_words(error)
        if known is None or known.code != AWAY_CODE:
            raise
        raise DatabaseAwayError(known.message) from error
