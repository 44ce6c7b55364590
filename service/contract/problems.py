"""What every error looks like."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel


class Problem(BaseModel):
    """What every error looks like (RFC 9457): ``code`` is stable, ``detail`` names the place and the remedy."""

    type: str
    title: str
    status: int
    detail: str
    code: str
    context: dict[str, Any]
    request_id: str
