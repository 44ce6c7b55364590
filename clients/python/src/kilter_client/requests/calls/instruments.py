"""Calls about instruments."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kilter_client.requests.steps import Document, Steps, get, post


def add(instrument: Mapping[str, Any]) -> Steps[Document]:
    """Add an instrument."""
    return post("/v1/instruments", {key: value for key, value in instrument.items() if value is not None})


def list_instruments() -> Steps[list[Document]]:
    """Return the instruments, by name."""
    found = yield from get("/v1/instruments")
    return list(found["instruments"])
