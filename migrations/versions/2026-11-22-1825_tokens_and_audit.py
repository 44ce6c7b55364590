"""tokens, and the audit, whose entries the database refuses to change."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None

FIXED = "the audit is append-only"
LAST = "(SELECT a.sha256 FROM audit a ORDER BY a.number DESC LIMIT 1)"
NEXT = "(SELECT coalesce(max(a.number), 0) + 1 FROM audit a)"
# REPLACE would delete without the trigger of deletions: an entry that does not continue the chain is refused too.
CONTINUES = f"NEW.number = {NEXT} AND NEW.previous = coalesce({LAST}, '')"
SQLITE = (
    f"CREATE TRIGGER audit_update BEFORE UPDATE ON audit BEGIN SELECT RAISE(ABORT, '{FIXED}'); END",
    f"CREATE TRIGGER audit_delete BEFORE DELETE ON audit BEGIN SELECT RAISE(ABORT, '{FIXED}'); END",
    f"CREATE TRIGGER audit_insert BEFORE INSERT ON audit WHEN NOT ({CONTINUES}) "
    "BEGIN SELECT RAISE(ABORT, 'the entry does not continue the audit'); END",
)
POSTGRESQL = (
    f"CREATE FUNCTION audit_fixed() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN RAISE EXCEPTION '{FIXED}'; END $$",
    f"CREATE FUNCTION audit_continued() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN IF NOT ({CONTINUES}) THEN "
    "RAISE EXCEPTION 'the entry does not continue the audit'; END IF; RETURN NEW; END $$",
    "CREATE TRIGGER audit_row BEFORE UPDATE OR DELETE ON audit FOR EACH ROW EXECUTE FUNCTION audit_fixed()",
    "CREATE TRIGGER audit_table BEFORE TRUNCATE ON audit FOR EACH STATEMENT EXECUTE FUNCTION audit_fixed()",
    "CREATE TRIGGER audit_insert BEFORE INSERT ON audit FOR EACH ROW EXECUTE FUNCTION audit_continued()",
)


def upgrade() -> None:
    op.create_table(
        "tokens",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("role", sa.String(length=16), nullable=False),
        sa.Column("robots", sa.JSON(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("created_by", sa.String(length=64), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("revoked_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("revoked_by", sa.String(length=64), nullable=False, server_default=""),
        sa.PrimaryKeyConstraint("id"),
        sa.UniqueConstraint("sha256"),
    )
    op.create_index("ix_tokens_name", "tokens", ["name"])
    op.create_table(
        "audit",
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("previous", sa.String(length=64), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("content", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("number"),
    )
    for statement in SQLITE if op.get_bind().dialect.name == "sqlite" else POSTGRESQL:
        op.execute(statement)


def downgrade() -> None:
    op.drop_table("audit")
    if op.get_bind().dialect.name != "sqlite":
        op.execute("DROP FUNCTION audit_fixed()")
        op.execute("DROP FUNCTION audit_continued()")
    op.drop_index("ix_tokens_name", "tokens")
    op.drop_table("tokens")
