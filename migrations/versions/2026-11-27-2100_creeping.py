"""Robots that the operator's address was told to be creeping."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0021"
down_revision = "0020"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "creeping",
        sa.Column("robot_id", sa.Integer(), sa.ForeignKey("robots.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("job_id", sa.String(length=32), nullable=False),
        sa.Column("told_at", sa.DateTime(timezone=True), nullable=False),
    )


def downgrade() -> None:
    op.drop_table("creeping")
