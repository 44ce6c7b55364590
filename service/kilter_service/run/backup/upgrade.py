"""What an update of Kilter does to a database: says it before, keeps a copy of what there was, and migrates."""

from __future__ import annotations

import hashlib
import logging
import re
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from kilter_files.ground.later import later
from kilter_service.ground.db import Database, revision
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.private_files import private_file
from kilter_service.ground.settings import Settings

if TYPE_CHECKING:
    from kilter_service.versions.replays import Change

with later(__name__):  # a database without active versions needs no core
    from kilter_service.versions import replays
    from kilter_service.versions import store as versions

log = logging.getLogger("kilter.serve")

SUFFIX = ".kilter-backup"
MARGIN_BYTES = 64 << 20  # of the migration itself, beside the copy
# Up to this revision a correction held the whole pose or, of an arm with fewer than six joints, the tool point alone with the
# least motion of the joints: as today where every posture counts as weak. Releases kept no rules then.
POINT_ALONE = "0014"
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
    changes: tuple[Change, ...] = ()  # of what active versions answer

    @property
    def fits(self) -> bool:
        """Whether the disk has room for the copy and the migration."""
        return self.copy is None or self.copy_bytes + MARGIN_BYTES <= self.free_bytes


def plan_upgrade(settings: Settings) -> Plan:
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


def planned_changes(settings: Settings, plan: Plan) -> Iterator[Change]:
    """Replay the answers of the active versions; those of an earlier revision in a copy that is migrated.

    Of a PostgreSQL database of an earlier revision there is no copy: the upgrade itself replays them.
    """
    if plan.found is None or (plan.steps and settings.sqlite_file is None):
        return
    with tempfile.TemporaryDirectory(prefix="kilter-replay-", dir=settings.data) as folder:
        url = settings.database
        if plan.steps:
            copy = Path(folder) / "copy.sqlite"
            assert settings.sqlite_file is not None
            _copy(settings.sqlite_file, copy)
            url = f"sqlite:///{copy}"
        with closing(Database(url)) as database:
            revision.migrate(database)
            yield from replays.compare_answers(database, before_rules=_is_before_rules(plan.found))


def _is_before_rules(found: str | None) -> bool:
    return found is not None and found <= POINT_ALONE


def upgrade(settings: Settings, *, replay: bool = True) -> Plan:
    """Bring the database to the revision of this Kilter, with a copy of what there was beside it.

    The answers of active versions are compared with those that were kept, where something is upgraded or ``replay`` asks
    for it; those of versions that have none are kept.

    Raises:
        ServiceError: the database is of a newer Kilter, or the disk has no room for the copy.

    """
    plan = plan_upgrade(settings)
    if not (plan.steps or replay):
        return plan
    if plan.copy is not None:
        _keep(settings, plan, plan.copy)
    database = Database(settings.database)
    try:
        if revision.migrate(database):
            log.info("the database was brought to revision %s", revision.HEAD)
        plan = plan._replace(changes=replay_and_keep(database, plan.found))
    finally:
        database.close()
    for change in plan.changes:
        log.info("%s", describe_change(change, plan.found, done=True))
    return plan


def replay_and_keep(database: Database, found: str | None) -> tuple[Change, ...]:
    """Compare answers of active versions with those that were kept, and keep task, rules and answers of those that have none:
    those of the release of revision ``found``.

    However old data come to this revision, by an upgrade or by restoring a backup, they are given here what they lack.
    """
    if not _has_active(database):
        return ()
    changes = tuple(replays.compare_answers(database, before_rules=_is_before_rules(found)))
    replays.keep_answers(database, before_rules=_is_before_rules(found))
    return changes


def _has_active(database: Database) -> bool:
    with database.reading() as session:
        return bool(versions.active_entries(session))


def describe_change(change: Change, found: str | None, *, done: bool) -> str:
    """Say how far the answers of an active version change, or that none were kept."""
    joint = [f"{change.joint_deg:.2g} deg"] if change.joint_deg or not change.joint_mm else []
    joints = " or ".join([*joint, *([f"{change.joint_mm:.2g} mm"] if change.joint_mm else [])])
    far = f"joints change by at most {joints}, the tool point by {change.tool_mm:.2g} mm"
    who = f"{change.robot} {change.version_id}"
    if not change.kept:
        none = f"{who}: no earlier answers are stored"
        if _is_before_rules(found):
            return f"{none}; it {'keeps' if done else 'would keep'} the task of its release. Activated anew, {far}."
        return f"{none}; today's {'are' if done else 'would be'} kept."
    other = f"; {change.otherwise} are refused that were not, or the other way round" if change.otherwise else ""
    return f"{who}: {far}, at {change.setpoints} setpoints{other}."


def _keep(settings: Settings, plan: Plan, copy: Path) -> None:
    if not plan.fits:
        raise ServiceError(
            f"The database is not migrated: {copy.parent} has {plan.free_bytes >> 20} MB free, and the copy of it that is kept "
            f"needs {(plan.copy_bytes + MARGIN_BYTES) >> 20} MB. Make room and start again.",
            code="disk_full",
        )
    assert settings.sqlite_file is not None
    part = copy.with_name(f"{copy.name}.part")
    try:
        _copy(settings.sqlite_file, part)
        with closing(sqlite3.connect(part)) as written:
            written.execute("PRAGMA journal_mode=DELETE")
        part.rename(copy)
    finally:
        part.unlink(missing_ok=True)
    digest = hashlib.sha256(copy.read_bytes()).hexdigest()
    copy.with_name(f"{copy.name}.sha256").write_text(f"{digest}  {copy.name}\n", encoding="utf-8")
    log.info("the database of revision %s is kept as %s", plan.found, copy)


def _copy(source: Path, target: Path) -> None:
    private_file(target)
    with closing(sqlite3.connect(source)) as read, closing(sqlite3.connect(target)) as written:
        read.backup(written)


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
