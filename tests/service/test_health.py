from __future__ import annotations

import asyncio
import os

import httpx
import pytest

from kilter_service.app import create_app
from kilter_service.db import Database
from kilter_service.errors import ServiceError
from kilter_service.health import store
from kilter_service.settings import Settings


def test_live_says_the_version(client: httpx.Client) -> None:
    assert client.get("/v1/health/live").json()["status"] == "live"


def test_ready_needs_a_worker(client: httpx.Client, database: Database) -> None:
    answer = client.get("/v1/health/ready")
    assert answer.status_code == 503
    assert answer.json()["code"] == "not_ready"
    assert "kilterd worker" in answer.json()["detail"]
    with database.transaction() as session:
        store.beat(session, "worker", "here", os.getpid())
    assert client.get("/v1/health/ready").json()["status"] == "ready"
    with database.transaction() as session:
        store.silence(session, "worker", "here")
    assert client.get("/v1/health").json()["status"] == "not_ready"


def test_a_database_of_another_revision_is_refused_with_the_remedy(settings: Settings) -> None:
    app = create_app(settings)

    async def start() -> None:
        async with app.router.lifespan_context(app):
            pass

    with pytest.raises(ServiceError, match="kilterd migrate"):
        asyncio.run(start())
