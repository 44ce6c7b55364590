"""Whether a database is being migrated: on a slow disk that takes minutes, in which others must not even open it."""

from __future__ import annotations

import fcntl
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from kilter_service.ground.files.private_files import private_folder

LOCK_FILE = "migration.lock"
LOOK_S = 0.02


@contextmanager
def migration_lock(data: Path) -> Iterator[None]:
    """Hold the lock of a data folder; one process after the other migrates. It ends with the process, however it ends."""
    with (private_folder(data) / LOCK_FILE).open("w", encoding="ascii") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            fcntl.flock(file, fcntl.LOCK_UN)


def is_migrating(data: Path) -> bool:
    """Whether another process migrates the database of a data folder."""
    try:
        with (data / LOCK_FILE).open(encoding="ascii") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # there is no such file, or no such folder
        return False
    return False


def wait_for_migration(data: Path) -> None:
    """Wait for the end of a migration, however long it takes: whoever migrates says what goes wrong."""
    while is_migrating(data):
        time.sleep(LOOK_S)
