"""Seals: a digest for every column of every row, a total over the rows of each table, and one seal over all totals.

A row that is changed, removed or put in past Kilter no longer fits its digests or the total; a table that is put back to
an earlier state with its total no longer fits the seal over all of them. Values are taken as SQLite
stores them, so that a seal holds in either database and in a backup. docs/decisions/0019-rows-are-sealed.md has the reasons.

The tables of the seals: of the rows, and the one over all tables.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import Any

from sqlalchemy import Column, String, Table, Text
from sqlalchemy.dialects import sqlite
from sqlalchemy.orm import Mapped, mapped_column

from kilter_service.ground.db.row import Row
from kilter_service.ground.db.tables import AuditRow, EndedJobsRow, HeartbeatRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.private_files import read_secret_file


class SealRow(Row):
    """What a row was stored as: a digest for each of its columns. It is written with the row (`db/sealed.py`)."""

    __tablename__ = "seals"
    thing: Mapped[str] = mapped_column(String(32), primary_key=True)
    id: Mapped[str] = mapped_column(String(200), primary_key=True)
    digests: Mapped[str] = mapped_column(Text)


class DatabaseSealRow(Row):
    """The one seal over the totals of all tables and the last entry of the audit, and the number of the key that made it.

    ``totals`` is a JSON object: for each table the number of its rows and a total over their seals, for the audit the
    number and hash of its last entry.
    """

    __tablename__ = "database_seal"
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    totals: Mapped[str] = mapped_column(Text)
    keyed_by: Mapped[str] = mapped_column(String(16))
    seal: Mapped[str] = mapped_column(String(32))


# The audit has a chain of its own, that a process is alive lasts for seconds, and on how many jobs ended rests nothing but
# a metric. Nor does anything on the progress of a job, which workers note beside each other, and the bytes of chunks and
# shapes have a SHA-256 in the row.
APART = frozenset(row.__tablename__ for row in (AuditRow, EndedJobsRow, HeartbeatRow, SealRow, DatabaseSealRow))
OPEN = frozenset({("jobs", "fraction"), ("jobs", "stage"), ("chunks", "parquet"), ("meshes", "content")})
TABLES: Mapping[str, Table] = {table.name: table for table in Row.metadata.sorted_tables if table.name not in APART}
DIGEST_BYTES, TOTAL_BYTES, SEAL_BYTES, NUMBER_BYTES = 8, 32, 16, 4
MODULUS = 1 << 8 * TOTAL_BYTES
LEAST_KEY = 32  # characters of a file with a key
KEY_VARIABLE = "KILTER_SEAL_KEY"
Digests = dict[str, str]
_DIALECT = sqlite.dialect()


class Sealer:
    """Computes seals, with a key or without one."""

    def __init__(self, secret: bytes = b"") -> None:
        self._key = blake2b(secret).digest() if secret else b""
        self.number = self._hash(b"number", NUMBER_BYTES).hex() if secret else ""

    def _hash(self, content: bytes, size: int) -> bytes:
        return blake2b(content, key=self._key, digest_size=size).digest()

    def digest(self, table: str, row: str, column: str, value: Any) -> str:
        """Digest of a value as SQLite stores it, in its place."""
        place = f"{table}\0{row}\0{column}\0".encode("utf-8", "surrogateescape")
        return self._hash(place + _bytes(value), DIGEST_BYTES).hex()

    def weight(self, table: str, row: str, digests: str) -> int:
        """What a row adds to the total of its table."""
        place = f"{table}\0{row}\0\0{digests}".encode("utf-8", "surrogateescape")
        return int.from_bytes(self._hash(place, TOTAL_BYTES), "big")

    def seal(self, totals: str) -> str:
        """Seal over the totals of all tables, as they are stored."""
        return self._hash(f"{totals}\0{self.number}".encode("utf-8", "surrogateescape"), SEAL_BYTES).hex()


def sealer() -> Sealer:
    """Return what seals the rows of this process: with the key that KILTER_SEAL_KEY names, if there is one.

    Raises:
        ServiceError: the file cannot be read, others can read it, or it is too short.

    """
    named = os.environ.get(KEY_VARIABLE)
    return Sealer(_read_key_file(Path(named))) if named else Sealer()


def _read_key_file(file: Path) -> bytes:
    return read_secret_file(file, "key", LEAST_KEY, 0o077 & ~_right_of_credential(file), _unusable)


def _right_of_credential(file: Path) -> int:
    """systemd gives the account of a unit an entry in the access list of a credential, which shows as a right of the group."""
    folder = os.environ.get("CREDENTIALS_DIRECTORY")
    return 0o040 if folder and file.parent == Path(folder) else 0


def _unusable(what: str) -> ServiceError:
    return ServiceError(f"The file that {KEY_VARIABLE} names {what}.", code="seal_key_unusable")


def sealed_columns(table: Table) -> list[Column[Any]]:
    """Columns of a table that have digests."""
    return [column for column in table.columns if (table.name, column.name) not in OPEN]


def format_row_key(raw: Iterable[Any]) -> str:
    """Key of a row as text."""
    return "/".join(str(part) for part in raw)


def raw(column: Column[Any], value: Any) -> Any:
    """Return a value as SQLite stores it."""
    process = _processor(column)
    return value if process is None else process(value)


@cache
def _processor(column: Column[Any]) -> Callable[[Any], Any] | None:
    return column.type.dialect_impl(_DIALECT).bind_processor(_DIALECT)


def _bytes(value: Any) -> bytes:
    if value is None:
        return b"n"
    if isinstance(value, int):
        return b"i%d" % value
    if isinstance(value, float):
        return b"f" + struct.pack("<d", value)
    if isinstance(value, bytes):
        return b"b" + value
    return b"t" + str(value).encode("utf-8", "surrogateescape")


def written(digests: Digests) -> str:
    """Digests of a row as text."""
    return " ".join(f"{name}={digest}" for name, digest in sorted(digests.items()))


def read(text: str) -> Digests:
    """Digests of a row from their text, however damaged."""
    return {name: digest for name, _, digest in (part.partition("=") for part in str(text).split(" "))}
