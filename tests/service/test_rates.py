"""How often one sender may ask, and how slowly it may send."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from kilter_client import Kilter
from kilter_client.requests.steps import post
from kilter_service.contract.robot_reports import Frame, NewFrame
from kilter_service.contract.server import NewToken
from kilter_service.ground.caller import CALLER, Caller
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.robots import routes
from kilter_service.run.app import create_app
from kilter_service.web import gate, logins
from kilter_service.web.auth.token import admin_token
from kilter_service.web.gate import MOST_SENDERS, Rates, TimedConnection

from .conftest import served

Serve = Callable[[FastAPI], httpx.Client]


def refusals(rates: Rates, sender: str, count: int) -> list[int]:
    """Ask so often at once; return after how many seconds each refused one may come again."""
    found = []
    for _ in range(count):
        try:
            rates.count_request(sender)
        except ServiceError as error:
            found.append(error.context["retry_after_s"])
    return found


def test_a_sender_may_ask_so_often_and_each_has_its_own_count() -> None:
    clock = [0.0]
    rates = Rates(2.0, lambda: clock[0])
    assert refusals(rates, "a", 25) == [1] * 5  # ten seconds' worth at once
    assert refusals(rates, "b", 20) == []
    clock[0] = 1.0
    assert len(refusals(rates, "a", 5)) == 3
    clock[0] = 1000.0
    assert len(refusals(rates, "a", 30)) == 10
    assert refusals(Rates(0.01, lambda: 0.0), "a", 2) == [100]


def test_the_seconds_that_are_said_are_enough() -> None:
    clock = [0.0]
    rates = Rates(0.3, lambda: clock[0])
    for _ in range(20):
        waits = refusals(rates, "a", 10)
        clock[0] += waits[-1]
        assert refusals(rates, "a", 1) == []


def test_senders_that_went_away_are_forgotten() -> None:
    clock = [0.0]
    rates = Rates(1.0, lambda: clock[0])
    for number in range(3 * MOST_SENDERS):
        clock[0] += 0.01
        rates.count_request(str(number))
    assert len(rates._buckets) <= MOST_SENDERS


def test_what_computes_is_counted_by_token_and_reads_are_not(
    settings: Settings, database: Database, serve: Serve
) -> None:
    tight = settings.model_copy(update={"rate": 0.01})  # one at once, the next in 100 s
    client = serve(create_app(tight))
    before = CALLER.set(Caller("admin", "admin"))  # whose change is audited: a token that is not does not work
    made = [logins.add(database, NewToken(name=name, role="operator"), "admin") for name in ("a", "b")]
    CALLER.reset(before)
    first, second = ({"Authorization": f"Bearer {token.token}"} for token in made)
    assert client.post("/v1/frames", json={}, headers=first).json()["code"] == "observations_invalid"
    last = client.post("/v1/frames", json={}, headers=first)
    assert (last.status_code, last.json()["code"]) == (429, "rate_limited")
    assert 90 <= int(last.headers["retry-after"]) <= 100
    assert client.post("/v1/frames", json={}, headers=second).status_code == 400
    assert [client.get("/v1/robots", headers=first).status_code for _ in range(10)] == [200] * 10
    # Nobody's reads that compute are counted by address.
    assert [client.get("/v1/versions/ver_0/export").status_code for _ in range(2)] == [404, 429]


def test_the_client_comes_again_when_it_was_told_to(settings: Settings, database: Database, serve: Serve) -> None:
    tight = settings.model_copy(update={"rate": 1.0})
    client = serve(create_app(tight))
    points = [{"known_mm": [k, k * k, 0], "measured_mm": [k, k * k, 5]} for k in range(4)]
    with Kilter(str(client.base_url), admin_token(tight)) as kilter:
        for _ in range(12):
            kilter.run(post("/v1/frames", {"points": points}))


@pytest.fixture
def quick(
    settings: Settings, database: Database, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[httpx.Client, dict[str, str]]]:
    """A server that waits for a moment only, on its own connections."""
    monkeypatch.setattr(gate, "GRACE_S", 0.5)
    monkeypatch.setattr(gate, "HEAD_S", 0.5)
    with served(create_app(settings), http=TimedConnection) as client:
        yield client, {"Authorization": f"Bearer {admin_token(settings)}"}


def connected(client: httpx.Client) -> socket.socket:
    return socket.create_connection((client.base_url.host, client.base_url.port or 80), timeout=20)


def dripped(connection: socket.socket, head: bytes, drop: bytes) -> bytes:
    """Send, then a drop now and then until the server has had enough; return what it said."""
    connection.sendall(head)
    connection.settimeout(0.1)
    received, until = b"", time.monotonic() + 20
    while time.monotonic() < until:
        try:
            part = connection.recv(65536)
            if not part:
                break
            received += part
        except TimeoutError:
            try:
                connection.sendall(drop)
            except OSError:
                break
        except ConnectionResetError:
            break
    else:
        pytest.fail("the connection is still open")
    return received


def refusal(received: bytes) -> tuple[bytes, dict[str, Any]]:
    head, _, body = received.partition(b"\r\n\r\n")
    document: dict[str, Any] = json.loads(body)
    return head, document


@pytest.mark.parametrize(
    "head", [b"GET /v1/robots HTTP/1.1\r\nHost: localhost\r\nX-A: ", b"G", b"POST /v1/frames HTTP/1.1\r\n"]
)
def test_a_head_that_never_ends_is_refused(quick: tuple[httpx.Client, dict[str, str]], head: bytes) -> None:
    with connected(quick[0]) as connection:
        said, document = refusal(dripped(connection, head, b"a"))
    assert said.startswith(b"HTTP/1.1 408 ")
    assert b"Retry-After: 1" in said
    assert document["code"] == "request_too_slow"


def test_a_connection_on_which_nothing_comes_is_closed(quick: tuple[httpx.Client, dict[str, str]]) -> None:
    with connected(quick[0]) as connection:
        assert connection.recv(100) == b""


def test_the_second_head_on_a_connection_is_watched_too(quick: tuple[httpx.Client, dict[str, str]]) -> None:
    with connected(quick[0]) as connection:
        connection.sendall(b"GET /v1/health/live HTTP/1.1\r\nHost: localhost\r\n\r\n")
        first = b""
        while not first.endswith(b"}}"):  # head and body may come apart
            first += connection.recv(65536)
        assert first.startswith(b"HTTP/1.1 200")
        said, _ = refusal(dripped(connection, b"GET /v1/robots HTTP/1.1\r\nX-A: ", b"a"))
    assert said.startswith(b"HTTP/1.1 408 ")


@pytest.mark.parametrize(
    ("path", "media"),
    [("/v1/frames", "application/json"), ("/v1/robots/from-circles", "text/csv"), ("/v1/robots/x/correct", "text/csv")],
)
def test_a_body_that_drips_is_refused(quick: tuple[httpx.Client, dict[str, str]], path: str, media: str) -> None:
    client, headers = quick
    lines = [f"POST {path} HTTP/1.1", "Host: localhost", f"Authorization: {headers['Authorization']}",
             f"Content-Type: {media}", "Content-Length: 1000000", "", ""]  # fmt: skip
    with connected(client) as connection:
        said, document = refusal(dripped(connection, "\r\n".join(lines).encode(), b" "))
    assert said.startswith(b"HTTP/1.1 408 ")
    assert b"retry-after: 1" in said.lower()
    assert b"connection: close" in said.lower()
    assert document["code"] == "request_too_slow"
    assert client.get("/v1/health/live").status_code == 200


def test_time_in_which_the_server_computes_does_not_count(
    quick: tuple[httpx.Client, dict[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    client, headers = quick
    found = routes.find_frame

    def slowly(frame: NewFrame) -> Frame:
        time.sleep(1.5)
        return found(frame)

    monkeypatch.setattr(routes, "find_frame", slowly)
    points = [{"known_mm": [k, k * k, 0], "measured_mm": [k, k * k, 5]} for k in range(4)]
    assert client.post("/v1/frames", json={"points": points}, headers=headers).status_code == 200
