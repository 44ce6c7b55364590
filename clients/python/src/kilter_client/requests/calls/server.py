"""Calls about the server itself."""

from __future__ import annotations

from kilter_client.requests.steps import Document, Steps, get


def health() -> Steps[Document]:
    """Return whether the server is ready."""
    return get("/v1/health")


def tombstones(robot: str | None = None) -> Steps[list[Document]]:
    """Return what was purged, newest first."""
    found = yield from get("/v1/tombstones", **({"robot": robot} if robot else {}))
    return list(found["tombstones"])
