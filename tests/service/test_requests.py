"""What a request may cost before and while it is answered: its token, its length, its turn, and the thread it runs in."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from fastapi.routing import APIRoute
from starlette.types import ASGIApp, Receive, Scope, Send

from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.robots import routes as robot_routes
from kilter_service.run import app as application
from kilter_service.run.app import create_app
from kilter_service.web import bodies
from kilter_service.web.auth.token import admin_token
from kilter_service.web.routing import GuardedRoute

Serve = Callable[[FastAPI], httpx.Client]
# Reads are what the contract calls so; each of them only looks up what is stored.
OPEN = {
    "GET /v1/health", "GET /v1/health/live", "GET /v1/health/ready",
    "GET /v1/robots", "GET /v1/robots/{robot}", "GET /v1/robots/{robot}/acceptance", "GET /v1/instruments",
    "GET /v1/robots/{robot}/campaigns", "GET /v1/robots/{robot}/meshes",
    "GET /v1/robots/{robot}/meshes/{link}", "GET /v1/robots/{robot}/urdf-shapes", "GET /v1/campaigns/{campaign}",
    "GET /v1/jobs", "GET /v1/jobs/{job}", "GET /v1/jobs/{job}/events",
    "GET /v1/fleet-jobs", "GET /v1/fleet-jobs/{fleet_job}",
    "GET /v1/robots/{robot}/versions", "GET /v1/robots/{robot}/activations", "GET /v1/robots/{robot}/today",
    "GET /v1/robots/{robot}/bridges",
    "GET /v1/robots/{robot}/drift", "GET /v1/drift",
    "GET /v1/versions/{version}",
    "GET /v1/versions/{a}/diff/{b}", "GET /v1/versions/{version}/export",
    "GET /v1/versions/{version}/residuals", "GET /v1/resolve", "GET /v1/tombstones",
    "GET /v1/campaigns/{campaign}/suspicious", "GET /v1/campaigns/{campaign}/observations",
    "GET /v1/versions/{version}/preview", "GET /v1/whoami", "GET /metrics",
}  # fmt: skip
POINTS = [{"known_mm": [k, k * k, 0], "measured_mm": [k, k * k, 5]} for k in range(4)]


@pytest.fixture
def small(settings: Settings) -> Settings:
    changes = {"max_upload_mb": 2, "max_document_mb": 1, "max_requests": 2, "max_computing": 1}
    return settings.model_copy(update=changes)


@pytest.fixture
def limited(small: Settings, database: Database, serve: Serve) -> httpx.Client:
    client = serve(create_app(small))
    client.headers["Authorization"] = f"Bearer {admin_token(small)}"
    return client


def head(client: httpx.Client, path: str, *lines: str, token: bool = True) -> bytes:
    authorization = [f"Authorization: {client.headers['Authorization']}"] if token else []
    return "\r\n".join([f"POST {path} HTTP/1.1", "Host: localhost", *authorization, *lines, "", ""]).encode()


def answer_to(client: httpx.Client, sent: bytes) -> dict[str, Any]:
    """Send bytes, and no more of what they announce; return the problem that comes back."""
    with socket.create_connection((client.base_url.host, client.base_url.port or 80), timeout=20) as connection:
        connection.sendall(sent)
        received = b""
        while b"\r\n\r\n" not in received or not received.endswith(b"}"):
            part = connection.recv(65536)
            if not part:
                break
            received += part
    found: dict[str, Any] = json.loads(received.partition(b"\r\n\r\n")[2])
    return found


def test_every_route_is_a_plain_read_or_needs_the_token(settings: Settings, database: Database, serve: Serve) -> None:
    app = create_app(settings)
    client = serve(app)
    routes = {(m.upper(), path) for path, methods in app.openapi()["paths"].items() for m in methods}
    assert len(routes) > 25
    for method, path in sorted(routes):
        answer = client.request(method, path.replace("{", "").replace("}", ""))
        if f"{method} {path}" in OPEN:
            assert answer.status_code != 401, (method, path)
        else:
            assert (answer.status_code, answer.json()["code"]) == (401, "token_missing"), (method, path)
    assert {f"{method} {path}" for method, path in routes} >= OPEN


def test_every_router_makes_guarded_routes() -> None:
    for router in (*application.ROUTERS, application.health):
        assert all(isinstance(route, GuardedRoute) for route in router.routes if isinstance(route, APIRoute))


def test_each_route_is_built_once_for_all_applications(settings: Settings) -> None:
    """An application that includes routers builds their routes again, each at its first requests."""
    routers = (*application.ROUTERS, *application.PAGE, application.health, application.docs_page)
    made = {id(route) for router in routers for route in router.routes}
    for app in (create_app(settings), create_app(settings)):
        assert made <= {id(route) for route in app.routes}


def test_reads_beyond_this_machine_need_the_token_too(settings: Settings, database: Database, serve: Serve) -> None:
    client = serve(create_app(settings.model_copy(update={"host": "0.0.0.0"})))
    assert client.get("/v1/robots").status_code == 401
    assert client.get("/v1/health/live").status_code == 200


@pytest.mark.parametrize("path", ["/v1/robots/check", "/v1/campaigns/x/observations", "/v1/robots/x/correct"])
def test_without_a_token_no_body_is_waited_for(limited: httpx.Client, path: str) -> None:
    sent = head(limited, path, "Content-Type: application/json", "Content-Length: 1000", token=False)
    assert answer_to(limited, sent)["code"] == "token_missing"


def campaign(client: httpx.Client) -> str:
    client.post("/v1/robots", json={"name": "arm", "convention": "preset", "preset": "ur10"}).raise_for_status()
    return str(
        client.post("/v1/robots/arm/campaigns", json={"name": "c", "numbered": True}).raise_for_status().json()["id"]
    )


def uploads(client: httpx.Client) -> list[tuple[str, str, int]]:
    """Routes that take a body, its type and their limit (MB)."""
    files = [f"/v1/campaigns/{campaign(client)}/observations", "/v1/robots/arm/correct", "/v1/robots/from-circles"]
    documents = ["/v1/robots", "/v1/robots/check", "/v1/robots/convert?to=dh", "/v1/robots/arm/campaigns", "/v1/jobs",
                 "/v1/frames", "/v1/campaigns/x/commit"]  # fmt: skip
    return [(path, "text/csv", 2) for path in files] + [(path, "application/json", 1) for path in documents]


def test_a_length_beyond_the_limit_is_refused_before_a_byte_of_it(limited: httpx.Client) -> None:
    for path, media, most in uploads(limited):
        sent = head(limited, path, f"Content-Type: {media}", f"Content-Length: {(most << 20) + 1}")
        problem = answer_to(limited, sent)
        assert (problem["status"], problem["code"]) == (413, "upload_too_large"), path
        assert problem["context"] == {"limit_mb": most}
        assert ("KILTER_MAX_UPLOAD_MB" if most == 2 else "KILTER_MAX_DOCUMENT_MB") in problem["detail"]


def test_a_body_without_a_length_is_refused_when_it_is_too_long(limited: httpx.Client) -> None:
    """As much as the limit is taken, of a body that would never end."""
    for path, media, most in uploads(limited):
        piece = b"10000\r\n" + b" " * 65536 + b"\r\n"
        sent = head(limited, path, f"Content-Type: {media}", "Transfer-Encoding: chunked")
        problem = answer_to(limited, sent + piece * (16 * most + 1))
        assert (problem["status"], problem["code"]) == (413, "upload_too_large"), path


def test_a_client_that_sends_too_much_reads_why_and_the_remedy_works(
    limited: httpx.Client, small: Settings, serve: Serve
) -> None:
    robot = {"name": "a", "convention": "dh", "rows": [{}], "source": "x" * (2 << 20)}
    assert limited.post("/v1/robots/check", json=robot).json()["code"] == "upload_too_large"
    wide = serve(create_app(small.model_copy(update={"max_document_mb": 3})))
    answer = wide.post("/v1/robots/check", json=robot, headers=limited.headers)
    assert answer.json()["code"] == "payload_invalid"  # read, and found to have too long a source


def test_packed_bodies_are_refused(limited: httpx.Client) -> None:
    for path, media, _ in uploads(limited):
        headers = {"Content-Encoding": "gzip", "Content-Type": media}
        answer = limited.post(path, content=b"\x1f\x8b", headers=headers)
        assert (answer.status_code, answer.json()["code"]) == (415, "media_type_unsupported"), path


def test_a_sender_that_falls_silent_is_let_go(limited: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bodies, "SILENT_S", 0.2)
    sent = head(limited, "/v1/frames", "Content-Type: application/json", "Content-Length: 100")
    assert answer_to(limited, sent + b'{"points"')["code"] == "upload_incomplete"


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b"[" * 100_000, "nested deeper than 32 levels"),
        (b'{"a":' * 100_000, "nested deeper than 32 levels"),
        (b"[" + b"{}," * 250_000 + b"{}]", "more than 200000"),
        (b"{", "not JSON"),
        (b"\xff", "not JSON"),
        (b'{"points": NaN}', "holds NaN"),
        (b"1" * 10_000, "not JSON"),
        (json.dumps({f"k{k}": 0 for k in range(2000)}).encode(), "2000 fields"),
        (json.dumps({"points": [{}] * 10_001}).encode(), "at most 10000 items"),
        (json.dumps({"points": [{"known_mm": ["x"] * 3}] * 5000}).encode(), "more"),
    ],
)
def test_documents_of_a_wrong_shape_get_a_short_refusal(limited: httpx.Client, body: bytes, said: str) -> None:
    answer = limited.post("/v1/frames", content=body, headers={"Content-Type": "application/json"})
    assert (answer.status_code, answer.json()["code"]) == (422, "payload_invalid"), answer.text
    assert said in answer.json()["detail"]
    assert len(answer.content) < 20_000


def test_a_refusal_repeats_no_long_text(limited: httpx.Client) -> None:
    campaign(limited)
    long = "x" * 500_000
    for body in (
        {"kind": "identify", "robot": "arm", "options": {long: 1}},
        {"kind": "identify", "robot": "arm", "options": {"effects": [long]}},
        {"kind": long, "robot": "arm"},
        {"kind": "identify", "robot": "arm", "campaigns": ["c"] * 5000},
    ):
        answer = limited.post("/v1/jobs", json=body)
        assert 400 <= answer.status_code < 500
        assert len(answer.content) < 30_000


class Held:
    """A computation that waits until it is let go, and counts how many are in it."""

    def __init__(self) -> None:
        self.go, self.inside, self.most, self._lock = threading.Event(), 0, 0, threading.Lock()

    def __call__(self, *_: Any) -> Any:
        with self._lock:
            self.inside += 1
            self.most = max(self.most, self.inside)
        assert self.go.wait(60)
        with self._lock:
            self.inside -= 1
        return {"pose": {}, "rms_mm": 0.0, "points": []}


@pytest.fixture
def held(monkeypatch: pytest.MonkeyPatch) -> Iterator[Held]:
    held = Held()
    monkeypatch.setattr(robot_routes, "find_frame", held)
    yield held
    held.go.set()


def test_too_many_requests_wait_their_turn_or_are_sent_away(
    small: Settings, database: Database, serve: Serve, held: Held, until: Callable[..., None]
) -> None:
    """Of two that are inside one computes; the third goes away; reads and health go on."""
    app = create_app(small)
    client = serve(app)
    client.headers["Authorization"] = f"Bearer {admin_token(small)}"
    with ThreadPoolExecutor(2) as pool:
        waiting = [pool.submit(client.post, "/v1/frames", json={"points": POINTS}) for _ in range(2)]
        until(lambda: app.state.rooms["checks"].open.total() == 2 and held.inside == 1, seconds=30)
        refused = client.post("/v1/frames", json={"points": POINTS})
        assert (refused.status_code, refused.json()["code"]) == (503, "busy")
        assert int(refused.headers["retry-after"]) > 0
        assert client.get("/v1/health/live").json()["status"] == "live"
        assert client.get("/v1/robots").status_code == 200
        # Files have turns of their own.
        empty = client.post("/v1/robots/from-circles", content=b"", headers={"Content-Type": "text/csv"})
        assert empty.status_code == 400
        held.go.set()
        assert [answer.result(60).status_code for answer in waiting] == [200, 200]
    assert held.most == 1
    assert client.post("/v1/frames", json={"points": POINTS}).status_code == 200


class Recorder:
    """Notes the thread in which the application's event loop runs."""

    threads: set[int]

    def __init__(self, app: ASGIApp, threads: set[int]) -> None:
        self.app, self.threads = app, threads

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        self.threads.add(threading.get_ident())
        await self.app(scope, receive, send)


def test_nothing_is_parsed_or_computed_on_the_event_loop(
    settings: Settings, database: Database, serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    from kilter_service.campaigns import service as campaigns
    from kilter_service.correction import service as correction
    from kilter_service.ground.tables import reading
    from kilter_service.robots import check
    from kilter_service.robots import documents as resolved
    from kilter_service.robots import service as robots

    loops: set[int] = set()
    seen: dict[str, set[int]] = {}

    def watch(module: Any, name: str) -> None:
        real = getattr(module, name)

        def watched(*args: Any, **kwargs: Any) -> Any:
            seen.setdefault(f"{module.__name__}.{name}", set()).add(threading.get_ident())
            return real(*args, **kwargs)

        monkeypatch.setattr(module, name, watched)

    watched = [
        (bodies, "_parse_json"), (reading, "column_names"), (campaigns, "upload"), (correction, "correct"),
        (check, "check"), (robot_routes, "found_robot"), (resolved, "convert"), (robots, "add"), (robot_routes, "find_frame"),
    ]  # fmt: skip
    for module, name in watched:
        watch(module, name)
    app = create_app(settings)
    app.add_middleware(Recorder, threads=loops)
    client = serve(app)
    client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
    robot = {"name": "arm", "convention": "preset", "preset": "ur10"}
    for path in ("/v1/robots", "/v1/robots/check", "/v1/robots/convert?to=dh"):
        client.post(path, json=robot)
    client.post("/v1/frames", json={"points": POINTS})
    for path in (f"/v1/campaigns/{campaign(client)}/observations", "/v1/robots/arm/correct", "/v1/robots/from-circles"):
        client.post(path, content=b"q1_deg\n1\n", headers={"Content-Type": "text/csv"})
    assert len(loops) == 1
    assert set(seen) == {f"{module.__name__}.{name}" for module, name in watched}
    for name, threads in seen.items():
        assert not threads & loops, name
