"""What all rows of the database are built on: their base, and times in UTC."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

from sqlalchemy import JSON, DateTime, Dialect, TypeDecorator
from sqlalchemy.orm import DeclarativeBase

MOMENT = timedelta(microseconds=1)  # by which the databases tell times apart


def utc_now() -> datetime:
    """Return the time in UTC."""
    return datetime.now(UTC)


def days_since(moment: datetime) -> int:
    """Return the whole days since a time; 0 where a clock that is fast has it ahead."""
    return max((utc_now() - moment).days, 0)


class Instant(TypeDecorator[datetime]):
    """A time in UTC; SQLite forgets the zone, this puts it back."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Write a time as UTC."""
        return value.astimezone(UTC) if value is not None and value.tzinfo is not None else value

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Read a time as UTC."""
        return value.replace(tzinfo=UTC) if value is not None and value.tzinfo is None else value


class Row(DeclarativeBase):
    """Base of all rows."""

    type_annotation_map = {  # noqa: RUF012 (SQLAlchemy reads it)
        datetime: Instant,
        dict[str, Any]: JSON(none_as_null=True),
        list[Any]: JSON,
    }
