"""Answers hold all that jobs wrote: what the contract does not know would be left out of them."""

from __future__ import annotations

from typing import Any

from kilter_service.ground.db import Database
from kilter_service.jobs import store


def same_as_stored(database: Database, job: dict[str, Any]) -> None:
    """Compare the result of a job as answered with what its worker stored."""
    with database.reading() as session:
        assert job["result"] == store.get(session, job["id"]).result
