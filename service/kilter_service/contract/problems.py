"""What every error looks like."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, Field


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
