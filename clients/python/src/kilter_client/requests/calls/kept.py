"""Calls about what campaigns and versions have in common: names, notes, retiring and purging."""

from __future__ import annotations

from kilter_client.requests.calls.references import Kind, resolve_id
from kilter_client.requests.steps import Document, Steps, address, patch, post


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
