"""One process runs the jobs of a SQLite file. The lock ends with the process, however it ends."""

from __future__ import annotations

import fcntl
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from kilter_service.ground.errors import ServiceError

LOOK_S = 0.1


@contextmanager
def single_worker_lock(database_file: Path, wait_s: float) -> Iterator[None]:
    """Hold the lock beside the database file.

    Raises:
        ServiceError: another process still holds it after ``wait_s``; one that was asked to stop needs a moment.

    """
    database_file.parent.mkdir(parents=True, exist_ok=True)
    deadline = time.monotonic() + wait_s
    with database_file.with_name(f"{database_file.name}.worker.lock").open("w", encoding="ascii") as file:
        while not _try_lock(file.fileno()):
            if time.monotonic() > deadline:
                raise ServiceError(
                    f"Another process runs the jobs of {database_file} (a `kilterd worker`, or the one of `kilterd "
                    "serve`), and a SQLite database has one only. Stop it first; for several workers set "
                    "KILTER_DATABASE_URL to a PostgreSQL database.",
                    code="jobs_taken",
                )
            time.sleep(LOOK_S)
        yield


def _try_lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
