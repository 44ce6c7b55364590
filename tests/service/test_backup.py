"""Backups while the server works, restoration into SQLite and PostgreSQL, and what a check of the hashes says."""

from __future__ import annotations

import os
import shutil
import sqlite3
import subprocess
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import httpx
import numpy as np
import pytest
from sqlalchemy import text

from kilter_service.ground.db import Database, revision
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from kilter_service.run.backup import service, store
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import Katana, ready, served
from tests.service.forked import forked_command
from tests.service.made_versions import store_version
from tests.service.postgresql import programs, running_postgresql
from tests.service.test_meshes import CORNERS, binary

REPOSITORY = Path(__file__).resolve().parents[2]
SHOWN = ("/v1/robots", "/v1/robots/katana/campaigns", "/v1/robots/katana/activations", "/v1/robots/katana/versions")


def rows(count: int, seed: int) -> bytes:
    """Rows of the arm: rows that belong to no robot are asked what was mixed up, for seconds each time."""
    columns = Katana().columns(count, seed)
    cells = zip(*columns.values(), strict=True)
    return ",".join(columns).encode() + b"\n" + b"\n".join(b",".join(b"%.9f" % v for v in row) for row in cells)


def plain(tmp_path: Path, name: str) -> Settings:
    return Settings(data=tmp_path / name, database_url=None, port=0, zenoh_listen="tcp/127.0.0.1:0", token=None)


def filled(client: httpx.Client, database: Database, campaigns: int = 3) -> None:
    client.post("/v1/robots", json=Katana.document).raise_for_status()
    for number in range(campaigns):
        added = client.post("/v1/robots/katana/campaigns", json={"name": f"c{number}"}).raise_for_status().json()
        for part in range(2):
            client.post(
                f"/v1/campaigns/{added['id']}/observations",
                content=rows(200, 10 * number + part),
                headers={"Content-Type": "text/csv"},
            ).raise_for_status()
    shape = {"content": binary(CORNERS), "headers": {"Content-Type": "model/stl"}}
    client.put("/v1/robots/katana/meshes/base", **shape).raise_for_status()  # type: ignore[arg-type]
    for number in range(2):
        version = store_version(database, "katana", number)
        client.post(f"/v1/versions/{version}/activate", json={"force": True, "reason": "test"}).raise_for_status()


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[tuple[Settings, httpx.Client]]:
    """A running server with three campaigns and two versions."""
    settings = plain(tmp_path_factory.mktemp("source"), "data")
    ready(settings, migrated)
    database = Database(settings.database)
    with served(create_app(settings)) as client:
        client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
        filled(client, database)
        yield settings, client
    database.close()


def answers(client: httpx.Client) -> list[object]:
    shown = [client.get(path).json() for path in SHOWN]
    versions = [client.get(f"/v1/versions/{one['id']}").json() for one in shown[3]["versions"]]
    path = {
        "q1_deg": [0.0, 10.0],
        "q2_deg": [5.0, 6.0],
        "q3_deg": [1.0, 2.0],
        "q4_deg": [0.0, 0.0],
        "q5_deg": [3.0, 4.0],
    }
    return [*shown, *versions, client.post("/v1/robots/katana/correct", json=path).raise_for_status().json()]


def kilterd(settings: Settings, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **settings.environment()}
    done = forked_command(*arguments, environment=environment, folder=REPOSITORY)
    assert "Traceback" not in done.stderr, done.stderr
    return done


def test_a_restored_server_answers_the_same(source: tuple[Settings, httpx.Client], tmp_path: Path) -> None:
    settings, client = source
    (tmp_path / "backups").mkdir()
    done = kilterd(settings, "backup", str(tmp_path / "backups"))
    assert done.returncode == 0, done.stderr
    assert (
        "holds 1 robot, 3 campaigns with 6 chunks, 2 versions, 1 link shape; every row of every table has its hash."
        in done.stdout
    )
    file, hashes = sorted((tmp_path / "backups").iterdir())
    assert file.stat().st_mode & 0o777 == 0o600
    assert hashes.name == f"{file.name}.sha256"
    assert kilterd(settings, "verify", str(file)).stdout.startswith("All is whole: 1 robot, 3 campaigns with 6 chunks")

    new = plain(tmp_path, "new")
    restored = kilterd(new, "restore", str(file))
    assert restored.returncode == 0, restored.stderr
    with served(create_app(new)) as other:
        other.headers["Authorization"] = f"Bearer {admin_token(new)}"
        assert answers(other) == answers(client)
    again = kilterd(new, "restore", str(file))
    assert (again.returncode, "has data already (kilter.sqlite" in again.stderr) == (1, True)
    twice = kilterd(settings, "backup", str(file))
    assert (twice.returncode, "backups are never written over" in twice.stderr) == (1, True)


def test_a_backup_beside_writers_is_one_moment(source: tuple[Settings, httpx.Client], tmp_path: Path) -> None:
    settings, client = source
    stop = threading.Event()
    sent: list[str] = []

    def write() -> None:
        while not stop.is_set():
            name = f"busy {len(sent)}"
            campaign = client.post("/v1/robots/katana/campaigns", json={"name": name}).raise_for_status().json()["id"]
            client.post(
                f"/v1/campaigns/{campaign}/observations",
                content=rows(50, len(sent)),
                headers={"Content-Type": "text/csv"},
            ).raise_for_status()
            sent.append(campaign)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        counts = []
        for number in range(4):
            before = len(sent)
            _, found = service.backup(settings, tmp_path / f"{number}.backup")
            counts.append((before, found.campaigns - 3, len(sent) + 1))
    finally:
        stop.set()
        writer.join()
    assert all(before <= held <= after for before, held, after in counts), counts


def damage(settings: Settings, tmp_path: Path, *statements: str) -> Settings:
    """Copy the database and change it behind Kilter's back."""
    service.backup(settings, tmp_path / "whole.backup")
    other = plain(tmp_path, "damaged")
    service.restore(other, tmp_path / "whole.backup")
    with closing(sqlite3.connect(other.data / "kilter.sqlite")) as file:
        for statement in statements:
            file.execute(statement)
        file.commit()
    return other


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("UPDATE chunks SET parquet = zeroblob(length(parquet)) WHERE upload_id = 3", "('c1' of 'katana'), upload "),
        ("DELETE FROM chunks WHERE upload_id = 5", "chunk 0 is missing."),
        (
            "UPDATE versions SET limits = '{}' WHERE id = 'ver_0000000000000001'",
            "Version ver_0000000000000001: its content",
        ),
        ("UPDATE robots SET chain = '{}'", "Robot 'katana': its chain does not have its hash"),
        ("UPDATE meshes SET content = x'00'", "Robot 'katana': the shape of link 'base' is damaged"),
        ("DELETE FROM uploads WHERE id = 2", "of chunks refers to a row of uploads that is missing."),
    ],
)
def test_what_is_damaged_or_missing_is_named(
    statement: str, said: str, source: tuple[Settings, httpx.Client], tmp_path: Path
) -> None:
    other = damage(source[0], tmp_path, "PRAGMA foreign_keys=OFF", statement)
    found = service.verify_stored(other)
    assert any(said in one for one in found.damaged), found.damaged
    with pytest.raises(ServiceError, match="so there is no new backup"):
        service.backup(other, tmp_path / "bad.backup")
    assert not list(tmp_path.glob("bad.backup*"))


def test_verify_names_the_chunk_and_ends_with_1(source: tuple[Settings, httpx.Client], tmp_path: Path) -> None:
    other = damage(source[0], tmp_path, "UPDATE chunks SET parquet = x'00' WHERE upload_id = 3")
    done = kilterd(other, "verify")
    assert done.returncode == 1
    assert "chunk 0 is damaged, its bytes do not have the hash" in done.stdout
    assert "kilterd: 1 finding in " in done.stderr
    assert "`kilterd restore`" in done.stderr
    looked = kilterd(other, "doctor")
    assert looked.returncode == 1
    assert "WRONG hashes: Campaign cmp_" in looked.stdout


def test_a_damaged_page_is_found_and_the_rest_is_read(source: tuple[Settings, httpx.Client], tmp_path: Path) -> None:
    other = damage(source[0], tmp_path, "VACUUM")
    path = other.data / "kilter.sqlite"
    with closing(sqlite3.connect(path)) as file:
        file.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        page = file.execute("SELECT pageno FROM dbstat WHERE name = 'chunks' ORDER BY pageno DESC").fetchone()
        size = file.execute("PRAGMA page_size").fetchone()[0]
    with path.open("r+b") as raw:
        raw.seek((page[0] - 1) * size)
        raw.write(os.urandom(size))
    found = service.verify_stored(other)
    assert found.damaged
    assert found.versions == 2
    assert any("chunk" in one for one in found.damaged)


def test_a_backup_that_was_changed_is_not_restored(source: tuple[Settings, httpx.Client], tmp_path: Path) -> None:
    path, _ = service.backup(source[0], tmp_path / "one.backup")
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    new = plain(tmp_path, "new")
    with pytest.raises(ServiceError, match="does not have the hash in one"):
        service.restore(new, path)
    path.write_bytes(b"no database at all" * 1000)
    path.with_name("one.backup.sha256").unlink()
    with pytest.raises(ServiceError, match="is damaged and was not restored"):
        service.restore(new, path)
    assert [one.name for one in new.data.iterdir()] == ["serve.lock"]


def dump(path: Path) -> list[str]:
    """Everything that is stored in a file."""
    with closing(sqlite3.connect(path)) as file:
        return list(file.iterdump())


@pytest.mark.parametrize(
    ("statement", "table"),
    [
        ("UPDATE versions SET report = '{}' WHERE id = 'ver_0000000000000001'", "versions"),
        ("UPDATE campaigns SET name = 'other' WHERE name = 'c1'", "campaigns"),
        ("DELETE FROM activations WHERE id = 1", "activations"),
        ("UPDATE activations SET forced = NOT forced", "activations"),
        ("CREATE TABLE more (a)", "more"),
        ("DROP TABLE meshes", "meshes"),
    ],
)
def test_a_backup_notices_rows_without_a_hash_of_their_own(
    statement: str, table: str, source: tuple[Settings, httpx.Client], tmp_path: Path
) -> None:
    """Reports, results, roles and activations were altered and restored without a word."""
    path, _ = service.backup(source[0], tmp_path / "one.backup")
    path.with_name("one.backup.sha256").unlink()
    with closing(sqlite3.connect(path)) as file:
        for trigger in file.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
            file.execute(f"DROP TRIGGER {trigger[0]}")
        file.execute(statement)
        file.commit()
    found = service.verify(path)
    assert any(one.startswith(f"Table {table} ") for one in found.damaged), found.damaged
    with pytest.raises(ServiceError, match=f"Table {table} "):
        service.restore(plain(tmp_path, "new"), path)


def flip(settings: Settings, folder: Path, number: int, seed: int) -> list[list[str]]:
    """Flip bits of a backup, one at a time; returns what is found of each without the hash beside it, by the manifest."""
    path, _ = service.backup(settings, folder / "one.backup")
    whole, stored = path.read_bytes(), dump(path)
    beside = path.with_name("one.backup.sha256")
    chance = np.random.default_rng(seed)
    named = []
    for at in chance.integers(len(whole), size=number).tolist():
        flipped = bytearray(whole)
        flipped[at] ^= 1 << int(chance.integers(8))
        path.write_bytes(flipped)
        assert service.verify(path).damaged, at
        hashes = beside.read_bytes()
        beside.unlink()
        found = service.verify(path).damaged
        if not found:  # a bit that holds nothing
            assert dump(path) == stored, at
        named.append(found)
        beside.write_bytes(hashes)
    return named


def test_no_flipped_bit_of_a_backup_is_restored(source: tuple[Settings, httpx.Client], tmp_path: Path) -> None:
    assert sum(map(bool, flip(source[0], tmp_path, 25, seed=3))) > 5


@pytest.mark.slow
def test_two_hundred_flipped_bits_of_a_backup(source: tuple[Settings, httpx.Client], tmp_path: Path) -> None:
    named = flip(source[0], tmp_path, 200, seed=20261125)
    by_table = sum(any(one.startswith("Table ") for one in found) for found in named)
    nothing = sum(not found for found in named)
    print(
        f"\n200 bits of a backup flipped: 200 noticed by its hash; without it {by_table} named by table, "
        f"{len(named) - by_table - nothing} by page or file, {nothing} in bytes that hold nothing"
    )
    assert by_table > 50


def test_a_flipped_bit_beside_a_backup_is_noticed(source: tuple[Settings, httpx.Client], tmp_path: Path) -> None:
    path, _ = service.backup(source[0], tmp_path / "one.backup")
    beside = path.with_name("one.backup.sha256")
    flipped = bytearray(beside.read_bytes())
    flipped[5] ^= 128
    beside.write_bytes(flipped)
    assert "one.backup.sha256: one of the two was altered" in service.verify(path).damaged[0]


def test_damaged_json_is_a_finding(source: tuple[Settings, httpx.Client], tmp_path: Path) -> None:
    other = damage(source[0], tmp_path, "UPDATE robots SET chain = '{\"elements'")
    done = kilterd(other, "verify")
    assert done.returncode == 1
    assert "Not all robots can be read, what one holds is damaged" in done.stdout


def test_older_and_newer_backups(source: tuple[Settings, httpx.Client], tmp_path: Path) -> None:
    from alembic import command

    path, _ = service.backup(source[0], tmp_path / "one.backup")
    path.with_name("one.backup.sha256").unlink()
    older = tmp_path / "older.backup"
    shutil.copy(path, older)
    service.remove(older)  # an older Kilter wrote none
    database = Database(f"sqlite:///{older}")
    command.downgrade(revision.configuration(database.url), "0005")
    database.close()
    new = plain(tmp_path, "new")
    service.restore(new, older)
    assert service.verify_stored(new).damaged == []
    with closing(sqlite3.connect(path)) as file:
        file.execute("UPDATE alembic_version SET version_num = '9999'")
        file.commit()
    with pytest.raises(ServiceError, match="of a newer Kilter: it has revision 9999"):
        service.restore(plain(tmp_path, "newer"), path)


def test_a_version_is_copied_after_the_one_it_continues(
    source: tuple[Settings, httpx.Client], migrated: Path, tmp_path: Path
) -> None:
    """Also when the clock was set back between them: then it is the older one by its date."""
    path, _ = service.backup(source[0], tmp_path / "one.backup")
    shutil.copy(path, tmp_path / "from.sqlite")
    shutil.copy(migrated, tmp_path / "into.sqlite")
    with closing(sqlite3.connect(tmp_path / "from.sqlite")) as file:
        (first, second) = (one for (one,) in file.execute("SELECT id FROM versions ORDER BY id"))
        file.execute("DROP TRIGGER IF EXISTS versions_immutable")
        for version, parent, at in ((first, second, "2026-01-01 00:00:00"), (second, None, "2026-01-02 00:00:00")):
            file.execute("UPDATE versions SET parent_id = ?, created_at = ? WHERE id = ?", (parent, at, version))
        file.commit()
    taken, given = (Database(f"sqlite:///{tmp_path / name}.sqlite") for name in ("from", "into"))
    assert store.copy(taken, given) > 2
    with given.reading() as session:
        assert dict(session.execute(text("SELECT id, parent_id FROM versions")).all()) == {first: second, second: None}  # type: ignore[arg-type]
    taken.close()
    given.close()


def test_a_backup_goes_into_postgresql_and_back(source: tuple[Settings, httpx.Client], tmp_path: Path) -> None:
    if programs() is None:
        pytest.skip("PostgreSQL is not installed")
    settings, client = source
    path, held = service.backup(settings, tmp_path / "one.backup")
    with running_postgresql() as url:
        there = plain(tmp_path, "there").model_copy(update={"database_url": url})
        service.restore(there, path)
        with pytest.raises(ServiceError, match="has data already"):
            service.restore(there, path)
        with served(create_app(there)) as other:
            other.headers["Authorization"] = f"Bearer {admin_token(there)}"
            assert answers(other) == answers(client)
            other.post("/v1/robots/katana/rollback").raise_for_status()  # numbers of new rows go on
            other.post("/v1/robots", json=Katana.document | {"name": "another"}).raise_for_status()
        back, found = service.backup(there, tmp_path / "two.backup")
        assert (found.campaigns, found.chunks, found.versions) == (held.campaigns, held.chunks, held.versions)
    service.restore(plain(tmp_path, "back"), back)
