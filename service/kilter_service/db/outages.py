"""A database that cannot be reached: one error for the API, which answers 503, and for workers, which wait."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.exc import DBAPIError, OperationalError

from kilter_service.errors import ServiceError

# SQLSTATE of PostgreSQL: 08 is a lost connection, 57P01 to 57P03 a server that stops or starts, 53300 one without a free
# connection, 25P03 a session that it ended.
AWAY_STATES = ("08", "57P01", "57P02", "57P03", "53300", "25P03")


class DatabaseAwayError(ServiceError):
    """The database does not answer now; what was asked of it was not stored, or it cannot be told."""

    default_code = "database_unavailable"


@contextmanager
def outages() -> Iterator[None]:
    """Raise ``DatabaseAwayError`` where the driver says that its server is gone; other errors pass."""
    try:
        yield
    except DBAPIError as error:
        if not _is_away(error):
            raise
        raise DatabaseAwayError(
            "The database does not answer: try again in a moment. If it lasts, start the PostgreSQL server that "
            "KILTER_DATABASE_URL names, or correct the URL."
        ) from error


def _is_away(error: DBAPIError) -> bool:
    if error.connection_invalidated:
        return True
    state = getattr(error.orig, "sqlstate", _NO_SERVER)
    if state is None:  # psycopg never got an answer from the server
        return isinstance(error, OperationalError)
    return str(state).startswith(AWAY_STATES)


_NO_SERVER = "sqlite"  # its errors are of files, and have sentences of their own
