"""names and notes of versions and jobs, retirement, and what is left of what was purged."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None

RETIRABLE = ("robots", "campaigns", "versions")
TEXTS = (("robots", "remarks", None), ("versions", "name", 200), ("versions", "notes", None), ("jobs", "name", 200))


def upgrade() -> None:
    # Columns are only added, so that SQLite need not copy a table that others refer to.
    for table in RETIRABLE:
        op.add_column(table, sa.Column("retired_at", sa.DateTime(timezone=True), nullable=True))
        op.add_column(table, sa.Column("retired_by", sa.String(length=64), nullable=False, server_default=""))
    for table, name, length in TEXTS:
        op.add_column(table, sa.Column(name, sa.String(length=length), nullable=False, server_default=""))
    op.create_table(
        "tombstones",
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("robot", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("by", sa.String(length=64), nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("kind", "id", "at"),
    )


def downgrade() -> None:
    op.drop_table("tombstones")
    for table, name, _ in reversed(TEXTS):
        op.drop_column(table, name)
    for table in RETIRABLE:
        op.drop_column(table, "retired_by")
        op.drop_column(table, "retired_at")
