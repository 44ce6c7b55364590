"""The database: engine, tables, revision. Only this package and the ``store`` modules know SQLAlchemy."""

from __future__ import annotations

from sqlalchemy.orm import Session

from kilter_service.ground.db.database import Database, DatabaseAwayError

__all__ = ["Database", "DatabaseAwayError", "Session"]
