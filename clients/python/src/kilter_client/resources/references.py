"""What stands for an id: the beginning of it, a name, or ``latest``; and what people call, note, retire and purge."""

from __future__ import annotations

from typing import ClassVar

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
