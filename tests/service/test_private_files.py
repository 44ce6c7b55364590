"""What the server writes is its owner's alone, and a process that is killed leaves no folder for good."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from kilter_service.ground.db import Database
from kilter_service.ground.private_files import Scratch, protect
from kilter_service.stream.corrector.endpoints import PrivateSocket
from tests.service.forked import forked_command

REPOSITORY = Path(__file__).resolve().parents[2]
HOLDER = """
import sys, time
from pathlib import Path
from kilter_service.ground.private_files import Scratch
scratch = Scratch(Path(sys.argv[1]))
(scratch.folder / "upload-x").mkdir()
print(scratch.folder, flush=True)
time.sleep(600)
"""


def plain() -> dict[str, str]:
    """Return this process's environment without settings of Kilter."""
    return {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_new_data_folder_and_its_databases_are_the_owners(tmp_path: Path) -> None:
    data = tmp_path / "data"
    done = forked_command("migrate", "--data", str(data), environment=plain(), folder=REPOSITORY, umask=0o022)
    assert done.returncode == 0, done.stderr
    assert mode(data) == 0o700
    assert {mode(path) for path in data.iterdir()} == {0o600}


def test_a_database_opened_by_a_library_user_is_the_owners(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        database = Database(f"sqlite:///{tmp_path / 'data' / 'kilter.sqlite'}")
        with database.transaction():
            assert mode(tmp_path / "data") == 0o700
            assert {mode(path) for path in (tmp_path / "data").iterdir()} == {0o600}
        database.close()
    finally:
        os.umask(before)


def test_files_that_an_older_kilter_left_open_are_closed(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir(mode=0o755)
    for name in ("kilter.sqlite", "kilter.sqlite-wal", "jobs.sqlite", "other.txt"):
        (tmp_path / "data" / name).touch(mode=0o644)
        (tmp_path / "data" / name).chmod(0o644)
    protect(tmp_path / "data", "kilter.sqlite", "jobs.sqlite")
    found = {path.name: mode(path) for path in (tmp_path / "data").iterdir()}
    assert found == {"kilter.sqlite": 0o600, "kilter.sqlite-wal": 0o600, "jobs.sqlite": 0o600, "other.txt": 0o644}
    assert mode(tmp_path / "data") == 0o755


@pytest.mark.parametrize("rights", [0o755, 0o775, 0o1777])
def test_a_folder_of_somebody_stays_as_open_as_it_was(tmp_path: Path, rights: int) -> None:
    """A database in /tmp, opened by root, closed /tmp to all other accounts; a backup did so to the folder it went to."""
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(rights)
    database = Database(f"sqlite:///{shared}/kilter.sqlite")
    database.close()
    assert mode(shared) == rights
    assert mode(shared / "kilter.sqlite") == 0o600


def rights_of(folder: Path, but: Path) -> dict[str, tuple[int, int, int, str]]:
    """Mode, owner, group and content of all that lies in a folder, but for what lies in one of them."""
    found = {}
    for path in [folder, *folder.rglob("*")]:
        if path != but and but not in path.parents:
            state = path.stat()
            content = path.read_bytes().hex() if path.is_file() else ""
            found[str(path)] = (stat.S_IMODE(state.st_mode), state.st_uid, state.st_gid, content)
    return found


def test_no_command_touches_what_is_not_its_own(tmp_path: Path) -> None:
    """`kilterd backup NAME` set the folder above NAME to 0700; it ended a PostgreSQL whose data lay below."""
    data, theirs = tmp_path / "data", tmp_path / "theirs"
    (theirs / "backups").mkdir(parents=True)
    (theirs / "postgresql").mkdir()
    (theirs / "postgresql" / "PG_VERSION").write_text("15")
    for path in (tmp_path, theirs, theirs / "backups", theirs / "postgresql"):
        path.chmod(0o755)
    before = rights_of(tmp_path, data)
    written = theirs / "one.kilter-backup"
    commands = [
        ["migrate"], ["backup", str(written)], ["backup", str(theirs / "backups")], ["verify"], ["verify", str(written)],
        ["doctor"], ["restore", str(written), "--data", str(tmp_path / "data" / "restored")],
    ]  # fmt: skip
    for command in commands:
        done = forked_command(
            command[0], "--data", str(data), *command[1:], environment=plain(), folder=REPOSITORY, umask=0o022
        )
        assert done.returncode == 0 or command == ["doctor"], done.stderr  # which may find this machine's disk too full
        after = rights_of(tmp_path, data)
        backups = {path for path in after if ".kilter-backup" in path}
        assert {path: after[path] for path in after if path not in backups} == before, command
        assert {after[path][0] for path in backups} <= {0o600}


def test_folders_of_killed_processes_are_removed_and_those_of_living_ones_stay(tmp_path: Path) -> None:
    holders = [
        subprocess.Popen(
            [sys.executable, "-c", HOLDER, str(tmp_path / "tmp")], stdout=subprocess.PIPE, text=True, cwd=REPOSITORY
        )
        for _ in range(2)
    ]
    try:
        folders = [Path((holder.stdout.readline() if holder.stdout else "").strip()) for holder in holders]
        assert all((folder / "upload-x").is_dir() for folder in folders)
        holders[0].send_signal(signal.SIGKILL)
        holders[0].wait()
        mine = Scratch(tmp_path / "tmp")
        assert not folders[0].exists()
        assert (folders[1] / "upload-x").is_dir()
        with mine.folder_for("upload") as folder:
            assert mode(folder) == 0o700
        assert not folder.exists()
        mine.close()
        assert not mine.folder.exists()
    finally:
        for holder in holders:
            holder.kill()
            holder.wait()
            assert holder.stdout is not None
            holder.stdout.close()


def test_a_socket_fits_however_deep_the_data_folder_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    deep = tmp_path.joinpath(*["a-folder-with-a-long-name"] * 6)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    socket = PrivateSocket(deep)
    assert len(socket.endpoint.removeprefix("unixsock-stream/")) < 107 or len(str(tmp_path)) > 70
    socket.close()
