"""Tokens as they are stored: of the secret only its hash."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from kilter_service.contract.tokens import Role


@dataclass(frozen=True)
class TokenRecord:
    """A token; ``robots`` None: of all robots."""

    id: str
    name: str
    role: Role
    robots: list[str] | None
    created_at: datetime
    created_by: str
    expires_at: datetime | None
    revoked_at: datetime | None
    revoked_by: str
