"""What is retired is out of use: it can be looked at, not worked with."""

from __future__ import annotations

from datetime import datetime
from typing import Protocol

from kilter_service.db.tables import now
from kilter_service.errors import ServiceError


class Retirable(Protocol):
    """A row that may be retired."""

    retired_at: datetime | None
    retired_by: str


def retire(row: Retirable, actor: str) -> None:
    """Take something out of use; again changes nothing."""
    if row.retired_at is None:
        row.retired_at, row.retired_by = now(), actor


def restore(row: Retirable) -> None:
    """Bring something back into use."""
    row.retired_at, row.retired_by = None, ""


def refuse(kind: str, id_: str, retired_at: datetime | None) -> None:
    """Refuse to work with what is retired.

    Raises:
        ServiceError: it is.

    """
    if retired_at is not None:
        command = "robot" if kind == "robot" else f"{kind}s"
        raise ServiceError(
            f"{kind.capitalize()} {id_} is retired since {retired_at:%Y-%m-%d}: take another, or bring it back with "
            f"`kilter {command} restore {id_}`.",
            code="retired",
            kind=kind,
            id=id_,
        )
