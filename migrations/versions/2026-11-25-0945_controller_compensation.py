"""Whether the controller of a robot corrects by itself: a setting beside the document, which no hash covers."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None


def upgrade() -> None:
    column = sa.Column("controller_compensation", sa.String(length=16), nullable=False, server_default="unknown")
    op.add_column("robots", column)


def downgrade() -> None:
    op.drop_column("robots", "controller_compensation")
