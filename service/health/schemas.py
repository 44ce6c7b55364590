"""Wire types of the health routes."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict


class Check(BaseModel):
    """One thing that was looked at."""

    model_config = ConfigDict(extra="forbid")
    ok: bool
    detail: str


class Health(BaseModel):
    """The state of the server."""

    model_config = ConfigDict(extra="forbid")
    status: Literal["live", "ready", "not_ready"]
    version: str
    checks: dict[str, Check]
