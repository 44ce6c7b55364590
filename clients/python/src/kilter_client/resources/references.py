"""What stands for an id: the beginning of it, a name, or ``latest``; and what people call, note, retire and purge.

Whether a campaign at the server is the one that a file wants to be.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime
from typing import Any, ClassVar

from kilter_client.requests.calls import references
from kilter_client.requests.calls.references import Found, Kind, is_full
from kilter_client.requests.connection import Connection
from kilter_client.requests.steps import Document

__all__ = ["Found", "Kept", "Kind", "Resource", "is_full"]


class Resource:
    """What can be asked about one kind of thing, over a connection."""

    def __init__(self, connection: Connection) -> None:
        self._run = connection.run


class Kept(Resource):
    """What campaigns and versions have in common. An id may be its beginning, a name, or ``latest`` of a robot."""

    kind: ClassVar[Kind]

    def resolve_id(self, reference: str, robot: str | None = None) -> str:
        """Return the id that a reference stands for."""
        return self._run(references.resolve_id(self.kind, reference, robot))

    def change(
        self, reference: str, *, name: str | None = None, notes: str | None = None, robot: str | None = None
    ) -> Document:
        """Name it, or note something on it; what is left out stays."""
        return self._run(references.change(self.kind, reference, name, notes, robot))

    def retire(self, reference: str, robot: str | None = None) -> Document:
        """Take it out of use; what cites it does not change."""
        return self._run(references.do(self.kind, reference, "retire", robot))

    def restore(self, reference: str, robot: str | None = None) -> Document:
        """Bring it back into use."""
        return self._run(references.do(self.kind, reference, "restore", robot))

    def purge(self, full_id: str) -> Document:
        """Delete it for good, by its full id, if nothing cites it; returns what is left: its hash, who and when."""
        return self._run(references.purge(self.kind, full_id))


def is_same_campaign(known: Mapping[str, Any], wanted: Mapping[str, Any]) -> bool:
    """Whether a campaign is the wanted one: its name, perhaps with a number behind it, and all that is stated of its rows.

    The same rows at another temperature, with another payload or by another instrument are another campaign: what is
    stated of them is never dropped because they were sent before with less.
    """
    numbered = r"( \(\d+\))?" if wanted.get("numbered") else ""  # the server put it behind a name that was taken
    called = re.fullmatch(re.escape(wanted["name"]) + numbered, known["name"]) is not None
    alike = all((known.get(key) or "") == (wanted.get(key) or "") for key in ("device", "role", "notes", "instrument"))
    there, asked = (one.get("conditions") or {} for one in (known, wanted))
    named = [{name for name, value in one.items() if value is not None} for one in (there, asked)]
    holds = named[0] == named[1] and _agree(there, asked)
    return called and alike and holds and _day(known.get("measured_at")) == _day(wanted.get("measured_at"))


def _agree(there: Any, asked: Any) -> bool:
    """Whether what is asked stands there; the server adds what a document leaves to its defaults."""
    if isinstance(asked, Mapping) and isinstance(there, Mapping):
        return all(_agree(there.get(name), value) for name, value in asked.items() if value is not None)
    if isinstance(asked, list | tuple) and isinstance(there, list | tuple):
        return len(there) == len(asked) and all(_agree(a, b) for a, b in zip(there, asked, strict=True))
    return bool(there == asked)


def _day(moment: str | None) -> object:
    """The day of a time: one that is given as today ends now, at each sending a little later."""
    return None if moment is None else datetime.fromisoformat(moment).astimezone().date()
