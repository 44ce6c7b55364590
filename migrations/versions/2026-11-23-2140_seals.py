"""Seals: what every row was stored as, and how many rows of each table, so that a change past Kilter shows.

They are filled by `kilter_service.ground.db.sealed.complete` after the newest revision, from the columns that the tables
have then.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "seals",
        sa.Column("thing", sa.String(32), primary_key=True),
        sa.Column("id", sa.String(200), primary_key=True),
        sa.Column("digests", sa.Text(), nullable=False),
    )
    op.create_table(
        "sealed_tables",
        sa.Column("thing", sa.String(32), primary_key=True),
        sa.Column("rows", sa.Integer(), nullable=False),
        sa.Column("total", sa.String(64), nullable=False),
        sa.Column("columns", sa.Text(), nullable=False),
        sa.Column("keyed_by", sa.String(16), nullable=False),
        sa.Column("seal", sa.String(32), nullable=False),
    )


def downgrade() -> None:
    op.drop_table("sealed_tables")
    op.drop_table("seals")
