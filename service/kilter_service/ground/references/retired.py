"""What is retired is out of use: it can be looked at, not worked with."""

from __future__ import annotations

from datetime import datetime

from kilter_service.ground.errors import ServiceError


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
