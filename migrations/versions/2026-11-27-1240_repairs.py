"""Repairs of robots: what was done to an arm, and when."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "repairs",
        sa.Column("id", sa.String(length=32), primary_key=True),
        sa.Column("robot_id", sa.Integer(), sa.ForeignKey("robots.id", ondelete="CASCADE"), nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("what", sa.String(length=200), nullable=False),
        sa.Column("actor", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
    )
    op.create_index(op.f("ix_repairs_robot_id"), "repairs", ["robot_id"])


def downgrade() -> None:
    op.drop_index(op.f("ix_repairs_robot_id"), "repairs")
    op.drop_table("repairs")
