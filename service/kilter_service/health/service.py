"""What the server can say about its own state."""

from __future__ import annotations

from kilter_service.contract.health import Check, Health
from kilter_service.db import Database, revision
from kilter_service.health import store
from kilter_service.version import code_version

SILENT_AFTER_S = 10.0


def report(database: Database) -> Health:
    """Check the database's revision and whether a worker is alive."""
    checks = {"database": _database(database)}
    if checks["database"].ok:
        checks["worker"] = _worker(database)
    ready = all(check.ok for check in checks.values())
    return Health(status="ready" if ready else "not_ready", version=code_version(), checks=checks)


def _database(database: Database) -> Check:
    found = revision.current(database)
    if found == revision.HEAD:
        return Check(ok=True, detail=f"revision {found}")
    return Check(ok=False, detail=f"revision {found or 'none'}, needed {revision.HEAD}: run `kilterd migrate`")


def _worker(database: Database) -> Check:
    with database.reading() as session:
        alive = store.alive(session, "worker", SILENT_AFTER_S)
    if alive:
        return Check(ok=True, detail=f"{alive} alive")
    return Check(ok=False, detail=f"no worker spoke in the last {SILENT_AFTER_S:.0f} s: start `kilterd worker`")
