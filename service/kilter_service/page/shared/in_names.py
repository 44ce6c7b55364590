"""Sentences of the interface, which name by ids so that a program can ask further, as people read them: by names."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from kilter_core.errors import CoreError
from kilter_service.campaigns import service as campaigns
from kilter_service.contract.versions import Objection
from kilter_service.ground.called import display_name
from kilter_service.ground.db import Database
from kilter_service.jobs import service as jobs
from kilter_service.versions import service as versions

ID = re.compile(r"(?:\b[Vv]ersion )?\b(ver|cmp|job)_[0-9a-f]{16}\b")
KINDS: Mapping[str, Callable[[Database, str], Any]] = {
    "ver": versions.get,
    "cmp": campaigns.get,
    "job": jobs.get,
}


def in_names(database: Database, text: str) -> str:
    """Write names for the ids of a sentence; of what is gone the id stays."""

    def name(found: re.Match[str]) -> str:
        before, _, what = found[0].rpartition(" ")
        try:
            said = display_name(KINDS[found[1]](database, what))
        except CoreError:
            return found[0]
        return said if not before or said.startswith("version ") else f"{before} {said}"

    return ID.sub(name, text)


def objections_in_names(database: Database, found: list[Objection]) -> list[Objection]:
    """Return objections whose sentences name by names."""
    return [one.model_copy(update={"message": in_names(database, one.message)}) for one in found]
