"""The one seal over the totals of all tables and the end of the audit, and which key made it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, select, update
from sqlalchemy.orm import Session

from kilter_service.ground.db.row import Row
from kilter_service.ground.db.seals import KEY_VARIABLE, DatabaseSealRow, Sealer
from kilter_service.ground.db.tables import AuditRow
from kilter_service.ground.errors import ServiceError

AUDIT = AuditRow.__tablename__
WHOLE = Row.metadata.tables[DatabaseSealRow.__tablename__]
ONLY = 1  # the key of its only row
# Made once: to build a statement takes longer than to execute it.
_READ = select(WHOLE.c.totals, WHOLE.c.keyed_by, WHOLE.c.seal).where(WHOLE.c.id == ONLY)
_WRITE = update(WHOLE).where(WHOLE.c.id == ONLY)
_END = select(AuditRow.number, AuditRow.sha256).order_by(AuditRow.number.desc()).limit(1)


@dataclass
class DatabaseSeal:
    """The seal over the totals of all tables and the end of the audit, as it is stored."""

    totals: dict[str, Any]
    keyed_by: str
    fits: bool

    def total(self, table: str) -> tuple[int, int]:
        """Return the number of rows and their total; of a table that has none, or a damaged one, nothing."""
        try:
            rows, total = self.totals[table]
            return int(rows), int(total, 16)
        except (KeyError, TypeError, ValueError):
            return 0, 0

    def write(self, connection: Connection, sealer: Sealer) -> None:
        """Write the totals, and sign them only if what was signed before still fits: else it goes on being a finding."""
        totals = json.dumps(self.totals, sort_keys=True)
        values = {"totals": totals, "keyed_by": self.keyed_by}
        connection.execute(_WRITE, values | ({"seal": sealer.seal(totals)} if self.fits else {}))


def read_database_seal(connection: Connection, sealer: Sealer) -> DatabaseSeal | None:
    """Return the seal over all totals, checked; None where it was taken out."""
    found = connection.execute(_READ).first()
    if found is None:
        return None
    try:
        totals = json.loads(found.totals)
    except ValueError:
        totals = None
    known = isinstance(totals, dict)
    return DatabaseSeal(totals if known else {}, found.keyed_by, known and sealer.seal(found.totals) == found.seal)


def audit_end(connection: Connection) -> list[Any]:
    """Return the number and hash of the last entry of the audit."""
    last = connection.execute(_END).first()
    return [0, ""] if last is None else list(last)


def check_key(reading: Session, sealer: Sealer) -> None:
    """Refuse to work on rows that are sealed with another key, before anything is done.

    Raises:
        ServiceError: they are.

    """
    refuse_other_key(read_database_seal(reading.connection(), sealer), sealer)


def refuse_other_key(whole: DatabaseSeal | None, sealer: Sealer) -> None:
    """Refuse to go on where what is stored is sealed with another key than that of this process, or without one.

    Raises:
        ServiceError: it is.

    """
    keyed_by = "" if whole is None else whole.keyed_by
    if keyed_by != sealer.number:
        raise ServiceError(describe_other_key(keyed_by, sealer), code="seal_key_other")


def describe_other_key(keyed_by: str, sealer: Sealer) -> str:
    """Say that what is stored is not sealed with the key of this process, and what helps."""
    if not keyed_by:
        return (
            f"The rows are not sealed with the key that {KEY_VARIABLE} names. If that key is new, run `kilterd verify` "
            "without it, then `kilterd seal --accept` with it. If not, bring back a backup."
        )
    now = "with another one" if sealer.number else "without one"
    return (
        f"The rows are sealed with the key {keyed_by}, and this process runs {now}: set {KEY_VARIABLE} to its file. If "
        "it is lost, run `kilterd seal --accept` once."
    )


def describe_unsealed() -> str:
    """Say that rows of a release without seals are not taken for sealed ones, and what helps."""
    return (
        f"The data have no seals, and {KEY_VARIABLE} names a key. If they are of a release before seals, run "
        "`kilterd upgrade` without the key, then `kilterd seal --accept` with it. If not, bring back a backup."
    )
