"""Answers hold all that jobs wrote: what the contract does not know would be left out of them."""

from __future__ import annotations

from typing import Any

from kilter_service.ground.db import Database
from kilter_service.jobs import store

MADE_WHEN_READ = {"headline", "found"}  # of the rest of the result


def same_as_stored(database: Database, job: dict[str, Any]) -> None:
    """Compare the result of a job as answered with what its worker stored."""
    with database.reading() as session:
        answered = {name: value for name, value in job["result"].items() if name not in MADE_WHEN_READ}
        assert answered == store.get(session, job["id"]).result
