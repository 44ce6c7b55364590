"""The admin token: made at first start, kept in a file only its owner can read."""

from __future__ import annotations

import os
import secrets
import stat

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings, check_strong


def admin_token(settings: Settings) -> str:
    """Return the token that changes need; the first start of a data folder makes it (mode 0600).

    Raises:
        ServiceError: the token file can be read by others, or holds a token that can be guessed.

    """
    if settings.token is not None:
        return settings.token.get_secret_value()
    settings.data.mkdir(parents=True, exist_ok=True)
    # Two processes may start at once: whoever links the finished file first wins, the other reads it.
    if not settings.token_file.exists():
        _offer(settings)
    if stat.S_IMODE(settings.token_file.stat().st_mode) & 0o077:
        raise ServiceError(
            f"{settings.token_file} can be read by others: run `chmod 600 {settings.token_file}`.",
            code="token_file_open",
            path=str(settings.token_file),
        )
    token = settings.token_file.read_text(encoding="ascii", errors="replace").strip()
    try:
        check_strong(token)
    except ValueError as error:
        raise ServiceError(
            f"In {settings.token_file} {error}, or delete the file: the next start makes a new one.",
            code="token_weak",
            path=str(settings.token_file),
        ) from error
    return token


def _offer(settings: Settings) -> None:
    draft = settings.token_file.with_name(f"{settings.token_file.name}.{os.getpid()}")
    with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w", encoding="ascii") as file:
        file.write(secrets.token_urlsafe(32) + "\n")
    try:
        os.link(draft, settings.token_file)
    except FileExistsError:
        return
    finally:
        draft.unlink()
