"""Events of jobs: resumed where they broke off, and free for those that only wait."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

import httpx
import pytest
from fastapi import FastAPI
from sqlalchemy import event, update

from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import JobRow
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from kilter_service.web.auth.token import admin_token


class Event(NamedTuple):
    id: str
    name: str
    data: Any


@pytest.fixture
def app(settings: Settings, database: Database) -> FastAPI:
    return create_app(settings)


@pytest.fixture
def http(app: FastAPI, settings: Settings, serve: Callable[[FastAPI], httpx.Client]) -> httpx.Client:
    client = serve(app)
    client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
    client.timeout = httpx.Timeout(30, pool=60)
    return client


@pytest.fixture
def job(http: httpx.Client, katana: Any) -> str:
    campaign = katana.campaign(http, 8)
    wish = {"kind": "identify", "robot": "katana", "campaigns": [campaign]}
    return str(http.post("/v1/jobs", json=wish).raise_for_status().json()["id"])


@contextmanager
def followed(http: httpx.Client, job: str, last: str | None = None) -> Iterator[Iterator[Event]]:
    headers = {} if last is None else {"Last-Event-ID": last}
    with http.stream("GET", f"/v1/jobs/{job}/events", headers=headers) as answer:
        assert answer.status_code == 200
        yield events(answer.iter_lines())


def events(lines: Iterator[str]) -> Iterator[Event]:
    fields: dict[str, str] = {}
    for line in lines:
        name, _, value = line.partition(": ")
        if line and name:
            fields[name] = value
        elif not line and fields:
            yield Event(fields["id"], fields["event"], json.loads(fields["data"]))
            fields = {}


def advance(database: Database, job: str, fraction: float, stage: str) -> None:
    with database.noting() as session:
        session.execute(update(JobRow).where(JobRow.id == job).values(fraction=fraction, stage=stage))


def test_who_comes_back_is_told_only_what_is_new(http: httpx.Client, database: Database, job: str) -> None:
    advance(database, job, 0.25, "fitting")
    with followed(http, job) as news:
        first = next(news)
    assert first.data == {"id": job, "state": "queued", "progress": {"fraction": 0.25, "stage": "fitting"}}
    with followed(http, job) as news:
        assert next(news) == first, "the same news have the same id"
    with followed(http, job, first.id) as news:
        advance(database, job, 0.5, 'she said "on"')
        second = next(news)
    assert second.id != first.id
    assert second.data["progress"] == {"fraction": 0.5, "stage": 'she said "on"'}
    with followed(http, job, first.id) as news:
        assert next(news) == second, "what was missed meanwhile is told at once"
        http.post(f"/v1/jobs/{job}/cancel").raise_for_status()
        end = next(news)
        assert list(news) == []
    assert (end.name, end.data["state"]) == ("end", "cancelled")
    with followed(http, job, second.id) as news:
        assert list(news) == [end]


def test_who_knows_the_end_is_sent_away(http: httpx.Client, job: str) -> None:
    http.post(f"/v1/jobs/{job}/cancel").raise_for_status()
    with followed(http, job) as news:
        (end,) = news
    answer = http.get(f"/v1/jobs/{job}/events", headers={"Last-Event-ID": end.id})
    assert (answer.status_code, answer.content) == (204, b"")  # an EventSource connects no more


def test_followers_cost_the_database_nothing_each(
    http: httpx.Client, app: FastAPI, database: Database, job: str
) -> None:
    count, queries = 40, []
    http.headers["Connection"] = "close"
    with ExitStack() as stack, ThreadPoolExecutor(count) as pool:
        streams = [stack.enter_context(followed(http, job)) for _ in range(count)]
        told = list(pool.map(next, streams))
        assert len({one.id for one in told}) == 1
        note = lambda *_: queries.append(1)  # noqa: E731
        event.listen(app.state.database.engine, "before_cursor_execute", note)
        time.sleep(1.0)
        # One follower alone made 5 looks of several queries a second; a slow machine makes fewer.
        assert 0 < len(queries) < 5 * count
        queries.clear()
        http.post(f"/v1/jobs/{job}/cancel").raise_for_status()
        ends = list(pool.map(next, streams))
    assert {one.name for one in ends} == {"end"}
    assert len(queries) < 5 * count


def test_a_first_follower_who_sees_one_robot_limits_nobody_else(http: httpx.Client, job: str) -> None:
    other = {"name": "theirs", "convention": "preset", "preset": "katana450-chapter5"}
    http.post("/v1/robots", json=other).raise_for_status()
    theirs = http.post("/v1/jobs", json={"kind": "plan", "robot": "theirs", "options": {"purpose": "iso9283"}}).json()
    limited = http.post("/v1/tokens", json={"name": "theirs-only", "role": "viewer", "robots": ["theirs"]}).json()
    headers = {"Authorization": f"Bearer {limited['token']}"}
    with http.stream("GET", f"/v1/jobs/{theirs['id']}/events", headers=headers) as first:
        assert next(events(first.iter_lines())).data["state"] == "queued"
        with followed(http, job) as news:
            next(news)
            http.post(f"/v1/jobs/{job}/cancel").raise_for_status()
            assert next(news).data["state"] == "cancelled"
