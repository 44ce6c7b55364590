"""Calls that find what a reference stands for, and those that campaigns and versions have in common."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from kilter_client.requests.steps import Document, Steps, address, get, patch, post

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
