"""Alembic's entry: runs the revisions on the database Kilter is set to use."""

from __future__ import annotations

from typing import Literal

from alembic import context
from sqlalchemy import inspect

from kilter_service.ground.db.database import open_engine
from kilter_service.ground.db.initial_seals import complete
from kilter_service.ground.db.revision import HEAD
from kilter_service.ground.db.row import Instant, Row
from kilter_service.ground.db.seals import sealer
from kilter_service.ground.settings import Settings


def render(kind: str, item: object, _autogen: object) -> str | Literal[False]:
    # A revision must not change when Kilter's own column types do: it names SQLAlchemy's.
    return "sa.DateTime(timezone=True)" if isinstance(item, Instant) else False


def run() -> None:
    url = context.config.attributes.get("url") or Settings().database
    engine = open_engine(url)
    # A SQLite table cannot be altered in place: batch mode copies it.
    with engine.begin() as connection:
        context.configure(connection=connection, target_metadata=Row.metadata, render_as_batch=True, render_item=render)
        with context.begin_transaction():
            context.run_migrations()
        # In one transaction with what it seals: tables that are new, or columns that a revision has added.
        if inspect(connection).has_table("database_seal") and context.get_context().get_current_revision() == HEAD:
            complete(connection, sealer())
    engine.dispose()


run()
