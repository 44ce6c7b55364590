"""The state of the server, what every error looks like, tokens, and the audit of who did what."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from kilter_service.contract.units import MAX_NAMED, Listed, Name, Strict


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


class AuditChange(Strict):
    """One thing that a request changed."""

    thing: str = Field(description="What it is: a kind of entry and its key, or `active_version`.")
    before: str = Field(description="What it was, as JSON text; empty: it was not there. A long value is its SHA-256.")
    after: str = Field(description="What it is since, as JSON text; empty: it is gone.")


class AuditEntry(Strict):
    """What one request changed, and who sent it. Its hash covers `previous`, a line break and `content`."""

    number: int = Field(description="Its number, from 1 without gaps.")
    at: datetime = Field(description="When it was changed.")
    actor: str = Field(description="Name of the token; `admin`: the server's own.")
    token_id: str = Field(description="Id of the token; empty: the server's own.")
    role: str = Field(description="Role of the token.")
    address: str = Field(description="Network address the request came from.")
    route: str = Field(description="Method and path of the route.")
    place: str = Field(description="What the path named, as JSON text.")
    changes: list[AuditChange] = Field(description="What was changed, at most 100 things.")
    more: int = Field(description="How many further things were changed.")
    content: str = Field(description="All of this as it was stored, as JSON text: what the hash covers.")
    previous: str = Field(description="SHA-256 of the entry before; empty for the first.")
    sha256: str = Field(description="SHA-256 of the entry.")


class AuditPage(Listed):
    """The audit, oldest first."""

    entries: list[AuditEntry] = Field(description="Entries of the audit, oldest first.")


Role = Literal["viewer", "operator", "admin"]
TokenName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.@-]{0,63}$")]
NAME = "Whose token it is or what it is for; the records of changes show it."
ROLE = (
    "`viewer` reads; `operator` also uploads, runs jobs, corrects and activates; `admin` also has robots, tokens, purging "
    "and the audit."
)
ROBOTS = "Names of the robots it is limited to; null: all robots. A robot of that name may be added later."


class NewToken(Strict):
    """A token to make."""

    name: TokenName = Field(description=NAME)
    role: Role = Field(description=ROLE)
    robots: Annotated[list[Name], Field(min_length=1, max_length=MAX_NAMED)] | None = Field(None, description=ROBOTS)
    days: Annotated[int, Field(ge=1, le=3650)] | None = Field(
        365, description="After how many days it expires; null: never."
    )


class Token(Strict):
    """A token; what is sent with requests is shown once, when it is made."""

    id: str = Field(description="Its id.")
    name: str = Field(description=NAME)
    role: Role = Field(description=ROLE)
    robots: list[str] | None = Field(description=ROBOTS)
    created_at: datetime = Field(description="When it was made.")
    created_by: str = Field(description="Who made it.")
    expires_at: datetime | None = Field(description="When it expires; null: never.")
    revoked_at: datetime | None = Field(description="When it was revoked; null: it was not.")
    revoked_by: str = Field(description="Who revoked it; empty: nobody.")


class MadeToken(Token):
    """A token that was just made."""

    token: str = Field(description="What to send with requests (KILTER_TOKEN); it is shown this once only.")


class NewLoginLink(Strict):
    """A link to log in at the page with."""

    minutes: Annotated[int, Field(ge=1, le=60)] = Field(5, description="For how long it can be used, minutes.")


class LoginLink(Strict):
    """A link that logs a browser in once, in the role of whoever asked for it."""

    path: str = Field(
        description="To append to the address of the server. What is behind `#` stays in the browser and is in no log."
    )
    expires_at: datetime = Field(description="Until when it can be used, once.")


class TokenList(Listed):
    """Tokens, newest first."""

    tokens: list[Token] = Field(description="The tokens, newest first.")


class Identity(Strict):
    """Who sends this request, and what that allows."""

    actor: str = Field(description="Name of the token; `admin`: the server's own; `anybody`: no token was needed.")
    token_id: str = Field(description="Id of the token; empty: the server's own, or none.")
    role: Role = Field(description=ROLE)
    robots: list[str] | None = Field(description=ROBOTS)
