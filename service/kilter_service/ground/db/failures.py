"""What the database or the disk under it says when it fails, in a sentence with the remedy.

How a failure is logged: in one line where the database or its disk says what is wrong, and once until it works again.
"""

from __future__ import annotations

import errno
import logging
import re
import sqlite3
from collections.abc import Callable

from sqlalchemy.exc import DBAPIError

from kilter_core.errors import CoreError
from kilter_service.ground.errors import ServiceError

FULL = (
    "The disk of the data folder is full: nothing was stored. Make room there (`kilterd doctor` says how much is left) "
    "and send it again; what was stored before is whole."
)
READ_ONLY = (
    "The data folder cannot be written to (read-only disk, or rights): nothing was stored, reads go on. Mount it for "
    "writing, or give the folder to this account, and send it again."
)
DAMAGED = (
    "The database is damaged: a page of its file is not what was written. Stop the server, run `kilterd verify` to see "
    "what is hit, and bring back a backup with `kilterd restore`."
)
FAILED = (
    "The disk of the data folder refused to read or write: nothing was stored. See that it has room and is sound "
    "(`kilterd doctor`, the system's log), then send it again."
)
BUSY = "The database is busy with other writes: send it again in a few seconds."
AWAY = (
    "The database cannot be reached ({reason}): see that it runs and that KILTER_DATABASE_URL is right "
    "(`kilterd doctor` tries it). Nothing was stored; send it again."
)
AWAY_CODE = "database_away"
FULL_CODE, READ_ONLY_CODE, FAILED_CODE = "disk_full", "disk_read_only", "disk_failed"
REFUSED_CODE = "database_refused"
REFUSED = (
    "The database refuses this account ({reason}): see the user, the password and the name in KILTER_DATABASE_URL."
)
CREDENTIALS = re.compile(r"(?<=://)[^@/\s]*@|password=\S+")
CODES = {AWAY_CODE, FULL_CODE, READ_ONLY_CODE, FAILED_CODE, REFUSED_CODE, "database_damaged", "database_busy"}
ERRNO = {
    errno.ENOSPC: (FULL_CODE, FULL),
    errno.EDQUOT: (FULL_CODE, FULL),
    errno.EFBIG: (FULL_CODE, FULL),
    errno.EROFS: (READ_ONLY_CODE, READ_ONLY),
    errno.EIO: (FAILED_CODE, FAILED),
}
SQLITE = (
    ("database or disk is full", FULL_CODE, FULL),
    ("readonly database", READ_ONLY_CODE, READ_ONLY),
    ("unable to open database file", READ_ONLY_CODE, READ_ONLY),
    ("malformed", "database_damaged", DAMAGED),
    ("not a database", "database_damaged", DAMAGED),
    ("disk I/O error", FAILED_CODE, FAILED),
    ("locked", "database_busy", BUSY),
)
# SQLSTATE, the first characters that tell (https://www.postgresql.org/docs/15/errcodes-appendix.html)
POSTGRESQL = (
    ("53100", FULL_CODE, FULL),
    ("25006", READ_ONLY_CODE, READ_ONLY),
    ("XX001", "database_damaged", DAMAGED),
    ("XX002", "database_damaged", DAMAGED),
)


def in_words(error: BaseException | None) -> CoreError | None:
    """Return what an error says as a refusal of Kilter; None when neither the database nor its disk failed.

    The causes of an error are looked through too: a library may wrap what the database said.
    """
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, CoreError):
            return error
        found = _as_service_error(error)
        if found is not None:
            return found
        error = error.__cause__ or error.__context__
    return None


def _as_service_error(error: BaseException) -> ServiceError | None:
    if isinstance(error, DBAPIError):
        return _of_driver(error.orig, away=error.connection_invalidated)
    if isinstance(error, sqlite3.Error):
        return _of_driver(error)
    if isinstance(error, OSError) and error.errno in ERRNO:
        code, sentence = ERRNO[error.errno]
        return ServiceError(sentence, code=code)
    return None


def _of_driver(error: BaseException | None, *, away: bool = False) -> ServiceError | None:
    if error is None:
        return None
    if isinstance(error, sqlite3.Error):
        return _first_matching_error(SQLITE, str(error), str.__contains__)
    state = getattr(error, "sqlstate", None)
    if state is not None and (found := _first_matching_error(POSTGRESQL, state, str.startswith)):
        return found
    if state is not None and state.startswith(("28", "3D")):
        return ServiceError(REFUSED.format(reason=_reason(error)), code=REFUSED_CODE)
    # psycopg gives no state to what fails before the server answers; 57P0x and 08 say that the server goes or is gone.
    operational = type(error).__name__ in ("OperationalError", "ConnectionTimeout")
    if away or (operational and state is None) or (state or "").startswith(("57P", "08", "53300", "25P03")):
        return ServiceError(AWAY.format(reason=_reason(error)), code=AWAY_CODE)
    return None


def _first_matching_error(
    table: tuple[tuple[str, str, str], ...], text: str, matches: Callable[[str, str], bool]
) -> ServiceError | None:
    return next((ServiceError(sentence, code=code) for part, code, sentence in table if matches(text, part)), None)


def _reason(error: BaseException) -> str:
    """The driver's first line, without what it says of credentials."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return CREDENTIALS.sub("", lines[0])[:200] if lines else type(error).__name__


def log_failure(log: logging.Logger, error: Exception, message: str, *arguments: object) -> None:
    """Log a sentence with what the database or its disk says; only what Kilter does not know has its traceback."""
    known = in_words(error)
    if known is not None and (known is error or known.code in CODES):
        log.error(f"{message}: %s", *arguments, known.message)
    else:
        log.error(message, *arguments, exc_info=error)


class Failing:
    """Something that is tried again and again: that it fails is logged once, until it has worked again."""

    def __init__(self, log: logging.Logger, message: str, *arguments: object) -> None:
        self._log, self._message, self._arguments = log, message, arguments
        self._known = False

    def report_failure(self, error: Exception) -> None:
        """Say that it failed, and why."""
        if not self._known:
            self._known = True
            log_failure(self._log, error, self._message, *self._arguments)

    def report_success(self) -> None:
        """Note that it works."""
        self._known = False
