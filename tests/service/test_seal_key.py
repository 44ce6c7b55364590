"""With a key nobody who writes the files and lacks the key goes unseen: tables put back, totals by arithmetic, seals anew."""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from kilter_service.ground.caller import on_behalf
from kilter_service.ground.db import Database, revision
from kilter_service.ground.db.initial_seals import anew
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.seals import MODULUS, Sealer
from kilter_service.ground.db.tables import RobotRow, TokenRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from kilter_service.run.backup import service
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import Katana, ready, served
from tests.service.made_versions import store_version
from tests.service.test_backup import kilterd, plain

_WHERE = " WHERE thing = 'tokens'"
SECRET = "a secret of more than thirty-two characters\n"
ANY_TABLE = "a table was put back to an earlier state, or a total was altered"
REVOKED = "Table tokens, row tok_1: revoked_at, revoked_by are not what the audit says."


@pytest.fixture
def keyed(tmp_path: Path, migrated: Path, monkeypatch: pytest.MonkeyPatch) -> Settings:
    """A database that was sealed with a key when it was new, with an admin token in use and a robot."""
    key = tmp_path / "key"
    key.write_text(SECRET)
    key.chmod(0o600)
    monkeypatch.setenv("KILTER_SEAL_KEY", str(key))
    settings = plain(tmp_path, "data").model_copy(update={"seal_key": key})
    settings.data.mkdir()
    with changing(settings) as session:
        session.add(TokenRow(id="tok_1", name="anna", sha256="1" * 64, role="admin", created_by="admin"))
        session.add(RobotRow(id=1, name="arm", document={}))
    return settings


@contextmanager
def changing(settings: Settings) -> Iterator[Any]:
    """A transaction as a request of an administrator makes it."""
    database = Database(settings.database)
    try:
        revision.migrate(database)
        with on_behalf({"actor": "admin", "role": "admin"}, "a request", {}), database.transaction() as session:
            yield session
    finally:
        database.close()


def revoke(settings: Settings) -> None:
    with changing(settings) as session:
        token = session.get_one(TokenRow, "tok_1")
        token.revoked_at, token.revoked_by = utc_now(), "admin"


def remember(settings: Settings) -> dict[str, list[tuple[Any, ...]]]:
    """What somebody copies who reads the file: a table, its seals, and the seal over all tables."""
    with closing(sqlite3.connect(settings.data / "kilter.sqlite")) as file:
        return {
            "tokens": file.execute("SELECT * FROM tokens").fetchall(),
            "seals": file.execute("SELECT * FROM seals WHERE thing = 'tokens'").fetchall(),
            "database_seal": file.execute("SELECT * FROM database_seal").fetchall(),
        }


def put_back(settings: Settings, copied: dict[str, list[tuple[Any, ...]]], *tables: str) -> None:
    with closing(sqlite3.connect(settings.data / "kilter.sqlite", isolation_level=None)) as file:
        for table in tables:
            file.execute(f"DELETE FROM {table}{_WHERE if table == 'seals' else ''}")
            for row in copied[table]:
                file.execute(f"INSERT INTO {table} VALUES ({', '.join('?' * len(row))})", row)


def damage(settings: Settings) -> list[str]:
    return service.verify_stored(settings).sentences


@pytest.mark.parametrize("tables", [("tokens", "seals"), ("tokens", "seals", "database_seal")])
def test_a_revoked_token_that_is_put_back_with_its_seals_is_named(keyed: Settings, tables: tuple[str, ...]) -> None:
    before = remember(keyed)
    revoke(keyed)
    assert damage(keyed) == []
    put_back(keyed, before, *tables)
    found = damage(keyed)
    assert REVOKED in found
    assert len(found) > 1  # the seals say so, too


def test_a_revoked_token_that_is_put_back_is_named_without_a_key(
    keyed: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever computes all seals anew still has the audit against him, which has a chain of its own."""
    monkeypatch.delenv("KILTER_SEAL_KEY")
    plain_settings = plain(tmp_path, "plain")
    plain_settings.data.mkdir()
    with changing(plain_settings) as session:
        session.add(TokenRow(id="tok_1", name="anna", sha256="1" * 64, role="admin", created_by="admin"))
    before = remember(plain_settings)
    revoke(plain_settings)
    put_back(plain_settings, before, "tokens", "seals")
    forge(plain_settings)
    assert damage(plain_settings) == [REVOKED]
    put_back(plain_settings, {"tokens": []}, "tokens")
    forge(plain_settings)
    assert damage(plain_settings) == ["Table tokens, row tok_1 is missing, and the audit says it was stored."]


@pytest.mark.parametrize("table", ["tokens", "activations", "repairs"])
def test_a_row_that_is_dated_before_the_audit_is_named_without_a_key(
    tmp_path: Path, migrated: Path, table: str
) -> None:
    settings = plain(tmp_path, "data")
    ready(settings, migrated)
    database = Database(settings.database)
    with served(create_app(settings)) as client:
        client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
        client.post("/v1/robots", json=Katana.document).raise_for_status()
        version = store_version(database, "katana", 1)
        client.post(f"/v1/versions/{version}/activate", json={"force": True, "reason": "test"}).raise_for_status()
    database.close()
    put_in = {
        "tokens": "VALUES ('2', 'eve', '2', 'admin', NULL, '2020-01-01 00:00:00.000000', 'admin', NULL, NULL, '')",
        "activations": "SELECT 2, 1, version_id, action, actor, '2020-01-01 00:00:00.000000', 0, '', '[]' FROM activations",
        "repairs": "VALUES ('2', 1, '2026-01-01 00:00:00.000000', 'new', 'eve', '2020-01-01 00:00:00.000000', 'repair', "
        "NULL, '')",
    }
    with closing(sqlite3.connect(settings.data / "kilter.sqlite", isolation_level=None)) as file:
        file.execute(f"INSERT INTO {table} {put_in[table]}")
    forge(settings)
    assert damage(settings) == [f"Table {table}, row 2: it was put in past Kilter, the audit has no entry of it."]


def test_an_activation_dated_before_the_audit_is_named_where_the_audit_has_none(tmp_path: Path, migrated: Path) -> None:
    settings = plain(tmp_path, "data")
    ready(settings, migrated)
    database = Database(settings.database)
    with served(create_app(settings)) as client:
        client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
        client.post("/v1/robots", json=Katana.document).raise_for_status()
        with on_behalf({"actor": "admin", "role": "admin"}, "a job", {}):
            version = store_version(database, "katana", 1)
    database.close()
    at = "2020-01-01 00:00:00.000000"
    with closing(sqlite3.connect(settings.data / "kilter.sqlite", isolation_level=None)) as file:
        file.execute(f"INSERT INTO activations VALUES (1, 1, '{version}', 'activate', 'eve', '{at}', 0, '', '[]')")
    forge(settings)
    assert damage(settings) == ["Table activations, row 1: it was put in past Kilter, the audit has no entry of it."]


def forge(settings: Settings) -> None:
    """Seal everything anew without a key, as anybody who reads the source does."""
    database = Database(settings.database)
    with database.engine.begin() as connection:
        anew(connection, Sealer())
    database.close()


def test_no_write_signs_a_total_that_was_corrected_by_arithmetic(keyed: Settings) -> None:
    before = remember(keyed)
    totals_before = json.loads(before["database_seal"][0][1])
    revoke(keyed)
    with closing(sqlite3.connect(keyed.data / "kilter.sqlite")) as file:
        totals = json.loads(file.execute("SELECT totals FROM database_seal").fetchone()[0])
    put_back(keyed, before, "tokens", "seals")
    difference = int(totals["tokens"][1], 16) - int(totals_before["tokens"][1], 16)
    totals["tokens"][1] = f"{(int(totals['tokens'][1], 16) - difference) % MODULUS:064x}"
    with closing(sqlite3.connect(keyed.data / "kilter.sqlite", isolation_level=None)) as file:
        file.execute("UPDATE database_seal SET totals = ?", (json.dumps(totals, sort_keys=True),))
    for remarks in ("one", "two"):
        with changing(keyed) as session:
            session.get_one(RobotRow, 1).remarks = remarks
        found = damage(keyed)
        assert any(ANY_TABLE in one for one in found), found
        assert REVOKED in found


def test_what_was_sealed_anew_without_the_key_is_accepted_by_nobody_unasked(keyed: Settings) -> None:
    with closing(sqlite3.connect(keyed.data / "kilter.sqlite", isolation_level=None)) as file:
        file.execute("UPDATE robots SET remarks = 'by hand'")
    forge(keyed)
    (said,) = damage(keyed)
    assert "not sealed with the key that KILTER_SEAL_KEY names" in said
    with pytest.raises(ServiceError, match="not sealed with the key"), changing(keyed) as session:
        session.get_one(RobotRow, 1).remarks = "more"
    assert service.seal(keyed, accept=False) == [said]
    assert service.seal(keyed, accept=True) == []
    assert damage(keyed) == []


@pytest.mark.parametrize("statement", ["DELETE FROM database_seal", "UPDATE database_seal SET id = 2"])
def test_a_seal_that_is_taken_out_is_none(keyed: Settings, statement: str) -> None:
    with closing(sqlite3.connect(keyed.data / "kilter.sqlite", isolation_level=None)) as file:
        file.execute(statement)
    assert any("not sealed with the key" in one for one in damage(keyed))
    assert service.seal(keyed, accept=False) != []


def test_rows_beside_the_seals_are_named(keyed: Settings) -> None:
    with closing(sqlite3.connect(keyed.data / "kilter.sqlite", isolation_level=None)) as file:
        file.execute("INSERT INTO database_seal SELECT 2, totals, keyed_by, seal FROM database_seal")
        file.execute("INSERT INTO seals VALUES ('nothing', '1', '')")
    assert damage(keyed) == [
        "Table seals, rows of nothing: they were put in past Kilter, there is no such table.",
        "Table database_seal, row 2: it was put in past Kilter.",
    ]


@pytest.mark.parametrize("number", ["", "0" * 8])
def test_a_backup_that_names_another_key_is_not_whole(keyed: Settings, number: str, tmp_path: Path) -> None:
    path, _ = service.backup(keyed, tmp_path / "one.backup")
    path.with_name("one.backup.sha256").unlink()
    with closing(sqlite3.connect(path, isolation_level=None)) as file:
        file.execute("UPDATE database_seal SET keyed_by = ?", (number,))
        file.execute("DROP TABLE kilter_manifest")
    said = kilterd(keyed, "verify", str(path))
    assert said.returncode == 1
    assert "whole:" not in said.stdout
    new = plain(tmp_path, "new").model_copy(update={"seal_key": keyed.seal_key})
    refused = kilterd(new, "restore", str(path))
    assert refused.returncode == 2
    assert "its seals cannot be compared" in refused.stderr
    assert not (new.data / "kilter.sqlite").exists()
    assert kilterd(new, "restore", "--accept", str(path)).returncode == 0
    assert kilterd(new, "seal").returncode == 1


def test_data_without_seals_are_taken_by_no_process_with_a_key(
    keyed: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from alembic import command

    monkeypatch.delenv("KILTER_SEAL_KEY")
    forge(keyed)  # what comes without a key, with its seals taken out by the way back
    path = keyed.data / "kilter.sqlite"
    shutil.copy(path, tmp_path / "old.sqlite")
    command.downgrade(revision.configuration(f"sqlite:///{tmp_path / 'old.sqlite'}"), "0014")
    old = plain(tmp_path, "old")
    old.data.mkdir()
    shutil.move(tmp_path / "old.sqlite", old.data / "kilter.sqlite")
    found = service.verify(old.data / "kilter.sqlite")
    assert (found.damaged, found.headline().startswith("All is whole")) == ([], False)
    monkeypatch.setenv("KILTER_SEAL_KEY", str(keyed.seal_key))
    database = Database(old.database)
    with pytest.raises(ServiceError, match="The data have no seals, and KILTER_SEAL_KEY names a key"):
        revision.migrate(database)
    database.close()


def test_old_seals_are_compared_once_and_the_way_back_writes_them_again(keyed: Settings) -> None:
    from alembic import command

    configuration = revision.configuration(keyed.database)
    path = keyed.data / "kilter.sqlite"

    def old() -> list[str]:
        with closing(sqlite3.connect(path)) as file:
            return list(file.iterdump())

    command.downgrade(configuration, "0021")
    first = old()
    assert any(line.startswith('INSERT INTO "sealed_tables"') for line in first)
    command.upgrade(configuration, "head")
    assert damage(keyed) == []
    command.downgrade(configuration, "0021")
    assert old() == first
    with closing(sqlite3.connect(path, isolation_level=None)) as file:
        file.execute("UPDATE sealed_tables SET rows = rows + 1 WHERE thing = 'meshes'")
    command.upgrade(configuration, "head")
    assert any(ANY_TABLE in one for one in damage(keyed))
