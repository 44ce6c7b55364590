"""Lists page by page: every entry once, whatever is added meanwhile."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from sqlalchemy import Engine, event

from kilter_service.ground.db import Database, tables
from tests.service.made_versions import store_version

ROWS = {**{f"q{j}_deg": [10.0, 20.0] for j in range(1, 6)}, "y_mm": [1.0, 2.0], "z_mm": [3.0, 4.0]}
PRESET = {"convention": "preset", "preset": "katana450-chapter4"}


def pages(
    client: httpx.Client, address: str, field: str, limit: int, between: Callable[[], Any] = lambda: None, **more: Any
) -> Any:
    """All entries of a list, read ``limit`` at a time."""
    found, after = [], None
    while True:
        query = more | {"limit": limit} | ({"after": after} if after else {})
        answer = client.get(address, params=query).raise_for_status().json()
        assert len(answer[field]) <= limit
        found += answer[field]
        after = answer["next"]
        if after is None:
            return found
        between()


@pytest.fixture
def robot(client: httpx.Client) -> str:
    client.post("/v1/robots", json={"name": "m", **PRESET}).raise_for_status()
    return "m"


def test_robots_are_listed_by_name_page_by_page(client: httpx.Client) -> None:
    names = ["a", "b", "c", "d", "e"]
    for name in names:
        client.post("/v1/robots", json={"name": name, **PRESET}).raise_for_status()
    assert client.get("/v1/robots").json()["next"] is None
    first = lambda: client.post("/v1/robots", json={"name": "aa", **PRESET})  # noqa: E731 (before what is listed)
    assert [one["name"] for one in pages(client, "/v1/robots", "robots", 2, first)] == names
    assert [one["name"] for one in pages(client, "/v1/robots", "robots", 6)] == ["a", "aa", *names[1:]]


def test_campaigns_are_listed_oldest_first_with_those_added_meanwhile(client: httpx.Client, robot: str) -> None:
    address, numbers = f"/v1/robots/{robot}/campaigns", iter(range(3, 9))
    add = lambda k: client.post(address, json={"name": str(k)}).raise_for_status()  # noqa: E731
    for k in range(3):
        add(k)
    found = pages(client, address, "campaigns", 1, lambda: (k := next(numbers)) < 5 and add(k))
    assert [one["name"] for one in found] == ["0", "1", "2", "3", "4"]


def test_what_is_retired_is_on_no_page_unless_it_is_asked_for(client: httpx.Client, robot: str) -> None:
    address = f"/v1/robots/{robot}/campaigns"
    ids = [client.post(address, json={"name": str(k)}).raise_for_status().json()["id"] for k in range(5)]
    for retired in (ids[1], ids[2]):
        client.post(f"/v1/campaigns/{retired}/retire").raise_for_status()
    assert [one["id"] for one in pages(client, address, "campaigns", 2)] == [ids[0], ids[3], ids[4]]
    found = pages(client, address, "campaigns", 2, retired=True)
    assert [(one["id"], one["retired_at"] is not None) for one in found] == list(
        zip(ids, (False, True, True, False, False), strict=True)
    )
    client.post("/v1/robots", json={"name": "n", **PRESET}).raise_for_status()
    client.post(f"/v1/robots/{robot}/retire").raise_for_status()
    assert [one["name"] for one in pages(client, "/v1/robots", "robots", 1)] == ["n"]
    assert [one["name"] for one in pages(client, "/v1/robots", "robots", 1, retired=True)] == ["m", "n"]


def test_tombstones_are_listed_newest_first_without_those_added_meanwhile(client: httpx.Client, robot: str) -> None:
    def purged(name: str) -> str:
        campaign = client.post(f"/v1/robots/{robot}/campaigns", json={"name": name}).raise_for_status().json()["id"]
        client.post(f"/v1/campaigns/{campaign}/purge").raise_for_status()
        return str(campaign)

    ids = [purged(str(k)) for k in range(3)]
    found = pages(client, "/v1/tombstones", "tombstones", 1, lambda: purged("x"), robot=robot)
    assert [one["id"] for one in found] == ids[::-1]


def test_jobs_are_listed_newest_first_without_those_added_meanwhile(client: httpx.Client, robot: str) -> None:
    body = {"kind": "plan", "robot": robot, "options": {"purpose": "identify"}}
    ids = [client.post("/v1/jobs", json=body).raise_for_status().json()["id"] for _ in range(3)]
    found = pages(client, "/v1/jobs", "jobs", 1, lambda: client.post("/v1/jobs", json=body))
    assert [one["id"] for one in found] == ids[::-1]


@pytest.mark.parametrize(
    "address", ["/v1/robots", "/v1/jobs", "/v1/robots/m/versions", "/v1/robots/m/activations", "/v1/tombstones"]
)
@pytest.mark.parametrize("after", ["nonsense", "WyJhIiwgImIiXQ", "WzFd", "e30", "WyJ4IiwgInkiLCAieiJd"])
def test_what_is_no_cursor_is_refused(shared_client: httpx.Client, address: str, after: str) -> None:
    shared_client.post("/v1/robots", json={"name": "m", **PRESET}).raise_for_status()
    answer = shared_client.get(address, params={"after": after})
    assert (answer.status_code, answer.json()["code"]) == (422, "payload_invalid"), answer.text
    assert "`next`" in answer.json()["detail"]


@contextmanager
def statements() -> Iterator[list[str]]:
    """What is asked of any database meanwhile."""
    asked: list[str] = []

    def note(_connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
        asked.append(statement)

    event.listen(Engine, "before_cursor_execute", note)
    try:
        yield asked
    finally:
        event.remove(Engine, "before_cursor_execute", note)


LISTS = ("robots", "robots/m/campaigns", "jobs", "robots/m/versions", "robots/m/activations", "tokens")


def test_longer_lists_ask_the_database_no_more_often(client: httpx.Client, database: Database, robot: str) -> None:
    asked: dict[str, list[int]] = {}
    for number in range(4):
        name = f"r{number}"
        client.post("/v1/robots", json={"name": name, **PRESET}).raise_for_status()
        for k, one in enumerate((robot, name)):
            made = store_version(database, one, 2 * number + k)
            client.post(f"/v1/versions/{made}/activate", json={"force": True}).raise_for_status()
        campaign = client.post(f"/v1/robots/{robot}/campaigns", json={"name": name}).raise_for_status().json()["id"]
        rows = {**ROWS, "x_mm": [1.0 + number, 2.0]}
        client.post(f"/v1/campaigns/{campaign}/observations", json=rows).raise_for_status()
        client.post("/v1/jobs", json={"kind": "identify", "robot": robot, "campaigns": [campaign]}).raise_for_status()
        client.post("/v1/tokens", json={"name": name, "role": "viewer"}).raise_for_status()
        for address in ("/", *(f"/v1/{each}" for each in LISTS)):
            client.get(address).raise_for_status()
            counts = []
            for _ in range(2):  # what the server asks by itself, now and then, may fall into one of them
                with statements() as said:
                    client.get(address).raise_for_status()
                counts.append(len(said))
            asked.setdefault(address, []).append(min(counts))
    assert all(len(set(counts)) == 1 for counts in asked.values()), asked


def test_what_is_made_after_the_clock_was_set_back_comes_first(
    client: httpx.Client, robot: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    wishes = {"tokens": {"role": "viewer"}, "fleet-jobs": {"robots": [robot], "options": {"level": 1}}}
    for hours, name in ((0, "before"), (-24, "after"), (-23, "last")):
        clock = SimpleNamespace(now=lambda zone, h=hours: datetime.now(zone) + timedelta(hours=h))
        monkeypatch.setattr(tables, "datetime", clock)
        for address, wish in wishes.items():
            client.post(f"/v1/{address}", json={"name": name, **wish}).raise_for_status()
    for address, field in (("tokens", "tokens"), ("fleet-jobs", "fleet_jobs")):
        assert [one["name"] for one in pages(client, f"/v1/{address}", field, 2)] == ["last", "after", "before"]
