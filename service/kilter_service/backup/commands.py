"""`kilterd backup`, `restore`, `verify` and `seal` as commands."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from kilter_service.settings import Settings


def backup(settings: Settings, arguments: argparse.Namespace) -> None:
    """Write all that is stored to a file, while the server runs."""
    from kilter_service.backup import service

    path, found = service.backup(settings, Path(arguments.path))
    print(f"{path} holds {found.looked_at()}; {found.checked()}.")


def restore(settings: Settings, arguments: argparse.Namespace) -> None:
    """Bring a backup into an empty data folder or database."""
    from kilter_service.backup import service

    found = service.restore(settings, Path(arguments.path))
    print(
        f"Restored {found.looked_at()}. Secrets are not in a backup: copy the token file, stream-keys.json and the "
        "authority of zenoh-config, where they were kept; the first start makes new ones."
    )


def verify(settings: Settings, arguments: argparse.Namespace) -> None:
    """Check every hash of the database, or of a backup, while the server runs."""
    from kilter_service.backup import service

    found = service.verify(Path(arguments.path)) if arguments.path else service.verify_stored(settings)
    for sentence in found.damaged:
        print(sentence)
    if found.damaged:
        print(
            f"kilterd: {len(found.damaged)} findings in {found.looked_at()}. Stop the server, move its data folder away and "
            "bring back the newest backup that is whole with `kilterd restore`.",
            file=sys.stderr,
        )
        sys.exit(1)
    print(f"All is whole: {found.looked_at()}; {found.checked()}.")


def seal(settings: Settings, arguments: argparse.Namespace) -> None:
    """Seal all rows anew: with a new key, or after a change by hand."""
    from kilter_service.backup import service

    found = service.seal(settings, accept=arguments.accept)
    for sentence in found:
        print(sentence)
    if found:
        print(
            f"kilterd: {len(found)} findings, and nothing was sealed: bring back a backup that is whole, or take the rows as "
            "they are with --accept.",
            file=sys.stderr,
        )
        sys.exit(1)
    print("All rows are sealed, and the audit says so.")
