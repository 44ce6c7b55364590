"""One seal over all tables, made once old seals are compared; answers of active versions, which the next upgrade replays."""

from __future__ import annotations

import json
from hashlib import blake2b

import sqlalchemy as sa
from alembic import op
from sqlalchemy import inspect

from kilter_service.ground.db.database_seal import DatabaseSeal, read_database_seal, refuse_other_key
from kilter_service.ground.db.seals import TABLES, Sealer, sealed_columns, sealer

revision = "0022"
down_revision = "0021"
branch_labels = None
depends_on = None

AUDIT = "audit"
BEFORE = sa.table("sealed_tables", *(sa.column(n) for n in ("thing", "rows", "total", "columns", "keyed_by", "seal")))
NOW = sa.table("database_seal", *(sa.column(name) for name in ("id", "totals", "keyed_by", "seal")))


def upgrade() -> None:
    connection, seals = op.get_bind(), sealer()
    op.create_table(
        "database_seal",
        sa.Column("id", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("totals", sa.Text(), nullable=False),
        sa.Column("keyed_by", sa.String(16), nullable=False),
        sa.Column("seal", sa.String(32), nullable=False),
    )
    found = connection.execute(sa.select(BEFORE)).mappings().all()
    if found:
        keys = {row["keyed_by"] for row in found}
        other = min(keys - {seals.number}, default=seals.number)
        fits = all(
            _seal(seals, row["thing"], row["rows"], row["total"], row["columns"]) == row["seal"] for row in found
        )
        refuse_other_key(DatabaseSeal({}, other, fits), seals)
        totals = json.dumps({row["thing"]: [row["rows"], row["total"]] for row in found}, sort_keys=True)
        # What did not fit before goes on being a finding.
        values = {"id": 1, "totals": totals, "keyed_by": seals.number, "seal": seals.seal(totals) if fits else ""}
        connection.execute(sa.insert(NOW).values(**values))
    op.drop_table("sealed_tables")
    op.create_table(
        "replays",
        sa.Column(
            "activation_id", sa.Integer(), sa.ForeignKey("activations.id", ondelete="RESTRICT"), primary_key=True
        ),
        sa.Column("rules", sa.JSON(), nullable=False),
        sa.Column("setpoints", sa.LargeBinary(), nullable=False),
        sa.Column("answers", sa.LargeBinary(), nullable=False),
        sa.Column("made_by", sa.String(16), nullable=False),
        sa.Column("code_version", sa.String(64), nullable=False),
    )


def downgrade() -> None:
    connection, seals = op.get_bind(), sealer()
    op.create_table(
        "sealed_tables",
        sa.Column("thing", sa.String(32), primary_key=True),
        sa.Column("rows", sa.Integer(), nullable=False),
        sa.Column("total", sa.String(64), nullable=False),
        sa.Column("columns", sa.Text(), nullable=False),
        sa.Column("keyed_by", sa.String(16), nullable=False),
        sa.Column("seal", sa.String(32), nullable=False),
    )
    whole = read_database_seal(connection, seals)
    refuse_other_key(whole, seals)
    totals = {} if whole is None else {thing: total for thing, total in whole.totals.items() if thing != "replays"}
    for thing, (rows, total) in totals.items():
        columns = "" if thing == AUDIT else " ".join(_columns(connection, thing))
        seal = _seal(seals, thing, rows, total, columns) if whole is not None and whole.fits else ""
        values = {
            "thing": thing,
            "rows": rows,
            "total": total,
            "columns": columns,
            "keyed_by": seals.number,
            "seal": seal,
        }
        connection.execute(sa.insert(BEFORE).values(**values))
    op.execute("DELETE FROM seals WHERE thing = 'replays'")
    op.drop_table("replays")
    op.drop_table("database_seal")


def _columns(connection: sa.Connection, table: str) -> list[str]:
    there = {column["name"] for column in inspect(connection).get_columns(table)}
    return [column.name for column in sealed_columns(TABLES[table]) if column.name in there]


def _seal(seals: Sealer, table: str, rows: int, total: str, columns: str) -> str:
    content = f"{table}\0{rows}\0{total}\0{columns}\0{seals.number}".encode("utf-8", "surrogateescape")
    return blake2b(content, key=seals._key, digest_size=16).hexdigest()
