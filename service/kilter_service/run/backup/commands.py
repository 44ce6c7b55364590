"""`kilterd backup`, `restore`, `verify` and `seal` as commands."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from kilter_service.ground import backup_folder
from kilter_service.ground.db import revision
from kilter_service.ground.naming import plural
from kilter_service.ground.settings import Settings
from kilter_service.run.backup import service
from kilter_service.run.backup import upgrade as upgrading


def backup(settings: Settings, arguments: argparse.Namespace) -> None:
    """Write all that is stored to a file, while the server runs."""
    where, keep = Path(arguments.path) if arguments.path else settings.backups, arguments.keep
    if where is None:
        print("kilterd: say where the backup goes: `kilterd backup PATH`, or set KILTER_BACKUPS", file=sys.stderr)
        sys.exit(2)
    if keep is not None or not arguments.path:
        backup_folder.check_folder(where)
    path, found = service.backup(settings, where)
    print(f"{path} holds {found.describe_coverage()}; {found.describe_hash_check()}.")
    if keep is None:
        return
    kept = backup_folder.keep_newest(where, keep)
    print(f"{kept.left} backups are kept in {where}, {len(kept.removed)} older ones were removed.")
    for altered in kept.altered:
        print(f"kilterd: {altered} does not have its hash: it was altered, move it away.", file=sys.stderr)


def restore(settings: Settings, arguments: argparse.Namespace) -> None:
    """Bring a backup into an empty data folder or database."""
    found, changes = service.restore(settings, Path(arguments.path), accept=arguments.accept)
    for change in changes:
        print(upgrading.describe_change(change, found.revision, done=True))
    print(
        f"Restored {found.describe_coverage()}. Secrets are not in a backup: copy the token file, stream-keys.json and the "
        "authority of zenoh-config, where they were kept; the first start makes new ones."
    )


def upgrade(settings: Settings, arguments: argparse.Namespace) -> None:
    """Bring the database to the revision of this Kilter, or say what that would do."""
    plan = upgrading.plan_upgrade(settings) if arguments.check else upgrading.upgrade(settings)
    changes = upgrading.planned_changes(settings, plan) if arguments.check else plan.changes
    for change in changes:
        print(upgrading.describe_change(change, plan.found, done=not arguments.check))
    if not plan.steps:
        print(f"The database is at revision {revision.HEAD}: there is nothing to upgrade.")
        return
    print(
        f"{'To bring' if arguments.check else 'Brought'} the database from revision {plan.found or 'none'} to {revision.HEAD}:"
    )
    for step in plan.steps:
        print(f"  {step.revision}: {step.adds}")
    if plan.copy is not None:
        needed = f"needs {plan.copy_bytes >> 20} MB of {plan.free_bytes >> 20} MB free"
        print(f"A copy of it as it is {'would be' if arguments.check else 'was'} kept: {plan.copy} ({needed}).")
    elif plan.found is not None:
        if arguments.check:
            print("`kilterd upgrade` says what changes of what arms are sent; of a PostgreSQL database --check cannot.")
        print("No copy is made of a PostgreSQL database: make one with pg_dump first.")
    if not plan.fits:
        print(
            "kilterd: the disk has no room for the copy, so the upgrade would be refused: make room.", file=sys.stderr
        )
        sys.exit(1)


def verify(settings: Settings, arguments: argparse.Namespace) -> None:
    """Check every hash of the database, or of a backup, while the server runs."""
    found = service.verify(Path(arguments.path)) if arguments.path else service.verify_stored(settings)
    for sentence in found.sentences:
        print(sentence)
    if found.damaged:
        print(
            f"kilterd: {plural(len(found.damaged), 'finding')} in {found.describe_coverage()}. Stop the server, move its data "
            "folder away and bring back the newest backup that is whole with `kilterd restore`.",
            file=sys.stderr,
        )
    if found.sentences:
        sys.exit(1)
    print(found.headline())


def seal(settings: Settings, arguments: argparse.Namespace) -> None:
    """Seal all rows anew: with a new key, or after a change by hand."""
    found = service.seal(settings, accept=arguments.accept)
    for sentence in found:
        print(sentence)
    if found:
        print(
            f"kilterd: {plural(len(found), 'finding')}, and nothing was sealed: bring back a backup that is whole, or take the "
            "rows as they are with --accept.",
            file=sys.stderr,
        )
        sys.exit(1)
    print("All rows are sealed, and the audit says so.")
