"""A database that cannot be reached or written to: one error for the API, which refuses, and for workers, which wait."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy.exc import DBAPIError

from kilter_service.ground.db.failures import AWAY_CODE, FAILED_CODE, FULL_CODE, READ_ONLY, READ_ONLY_CODE, in_words
from kilter_service.ground.errors import ServiceError


class DatabaseAwayError(ServiceError):
    """The database does not answer now; what was asked of it was not stored, or it cannot be told."""

    default_code = AWAY_CODE


def is_read_only(folder: Path) -> bool:
    """Whether the file system of a folder is mounted read-only, or takes nothing more after an error of its disk."""
    if os.statvfs(folder).f_flag & os.ST_RDONLY:
        return True
    try:  # since Linux 6.15 the flags do not say the second (ext4: emergency_ro)
        os.close(os.open(folder, getattr(os, "O_TMPFILE", 0) | os.O_WRONLY, 0o600))
    except OSError as error:
        return error.errno == errno.EROFS
    return False


@contextmanager
def outages(folder: Path | None = None, *, writes: bool = True) -> Iterator[None]:
    """Raise ``DatabaseAwayError`` where the server is gone or the disk full or read-only, of SQLite that of ``folder``.

    Other errors pass; so does a write that the database refuses to a session that only reads.
    """
    try:
        yield
    except DBAPIError as error:
        known = in_words(error)
        # SQLite calls it a failure when the kernel refuses to write to a file that was open before.
        if known is not None and known.code == FAILED_CODE and folder is not None and is_read_only(folder):
            raise DatabaseAwayError(READ_ONLY, code=READ_ONLY_CODE) from error
        if known is None or known.code not in (AWAY_CODE, FULL_CODE, READ_ONLY_CODE):
            raise
        if known.code == READ_ONLY_CODE and not writes and (folder is None or not is_read_only(folder)):
            raise
        raise DatabaseAwayError(known.message, code=known.code) from error
