"""`kilterd verify` compares tables, indexes and triggers with those of the revision."""

from __future__ import annotations

import json
import os
import sqlite3
from contextlib import closing

import pytest
from sqlalchemy import text

from kilter_service.ground.db import Database, revision
from kilter_service.ground.db.revision import FILE, definitions, schema_altered
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.run.backup import service

ALTERED = {
    "sqlite": [
        ("DROP TRIGGER audit_update", "The trigger audit_update is missing"),
        (
            "CREATE TRIGGER again AFTER INSERT ON tokens BEGIN UPDATE tokens SET revoked_at = NULL; END",
            "The trigger again was put into",
        ),
        ("DROP INDEX ix_tokens_name", "The index ix_tokens_name is missing"),
        ("ALTER TABLE tokens ADD COLUMN more TEXT", "The table tokens is not defined as Kilter does it: more TEXT"),
        ("CREATE TABLE more (id INTEGER)", "The table more was put into"),
        ("CREATE VIEW more AS SELECT * FROM tokens", "The view more was put into"),
        ("CREATE UNIQUE INDEX only ON activations (version_id)", "The index only was put into"),
        (
            "ALTER TABLE tokens RENAME COLUMN role TO rule",
            "The table tokens is not defined as Kilter does it: role VARCHAR(16) NOT NULL; rule VARCHAR(16) NOT NULL",
        ),
        (
            "CREATE TRIGGER alembic_version AFTER UPDATE ON alembic_version BEGIN DELETE FROM tokens; END",
            "The trigger alembic_version was put into",
        ),
        ("ALTER TABLE alembic_version ADD COLUMN more TEXT", "The table alembic_version is not defined as"),
    ],
    "postgresql": [
        ("DROP TRIGGER audit_row ON audit", "The trigger audit_row is missing"),
        ("ALTER TABLE audit DISABLE TRIGGER audit_row", "The trigger audit_row is not defined as Kilter does it"),
        (
            "CREATE OR REPLACE FUNCTION audit_fixed() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN RETURN OLD; END $$",
            "The trigger audit_row is not defined as Kilter does it",
        ),
        ("CREATE RULE kept AS ON UPDATE TO tokens DO INSTEAD NOTHING", "The rule kept was put into"),
        ("DROP INDEX ix_tokens_name", "The index ix_tokens_name is missing"),
        ("ALTER TABLE tokens ALTER COLUMN role DROP NOT NULL", "The table tokens is not defined as Kilter does it"),
        (
            "ALTER TABLE ended_jobs SET UNLOGGED",
            "The table ended_jobs is not defined as Kilter does it: not in the log",
        ),
        (
            "ALTER TABLE tokens FORCE ROW LEVEL SECURITY",
            "The table tokens is not defined as Kilter does it: rows hidden",
        ),
        (
            "ALTER TABLE seals DISABLE TRIGGER ALL; ALTER TABLE jobs DISABLE TRIGGER ALL",
            "The table jobs is not defined as",
        ),
        (
            "ALTER FUNCTION audit_continued() SET search_path = other, public",
            "The trigger audit_insert is not defined as Kilter does it",
        ),
        (
            "UPDATE pg_index SET indisvalid = false WHERE indexrelid = 'tokens_sha256_key'::regclass",
            "The index tokens_sha256_key",
        ),
        ('ALTER TABLE tokens ALTER COLUMN name TYPE varchar(64) COLLATE "C"', "The table tokens is not defined as"),
    ],
}


@pytest.mark.both_databases
def test_the_listed_schema_is_that_of_the_migrations(database: Database, backend: str) -> None:
    with database.engine.connect() as connection:
        found = definitions(connection)
    if os.environ.get("KILTER_WRITE_SNAPSHOTS"):
        listed = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
        FILE.write_text(json.dumps({**listed, backend: found}, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    assert found == json.loads(FILE.read_text(encoding="utf-8"))[backend]


@pytest.mark.both_databases
def test_what_is_altered_in_the_schema_is_named(database: Database, backend: str) -> None:
    for statement, said in ALTERED[backend]:
        with database.engine.connect() as connection:
            connection.execute(text(statement))
            found = list(schema_altered(connection))
            connection.rollback()
        assert any(sentence.startswith(said) for sentence in found), (statement, found)


def test_a_name_like_those_of_sqlite_hides_nothing(database: Database, settings: Settings) -> None:
    """The schema can be written as a table, and then takes names that SQLite refuses."""
    trigger = "CREATE TRIGGER sqlite_more AFTER INSERT ON tokens BEGIN DELETE FROM logins; END"
    with closing(sqlite3.connect(settings.data / "kilter.sqlite", isolation_level=None)) as file:
        file.execute("PRAGMA writable_schema=ON")
        file.execute("INSERT INTO sqlite_master VALUES ('trigger', 'sqlite_more', 'tokens', 0, ?)", (trigger,))
    assert service.verify_stored(settings).damaged == ["The trigger sqlite_more was put into the database past Kilter."]


@pytest.mark.parametrize("named", ["0022", "0014"])
def test_tables_that_are_not_of_the_revision_are_a_finding(database: Database, settings: Settings, named: str) -> None:
    with database.engine.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = :named"), {"named": named})
    (found,) = service.verify_stored(settings).damaged
    assert found.startswith(f"The database names revision {named}, and its tables are of another one (")
    with pytest.raises(ServiceError, match="Nothing was changed"):
        revision.migrate(database)


def test_two_revisions_are_a_finding(database: Database, settings: Settings) -> None:
    with database.engine.begin() as connection:
        connection.execute(text("INSERT INTO alembic_version VALUES ('0001')"))
    (found,) = service.verify_stored(settings).damaged
    assert found.startswith("The database names 2 revisions (")


def test_verify_compares_the_schema(database: Database, settings: Settings) -> None:
    with database.engine.begin() as connection:
        connection.execute(text("DROP TRIGGER audit_update"))
    assert service.verify_stored(settings).damaged == ["The trigger audit_update is missing from the database."]
