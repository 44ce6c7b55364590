"""resolved robots: the chain of every robot in plain numbers, its hash, and whose chain a version was made on."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

log = logging.getLogger("kilter.migrate")

# The presets as they were up to this revision. They stay as they are when a later release edits its own.
PRESETS = Path(__file__).resolve().parents[1] / "presets" / "0004"
OVERRIDABLE = ("name", "gravity_m_s2", "tool", "base", "links", "payload_sigma")

ROBOTS = sa.table(
    "robots",
    sa.column("id", sa.Integer),
    sa.column("name", sa.String),
    sa.column("document", sa.JSON(none_as_null=True)),
    sa.column("chain", sa.JSON(none_as_null=True)),
    sa.column("sha256", sa.String),
    sa.column("source_sha256", sa.String),
    sa.column("left_out", sa.JSON),
)
VERSIONS = sa.table("versions", sa.column("robot_id", sa.Integer), sa.column("robot_sha256", sa.String))


def upgrade() -> None:
    # Columns are only added, so that SQLite need not copy a table that others refer to.
    op.add_column("robots", sa.Column("chain", sa.JSON(none_as_null=True), nullable=True))
    op.add_column("robots", sa.Column("sha256", sa.String(length=64), nullable=False, server_default=""))
    op.add_column("robots", sa.Column("source_sha256", sa.String(length=64), nullable=False, server_default=""))
    op.add_column("robots", sa.Column("left_out", sa.JSON(), nullable=False, server_default="[]"))
    op.add_column("versions", sa.Column("hash_scheme", sa.Integer(), nullable=False, server_default="1"))
    op.add_column("versions", sa.Column("robot_sha256", sa.String(length=64), nullable=False, server_default=""))
    connection = op.get_bind()
    for robot in connection.execute(sa.select(ROBOTS.c.id, ROBOTS.c.name, ROBOTS.c.document)).all():
        _resolve(connection, robot.id, robot.name, robot.document)


def _resolve(connection: sa.Connection, robot_id: int, name: str, posted: dict[str, Any]) -> None:
    from kilter_core.errors import CoreError
    from kilter_service.robots.documents import resolve, source_sha256

    mine = ROBOTS.c.id == robot_id
    connection.execute(sa.update(ROBOTS).where(mine).values(source_sha256=source_sha256(posted)))
    try:
        found = resolve(_expanded(posted))
    except (CoreError, KeyError) as error:
        # It could not be used before either. All others go on, and this one says so when it is used.
        log.warning("robot %r is kept, but cannot be resolved: %s", name, error)
        return
    values = {"chain": found.chain, "sha256": found.sha256, "left_out": found.notes}
    connection.execute(sa.update(ROBOTS).where(mine).values(**values))
    connection.execute(sa.update(VERSIONS).where(VERSIONS.c.robot_id == robot_id).values(robot_sha256=found.sha256))


def _expanded(posted: dict[str, Any]) -> dict[str, Any]:
    """Put the preset of that time in the place of its name."""
    file = PRESETS / f"{posted.get('preset')}.json"
    if posted["convention"] != "preset" or not file.is_file():
        return posted
    preset: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return {**preset, **{key: posted[key] for key in OVERRIDABLE if key in posted}}


def downgrade() -> None:
    for column in ("robot_sha256", "hash_scheme"):
        op.drop_column("versions", column)
    for column in ("left_out", "source_sha256", "sha256", "chain"):
        op.drop_column("robots", column)
