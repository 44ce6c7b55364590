"""Calls that find what a reference stands for, and those that campaigns and versions have in common.

Calls about tokens, who one is, and the audit.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from kilter_client.errors import ConflictError
from kilter_client.requests.steps import Document, Request, Steps, address, get, patch, post, read

Kind = Literal["campaign", "version", "job"]

FULL: Mapping[str, re.Pattern[str]] = {
    "campaign": re.compile("cmp_[0-9a-f]{16}"),
    "version": re.compile("ver_[0-9a-f]{16}"),
    "job": re.compile("job_[0-9a-f]{16}"),
}


@dataclass(frozen=True)
class Found:
    """What a reference stands for; ``by`` is "id", "prefix", "name", "number" or "latest".

    ``number`` counts the versions of a robot from 1; 0: not a version.
    """

    id: str
    robot: str
    name: str
    by: str
    number: int = 0


def is_full(kind: Kind, reference: str) -> bool:
    """Whether a reference is a whole id already."""
    return FULL[kind].fullmatch(reference) is not None


def resolve(kind: Kind, reference: str, robot: str | None = None) -> Steps[Found]:
    """Ask the server what a reference stands for, among those of a robot or of all."""
    document = yield from get("/v1/resolve", kind=kind, reference=reference, robot=robot or None)
    return Found(document["id"], document["robot"], document["name"], document["by"], document.get("number", 0))


def resolve_id(kind: Kind, reference: str, robot: str | None = None) -> Steps[str]:
    """Return the id that a reference stands for; a whole id is not asked for."""
    if FULL[kind].fullmatch(reference):
        return reference
    found = yield from resolve(kind, reference, robot)
    return found.id


def resolved_request(robot: str, request: Mapping[str, Any]) -> Steps[Document]:
    """Return a request for a job with ids instead of references, all of its robot."""
    out = dict(request)
    for key in ("campaigns", "validation", "confirmation"):
        if isinstance(out.get(key), list | tuple):
            ids = []
            for given in out[key]:
                found = yield from resolve_id("campaign", given, robot)
                ids.append(found)
            out[key] = ids
    options = dict(out.get("options") or {})
    for key in ("start", "version"):
        if isinstance(options.get(key), str):
            options[key] = yield from resolve_id("version", options[key], robot)
    return out | {"options": options}


def place(kind: Kind, reference: str, robot: str | None = None, *more: str) -> Steps[str]:
    """Return the path of what a reference stands for."""
    found = yield from resolve_id(kind, reference, robot)
    return address(f"{kind}s", found, *more)


def change(kind: Kind, reference: str, name: str | None, notes: str | None, robot: str | None) -> Steps[Document]:
    """Name it, or note something on it; what is None stays."""
    body = {key: value for key, value in (("name", name), ("notes", notes)) if value is not None}
    path = yield from place(kind, reference, robot)
    return (yield from patch(path, body))


def do(kind: Kind, reference: str, what: str, robot: str | None) -> Steps[Document]:
    """Retire or restore it."""
    path = yield from place(kind, reference, robot, what)
    return (yield from post(path))


def purge(kind: Kind, full_id: str) -> Steps[Document]:
    """Delete it for good."""
    return post(address(f"{kind}s", full_id, "purge"))


PAGE = 1000


def whoami() -> Steps[Document]:
    """Return who sends requests: name and id of the token, its role, and its robots (None: all)."""
    return get("/v1/whoami")


def login_link(minutes: int = 5) -> Steps[Document]:
    """Make a link that logs a browser in once, in the role of your token; ``path`` follows the server's address.

    ``minutes``: for how long it can be used, at most 60.
    """
    return post("/v1/login-links", {"minutes": minutes})


def add_token(
    name: str, role: str = "viewer", *, robots: Sequence[str] | None = None, days: int | None = 365
) -> Steps[Document]:
    """Make a token; what to send with requests is in ``token``, this once only.

    ``role`` is "viewer", "operator" or "admin"; ``robots`` None: of all robots; ``days`` None: it never expires.

    Raises:
        ConflictError: another token has the name.

    """
    body = {"name": name, "role": role, "robots": None if robots is None else [*robots], "days": days}
    return post("/v1/tokens", body)


def tokens() -> Steps[list[Document]]:
    """Return the tokens, newest first; also those that expired or were revoked."""
    found = yield from get("/v1/tokens")
    return list(found["tokens"])


def revoke_token(token: str) -> Steps[Document]:
    """End a token at once, by its id or by the name of one that was not revoked yet.

    Raises:
        NotFoundError: there is none.

    """
    if not token.startswith("tok_"):
        named = [one for one in (yield from tokens()) if one["name"] == token and one["revoked_at"] is None]
        token = named[0]["id"] if named else token
    return (yield from read(Request("DELETE", address("tokens", token))))


def audit() -> Steps[list[Document]]:
    """Return the audit, oldest entry first: who changed what, from where, before and after."""
    found: list[Document] = []
    after: str | None = None
    while True:
        page = yield from get("/v1/audit", limit=PAGE, after=after)
        found += page["entries"]
        after = page["next"]
        if after is None:
            return found


def verify_audit(head: str | None = None) -> Steps[Document]:
    """Compute all hashes of the audit anew on this side; return the number and the hash of its last entry.

    ``head`` is what an earlier call returned, as "NUMBER:SHA256": that entry must still be there.

    Raises:
        ConflictError: an entry was changed, left out or put in, or the noted one is not there any more.

    """
    number, sha256 = verify_entries((yield from audit()), head)
    return {"entries": number, "sha256": sha256, "head": f"{number}:{sha256}"}


def verify_entries(entries: Iterable[Document], head: str | None = None) -> tuple[int, str]:
    """Return number and hash of the last of entries that continue each other; raises as ``verify_audit`` does."""
    number, before, seen = 0, "", head in (None, "0:")
    for entry in entries:
        told = {key: value for key, value in entry.items() if key not in ("content", "previous", "sha256")}
        now = hashlib.sha256(f"{before}\n{entry['content']}".encode()).hexdigest()
        same_time = {"at": entry["at"]}  # the answer writes the moment otherwise than the stored text
        if (entry["number"], entry["previous"], entry["sha256"]) != (number + 1, before, now) or told != (
            json.loads(entry["content"]) | same_time
        ):
            raise _broken(f"Entry {number + 1} of the audit is not what was written, or is missing", number)
        number, before = number + 1, now
        seen = seen or head == f"{number}:{now}"
    if not seen:
        raise _broken(f"The audit does not hold entry {head}", number)
    return number, before


def _broken(what: str, whole: int) -> ConflictError:
    return ConflictError(
        f"{what}: somebody changed the database past Kilter, or it is damaged. Entries up to {whole} are whole; compare with "
        "a backup.",
        code="audit_broken",
        whole_up_to=whole,
    )


def health() -> Steps[Document]:
    """Return whether the server is ready."""
    return get("/v1/health")


def tombstones(robot: str | None = None) -> Steps[list[Document]]:
    """Return what was purged, newest first."""
    found = yield from get("/v1/tombstones", **({"robot": robot} if robot else {}))
    return list(found["tombstones"])
