"""Problem documents become exceptions of their code; what is not a problem document is still explained."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import httpx
import pytest

import kilter_client
from kilter_client import (
    ApiError,
    CalibrationError,
    ConflictError,
    Kilter,
    KilterError,
    NotAuthorisedError,
    NotFoundError,
    ObservationError,
    OptionError,
    PayloadError,
    Prepared,
    RobotError,
    ServerUnreachableError,
    TooFewPosesError,
)
from kilter_client.requests import steps

Answer = Callable[[httpx.Request], httpx.Response]


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """What nobody answers is not asked for again for half a minute."""
    monkeypatch.setattr(steps, "PATIENCE_S", 0.3)


def client(answer: Answer) -> Kilter:
    return Kilter("http://kilter.test", "secret", httpx.MockTransport(answer))


def refusal(status: int, code: str, **more: Any) -> Answer:
    problem = {
        "type": f"urn:kilter:problem:{code}",
        "title": "A title",
        "status": status,
        "detail": "What and what to do.",
        "code": code,
        "context": {"row": 3},
        "request_id": "abc",
    } | more
    return lambda request: httpx.Response(status, content=json.dumps(problem).encode())


@pytest.mark.parametrize(
    ("status", "code", "kind"),
    [
        (400, "robot_invalid", RobotError),
        (400, "observations_invalid", ObservationError),
        (400, "too_few_poses", TooFewPosesError),
        (400, "option_invalid", OptionError),
        (400, "something_new", CalibrationError),
        (401, "token_missing", NotAuthorisedError),
        (401, "token_wrong", NotAuthorisedError),
        (404, "robot_not_found", NotFoundError),
        (409, "campaign_exists", ConflictError),
        (422, "payload_invalid", PayloadError),
        (500, "internal_error", ApiError),
        (503, "not_ready", ApiError),
    ],
)
def test_the_code_makes_the_class(status: int, code: str, kind: type[ApiError]) -> None:
    with client(refusal(status, code)) as kilter, pytest.raises(ApiError) as caught:
        kilter.robots.list()
    error = caught.value
    assert type(error) is kind
    assert (error.code, error.status, error.request_id) == (code, status, "abc")
    assert str(error) == error.detail == "What and what to do."
    assert error.context == {"row": 3}


def test_an_error_is_a_problem_document_again() -> None:
    with client(refusal(404, "robot_not_found")) as kilter, pytest.raises(NotFoundError) as caught:
        kilter.robots.get("arm")
    document = caught.value.to_document()
    assert document["code"] == "robot_not_found"
    assert document["title"] == "A title"
    assert set(document) == {"type", "title", "status", "detail", "code", "context", "request_id"}


@pytest.mark.parametrize("content", [b"<html>Bad gateway</html>", b"[]", b"", b"{}"])
def test_a_refusal_without_a_problem_document(content: bytes) -> None:
    with client(lambda request: httpx.Response(502, content=content)) as kilter, pytest.raises(ApiError) as caught:
        kilter.robots.list()
    assert caught.value.status == 502
    assert "502" in caught.value.detail


def test_another_program_behind_the_address() -> None:
    kilter = client(lambda request: httpx.Response(200, text="<html>"))
    with kilter, pytest.raises(ApiError, match="is KILTER_URL a Kilter server"):
        kilter.robots.list()


@pytest.mark.parametrize("broken", [httpx.ConnectError, httpx.ReadTimeout, httpx.RemoteProtocolError])
def test_no_answer(broken: type[httpx.TransportError]) -> None:
    def answer(request: httpx.Request) -> httpx.Response:
        raise broken("nobody")

    with client(answer) as kilter, pytest.raises(ServerUnreachableError, match=r"http://kilter\.test"):
        kilter.robots.list()


def test_the_token_goes_with_every_request() -> None:
    seen: list[str | None] = []

    def answer(request: httpx.Request) -> httpx.Response:
        seen.append(request.headers.get("authorization"))
        return httpx.Response(200, json={"robots": []})

    with client(answer) as kilter:
        kilter.robots.list()
    assert seen == ["Bearer secret"]


def test_names_are_quoted_in_addresses() -> None:
    paths: list[bytes] = []

    def answer(request: httpx.Request) -> httpx.Response:
        paths.append(request.url.raw_path)
        return httpx.Response(200, json={})

    with client(answer) as kilter:
        kilter.robots.get("../versions?x#y")
    assert paths == [b"/v1/robots/..%2Fversions%3Fx%23y"]


def test_codes_of_the_service_have_their_class() -> None:
    from kilter_client.errors import BY_CODE, from_problem
    from kilter_service.ground.errors import PROBLEMS

    assert set(BY_CODE) <= set(PROBLEMS)
    for code, (status, _) in PROBLEMS.items():
        error = from_problem({"code": code}, status)
        assert error.code == code
        assert status >= 500 or status in (405, 408, 413, 415, 421, 429) or type(error) is not ApiError


def test_what_is_exported() -> None:
    assert sorted(kilter_client.__all__) == kilter_client.__all__
    for name in kilter_client.__all__:
        found = getattr(kilter_client, name)
        assert found.__doc__, name
    exceptions = {e for e in vars(kilter_client.errors).values() if isinstance(e, type) and issubclass(e, KilterError)}
    assert exceptions <= {getattr(kilter_client, name) for name in kilter_client.__all__}


def test_a_busy_server_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    monkeypatch.setattr("kilter_client.requests.connection.time.sleep", waits.append)
    bodies: list[bytes] = []

    def busy_twice(request: httpx.Request) -> httpx.Response:
        bodies.append(request.read())
        if len(bodies) < 3:
            return httpx.Response(503, headers={"Retry-After": "2"}, json={"code": "busy", "detail": "Later."})
        return httpx.Response(201, json={"id": "upl_1", "rows": 1})

    assert (
        client(busy_twice).campaigns.upload("cmp_" + "1" * 16, Prepared(b"q1_deg,x_mm\n1,2\n", "text/csv"))["rows"] == 1
    )
    assert len(set(bodies)) == 1
    assert len(waits) == 2
    assert all(2.0 < seconds <= 2.5 for seconds in waits)


@pytest.mark.parametrize(("code", "tries"), [("busy", 6), ("database_away", 1)])
def test_what_may_have_been_done_is_not_sent_again(monkeypatch: pytest.MonkeyPatch, code: str, tries: int) -> None:
    monkeypatch.setattr("kilter_client.requests.connection.time.sleep", lambda seconds: None)
    asked: list[str] = []

    def away(request: httpx.Request) -> httpx.Response:
        asked.append(request.method)
        return httpx.Response(503, headers={"Retry-After": "1"}, json={"code": code, "detail": "Later."})

    with pytest.raises(ApiError, match="Later"):
        client(away).robots.add({"name": "arm"})
    assert len(asked) == tries


def test_a_server_that_stays_busy_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kilter_client.requests.connection.time.sleep", lambda seconds: None)
    always = httpx.Response(503, headers={"Retry-After": "1"}, json={"code": "busy", "detail": "Later."})
    with pytest.raises(ApiError, match="Later"):
        client(lambda request: always).robots.list()
