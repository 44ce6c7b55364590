"""the request that asked for a job, and where that was in a trace."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    for name in ("request_id", "traceparent"):
        op.add_column("jobs", sa.Column(name, sa.String(64), nullable=False, server_default=""))


def downgrade() -> None:
    for name in ("request_id", "traceparent"):
        op.drop_column("jobs", name)
