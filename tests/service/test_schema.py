"""`kilterd verify` compares tables, indexes and triggers with those of the revision."""

from __future__ import annotations

import json
import os

import pytest
from sqlalchemy import text

from kilter_service.ground.db import Database
from kilter_service.ground.db.schema_check import FILE, definitions, schema_altered
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


def test_verify_compares_the_schema(database: Database, settings: Settings) -> None:
    with database.engine.begin() as connection:
        connection.execute(text("DROP TRIGGER audit_update"))
    assert service.verify_stored(settings).damaged == ["The trigger audit_update is missing from the database."]
