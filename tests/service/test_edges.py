"""What a caller is promised beside the answer itself, over a real socket: headers, stops, keys of requests, followers."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager

import httpx
import pytest
from sqlalchemy import select

from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import JobRow, RobotRow
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from kilter_service.web.auth import token as following
from kilter_service.web.auth.token import admin_token
from kilter_service.web.logins import COOKIE, CSRF_HEADER
from tests.service.conftest import Katana, served

JOB = f"job_{1:016x}"


@pytest.fixture
def job(client: httpx.Client, database: Database) -> str:
    """A job that no worker takes, so that its events never end by themselves."""
    client.post("/v1/robots", json=Katana.document).raise_for_status()
    with database.transaction() as session:
        robot = session.execute(select(RobotRow.id)).scalar_one()
        request = {"kind": "identify", "robot": Katana.name, "campaigns": [], "validation": None, "options": {}}
        session.add(JobRow(id=JOB, kind="identify", robot_id=robot, request=request, state="queued"))
    return JOB


def made(client: httpx.Client, name: str, role: str = "operator") -> tuple[str, str]:
    """A token: its id, and what to send."""
    found = client.post("/v1/tokens", json={"name": name, "role": role}).raise_for_status().json()
    return found["id"], found["token"]


@contextmanager
def browser(client: httpx.Client, token: str) -> Iterator[httpx.Client]:
    """Somebody who logged in at the page."""
    with httpx.Client(base_url=client.base_url, timeout=30) as own:
        own.post("/login", data={"token": token}, headers={"Origin": str(client.base_url)})
        assert own.cookies.get(COOKIE)
        page = own.get("/").text
        own.headers[CSRF_HEADER] = page.partition('name="csrf" content="')[2].partition('"')[0]
        yield own


def test_no_answer_is_to_be_guessed_at(client: httpx.Client) -> None:
    asked = (
        client.get("/v1/health"), client.get("/v1/robots"), client.get("/v1/robots/nobody"), client.get("/nowhere"),
        client.post("/v1/robots", content=b"{"), client.get("/v1/robots", headers={"Host": "elsewhere.example"}),
        client.get("/docs"), client.get("/login"), client.get("/metrics"),
    )  # fmt: skip
    for answer in asked:
        assert answer.headers.get_list("x-content-type-options") == ["nosniff"], answer.request.url


def test_a_request_that_a_stop_cuts_off_is_answered_503(settings: Settings, database: Database) -> None:
    with ExitStack() as server, ThreadPoolExecutor(1) as pool:
        client = server.enter_context(served(create_app(settings), timeout_graceful_shutdown=1))
        with socket.create_connection((client.base_url.host, client.base_url.port), timeout=20) as open_:
            head = (
                f"POST /v1/robots HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {admin_token(settings)}\r\n"
                "Content-Type: application/json\r\nContent-Length: 1000\r\n\r\n{"
            )
            open_.sendall(head.encode())
            time.sleep(0.3)
            answered = pool.submit(_read, open_)
            server.close()  # it is asked to stop here
            answer = answered.result()
    top, _, body = answer.partition(b"\r\n\r\n")
    assert top.startswith(b"HTTP/1.1 503 "), answer
    assert b"retry-after: 1" in top.lower()
    assert json.loads(body)["code"] == "stopping"


def _read(open_: socket.socket) -> bytes:
    out = b""
    while part := open_.recv(65536):
        out += part
        head, _, body = out.partition(b"\r\n\r\n")
        length = [line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:")]
        if length and len(body) >= int(length[0].partition(b":")[2]):
            break
    return out


def test_keys_of_requests_are_the_persons(client: httpx.Client) -> None:
    client.post("/v1/robots", json=Katana.document).raise_for_status()
    url, key = "/v1/robots/katana/campaigns", {"Idempotency-Key": "same"}
    (_, one), (_, other) = made(client, "one"), made(client, "other")
    with browser(client, one) as first, browser(client, other) as second:
        mine = first.post(url, json={"name": "mine"}, headers=key)
        theirs = second.post(url, json={"name": "theirs"}, headers=key)
        assert (mine.status_code, theirs.status_code) == (201, 201)
        assert mine.json()["id"] != theirs.json()["id"]
        assert second.post(url, json={"name": "theirs"}, headers=key).json()["id"] == theirs.json()["id"]
    by_header = client.post(url, json={"name": "mine"}, headers={**key, "Authorization": f"Bearer {one}"})
    assert by_header.json()["id"] == mine.json()["id"]  # the same person, by another way


@pytest.mark.parametrize("logged_in", [False, True], ids=["token", "login"])
def test_who_follows_is_cut_off_within_a_second_of_the_revocation(
    client: httpx.Client, job: str, logged_in: bool
) -> None:
    token_id, token = made(client, "watcher", "viewer")
    with ExitStack() as stack:
        own = stack.enter_context(browser(client, token)) if logged_in else client
        headers = {} if logged_in else {"Authorization": f"Bearer {token}"}
        stream = stack.enter_context(own.stream("GET", f"/v1/jobs/{job}/events", headers=headers))
        lines = stream.iter_lines()
        assert next(lines).startswith("id: ")
        with httpx.Client(base_url=client.base_url, headers=client.headers, timeout=60) as admin:
            admin.delete(f"/v1/tokens/{token_id}").raise_for_status()
        began = time.monotonic()
        told = list(lines)  # ends by itself
        assert time.monotonic() - began < 10  # the job itself never ends
    assert told[-2:] == ['data: {"code": "token_ended"}', ""]
    refused = client.get(f"/v1/jobs/{job}/events", headers={"Authorization": f"Bearer {token}"})
    assert refused.json()["code"] == "token_ended"


def test_one_token_follows_only_so_much(client: httpx.Client, job: str) -> None:
    (_, token), (_, other) = made(client, "greedy", "viewer"), made(client, "modest", "viewer")
    limits = httpx.Limits(max_connections=None)
    with httpx.Client(base_url=client.base_url, limits=limits, timeout=30) as own, ExitStack() as stack:
        ask = {"method": "GET", "url": f"/v1/jobs/{job}/events", "headers": {"Authorization": f"Bearer {token}"}}
        open_ = [stack.enter_context(own.stream(**ask)) for _ in range(following.MOST)]
        assert {one.status_code for one in open_} == {200}
        lines = [one.iter_lines() for one in open_]  # kept: one that is forgotten closes its connection
        assert all(next(one).startswith("id: ") for one in lines)
        refused = own.send(own.build_request(**ask), stream=True)
        refused.read() if refused.status_code == 429 else refused.close()
        assert (refused.status_code, refused.json()["code"]) == (429, "too_many_followers")
        assert "Retry-After" in refused.headers
        third = own.stream("GET", ask["url"], headers={"Authorization": f"Bearer {other}"})
        assert stack.enter_context(third).status_code == 200
        open_[0].close()
        deadline = time.monotonic() + 20
        while time.monotonic() < deadline:
            with own.stream(**ask) as again:
                if again.status_code == 200:
                    return
            time.sleep(0.1)
    pytest.fail("a place that became free was not given again")
