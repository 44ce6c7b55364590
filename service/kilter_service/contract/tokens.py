"""Tokens: who may do what; and the audit of who did what."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field

from kilter_service.contract.units import MAX_NAMED, Listed, Name, Strict


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
