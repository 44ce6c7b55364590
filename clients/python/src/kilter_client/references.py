"""What stands for an id: the beginning of it, a name, or ``latest``; and what people call, note, retire and purge."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from kilter_client.connection import Connection, Document, address

Kind = Literal["campaign", "version", "job"]

FULL: Mapping[str, re.Pattern[str]] = {
    "campaign": re.compile("cmp_[0-9a-f]{16}"),
    "version": re.compile("ver_[0-9a-f]{16}"),
    "job": re.compile("job_[0-9a-f]{16}"),
}


@dataclass(frozen=True)
class Found:
    """What a reference stands for; ``by`` is "id", "prefix", "name" or "latest"."""

    id: str
    robot: str
    name: str
    by: str


def is_full(kind: Kind, reference: str) -> bool:
    """Whether a reference is a whole id already."""
    return FULL[kind].fullmatch(reference) is not None


def resolve(connection: Connection, kind: Kind, reference: str, robot: str | None = None) -> Found:
    """Ask the server what a reference stands for, among those of a robot or of all.

    Raises:
        NotFoundError: nothing; the sentence lists what there is.
        ConflictError: more than one thing; the sentence lists them.

    """
    asked = {"kind": kind, "reference": reference} | ({"robot": robot} if robot else {})
    document = connection.get("/v1/resolve", **asked)
    return Found(document["id"], document["robot"], document["name"], document["by"])


def id_of(connection: Connection, kind: Kind, reference: str, robot: str | None = None) -> str:
    """Return the id that a reference stands for; a whole id is not asked for."""
    return reference if is_full(kind, reference) else resolve(connection, kind, reference, robot).id


def is_called(known: str, wanted: str) -> bool:
    """Whether a name is the wanted one, or that with the number which the server put behind it."""
    return known == wanted or re.fullmatch(re.escape(wanted) + r" \(\d+\)", known) is not None


class Kept:
    """What campaigns and versions have in common. An id may be its beginning, a name, or ``latest`` of a robot."""

    kind: ClassVar[Kind]

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def id_of(self, reference: str, robot: str | None = None) -> str:
        """Return the id that a reference stands for."""
        return id_of(self._connection, self.kind, reference, robot)

    def change(
        self, reference: str, *, name: str | None = None, notes: str | None = None, robot: str | None = None
    ) -> Document:
        """Name it, or note something on it; what is left out stays."""
        body = {key: value for key, value in (("name", name), ("notes", notes)) if value is not None}
        return self._connection.patch(self._address(reference, robot), body)

    def retire(self, reference: str, robot: str | None = None) -> Document:
        """Take it out of use; what cites it stays as it is."""
        return self._connection.post(self._address(reference, robot, "retire"))

    def restore(self, reference: str, robot: str | None = None) -> Document:
        """Bring it back into use."""
        return self._connection.post(self._address(reference, robot, "restore"))

    def purge(self, full_id: str) -> Document:
        """Delete it for good, by its full id, if nothing cites it; returns what is left: its hash, who and when."""
        return self._connection.post(address(f"{self.kind}s", full_id, "purge"))

    def _address(self, reference: str, robot: str | None, *more: str) -> str:
        return address(f"{self.kind}s", self.id_of(reference, robot), *more)


def resolved_request(connection: Connection, robot: str, request: Mapping[str, Any]) -> Document:
    """Return a request for a job with ids in the place of references, all of its robot."""

    def ids(kind: Kind, given: Any) -> Any:
        if isinstance(given, str):
            return id_of(connection, kind, given, robot)
        return [id_of(connection, kind, one, robot) for one in given]

    out = dict(request)
    for key in ("campaigns", "validation", "confirmation"):
        if isinstance(out.get(key), list | tuple):
            out[key] = ids("campaign", out[key])
    options = dict(out.get("options") or {})
    for key in ("start", "version"):
        if isinstance(options.get(key), str):
            options[key] = ids("version", options[key])
    return out | {"options": options}
