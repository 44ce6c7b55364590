from __future__ import annotations

from pathlib import Path

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import inspect, text

from kilter_service.ground.db import Database, revision
from kilter_service.ground.db.row import Row
from kilter_service.versions import store


def test_the_head_written_down_is_the_one_alembic_finds(database: Database) -> None:
    scripts = ScriptDirectory.from_config(revision.configuration(database.url))
    assert scripts.get_heads() == [revision.HEAD]


def test_the_migrations_make_exactly_the_tables_of_the_code(database: Database) -> None:
    with database.engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Row.metadata) == []


def test_migrating_twice_changes_nothing(database: Database) -> None:
    assert revision.current(database) == revision.HEAD
    assert revision.migrate(database) is False


def test_a_downgrade_leaves_no_table(database: Database) -> None:
    command.downgrade(revision.configuration(database.url), "base")
    with database.engine.connect() as connection:
        left = inspect(connection).get_table_names()
    assert left == ["alembic_version"]


def test_sqlite_runs_in_wal_with_foreign_keys(database: Database) -> None:
    if not database.url.startswith("sqlite"):
        pytest.skip("the database is PostgreSQL")
    with database.engine.connect() as connection:
        assert connection.execute(text("PRAGMA journal_mode")).scalar_one() == "wal"
        assert connection.execute(text("PRAGMA foreign_keys")).scalar_one() == 1
        assert connection.execute(text("PRAGMA synchronous")).scalar_one() == 2  # FULL


def test_file_names_of_migrations_carry_their_date() -> None:
    names = [path.name for path in (revision.migrations() / "versions").glob("*.py")]
    assert names
    assert all(Path(name).stem[:15].replace("-", "").isdigit() for name in names)


def test_versions_of_before_the_numbers_are_counted_as_they_were_made(database: Database) -> None:
    command.downgrade(revision.configuration(database.url), "0022")
    made = {"a": (1, "ver_7", "2026-01-02"), "b": (1, "ver_3", "2026-01-01"), "c": (2, "ver_1", "2026-01-01")}
    with database.engine.begin() as connection:
        for robot in (1, 2):
            connection.execute(
                text("INSERT INTO robots (id, name, document, created_at) VALUES (:id, :name, '{}', '2026-01-01')"),
                {"id": robot, "name": f"arm {robot}"},
            )
        for job, (robot, version, at) in made.items():
            values = {"job": job, "robot": robot, "version": version, "at": at}
            connection.execute(
                text(
                    "INSERT INTO jobs (id, kind, robot_id, request, state, fraction, stage, attempts, cancel_requested, "
                    "created_at) VALUES (:job, 'identify', :robot, '{}', 'succeeded', 1, 'done', 1, false, :at)"
                ),
                values,
            )
            connection.execute(
                text(
                    "INSERT INTO versions (id, robot_id, job_id, sha256, calibration, report, covariance, campaigns, "
                    "limits, code_version, created_at) "
                    "VALUES (:version, :robot, :job, '', '{}', '{}', '{}', '[]', '{}', '0', :at)"
                ),
                values,
            )
    revision.migrate(database)
    with database.engine.connect() as connection:
        numbers = dict(connection.execute(text("SELECT id, number FROM versions")).all())
        counts = dict(connection.execute(text("SELECT id, versions_made FROM robots")).all())
    assert numbers == {"ver_3": 1, "ver_7": 2, "ver_1": 1}
    assert counts == {1: 2, 2: 1}


def test_activations_of_before_the_guard_were_not_forced(database: Database) -> None:
    command.downgrade(revision.configuration(database.url), "0002")
    with database.engine.begin() as connection:
        connection.execute(text("INSERT INTO robots VALUES (1, 'arm', '{}', '2026-01-01')"))
        connection.execute(
            text(
                "INSERT INTO jobs (id, kind, robot_id, request, state, fraction, stage, attempts, cancel_requested, "
                "created_at) VALUES ('job_1', 'identify', 1, '{}', 'succeeded', 1, 'done', 1, false, '2026-01-01')"
            )
        )
        connection.execute(
            text(
                "INSERT INTO versions (id, robot_id, job_id, sha256, calibration, report, covariance, campaigns, limits, "
                "code_version, created_at) VALUES ('ver_1', 1, 'job_1', '', '{}', '{}', '{}', '[]', '{}', '0', '2026-01-01')"
            )
        )
        connection.execute(
            text(
                "INSERT INTO activations (robot_id, version_id, action, actor, at) "
                "VALUES (1, 'ver_1', 'activate', 'admin', '2026-01-01')"
            )
        )
    revision.migrate(database)
    with database.reading() as session:
        (entry,) = store.activations(session, 1)
    assert (entry.version_id, entry.forced, entry.reason, entry.objections) == ("ver_1", False, "", [])
