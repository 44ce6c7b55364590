"""The state of the server.

What every error looks like.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field

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


class Problem(BaseModel):
    """What every error looks like (RFC 9457): ``code`` is stable, ``detail`` names the place and the remedy."""

    type: str = Field(description="`urn:kilter:problem:` and the code.")
    title: str = Field(description="What kind of error it is, in words.")
    status: int = Field(description="The HTTP status.")
    detail: str = Field(description="What is wrong, where, and what helps.")
    code: str = Field(description="Stable name of the error, for programs.")
    context: dict[str, Any] = Field(description="Names and numbers of the detail, by code.")
    request_id: str = Field(description="Id of the request, as the server's log has it.")


# For the OpenAPI document: the answers every route may give besides its own.
REFUSALS: dict[int | str, dict[str, Any]] = {
    status: {"model": Problem, "description": "Problem document"} for status in ("4XX", 422, "5XX")
}
