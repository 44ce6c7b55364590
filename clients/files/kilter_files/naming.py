"""Whether a campaign at the server is the one that a file wants to be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kilter_client.references import is_called


def same(known: Mapping[str, Any], wanted: Mapping[str, Any]) -> bool:
    """Whether a campaign is the wanted one: device, role, and its name, perhaps with a number behind it."""
    alike = all(known[key] == wanted[key] for key in ("device", "role"))
    called = is_called(known["name"], wanted["name"]) if wanted.get("numbered") else known["name"] == wanted["name"]
    return alike and called
