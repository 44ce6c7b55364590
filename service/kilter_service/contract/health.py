"""The state of the server."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from kilter_service.contract.units import Strict


class Check(Strict):
    """One thing that was looked at."""

    ok: bool = Field(description="Whether it is as it should be.")
    detail: str = Field(description="What was found, in words.")


class Health(Strict):
    """The state of the server."""

    status: Literal["live", "ready", "not_ready"] = Field(
        description="`live`: it answers; `ready`: it can do its work."
    )
    version: str = Field(description="Release of the server.")
    checks: dict[str, Check] = Field(description="What was looked at, by name.")
