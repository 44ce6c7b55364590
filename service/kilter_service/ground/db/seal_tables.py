"""The tables of the seals: of the rows, and the one over all tables."""

from __future__ import annotations

from sqlalchemy import String, Text
from sqlalchemy.orm import Mapped, mapped_column

from kilter_service.ground.db.row import Row


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
