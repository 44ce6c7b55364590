"""Starts that cannot succeed: one sentence with the remedy, at once, without a traceback and without trying for ever."""

from __future__ import annotations

import os
import socket
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from kilter_service.ground.db import Database, revision
from kilter_service.ground.settings import Settings
from tests.service.forked import forked_command

REPOSITORY = Path(__file__).resolve().parents[2]


def kilterd(*arguments: str, timeout: float = 120.0, **settings: str) -> subprocess.CompletedProcess[str]:
    plain = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
    environment = plain | {"KILTER_PORT": "0", "KILTER_ZENOH_LISTEN": "tcp/127.0.0.1:0"} | settings
    if "PYTHONPATH" in settings:  # read when Python starts
        done = subprocess.run(
            [sys.executable, "-m", "kilter_service", *arguments],
            cwd=REPOSITORY, env=environment, capture_output=True, text=True, timeout=timeout, check=False,
        )  # fmt: skip
    else:
        done = forked_command(*arguments, environment=environment, folder=REPOSITORY, deadline_s=timeout)
    assert "Traceback" not in done.stderr or "serve" in arguments, done.stderr
    return done


@pytest.fixture
def newer(tmp_path: Path) -> Path:
    database = Database(f"sqlite:///{tmp_path / 'kilter.sqlite'}")
    revision.migrate(database)
    database.close()
    with sqlite3.connect(tmp_path / "kilter.sqlite") as connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    connection.close()
    return tmp_path


@pytest.mark.parametrize("command", ["migrate", "api", "worker", "serve"])
def test_a_newer_schema_is_left_alone(command: str, newer: Path) -> None:
    done = kilterd(command, KILTER_DATA=str(newer))
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "kilterd: The database is of a newer Kilter: it has revision 9999" in done.stderr
    assert "kilterd restore" in done.stderr
    assert "kilterd migrate" not in done.stderr
    with sqlite3.connect(newer / "kilter.sqlite") as connection:
        assert connection.execute("SELECT version_num FROM alembic_version").fetchone() == ("9999",)
    connection.close()


def test_a_worker_alone_says_at_once_that_the_tables_are_missing(tmp_path: Path) -> None:
    done = kilterd("worker", KILTER_DATA=str(tmp_path), timeout=25)  # it used to wait for 30 s
    assert done.returncode == 1
    assert done.stderr.startswith("kilterd: The database is at revision none, this Kilter needs ")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("command", ["api", "worker", "migrate"])
def test_a_database_that_is_away(command: str, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
    url = f"postgresql://kilter:secret@127.0.0.1:{port}/kilter"
    done = kilterd(command, KILTER_DATA=str(tmp_path), KILTER_DATABASE_URL=url)
    assert done.returncode == 1
    assert done.stderr.startswith("kilterd: The database cannot be reached (")
    assert "KILTER_DATABASE_URL" in done.stderr
    assert "secret" not in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_file_that_is_no_database(tmp_path: Path) -> None:
    (tmp_path / "kilter.sqlite").write_bytes(b"this is no database, and never was one\n" * 200)
    done = kilterd("api", KILTER_DATA=str(tmp_path))
    assert done.returncode == 1
    assert done.stderr.startswith("kilterd: The database is damaged")
    assert "kilterd restore" in done.stderr


NO_API = """
import os, sys, time
if 'api' in sys.orig_argv:
    deadline = time.monotonic() + 60
    while os.environ.get('WAIT_FOR') and not os.path.exists(os.environ['WAIT_FOR']) and time.monotonic() < deadline:
        time.sleep(0.02)
    raise SystemExit('no room for the API')
"""


@pytest.mark.parametrize("corrector_first", [pytest.param(False, marks=pytest.mark.slow), True])
def test_an_api_that_ends_at_every_start_ends_the_server(corrector_first: bool, tmp_path: Path) -> None:
    """Nobody could ask what is wrong, so the last line says it; with a corrector that stood first it took 300 s."""
    (tmp_path / "sitecustomize.py").write_text(NO_API)
    path = os.pathsep.join(filter(None, [str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    stands = str(Settings(data=tmp_path / "data").corrector_file) if corrector_first else ""
    done = kilterd("serve", KILTER_DATA=str(tmp_path / "data"), PYTHONPATH=path, WAIT_FOR=stands)
    assert done.returncode == 1
    assert done.stdout == ""
    last = done.stderr.splitlines()[-1]
    assert last.startswith("kilterd: The api process ended with 1 (SystemExit: no room for the API), "), last
    assert "3 times in a row: the server is not started." in last
    assert not (tmp_path / "data" / "server.json").exists()


def test_a_data_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = kilterd("migrate", KILTER_DATA=str(tmp_path / "file" / "data"))
    assert done.returncode == 1
    assert done.stderr == (
        f"kilterd: The folder {tmp_path / 'file' / 'data'} cannot be made (Not a directory): give one that this account "
        "may write to with --data or KILTER_DATA.\n"
    )


def test_where_the_server_cannot_run_one_sentence_says_so_and_what_to_do(tmp_path: Path) -> None:
    """As on Windows, whose Python has no fcntl."""
    code = "import sys; sys.modules['fcntl'] = None; from kilter_service.__main__ import main; main(['serve'])"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=REPOSITORY, env=os.environ | {"KILTER_DATA": str(tmp_path / "data")},
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (1, "", 1)
    assert done.stderr.startswith("kilterd: the server needs Linux")
    assert "WSL 2 or in a container" in done.stderr
    assert not (tmp_path / "data").exists()
