"""which worker runs a job."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # A job that runs while this is done has no worker: the sweep puts it back into the queue.
    op.add_column("jobs", sa.Column("worker", sa.String(length=200), nullable=False, server_default=""))


def downgrade() -> None:
    op.drop_column("jobs", "worker")
