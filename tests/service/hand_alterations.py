"""87 alterations of stored data past Kilter, rows, totals, seals and schema, without and with a key: what `verify` names.

They share no code with the seals: what is altered is written as SQL, and data come from a running server.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import httpx

from benchmarks.api_memory import calibrate
from benchmarks.load import server
from kilter_service.ground.settings import Settings
from kilter_service.run.backup import service

LATER = "'2027-01-01 00:00:00.000000'"
ROWS = {  # table: what is set
    "robots": ["name='other'", "document='{}'", "chain='{}'", "sha256='0'", "controller_compensation='factory'",
               "tolerance_mm=9", "versions_made=7", "remarks='x'", f"retired_at={LATER}"],
    "versions": ["calibration='{}'", "covariance='{}'", "report='{}'", "limits='{}'", "sha256='0'", "number=9",
                 "name='best'", "campaigns='[]'", f"created_at={LATER}", "hash_scheme=1", "code_version='9'"],
    "campaigns": ["device='x'", "role='confirmation'", "conditions='{\"x\": 1}'", "notes='x'", f"measured_at={LATER}"],
    "uploads": ["sha256='0'", "rows=1", "columns='[]'"],
    "chunks": ["parquet=x'00'", "rows=1"],
    "activations": ["actor='somebody'", "forced=0", "reason='because'"],
    "tokens": ["role='viewer'", "revoked_at=NULL", f"expires_at={LATER}", "sha256='0'"],
    "jobs": ["state='failed'", "result='{}'", "request='{}'"],
    "replays": ["answers='[]'", "rules='x'"],
    "repairs": ["what='nothing'"],
    "tombstones": ["sha256='0'"],
    "audit": ["content='{}'"],
}  # fmt: skip
WHOLE = [  # rows, totals and seals
    "DELETE FROM versions", "DELETE FROM activations", "DELETE FROM audit WHERE number=(SELECT max(number) FROM audit)",
    "DELETE FROM audit WHERE number=3", "DELETE FROM tombstones", "DELETE FROM chunks WHERE rowid=1",
    "DELETE FROM seals WHERE thing='versions'", "DELETE FROM seals", "DELETE FROM database_seal",
    "UPDATE seals SET digests='{}' WHERE thing='robots'", "UPDATE database_seal SET totals='{}'",
    "UPDATE database_seal SET seal='0'",
    "UPDATE database_seal SET keyed_by='abcd'", "UPDATE seals SET id='9' WHERE thing='activations'",
    "INSERT INTO tombstones (id,kind,robot,name,sha256,by,at) VALUES ('z','version','','','','','2026-01-01')",
    "DELETE FROM tokens; DELETE FROM seals WHERE thing='tokens'", "UPDATE activations SET at=datetime(at,'-1 day')",
    "UPDATE alembic_version SET version_num='0014'",
]  # fmt: skip
SCHEMA = [
    "CREATE TRIGGER t AFTER INSERT ON activations BEGIN UPDATE tokens SET revoked_at=NULL; END",
    "CREATE TRIGGER t BEFORE DELETE ON tokens BEGIN SELECT RAISE(IGNORE); END",
    "DROP TRIGGER audit_update", "DROP TRIGGER audit_delete", "DROP TRIGGER audit_insert",
    "CREATE TABLE notes (x)", "CREATE TABLE sqlitex (x)", "CREATE VIEW v AS SELECT * FROM tokens", "DROP TABLE creeping",
    "ALTER TABLE tokens ADD COLUMN x", "ALTER TABLE robots DROP COLUMN remarks",
    "ALTER TABLE jobs RENAME COLUMN name TO called",
    "CREATE INDEX i ON robots (name)", "DROP INDEX ix_jobs_state", "CREATE UNIQUE INDEX i ON activations (robot_id)",
    "PRAGMA writable_schema=ON; UPDATE sqlite_master SET sql=replace(sql,'NOT NULL','') WHERE name='tokens'",
    "PRAGMA writable_schema=ON; UPDATE sqlite_master SET sql=replace(sql,'VARCHAR','TEXT') WHERE name='robots'",
    "CREATE TEMP TABLE x (y)", "PRAGMA user_version=7", "PRAGMA application_id=7", "ANALYZE", "VACUUM",
    "UPDATE jobs SET fraction=0.5, stage='x'", "UPDATE ended_jobs SET jobs=99",
]  # fmt: skip
# Of these nothing is to be said: docs/explanation/durability.md lists them, or they change nothing that is stored.
OPEN = {"CREATE TEMP TABLE x (y)", "PRAGMA user_version=7", "PRAGMA application_id=7", "ANALYZE", "VACUUM",
        "UPDATE jobs SET fraction=0.5, stage='x'", "UPDATE ended_jobs SET jobs=99"}  # fmt: skip


def alterations() -> Iterator[str]:
    """All of them, as SQL."""
    for table, values in ROWS.items():
        place = "SELECT max(rowid)" if table == "audit" else "SELECT min(rowid)"
        yield from (f"UPDATE {table} SET {value} WHERE rowid=({place} FROM {table})" for value in values)
    yield from WHOLE
    yield from SCHEMA


def fill(data: Path) -> None:
    """Have a server store what it stores in use: an arm, a version, an activation, a repair, an ended token, a purge."""
    with server(data, None) as (url, _):
        bearer = {"Authorization": f"Bearer {(data / 'token').read_text().strip()}"}
        with httpx.Client(base_url=url, headers=bearer, timeout=120) as client:
            calibrate(client)
            repair = {"what": "belt", "at": "2026-11-30T10:00:00Z", "kind": "repair"}
            client.post("/v1/robots/arm/repairs", json=repair).raise_for_status()
            token = client.post("/v1/tokens", json={"name": "t", "role": "operator", "days": 3}).json()["id"]
            client.delete(f"/v1/tokens/{token}").raise_for_status()
            gone = client.post("/v1/robots/arm/campaigns", json={"name": "gone"}).json()["id"]
            client.post(f"/v1/campaigns/{gone}/retire").raise_for_status()
            client.post(f"/v1/campaigns/{gone}/purge").raise_for_status()


def alter(path: Path, statement: str) -> bool:
    """Alter a database past Kilter, its triggers put back as they were; whether its content is another then."""
    with closing(sqlite3.connect(path, isolation_level=None)) as file:
        before = sorted(file.iterdump())
        guards = file.execute("SELECT name, sql FROM sqlite_master WHERE type = 'trigger'").fetchall()
        file.execute("PRAGMA foreign_keys=OFF")
        for name, _ in guards if "TRIGGER" not in statement else ():
            file.execute(f"DROP TRIGGER {name}")
        file.executescript(statement)
        for _, definition in guards if "TRIGGER" not in statement else ():
            file.execute(definition)
        file.execute("PRAGMA writable_schema=RESET")
        return sorted(file.iterdump()) != before


def score(data: Path) -> tuple[int, list[str]]:
    """Return how many alterations are named, and the others that change something and are not listed as open."""
    named, unseen = 0, []
    for statement in alterations():
        with tempfile.TemporaryDirectory() as folder:
            other = Path(shutil.copytree(data, Path(folder) / "data"))
            changed = alter(other / "kilter.sqlite", statement)
            found = service.verify_stored(Settings(data=other)).sentences
        named += bool(found)
        if bool(found) == (statement in OPEN) or not (found or changed or statement in OPEN):
            unseen.append(f"{statement}: {found[:1] or ('unseen' if changed else 'changes nothing')}")
    return named, unseen


def main() -> int:
    """Score without a key and with one, and print the table."""
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        data.mkdir(mode=0o700)
        fill(data)
        for keyed in (False, True):
            if keyed:
                key = Path(folder) / "key"
                key.write_text("a secret of more than thirty-two characters\n")
                key.chmod(0o600)
                os.environ["KILTER_SEAL_KEY"] = str(key)
                service.seal(Settings(data=data), accept=True)
            assert service.verify_stored(Settings(data=data)).sentences == []
            named, unseen = score(data)
            count = len(list(alterations()))
            print(f"{'with' if keyed else 'without'} a key: {named} of {count} named, {len(OPEN)} open by the list")
            print("\n".join(unseen))
            wrong += len(unseen)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
