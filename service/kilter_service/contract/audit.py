"""The audit over HTTP: who changed what, from where, before and after."""

from __future__ import annotations

from datetime import datetime

from pydantic import Field

from kilter_service.contract.units import Listed, Strict


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
