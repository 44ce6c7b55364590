"""Versions as people read them: `tour v2` for the second of `tour`. Programs read ids with --json."""

from __future__ import annotations

import re
from functools import cache

from kilter_client import Kilter
from kilter_client.errors import KilterError

ID = re.compile(r"\bver_[0-9a-f]{16}\b")


def name_versions(text: str) -> str:
    """Return a text with versions by number instead of id; an id that the server does not know stays."""
    return ID.sub(lambda found: _number_of_version(found[0]), text)


@cache
def _number_of_version(version_id: str) -> str:
    try:
        with Kilter() as kilter:
            found = kilter.resolve("version", version_id)
    except KilterError:
        return version_id
    return f"{found.robot} v{found.number}" if found.number else version_id
