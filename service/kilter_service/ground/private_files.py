"""Files that their owner alone may read: the data folder, the file that names a running server, folders for a while."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from kilter_service.ground.errors import ServiceError

UMASK = 0o077
TEMPORARY = "tmp"
LOCK = ".lock"
LONGEST_FOLDER = 80  # with the name of a socket in it: the system takes 107 characters


def private_folder(path: Path) -> Path:
    """Make a folder that only its owner may enter; one that is there, which may be of anybody's, stays as it is.

    Raises:
        ServiceError: it cannot be made.

    """
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise ServiceError(
            f"The folder {path} cannot be made ({os.strerror(error.errno or 0)}): give one that this account may write "
            "to with --data or KILTER_DATA.",
            code="data_unusable",
            path=str(path),
        ) from error
    return path


def private_file(path: Path) -> None:
    """Make a file that only its owner may read, before anybody writes into it; one that is there keeps its content.

    One that is there is not opened: closing it would take the locks that SQLite holds on it in this process.
    """
    with contextlib.suppress(OSError):  # whoever opens it next has the whole error
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600))
    keep_private(path)


def read_secret_file(file: Path, what: str, least: int, others: int, unusable: Callable[[str], ServiceError]) -> bytes:
    """Return ``what`` a file holds: at least so many bytes, and nobody may have the rights ``others``.

    Raises:
        ServiceError: what ``unusable`` makes of the reason.

    """
    try:
        open_to_others = stat.S_IMODE(file.stat().st_mode) & others
        content = file.read_bytes().strip()
    except OSError as error:
        raise unusable(f"cannot be read ({error.strerror}): give the file of the {what}") from error
    if open_to_others:
        raise unusable(f"can be read by others: run `chmod 600 {file}`")
    if len(content) < least:
        raise unusable(f"is too short: make one with `openssl rand -base64 48 > {file}`")
    return content


def keep_private(path: Path) -> None:
    """Take the rights of others from what Kilter has made, if it is this account's: an older Kilter gave some.

    Never of a folder that somebody else may have made: a backup into a folder of the user's closed it to the database
    server whose data lay below, and as root it would have closed ``/``.
    """
    with contextlib.suppress(OSError):
        found = path.stat()
        mode = stat.S_IMODE(found.st_mode)
        if mode & UMASK and found.st_uid == os.geteuid():
            path.chmod(mode & ~UMASK)


def protect(data: Path, *databases: str) -> None:
    """Make the data folder for its owner alone where there is none, and close the databases that are in it already.

    The rights of a folder that is there are its owner's choice; `kilterd doctor` says where others may enter it.
    """
    private_folder(data)
    for name in databases:
        for path in data.glob(f"{name}*"):  # SQLite's -wal and -shm too
            keep_private(path)


class Scratch:
    """A folder of this process for temporary files, inside one that it shares with others of its account.

    It is locked as long as the process lives. Whoever makes the next one removes those that nobody holds any more, so that
    a process which was killed leaves nothing for good.
    """

    def __init__(self, shared: Path) -> None:
        private_folder(shared)
        keep_private(shared)
        with _exclusive_lock(shared / LOCK):
            clean(shared)
            self.folder = Path(tempfile.mkdtemp(prefix=f"{os.getpid()}-", dir=shared))
            self._lock = hold_scratch_folder(self.folder)

    @classmethod
    def from_shared_folder(cls, folder: Path) -> Scratch:
        """Share the folder of another process."""
        made = cls.__new__(cls)
        made.folder, made._lock = folder, hold_scratch_folder(folder)
        return made

    @contextmanager
    def folder_for(self, purpose: str) -> Iterator[Path]:
        """Yield a new folder that is gone afterwards."""
        with tempfile.TemporaryDirectory(prefix=f"{purpose}-", dir=self.folder) as folder:
            yield Path(folder)

    def leave(self) -> None:
        """Leave the folder to the other processes that hold it."""
        if self._lock is not None:
            self._lock.close()

    def close(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.leave()


def scratch_for_sockets(data: Path) -> Scratch:
    """Return a folder for sockets: the system limits their path, so a deep data folder has them in the system's own."""
    shared = data.absolute() / TEMPORARY
    if len(os.fsencode(shared)) > LONGEST_FOLDER:
        shared = Path(tempfile.gettempdir()) / f"kilter-{os.geteuid()}"
        private_folder(shared)
        if shared.is_symlink() or shared.stat().st_uid != os.geteuid():
            shared = Path(tempfile.mkdtemp(prefix="kilter-"))  # somebody else has taken the name
    return Scratch(shared)


def hold_scratch_folder(folder: Path) -> IO[str] | None:
    """Keep a folder of :class:`Scratch` for as long as the file returned is open, as several processes may at once."""
    return _try_lock_file(folder / LOCK, fcntl.LOCK_SH)


def clean(shared: Path) -> None:
    """Remove the folders whose processes have ended."""
    for folder in shared.iterdir():
        if not folder.is_dir() or folder.is_symlink():
            continue
        lock = _try_lock_file(folder / LOCK, fcntl.LOCK_EX)
        if lock is not None:
            shutil.rmtree(folder, ignore_errors=True)
            lock.close()


@contextmanager
def _exclusive_lock(path: Path) -> Iterator[None]:
    """Hold a lock for a moment: no folder may be looked at between its making and its own lock."""
    with path.open("w", encoding="ascii") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _try_lock_file(path: Path, how: int) -> IO[str] | None:
    """Lock a file; None when another process holds it, or its folder is gone."""
    try:
        file = path.open("w", encoding="ascii")
    except OSError:
        return None
    try:
        fcntl.flock(file, how | fcntl.LOCK_NB)
    except OSError:
        file.close()
        return None
    return file


class ServerFile:
    """Writes the file when the server is ready, removes it when the server stops."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def write(self, document: dict[str, Any]) -> None:
        """Replace the file in one go, so that nobody reads half of it."""
        part = self._path.with_suffix(".part")
        part.write_text(json.dumps(document, indent=1), encoding="utf-8")
        part.replace(self._path)

    def __enter__(self) -> ServerFile:
        private_folder(self._path.parent)
        self._path.unlink(missing_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._path.unlink(missing_ok=True)
