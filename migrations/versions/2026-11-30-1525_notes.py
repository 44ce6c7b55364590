"""Notes on a date, a campaign and its rows beside the repairs of an arm: they are marked, and change no check."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0025"
down_revision = "0024"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("repairs", sa.Column("kind", sa.String(8), nullable=False, server_default="repair"))
    op.add_column("repairs", sa.Column("campaign_id", sa.String(32), nullable=True))
    op.add_column("repairs", sa.Column("rows", sa.String(200), nullable=False, server_default=""))


def downgrade() -> None:
    op.execute("DELETE FROM repairs WHERE kind = 'note'")
    for name in ("rows", "campaign_id", "kind"):
        op.drop_column("repairs", name)
