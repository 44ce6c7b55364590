"""How good a robot must be, and how often it is checked: settings beside the document."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0024"
down_revision = "0023"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("robots", sa.Column("tolerance_mm", sa.Double(), nullable=True))
    op.add_column("robots", sa.Column("check_interval_days", sa.Integer(), nullable=True))


def downgrade() -> None:
    op.drop_column("robots", "check_interval_days")
    op.drop_column("robots", "tolerance_mm")
