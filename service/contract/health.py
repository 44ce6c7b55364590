"""The state of the server."""

from __future__ import annotations

from typing import Literal

from service.contract.units import Strict


class Check(Strict):
    """One thing that was looked at."""

    ok: bool
    detail: str


class Health(Strict):
    """The state of the server."""

    status: Literal["live", "ready", "not_ready"]
    version: str
    checks: dict[str, Check]
