"""Instruments with their permissible errors and certificates, and which of them a campaign was measured with."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "instruments",
        sa.Column("name", sa.String(length=64), primary_key=True),
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("serial_number", sa.String(length=200), nullable=False),
        sa.Column("mpe_standard", sa.String(length=32), nullable=False),
        sa.Column("mpe_um", sa.Double(), nullable=False),
        sa.Column("mpe_um_per_m", sa.Double(), nullable=False),
        sa.Column("certificate", sa.String(length=200), nullable=False),
        sa.Column("certified_on", sa.String(length=10), nullable=True),
        sa.Column("valid_until", sa.String(length=10), nullable=True),
        sa.Column("notes", sa.String(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
    )
    # Without a foreign key: SQLite would copy the table of the campaigns to add one. Instruments are never deleted.
    op.add_column("campaigns", sa.Column("instrument", sa.String(length=64), nullable=True))


def downgrade() -> None:
    op.drop_column("campaigns", "instrument")
    op.drop_table("instruments")
