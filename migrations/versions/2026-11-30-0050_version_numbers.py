"""Versions are counted for each robot, so that a person can say `tour v2`."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"
branch_labels = None
depends_on = None

ONE_ROBOT = "SELECT count(*) FROM versions AS other WHERE other.robot_id = versions.robot_id"
NOT_LATER = (
    "other.created_at < versions.created_at OR (other.created_at = versions.created_at AND other.id <= versions.id)"
)


def upgrade() -> None:
    op.add_column("versions", sa.Column("number", sa.Integer(), nullable=False, server_default="0"))
    op.add_column("robots", sa.Column("versions_made", sa.Integer(), nullable=False, server_default="0"))
    op.execute(f"UPDATE versions SET number = ({ONE_ROBOT} AND ({NOT_LATER}))")  # noqa: S608 (our own words)
    op.execute("UPDATE robots SET versions_made = (SELECT count(*) FROM versions WHERE versions.robot_id = robots.id)")


def downgrade() -> None:
    op.drop_column("robots", "versions_made")
    op.drop_column("versions", "number")
