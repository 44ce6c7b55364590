"""jobs of a fleet, who asked for a job, and the order in which jobs are listed."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("jobs", sa.Column("asked_by", sa.JSON(), nullable=False, server_default="{}"))
    # As the lists are ordered: without them each page sorts all jobs.
    op.create_index("ix_jobs_newest", "jobs", ["created_at", "id"])
    op.create_index("ix_jobs_newest_of_robot", "jobs", ["robot_id", "created_at", "id"])
    op.drop_index("ix_jobs_robot_id", "jobs")
    not_over = sa.text("state IN ('queued', 'running')")
    op.create_index("ix_jobs_not_over", "jobs", ["created_at", "id"], sqlite_where=not_over, postgresql_where=not_over)
    op.create_table(
        "fleet_jobs",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False, server_default=""),
        sa.Column("request", sa.JSON(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("cancelled_at", sa.DateTime(timezone=True), nullable=True),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index("ix_fleet_jobs_newest", "fleet_jobs", ["created_at", "id"])
    op.create_table(
        "fleet_robots",
        sa.Column("fleet_id", sa.String(length=32), nullable=False),
        sa.Column("robot_id", sa.Integer(), nullable=False),
        sa.Column("job_id", sa.String(length=32), nullable=True),
        sa.Column("before_id", sa.String(length=32), nullable=True),
        sa.Column("refusal", sa.JSON(), nullable=True),
        sa.Column("judged", sa.JSON(), nullable=True),
        sa.ForeignKeyConstraint(["fleet_id"], ["fleet_jobs.id"], ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["robot_id"], ["robots.id"], ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("fleet_id", "robot_id"),
        sa.UniqueConstraint("job_id"),
    )
    op.create_index("ix_fleet_robots_robot_id", "fleet_robots", ["robot_id"])


def downgrade() -> None:
    op.drop_table("fleet_robots")
    op.drop_table("fleet_jobs")
    op.drop_index("ix_jobs_not_over", "jobs")
    op.create_index("ix_jobs_robot_id", "jobs", ["robot_id"])
    op.drop_index("ix_jobs_newest_of_robot", "jobs")
    op.drop_index("ix_jobs_newest", "jobs")
    op.drop_column("jobs", "asked_by")
