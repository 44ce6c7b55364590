"""What an update of Kilter does to a database: says it before, keeps a copy of what there was, and migrates."""

from __future__ import annotations

import hashlib
import logging
import re
import shutil
import sqlite3
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from kilter_service.ground.db import Database, revision
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.files.private_files import private_file
from kilter_service.ground.settings import Settings

log = logging.getLogger("kilter.serve")

SUFFIX = ".kilter-backup"
MARGIN_BYTES = 64 << 20  # of the migration itself, beside the copy
STEP = re.compile(r'^"""(.+?)(?:"""|\n)', re.DOTALL)
BEFORE = re.compile(r'^down_revision = "(\w+)"', re.MULTILINE)


class Step(NamedTuple):
    """A revision of the database, and what it adds, in its own words."""

    revision: str
    adds: str


class Plan(NamedTuple):
    """What an update would do; ``found`` is None for a database without tables. ``copy`` is None where none is made."""

    found: str | None
    steps: list[Step]
    copy: Path | None
    copy_bytes: int
    free_bytes: int

    @property
    def fits(self) -> bool:
        """Whether the disk has room for the copy and the migration."""
        return self.copy is None or self.copy_bytes + MARGIN_BYTES <= self.free_bytes


def planned(settings: Settings) -> Plan:
    """Look at what an update would do; nothing is changed.

    Raises:
        ServiceError: the database is of a newer Kilter.

    """
    file = settings.sqlite_file
    if file is not None and not file.exists():  # to look must not make it
        return Plan(None, _steps(None), None, 0, 0)
    database = Database(settings.database)
    try:
        found = revision.current(database)
        if found is not None:
            revision.check_known(database)
    finally:
        database.close()
    steps = _steps(found)
    if file is None or found is None or not steps:
        return Plan(found, steps, None, 0, 0)
    name = f"kilter-before-{revision.HEAD}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}{SUFFIX}"
    free = shutil.disk_usage(file.parent).free
    return Plan(found, steps, file.parent / name, file.stat().st_size, free)


def upgrade(settings: Settings) -> Plan:
    """Bring the database to the revision of this Kilter, with a copy of what there was beside it.

    Raises:
        ServiceError: the database is of a newer Kilter, or the disk has no room for the copy.

    """
    plan = planned(settings)
    if not plan.steps:
        return plan
    if plan.copy is not None:
        _keep(settings, plan, plan.copy)
    database = Database(settings.database)
    try:
        revision.migrate(database)
    finally:
        database.close()
    log.info("the database was brought to revision %s", revision.HEAD)
    return plan


def _keep(settings: Settings, plan: Plan, copy: Path) -> None:
    if not plan.fits:
        raise ServiceError(
            f"The database is not migrated: {copy.parent} has {plan.free_bytes >> 20} MB free, and the copy of it that is kept "
            f"needs {(plan.copy_bytes + MARGIN_BYTES) >> 20} MB. Make room and start again.",
            code="disk_full",
        )
    assert settings.sqlite_file is not None
    part = copy.with_name(f"{copy.name}.part")
    private_file(part)
    try:
        with closing(sqlite3.connect(settings.sqlite_file)) as read, closing(sqlite3.connect(part)) as written:
            read.backup(written)
        with closing(sqlite3.connect(part)) as written:
            written.execute("PRAGMA journal_mode=DELETE")
        part.rename(copy)
    finally:
        part.unlink(missing_ok=True)
    digest = hashlib.sha256(copy.read_bytes()).hexdigest()
    copy.with_name(f"{copy.name}.sha256").write_text(f"{digest}  {copy.name}\n", encoding="utf-8")
    log.info("the database of revision %s is kept as %s", plan.found, copy)


def _steps(found: str | None) -> list[Step]:
    """Revisions after ``found``, the oldest first."""
    after = {}
    for path in (revision.migrations() / "versions").glob("*.py"):
        source = path.read_text(encoding="utf-8")
        name, before, adds = revision.REVISION.search(source), BEFORE.search(source), STEP.search(source)
        if name is not None and adds is not None:
            after[before[1] if before is not None else None] = Step(name[1], adds[1].strip().rstrip("."))
    steps = []
    while found in after:
        steps.append(after[found])
        found = steps[-1].revision
    return steps
