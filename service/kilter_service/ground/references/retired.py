"""What is retired is out of use: it can be looked at, not worked with."""

from __future__ import annotations

from datetime import datetime

from kilter_service.ground.errors import ServiceError

# The command that lists, names and retires what there is of a kind.
COMMANDS = {"robot": "robot", "campaign": "measure campaigns", "version": "version"}


def refuse(kind: str, id_: str, retired_at: datetime | None) -> None:
    """Refuse to work with what is retired.

    Raises:
        ServiceError: it is.

    """
    if retired_at is not None:
        raise ServiceError(
            f"{kind.capitalize()} {id_} is retired since {retired_at:%Y-%m-%d}: take another, or bring it back with "
            f"`kilter {COMMANDS[kind]} restore {id_}`.",
            code="retired",
            kind=kind,
            id=id_,
        )
