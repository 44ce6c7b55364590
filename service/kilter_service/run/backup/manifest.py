"""The manifest of a backup: a hash for every table, over all of its rows, taken when the backup was written.

Chunks, robots, calibrations and shapes carry hashes of their own; reports, results, roles, tokens and activations do not, and
a flipped bit in one of them was restored without a word. The manifest is a table of the backup file alone: it is compared
with the file's own columns, before any migration, and taken out when the backup is restored.
"""

from __future__ import annotations

import hashlib
import sqlite3
import struct
from contextlib import closing
from pathlib import Path

NAME = "kilter_manifest"
INSERT = "INSERT INTO kilter_manifest VALUES (?, ?, ?)"
SELECT = "SELECT name, rows, sha256 FROM kilter_manifest"
_TABLES = (
    "SELECT name, sql FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite\\_%' ESCAPE '\\' ORDER BY name"
)


def write(path: Path) -> None:
    """Add the manifest to a backup that holds all its rows."""
    with closing(_open_with_raw_text(path)) as file, file:
        found = _hashes(file)
        file.execute(f"CREATE TABLE {NAME} (name TEXT PRIMARY KEY, rows INTEGER, sha256 TEXT)")
        file.executemany(INSERT, [(name, *rest) for name, rest in found.items()])


def compare(path: Path) -> list[str] | None:
    """Sentences about the tables that are not as they were written; None when the backup has no manifest.

    Raises:
        sqlite3.DatabaseError: a page of the file cannot be read.

    """
    with closing(_open_with_raw_text(path)) as file:
        listed = {name.decode() for name, _ in file.execute(_TABLES)}
        if NAME not in listed:
            return None
        written = {name.decode(): (rows, sha256.decode()) for name, rows, sha256 in file.execute(SELECT)}
        found = _hashes(file)
    said = [f"Table {name} is missing from the backup." for name in sorted(written.keys() - found.keys())]
    said += [
        f"Table {name} was not there when the backup was written." for name in sorted(found.keys() - written.keys())
    ]
    return said + [_difference(name, written[name], found[name]) for name in sorted(written.keys() & found.keys())
                   if written[name] != found[name]]  # fmt: skip


def remove(path: Path) -> None:
    """Take the manifest out of a copy that is going to be used."""
    with closing(_open_with_raw_text(path)) as file, file:
        file.execute(f"DROP TABLE IF EXISTS {NAME}")


def _difference(name: str, written: tuple[int, str], found: tuple[int, str]) -> str:
    if written[0] != found[0]:
        return f"Table {name} has {found[0]} rows; {written[0]} were written."
    return f"Table {name} does not have the hash {written[1][:12]} it was written with: at least one of its rows was altered."


def _open_with_raw_text(path: Path) -> sqlite3.Connection:
    file = sqlite3.connect(path)
    file.text_factory = bytes  # text that is no longer text is compared, and does not end in an error of decoding
    return file


def _hashes(file: sqlite3.Connection) -> dict[str, tuple[int, str]]:
    """Number of rows and hash of every table, of its definition too."""
    found = {}
    for name, definition in file.execute(_TABLES).fetchall():
        table = name.decode()
        if table == NAME:
            continue
        digest, rows = hashlib.sha256(definition), 0
        quoted = table.replace('"', '""')
        for row in file.execute(f'SELECT * FROM "{quoted}" ORDER BY rowid'):  # noqa: S608 (a name from the file, quoted)
            rows += 1
            for value in row:
                _feed(digest, value)
        found[table] = rows, digest.hexdigest()
    return found


def _feed(digest: hashlib._Hash, value: bytes | int | float | None) -> None:
    """Add a value, its kind and length with it, so that no two rows give the same bytes."""
    if value is None:
        digest.update(b"n")
    elif isinstance(value, int):
        digest.update(b"i%d;" % value)
    elif isinstance(value, float):
        digest.update(b"f" + struct.pack("<d", value))
    else:
        digest.update(b"b%d;" % len(value))
        digest.update(value)
