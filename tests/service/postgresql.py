"""A PostgreSQL server of the test's own, from Debian's package, as an unprivileged user."""

from __future__ import annotations

import os
import pwd
import shutil
import signal
import socket
import subprocess
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import create_engine, make_url, text

USERS = ("postgres", "nobody")  # root may not run it


def programs() -> Path | None:
    """Return the folder of the newest server's programs, None where none is installed."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda path: int(path.parts[-3]))
    return found[-1].parent if found else None


def _user() -> str | None:
    if os.geteuid() != 0:
        return None
    known = {entry.pw_name for entry in pwd.getpwall()}
    return next((name for name in USERS if name in known), None)


class PostgreSql:
    """A server of the test's own, which it may stop and start again."""

    def __init__(self) -> None:
        bin_ = programs()
        assert bin_ is not None
        self._bin, self._user = bin_, _user()
        self._folder = Path(tempfile.mkdtemp(prefix="kilter-pg-"))  # short: the path of a socket has 107 characters
        if self._user is not None:
            shutil.chown(self._folder, self._user)
        with socket.create_server(("127.0.0.1", 0)) as free:
            self._port = free.getsockname()[1]
        self._data = str(self._folder / "data")
        self._run("initdb", "-D", self._data, "-U", "kilter", "-A", "trust", "--no-sync")

    @property
    def url(self) -> str:
        """URL of its first database."""
        return f"postgresql://kilter@127.0.0.1:{self._port}/postgres"

    def start(self) -> None:
        """Start it, and wait until it answers."""
        options = f"-p {self._port} -k {self._folder} -c listen_addresses=127.0.0.1 -c fsync=off"
        log = str(self._folder / "log")
        self._run("pg_ctl", "-D", self._data, "-l", log, "-o", options, "-w", "start")

    def stop(self, mode: str = "immediate") -> None:
        """Stop it: ``immediate`` is as if it were killed, ``fast`` breaks off what runs."""
        self._run("pg_ctl", "-D", self._data, "-m", mode, "-w", "stop")

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Stop all its processes, which keep their connections and answer nothing, and let them go on."""
        first = int((Path(self._data) / "postmaster.pid").read_text(encoding="ascii").splitlines()[0])
        children = Path(f"/proc/{first}/task/{first}/children").read_text(encoding="ascii").split()
        pids = [first, *map(int, children)]
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        try:
            yield
        finally:
            for pid in pids:
                os.kill(pid, signal.SIGCONT)

    def remove(self) -> None:
        """Take its files away."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _run(self, program: str, *arguments: str) -> None:
        done = subprocess.run(
            [str(self._bin / program), *arguments], user=self._user, cwd=self._folder, capture_output=True, text=True,
            timeout=120,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr + done.stdout


@contextmanager
def own_postgresql() -> Iterator[PostgreSql]:
    """Run a server on a free port of this machine."""
    server = PostgreSql()
    try:
        server.start()
        try:
            yield server
        finally:
            server.stop()
    finally:
        server.remove()


@contextmanager
def running_postgresql() -> Iterator[str]:
    """Run a server on a free port of this machine; gives its URL."""
    with own_postgresql() as server:
        yield server.url


@contextmanager
def database_of(url: str, template: str | None = None) -> Iterator[str]:
    """Make an empty database on a server, or a copy of another; gives its URL."""
    name = f"kilter_{uuid.uuid4().hex[:12]}"
    server = make_url(url)
    engine = create_engine(server.set(drivername="postgresql+psycopg"), isolation_level="AUTOCOMMIT")
    try:
        with engine.connect() as connection:
            connection.execute(text(f"CREATE DATABASE {name}" + (f" TEMPLATE {template}" if template else "")))
        yield server.set(database=name).render_as_string(hide_password=False)
        with engine.connect() as connection:
            connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    finally:
        engine.dispose()
