"""Rows are sealed: what is altered past Kilter is named, and what Kilter does itself breaks no seal."""

from __future__ import annotations

import gc
import json
import shutil
import sqlite3
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from sqlalchemy import text, update

from kilter_service.ground.db import Database, revision, seals
from kilter_service.ground.db.row import Row
from kilter_service.ground.db.tables import JobRow, RobotRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from kilter_service.run.backup import service
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import Katana, WorkerProcess, ready, served
from tests.service.made_versions import store_version
from tests.service.postgresql import database_of
from tests.service.test_backup import kilterd, plain
from tests.service.test_meshes import CORNERS, binary

# What no result and no right rests on, as docs/explanation/durability.md says.
OPEN = {("jobs", "fraction"), ("jobs", "stage")}
APART = {"heartbeats", "ended_jobs"}
SEALS = {"seals", "database_seal"}


def used(client: httpx.Client, database: Database, katana: Katana) -> None:
    """Store something in every table, and delete some of it, as people do."""
    campaign = katana.campaign(client, 60)
    gone = client.post("/v1/robots/katana/campaigns", json={"name": "gone"}).json()["id"]
    client.post(f"/v1/campaigns/{gone}/observations", json=katana.columns(20, 7)).raise_for_status()
    client.post(f"/v1/campaigns/{gone}/purge").raise_for_status()
    client.post("/v1/robots", json={**katana.document, "name": "second"}).raise_for_status()
    client.post("/v1/robots", json={**katana.document, "name": "third"}).raise_for_status()
    shape = {"content": binary(CORNERS), "headers": {"Content-Type": "model/stl"}}
    for robot in ("katana", "second"):
        client.put(f"/v1/robots/{robot}/meshes/base", **shape).raise_for_status()  # type: ignore[arg-type]
    client.delete("/v1/robots/second").raise_for_status()
    for number in (1, 2):
        version = store_version(database, "katana", number)
        client.post(f"/v1/versions/{version}/activate", json={"force": True, "reason": "test"}).raise_for_status()
    client.patch(f"/v1/versions/{version}", json={"name": "of today", "notes": "on the bench"}).raise_for_status()
    made = client.post("/v1/tokens", json={"name": "anna", "role": "viewer"}).raise_for_status().json()
    client.post("/v1/tokens", json={"name": "bert", "role": "operator"}).raise_for_status()
    client.delete(f"/v1/tokens/{made['id']}").raise_for_status()
    job = {"kind": "identify", "robot": "katana", "campaigns": [campaign], "options": {"level": 1}}
    client.post("/v1/jobs", json=job, headers={"Idempotency-Key": "once"}).raise_for_status()
    client.post("/v1/fleet/jobs", json={"robots": ["katana"], "options": {"level": 1}})
    client.post("/login", data={"token": client.headers["Authorization"].removeprefix("Bearer ")})


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Path:
    """A database with something in every table, as one file."""
    settings = plain(tmp_path_factory.mktemp("whole"), "data")
    ready(settings, migrated)
    database = Database(settings.database)
    with served(create_app(settings)) as client:
        client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
        used(client, database, Katana())
    database.close()
    with closing(sqlite3.connect(settings.data / "kilter.sqlite")) as file:
        file.execute("PRAGMA journal_mode=DELETE")
    return settings.data / "kilter.sqlite"


@pytest.fixture
def filled(whole: Path, tmp_path: Path) -> Settings:
    return copied(whole, tmp_path, "data")


def copied(whole: Path, tmp_path: Path, name: str) -> Settings:
    settings = plain(tmp_path, name)
    settings.data.mkdir()
    shutil.copy(whole, settings.data / "kilter.sqlite")
    return settings


@pytest.mark.both_databases
def test_what_kilter_does_itself_breaks_no_seal(
    client: httpx.Client,
    settings: Settings,
    database: Database,
    katana: Katana,
    worker: WorkerProcess,
    until: Callable[..., None],
) -> None:
    used(client, database, katana)
    worker.start()
    until(lambda: all(job["state"] == "succeeded" for job in client.get("/v1/jobs").json()["jobs"]))
    with database.reading() as session:
        sealed = dict(session.execute(text("SELECT thing, count(*) FROM seals GROUP BY thing")).all())  # type: ignore[arg-type]
    assert {"robots", "campaigns", "chunks", "jobs", "versions", "replays", "tokens", "meshes"} <= sealed.keys()
    assert service.verify_stored(settings).damaged == []


@pytest.fixture
def on_postgresql(
    request: pytest.FixtureRequest, tmp_path: Path, katana: Katana
) -> Iterator[tuple[Settings, Database, httpx.Client]]:
    """A server on PostgreSQL with something in every table."""
    template = request.getfixturevalue("postgresql_template")
    with database_of(request.getfixturevalue("postgresql"), template) as url:
        settings = Settings(
            data=tmp_path / "data", database_url=url, port=0, zenoh_listen="tcp/127.0.0.1:0", token=None
        )
        settings.data.mkdir()
        database = Database(settings.database)
        revision.migrate(database)
        with served(create_app(settings)) as client, closing(database):
            client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
            used(client, database, katana)
            yield settings, database, client


def test_alterations_of_a_running_servers_postgresql_are_named(
    on_postgresql: tuple[Settings, Database, httpx.Client],
) -> None:
    """A value in about a third of all columns, altered by hand and put back, one after another."""
    settings, database, client = on_postgresql
    assert service.verify_stored(settings).damaged == []
    unseen = [*unnamed_alterations(settings, database)]
    assert unseen == []
    assert service.verify_stored(settings).damaged == []
    client.get("/v1/robots/katana").raise_for_status()


def test_a_check_that_ends_half_way_leaves_no_cursor_of_postgresql_open(
    on_postgresql: tuple[Settings, Database, httpx.Client], monkeypatch: pytest.MonkeyPatch
) -> None:
    settings, database, _ = on_postgresql
    with database.engine.begin() as hand:
        hand.execute(text("SET session_replication_role = replica"))
        hand.execute(text("UPDATE audit SET content = '{}' WHERE number = 2"))
    left: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", left.append)
    with warnings.catch_warnings():
        warnings.simplefilter("error", ResourceWarning)
        found = service.verify_stored(settings).sentences
        gc.collect()
    assert any("Entry 2 of the audit" in one for one in found)
    assert left == []


ALTERED = {  # by the type of the column, in PostgreSQL's words
    "character varying": "'~' || substr(coalesce({0}, ''), 2)",
    "text": "'~' || substr(coalesce({0}, ''), 2)",
    "json": "'{{\"x\": 1}}'",
    "bytea": "coalesce({0}, '') || '\\x00'",
    "boolean": "NOT coalesce({0}, false)",
    "timestamp with time zone": "coalesce({0}, now()) + interval '1 second'",
    "timestamp without time zone": "coalesce({0}, now()) + interval '1 second'",
    "integer": "coalesce({0}, 0) + 1000",
    "bigint": "coalesce({0}, 0) + 1000",
    "double precision": "coalesce({0}, 0) + 1000",
}
TYPES = "SELECT column_name, data_type FROM information_schema.columns WHERE table_name = :table ORDER BY 1"


def unnamed_alterations(settings: Settings, database: Database) -> Iterator[str]:
    """Alter columns one after another, and yield those of which nothing is said."""
    chance = np.random.default_rng(5)
    with database.engine.connect() as hand:
        hand.execute(text("SET session_replication_role = replica"))  # without triggers and foreign keys
        for table in Row.metadata.sorted_tables:
            if table.name in APART | SEALS | {"audit"} or not hand.scalar(text(f"SELECT count(*) FROM {table.name}")):
                continue
            columns = hand.execute(text(TYPES), {"table": table.name}).all()
            for column, kind in (one for one in columns if (table.name, one[0]) not in OPEN and chance.random() < 0.3):
                hand.execute(text(f"CREATE TEMP TABLE kept AS SELECT * FROM {table.name} LIMIT 1"))
                place = hand.scalar(text(f"SELECT ctid FROM {table.name} LIMIT 1"))
                change = f"UPDATE {table.name} SET {column} = {ALTERED[kind].format(column)} WHERE ctid = '{place}'"
                now = hand.scalar(text(f"{change} RETURNING ctid").execution_options(no_parameters=True))
                hand.commit()
                found = service.verify_stored(settings).sentences
                if not any(f"Table {table.name}" in one or "is damaged" in one or "audit" in one for one in found):
                    yield f"{table.name}.{column}"
                hand.execute(text(f"DELETE FROM {table.name} WHERE ctid = '{now}'"))
                hand.execute(text(f"INSERT INTO {table.name} SELECT * FROM kept"))
                hand.execute(text("DROP TABLE kept"))
                hand.commit()


@contextmanager
def open_to(path: Path) -> Iterator[sqlite3.Connection]:
    """The file as somebody opens it who writes past Kilter, and leaves the triggers as they were."""
    with closing(sqlite3.connect(path, isolation_level=None)) as file:
        triggers = file.execute("SELECT name, sql FROM sqlite_master WHERE type = 'trigger'").fetchall()
        for name, _ in triggers:
            file.execute(f"DROP TRIGGER {name}")
        yield file
        for _, definition in triggers:
            file.execute(definition)


def altered(chance: np.random.Generator, value: Any) -> Any:
    """Change a value a little, as a hand or a disk does."""
    if value is None:
        return "x"
    if isinstance(value, int | float):
        return value + 1
    content = bytearray(value.encode() if isinstance(value, str) else value)
    if not content:
        return "x"
    content[int(chance.integers(len(content)))] ^= 1 << int(chance.integers(7))
    return content.decode() if isinstance(value, str) else bytes(content)


@pytest.mark.parametrize("seed", [28, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3, 4))])
@pytest.mark.parametrize("keyed", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_random_alterations_are_named(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int, keyed: bool
) -> None:
    """Any column of any table by hand, deleted rows, and a cut audit."""
    if keyed:
        (tmp_path / "key").write_text("a secret of more than thirty-two characters\n")
        (tmp_path / "key").chmod(0o600)
        monkeypatch.setenv("KILTER_SEAL_KEY", str(tmp_path / "key"))
        sealed = copied(whole, tmp_path, "sealed")
        assert service.seal(sealed, accept=True) == []
        with closing(sqlite3.connect(sealed.data / "kilter.sqlite")) as file:
            file.execute("PRAGMA journal_mode=DELETE")
        whole = sealed.data / "kilter.sqlite"
    chance = np.random.default_rng(seed)
    tables = [table for table in Row.metadata.sorted_tables if table.name not in APART]
    with closing(sqlite3.connect(whole)) as file:
        held = [table for table in tables if file.execute(f"SELECT count(*) FROM {table.name}").fetchone()[0]]
    assert len(held) > 12
    made = 0
    for number in range(40):
        other = copied(whole, tmp_path, f"altered {number}")
        table = held[int(chance.integers(len(held)))]
        with open_to(other.data / "kilter.sqlite") as file:
            file.execute("PRAGMA foreign_keys=OFF")
            rows = [row for (row,) in file.execute(f"SELECT rowid FROM {table.name}")]
            row = rows[-1] if table.name == "audit" else int(chance.choice(rows))
            if number % 5 == 0:
                what = f"{table.name}: row {row} deleted"
                file.execute(f"DELETE FROM {table.name} WHERE rowid = ?", (row,))
            else:
                names = [column.name for column in table.columns if (table.name, column.name) not in OPEN]
                column = str(chance.choice(names))
                what = f"{table.name}.{column} of row {row}"
                (value,) = file.execute(f"SELECT {column} FROM {table.name} WHERE rowid = ?", (row,)).fetchone()
                done = file.execute(
                    f"UPDATE OR IGNORE {table.name} SET {column} = ? WHERE rowid = ?", (altered(chance, value), row)
                )
                if not done.rowcount:  # another row has that key
                    continue
        made += 1
        found = service.verify_stored(other).sentences
        if table.name in SEALS:
            assert found, what
        elif number % 5 == 0:
            assert any(("is missing" in one and table.name in one) or "audit ends at" in one for one in found), (
                what,
                found,
            )
        else:
            assert any(
                f"Table {table.name}, row " in one or "audit" in one or "is damaged, its bytes" in one for one in found
            ), (what, found)
    assert made > 35


def test_an_altered_column_is_named_alone(filled: Settings) -> None:
    with open_to(filled.data / "kilter.sqlite") as file:
        file.execute("UPDATE versions SET covariance = '{\"names\": [\"x\"]}', code_version = '9' WHERE id LIKE '%1'")
    done = kilterd(filled, "verify")
    assert done.returncode == 1
    assert done.stdout == "Table versions, row ver_0000000000000001: covariance, code_version were altered.\n"
    looked = kilterd(filled, "doctor")
    assert "WRONG hashes: Table versions, row ver_0000000000000001: covariance" in looked.stdout


def test_a_row_that_was_altered_stays_so_when_kilter_changes_it(filled: Settings) -> None:
    with open_to(filled.data / "kilter.sqlite") as file:
        file.execute("UPDATE robots SET created_at = '2020-01-01 00:00:00.000000' WHERE name = 'katana'")
        file.execute("DELETE FROM activations WHERE id = 2")
    with served(create_app(filled)) as client:
        client.headers["Authorization"] = f"Bearer {admin_token(filled)}"
        client.patch("/v1/robots/katana", json={"remarks": "seen"}).raise_for_status()
        body = {"force": True, "reason": "test"}
        client.post("/v1/versions/ver_0000000000000002/activate", json=body).raise_for_status()
    found = service.verify_stored(filled).damaged
    assert "Table robots, row 1: created_at was altered." in found
    assert any(one.startswith("Table activations, row 2: ") for one in found), found  # its number was given again


def test_a_row_taken_out_with_its_seal_and_one_put_in_are_noticed(filled: Settings) -> None:
    path = filled.data / "kilter.sqlite"
    with open_to(path) as file:
        file.execute("DELETE FROM activations WHERE id = 2")
        file.execute("DELETE FROM seals WHERE thing = 'activations' AND id = '2'")
        file.execute(
            "INSERT INTO tombstones (kind, id, at, robot, name, sha256, by) VALUES ('version', 'x', '2026', '', '', '', '')"
        )
    found = service.verify_stored(filled).damaged
    assert "Table activations: 2 rows were stored, and 1 of them are sealed." in found
    assert "Table tombstones, row version/x/2026: it was put in past Kilter." in found


def test_bits_flipped_in_the_file_are_noticed_where_they_hold_something(filled: Settings) -> None:
    path = filled.data / "kilter.sqlite"
    with closing(sqlite3.connect(path)) as file:
        stored = list(file.iterdump())
    content, chance = path.read_bytes(), np.random.default_rng(4)
    noticed = 0
    for at in chance.integers(4096, len(content), size=12).tolist():
        flipped = bytearray(content)
        flipped[at] ^= 1 << int(chance.integers(8))
        path.write_bytes(flipped)
        for name in ("-wal", "-shm"):
            path.with_name(path.name + name).unlink(missing_ok=True)
        if service.verify_stored(filled).damaged:
            noticed += 1
            continue
        with closing(sqlite3.connect(path)) as file:
            assert list(file.iterdump()) == stored, at
    assert noticed > 2


def test_a_name_in_the_schema_that_is_not_text_any_more_is_a_finding(filled: Settings) -> None:
    path = filled.data / "kilter.sqlite"
    content = path.read_bytes()
    assert b"sqlite_autoindex_tombstones_1" in content
    path.write_bytes(content.replace(b"sqlite_autoindex_tombstones_1", b"sqlite_autoindex_t\xefmbstones_1"))
    for name in ("-wal", "-shm"):
        path.with_name(path.name + name).unlink(missing_ok=True)
    assert service.verify_stored(filled).damaged
    assert "Traceback" not in kilterd(filled, "verify").stderr


def test_the_key_may_be_a_credential_of_systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "credentials"
    folder.mkdir()
    key = folder / "seal-key"
    key.write_text("a secret of more than thirty-two characters\n")
    key.chmod(0o440)  # the entry of the unit's account in the access list
    monkeypatch.setenv("KILTER_SEAL_KEY", str(key))
    monkeypatch.delenv("CREDENTIALS_DIRECTORY", raising=False)
    with pytest.raises(ServiceError, match="can be read by others"):
        seals.sealer()
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(folder))
    assert seals.sealer().number
    key.chmod(0o444)
    with pytest.raises(ServiceError, match="can be read by others"):
        seals.sealer()


def test_a_statement_of_many_rows_is_refused(database: Database) -> None:
    with pytest.raises(RuntimeError, match="Change rows of robots as objects"), database.transaction() as session:
        session.execute(update(RobotRow).values(remarks="x"))


def test_a_key_keeps_others_from_sealing(filled: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = filled.data / "kilter.sqlite"
    key = tmp_path / "key"
    key.write_text("a secret of more than thirty-two characters\n")
    key.chmod(0o600)
    without = filled
    keyed = filled.model_copy(update={"seal_key": key})
    refused = kilterd(keyed, "verify")
    assert "not sealed with the key that KILTER_SEAL_KEY names" in refused.stderr + refused.stdout
    assert kilterd(keyed, "seal").returncode == 1
    assert kilterd(keyed, "seal", "--accept").returncode == 0
    assert kilterd(keyed, "verify").stdout.startswith("All is whole")
    assert kilterd(keyed, "audit").returncode == 0
    told = kilterd(without, "verify")
    assert "this process runs without one: set KILTER_SEAL_KEY" in told.stderr + told.stdout
    backup = tmp_path / "keyed.backup"
    assert kilterd(keyed, "backup", str(backup)).returncode == 0
    new = plain(tmp_path, "new")
    assert kilterd(new, "restore", str(backup)).returncode == 2
    assert kilterd(new, "restore", "--accept", str(backup)).returncode == 0  # the key may be lost with the machine
    assert kilterd(new, "seal").returncode == 1
    assert kilterd(new, "seal", "--accept").returncode == 0
    assert kilterd(new, "verify").stdout.startswith("All is whole")

    with open_to(path) as file:  # somebody who knows how seals are made, but not the key
        file.execute("UPDATE tokens SET role = 'admin'")
    monkeypatch.delenv("KILTER_SEAL_KEY", raising=False)
    forger = Database(f"sqlite:///{path}")
    with pytest.raises(ServiceError, match="this process runs without one"), forger.transaction() as session:
        session.get_one(RobotRow, 1).remarks = "x"
    forger.close()
    found = kilterd(keyed, "verify").stdout
    assert "Table tokens, row " in found
    assert "role was altered" in found
    key.chmod(0o644)
    assert "can be read by others: run `chmod 600" in kilterd(keyed, "verify").stderr


def test_what_was_changed_by_hand_is_accepted_with_an_entry(filled: Settings) -> None:
    with open_to(filled.data / "kilter.sqlite") as file:
        file.execute("UPDATE robots SET remarks = 'by hand'")
    refused = kilterd(filled, "seal")
    assert refused.returncode == 1
    assert "remarks was altered" in refused.stdout
    assert kilterd(filled, "seal", "--accept").returncode == 0
    assert kilterd(filled, "verify").stdout.startswith("All is whole")
    with closing(sqlite3.connect(filled.data / "kilter.sqlite")) as file:
        (content,) = file.execute("SELECT content FROM audit ORDER BY number DESC LIMIT 1").fetchone()
    (change,) = json.loads(content)["changes"]
    assert (change["thing"], "2 findings accepted" in change["after"]) == ("seals", True)


def test_progress_of_a_job_needs_no_seal(filled: Settings) -> None:
    database = Database(filled.database)
    with database.noting() as session:
        session.execute(update(JobRow).values(fraction=0.5, stage="half"))
    database.close()
    assert service.verify_stored(filled).damaged == []
