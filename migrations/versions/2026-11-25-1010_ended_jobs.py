"""Counts of the jobs that have ended, which no purge changes; they begin with the jobs that are there."""

from __future__ import annotations

from collections import defaultdict

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"
branch_labels = None
depends_on = None

AT_MOST_MS = (250, 1000, 2500, 5000, 10_000, 30_000, 60_000, 120_000, 300_000, 600_000, 1_800_000, 3_600_000)
LONGER_MS = 2**31 - 1


def upgrade() -> None:
    ended = op.create_table(
        "ended_jobs",
        sa.Column("kind", sa.String(32), primary_key=True),
        sa.Column("state", sa.String(16), primary_key=True),
        sa.Column("at_most_ms", sa.Integer(), primary_key=True, autoincrement=False),
        sa.Column("jobs", sa.Integer(), nullable=False),
        sa.Column("seconds", sa.Double(), nullable=False),
    )
    moment = sa.DateTime(timezone=True)
    jobs = sa.table(
        "jobs", sa.column("kind"), sa.column("state"), sa.column("started_at", moment), sa.column("finished_at", moment)
    )
    query = sa.select(jobs.c.kind, jobs.c.state, jobs.c.started_at, jobs.c.finished_at)
    found: dict[tuple[str, str, int], tuple[int, float]] = defaultdict(lambda: (0, 0.0))
    for row in op.get_bind().execute(query.where(jobs.c.state.in_(("succeeded", "failed", "cancelled")))):
        ran = row.started_at is not None and row.finished_at is not None
        seconds = max(0.0, (row.finished_at - row.started_at).total_seconds()) if ran else 0.0
        longer = (edge for edge in AT_MOST_MS if edge >= 1000.0 * seconds)
        key = (row.kind, row.state, next(longer, LONGER_MS) if ran else 0)
        found[key] = (found[key][0] + 1, found[key][1] + seconds)
    rows = [
        {"kind": kind, "state": state, "at_most_ms": edge, "jobs": number, "seconds": seconds}
        for (kind, state, edge), (number, seconds) in found.items()
    ]
    if rows:
        op.bulk_insert(ended, rows)


def downgrade() -> None:
    op.drop_table("ended_jobs")
